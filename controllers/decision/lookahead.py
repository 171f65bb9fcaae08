"""Look ahead: short rollouts of both lanes, and the lane that is faster wins.

In each lane the truck follows that lane's leader by the IDM for some seconds, everybody else goes
on at constant speed. What counts is the way made, the cost of a change, and a small reward for the
right lane; a change must leave the planner's safety gaps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.decision.base import DecisionContext
from controllers.decision.lanes import LaneView
from controllers.decision.mobil import TRUCK, gaps_allow
from controllers.following import idm_acceleration
from controllers.safety import SafetyConfig
from controllers.surroundings import Neighbor
from iits_mj.messages import Decision


@dataclass(frozen=True)
class LookAheadConfig:
    """Settings of the rollouts.

    Attributes:
      horizon: [s]; step: [s].
      change_cost: way that a change must gain over the horizon [m].
      right_gain: way that the right lane is worth [m]; below change_cost, or it would be left
        and come back to for nothing.
    """

    horizon: float = 14.0
    step: float = 0.5
    change_cost: float = 9.0
    right_gain: float = 2.0


class LookAhead:
    """Chooses the lane in which the truck comes farthest."""

    name = "lookahead"

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        self.config = config or LookAheadConfig()
        self.safety = SafetyConfig()

    def reset(self) -> None:
        """Has no memory."""

    def decide(self, context: DecisionContext) -> Decision:
        """The side whose lane leads farther by more than a change costs, else KEEP."""
        view = LaneView(context)
        best = self._way(context, view.leader(context.lane))
        choice = Decision.KEEP
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = context.lane - int(side)
            if not context.may_use(lane):
                continue
            leader, follower = view.leader(lane), view.follower(lane)
            if not gaps_allow(context.scene.ego.speed, leader, follower, self.safety):
                continue
            way = self._way(context, leader) - self.config.change_cost
            way += self.config.right_gain * int(side)
            if way > best:
                best, choice = way, side
        return choice

    def _way(self, context: DecisionContext, leader: Neighbor | None) -> float:
        """Way over the horizon behind a leader [m]."""
        speed, way, step = context.scene.ego.speed, 0.0, self.config.step
        gap = math.inf if leader is None else leader.gap
        ahead = 0.0 if leader is None else leader.vehicle.speed
        for _ in range(round(self.config.horizon / step)):
            a = idm_acceleration(speed, context.reference_speed, gap, ahead, TRUCK)
            nxt = max(0.0, speed + max(a, -6.0) * step)
            moved = 0.5 * (speed + nxt) * step
            way += moved
            gap += ahead * step - moved
            speed = nxt
        return way
