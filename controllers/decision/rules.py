"""Rules that decide on lane changes: the paper's three baselines, MOBIL, and look-ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.decision.base import DecisionContext
from controllers.planning.config import FollowingConfig, SafetyConfig
from controllers.planning.following import idm_acceleration
from controllers.planning.safety import front_gap_needed, rear_gap_needed
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.core.neighbors import Neighbor

CLEARANCE = {"conservative": 150.0, "neutral": 100.0, "aggressive": 50.0}
CAR = FollowingConfig(time_gap=1.2, standstill_gap=2.0, acceleration_max=1.5, deceleration=2.0)
TRUCK = FollowingConfig(time_gap=1.5, standstill_gap=4.0, acceleration_max=0.8, deceleration=1.3)
# Hardest braking in a roll-out, positive [m/s2].
_HARDEST = 6.0


def _leader(context: DecisionContext, lane: int) -> Neighbor | None:
    return context.scene.neighbors.leader_in_lane(context.route, lane)


def _follower(context: DecisionContext, lane: int) -> Neighbor | None:
    return context.scene.neighbors.follower_in_lane(context.route, lane)


class Rule:
    """A decision maker without memory."""

    def reset(self) -> None:
        """Has no memory."""


class ClearanceRule(Rule):
    """Changes lanes when the leader is closer than d and the other lane is free for d both ways.

    Distances are bumper gaps of the whole combination. The left lane is checked first, then the
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

    def decide(self, context: DecisionContext) -> Decision:
        """LEFT or RIGHT when the rule asks for it, else KEEP."""
        leader = _leader(context, context.lane)
        if leader is None or leader.gap >= self.clearance:
            return Decision.KEEP
        neighbors, route = context.scene.neighbors, context.route
        for side, lane in context.sides():
            if neighbors.is_lane_free(route, lane, self.clearance):
                return side
        return Decision.KEEP


@dataclass(frozen=True)
class MobilConfig:
    """Parameters of MOBIL.

    Attributes:
      politeness: weight of the others' loss, 0 to 1.
      threshold: gain that is worth a change [m/s2].
      right_bias: favors the lane on the right [m/s2].
      safe_deceleration: most that a new follower may have to brake, positive [m/s2].
    """

    politeness: float = 0.2
    threshold: float = 0.15
    right_bias: float = 0.12
    safe_deceleration: float = 1.5


class Mobil(Rule):
    """MOBIL for a truck: change where it gains acceleration and costs the others little.

    Kesting, Treiber and Helbing, General lane-changing model MOBIL, TRR 1999 (2007): safety
    criterion on the new follower's deceleration, incentive with politeness, bias to the right lane.
    The truck's accelerations are those of the IDM at the speeds that the lanes offer. The planner's
    gaps are a further safety criterion.
    """

    name = "mobil"

    def __init__(self, config: MobilConfig | None = None) -> None:
        self.config = config or MobilConfig()
        self.safety = SafetyConfig()

    def decide(self, context: DecisionContext) -> Decision:
        """The side with the greatest incentive above the threshold, else KEEP."""
        best, choice = 0.0, Decision.KEEP
        for side, lane in context.sides():
            gain = self._incentive(context, lane)
            gain += self.config.right_bias * int(side) - self.config.threshold
            if gain > best:
                best, choice = gain, side
        return choice

    def _incentive(self, context: DecisionContext, lane: int) -> float:
        """Own gain less the others' loss [m/s2]; minus infinity when it is not safe."""
        speed, desired = context.scene.ego.speed, context.reference_speed
        old, new = _leader(context, context.lane), _leader(context, lane)
        behind_new, behind_old = _follower(context, lane), _follower(context, context.lane)
        if not gaps_allow(speed, new, behind_new, self.safety):
            return -math.inf
        length = context.scene.footprint.length
        own = _acceleration(speed, desired, new) - _acceleration(speed, desired, old)
        loss = 0.0
        if behind_new is not None:
            with_truck, free = _with_and_without(behind_new, new, speed, desired, length)
            if with_truck < -self.config.safe_deceleration:
                return -math.inf
            loss += free - with_truck
        if behind_old is not None and behind_old.gap > 0.0:
            with_truck, free = _with_and_without(behind_old, old, speed, desired, length)
            loss -= free - with_truck
        return own - self.config.politeness * loss


def _with_and_without(
    follower: Neighbor, leader: Neighbor | None, speed: float, desired: float, length: float
) -> tuple[float, float]:
    """A follower's accelerations behind the truck, and behind the truck's leader instead [m/s2]."""
    own, wish = follower.speed, max(follower.speed, desired)
    gap = math.inf if leader is None else follower.gap + length + leader.gap
    ahead = 0.0 if leader is None else leader.speed
    with_truck = idm_acceleration(own, wish, follower.gap, speed, CAR)
    return with_truck, idm_acceleration(own, wish, gap, ahead, CAR)


def _acceleration(speed: float, desired: float, leader: Neighbor | None) -> float:
    """The truck's acceleration behind a leader [m/s2]."""
    gap, ahead = (math.inf, 0.0) if leader is None else (leader.gap, leader.speed)
    return idm_acceleration(speed, desired, gap, ahead, TRUCK)


def gaps_allow(
    speed: float, leader: Neighbor | None, follower: Neighbor | None, safety: SafetyConfig
) -> bool:
    """Whether the planner's safety gaps are there at both ends."""
    if leader is not None and leader.gap < front_gap_needed(speed, leader.speed, safety):
        return False
    return follower is None or follower.gap >= rear_gap_needed(speed, follower.speed, safety)


@dataclass(frozen=True)
class LookAheadConfig:
    """Settings of the look-ahead roll-outs.

    Attributes:
      horizon: [s]; step: [s].
      change_cost: distance that a change must gain over the horizon [m].
      right_gain: distance that the right lane is worth [m]; below change_cost, or the truck would
        change there and back for nothing.
    """

    horizon: float = 14.0
    step: float = 0.5
    change_cost: float = 9.0
    right_gain: float = 2.0


class LookAhead(Rule):
    """Chooses the lane in which the truck comes farthest, by short roll-outs of the lanes.

    In each lane the truck follows that lane's leader by the IDM for some seconds, while the others
    keep their speed. The distance driven counts, the cost of a change, and a small reward for the
    right lane; a change must leave the planner's safety gaps.
    """

    name = "lookahead"

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        self.config = config or LookAheadConfig()
        self.safety = SafetyConfig()

    def decide(self, context: DecisionContext) -> Decision:
        """The side whose lane leads farther by more than a change costs, else KEEP."""
        best, choice = self._distance(context, _leader(context, context.lane)), Decision.KEEP
        for side, lane in context.sides():
            leader = _leader(context, lane)
            follower = _follower(context, lane)
            if not gaps_allow(context.scene.ego.speed, leader, follower, self.safety):
                continue
            distance = self._distance(context, leader) - self.config.change_cost
            distance += self.config.right_gain * int(side)
            if distance > best:
                best, choice = distance, side
        return choice

    def _distance(self, context: DecisionContext, leader: Neighbor | None) -> float:
        """Distance over the horizon behind a leader [m]."""
        speed, distance, step = context.scene.ego.speed, 0.0, self.config.step
        gap, ahead = (math.inf, 0.0) if leader is None else (leader.gap, leader.speed)
        for _ in range(round(self.config.horizon / step)):
            a = idm_acceleration(speed, context.reference_speed, gap, ahead, TRUCK)
            after = max(0.0, speed + max(a, -_HARDEST) * step)
            moved = 0.5 * (speed + after) * step
            distance += moved
            gap += ahead * step - moved
            speed = after
        return distance
