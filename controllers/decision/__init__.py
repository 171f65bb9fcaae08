"""Decision makers by name: "keep", the paper's three rules, two stronger rules, and "ddqn"."""

from __future__ import annotations

from controllers.decision.base import DecisionContext, DecisionMaker, Keep
from controllers.decision.observation import ObservationHistory, observation, observe_frame
from iits_mj.core.errors import InputError

NAMES = ("keep", "conservative", "neutral", "aggressive", "mobil", "lookahead", "ddqn")


def make(name: str, weights: str | None = None) -> DecisionMaker:
    """Builds a decision maker.

    Args:
      name: one of `NAMES`.
      weights: file of the "ddqn" policy; default: the shipped one.

    Raises:
      InputError: unknown name, or unusable weights.
    """
    if weights is not None and name != "ddqn":
        raise InputError(f"decision maker {name!r} takes no weights; only 'ddqn' does")
    if name == "keep":
        return Keep()
    if name in ("conservative", "neutral", "aggressive"):
        from controllers.decision.rules import ClearanceRule

        return ClearanceRule(name)
    if name == "mobil":
        from controllers.decision.rules import Mobil

        return Mobil()
    if name == "lookahead":
        from controllers.decision.rules import LookAhead

        return LookAhead()
    if name == "ddqn":
        from controllers.decision.policy import load_policy

        return load_policy(weights)
    raise InputError(f"decision maker {name!r} is unknown; allowed are: {', '.join(NAMES)}")


__all__ = [
    "NAMES",
    "DecisionContext",
    "DecisionMaker",
    "Keep",
    "ObservationHistory",
    "make",
    "observation",
    "observe_frame",
]
