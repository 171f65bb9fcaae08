"""The trained policy as a decision maker; needs numpy only."""

from __future__ import annotations

from pathlib import Path

from controllers.decision.base import DecisionContext
from controllers.decision.network import QNetwork
from iits_mj.messages import Decision

SHIPPED = Path(__file__).resolve().parent / "weights" / "ddqn.npz"


class GreedyPolicy:
    """Decides for the action of greatest value; lanes that do not exist are not left to chance.

    Attributes:
      network: of the action values.
      name: "ddqn".
    """

    def __init__(self, network: QNetwork) -> None:
        self.network = network
        self.name = "ddqn"

    def reset(self) -> None:
        """Has no memory of its own: the observation holds the last three seconds."""

    def decide(self, context: DecisionContext) -> Decision:
        """The greedy decision; KEEP where it points to a lane the truck may not use."""
        decision = self.network.greedy(context.observation)
        if decision is not Decision.KEEP and not context.may_use(context.lane - int(decision)):
            return Decision.KEEP
        return decision


def load_policy(path: str | Path | None = None) -> GreedyPolicy:
    """The policy of a weights file; default: the shipped one.

    Raises:
      InputError: the file is missing, damaged, of another shape, or for another observation.
    """
    return GreedyPolicy(QNetwork.load(SHIPPED if path is None else path))
