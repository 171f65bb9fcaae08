"""The paper's three rule baselines: conservative, neutral, aggressive."""

from __future__ import annotations

from controllers.decision.base import DecisionContext
from controllers.decision.lanes import LaneView
from iits_mj.errors import InputError
from iits_mj.messages import Decision

CLEARANCE = {"conservative": 150.0, "neutral": 100.0, "aggressive": 50.0}


class ClearanceRule:
    """Changes when an obstacle is closer than d and the neighbor lane is free for d both ways.

    Distances are bumper gaps of the whole combination. The left lane is asked first, then the
    right. As in the paper, nothing brings the truck back to the right lane by itself.

    Args:
      name: "conservative", "neutral" or "aggressive": d = 150, 100 or 50 m.

    Raises:
      InputError: another name.
    """

    def __init__(self, name: str) -> None:
        if name not in CLEARANCE:
            raise InputError(f"rule {name!r} is unknown; allowed are: {', '.join(CLEARANCE)}")
        self.name = name
        self.clearance = CLEARANCE[name]

    def reset(self) -> None:
        """Has no memory."""

    def decide(self, context: DecisionContext) -> Decision:
        """LEFT or RIGHT when the rule asks for it, else KEEP."""
        view = LaneView(context)
        leader = view.leader(context.lane)
        if leader is None or leader.gap >= self.clearance:
            return Decision.KEEP
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = context.lane - int(side)
            if context.may_use(lane) and view.is_free(lane, self.clearance):
                return side
        return Decision.KEEP
