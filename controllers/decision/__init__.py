"""Decision makers by name: "keep", the paper's three rules, two stronger rules, and "ddqn"."""

from __future__ import annotations

from typing import Any

from controllers.decision.base import DecisionContext, Keep
from controllers.decision.observation import ObservationHistory, observation, observe_frame
from controllers.decision.prices import Prices
from controllers.own_parts import DECISION, guarded_decision
from controllers.protocols import DecisionMaker
from iits_mj.core.errors import InputError

NAMES = DECISION.shipped


def make(
    name: Any, weights: str | None = None, prices: Prices | None = None, **offered: Any
) -> DecisionMaker:
    """Returns a decision maker.

    Args:
      name: one of `NAMES`, with options as `lookahead:horizon=30:change_cost=25`; or the user's
        own, see `iits_mj.core.own_parts`.
      weights: file of the "ddqn" policy; default: the shipped one.
      prices: of lane changes, for the policy for every price; None for the paper's policy.
      **offered: arguments that a user's class may ask for.

    Raises:
      InputError: the name is unknown, the weights are unusable, or the part does not fit.
    """
    if weights is not None and name != "ddqn":
        raise InputError(f"decision maker {name!r} takes no weights; only 'ddqn' does")
    if prices is not None and name != "ddqn":
        raise InputError(f"decision maker {name!r} takes no prices; only 'ddqn' does")
    own = DECISION.make(name, **offered)
    if own is not None:
        return guarded_decision(own)
    if name == "keep":
        return Keep()
    if name == "ddqn" and prices is not None:
        from controllers.decision.priced import PricedNetwork, PricedPolicy

        return PricedPolicy(PricedNetwork.load(weights), prices)
    if name == "ddqn":
        from controllers.decision.policy import load_policy

        return load_policy(weights)
    from controllers.decision import rules

    if name == "mobil":
        return rules.Mobil()
    return rules.LookAhead() if name == "lookahead" else rules.ClearanceRule(name)


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
