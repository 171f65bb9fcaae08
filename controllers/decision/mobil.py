"""MOBIL for a truck: change where it gains speed and costs the others little.

Kesting, Treiber and Helbing, General lane-changing model MOBIL, TRR 1999 (2007): safety criterion
on the new follower's deceleration, incentive with politeness, bias to the right lane. The truck is
slow to use a gain, so its accelerations are those of the IDM at the speeds that the lanes offer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.decision.base import DecisionContext
from controllers.decision.lanes import LaneView
from controllers.following import FollowingConfig, idm_acceleration
from controllers.safety import SafetyConfig, front_gap_needed, rear_gap_needed
from controllers.surroundings import Neighbor
from iits_mj.messages import Decision

CAR = FollowingConfig(time_gap=1.2, standstill_gap=2.0, acceleration_max=1.5, deceleration=2.0)
TRUCK = FollowingConfig(time_gap=1.5, standstill_gap=4.0, acceleration_max=0.8, deceleration=1.3)


@dataclass(frozen=True)
class MobilConfig:
    """Parameters of MOBIL.

    Attributes:
      politeness: weight of what the others lose, 0 to 1.
      threshold: gain that is worth a change [m/s2].
      right_bias: favors the lane on the right [m/s2].
      safe_deceleration: that a new follower may be made to brake with, positive [m/s2].
    """

    politeness: float = 0.2
    threshold: float = 0.15
    right_bias: float = 0.12
    safe_deceleration: float = 1.5


class Mobil:
    """MOBIL with the truck's parameters, and the planner's gaps as a further safety criterion."""

    name = "mobil"

    def __init__(self, config: MobilConfig | None = None) -> None:
        self.config = config or MobilConfig()
        self.safety = SafetyConfig()

    def reset(self) -> None:
        """Has no memory."""

    def decide(self, context: DecisionContext) -> Decision:
        """The side with the greatest incentive above the threshold, else KEEP."""
        view = LaneView(context)
        best, choice = 0.0, Decision.KEEP
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = context.lane - int(side)
            if not context.may_use(lane):
                continue
            gain = self._incentive(context, view, lane)
            gain += self.config.right_bias * int(side) - self.config.threshold
            if gain > best:
                best, choice = gain, side
        return choice

    def _incentive(self, context: DecisionContext, view: LaneView, lane: int) -> float:
        """Own gain less the others' loss [m/s2]; minus infinity when it is not safe."""
        speed, desired = context.scene.ego.speed, context.reference_speed
        old, new = view.leader(context.lane), view.leader(lane)
        behind_new, behind_old = view.follower(lane), view.follower(context.lane)
        if not gaps_allow(speed, new, behind_new, self.safety):
            return -math.inf
        length = context.scene.footprint.length
        own = _acceleration(speed, desired, new, TRUCK) - _acceleration(speed, desired, old, TRUCK)
        loss = 0.0
        if behind_new is not None:
            v = behind_new.vehicle.speed
            wish = max(v, desired)
            with_truck = idm_acceleration(v, wish, behind_new.gap, speed, CAR)
            if with_truck < -self.config.safe_deceleration:
                return -math.inf
            free = math.inf if new is None else behind_new.gap + length + new.gap
            ahead = 0.0 if new is None else new.vehicle.speed
            loss += idm_acceleration(v, wish, free, ahead, CAR) - with_truck
        if behind_old is not None and behind_old.gap > 0.0:
            v = behind_old.vehicle.speed
            wish = max(v, desired)
            free = math.inf if old is None else behind_old.gap + length + old.gap
            ahead = 0.0 if old is None else old.vehicle.speed
            loss -= idm_acceleration(v, wish, free, ahead, CAR) - idm_acceleration(
                v, wish, behind_old.gap, speed, CAR
            )
        return own - self.config.politeness * loss


def gaps_allow(
    speed: float, leader: Neighbor | None, follower: Neighbor | None, safety: SafetyConfig
) -> bool:
    """Whether the planner's safety gaps are there at both ends."""
    if leader is not None and leader.gap < front_gap_needed(speed, leader.vehicle.speed, safety):
        return False
    return follower is None or follower.gap >= rear_gap_needed(
        speed, follower.vehicle.speed, safety
    )


def _acceleration(
    speed: float, desired: float, leader: Neighbor | None, config: FollowingConfig
) -> float:
    if leader is None:
        return idm_acceleration(speed, desired, math.inf, 0.0, config)
    return idm_acceleration(speed, desired, leader.gap, leader.vehicle.speed, config)
