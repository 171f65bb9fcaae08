"""Decision makers by name: "keep", the paper's three rules, two stronger rules, and "ddqn"."""

from __future__ import annotations

from controllers.decision.base import DecisionContext, DecisionMaker, Keep
from controllers.decision.observation import ObservationHistory, observation, observe_frame
from iits_mj.core.errors import InputError

NAMES = ("keep", "conservative", "neutral", "aggressive", "mobil", "lookahead", "ddqn")


def make(name: str, weights: str | None = None) -> DecisionMaker:
    """Returns a new decision maker.

    Args:
      name: one of `NAMES`.
      weights: file of the "ddqn" policy; default: the shipped one.

    Raises:
      InputError: the name is unknown, or the weights are unusable.
    """
    if weights is not None and name != "ddqn":
        raise InputError(f"decision maker {name!r} takes no weights; only 'ddqn' does")
    if name == "keep":
        return Keep()
    if name == "ddqn":
        from controllers.decision.policy import load_policy

        return load_policy(weights)
    if name in NAMES:
        from controllers.decision import rules

        if name == "mobil":
            return rules.Mobil()
        return rules.LookAhead() if name == "lookahead" else rules.ClearanceRule(name)
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
