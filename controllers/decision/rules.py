"""Rules that decide on lane changes: the paper's three baselines, MOBIL and look-ahead."""

from __future__ import annotations

import math

from controllers.decision.base import DecisionContext, Memoryless
from controllers.planning.config import FollowingConfig, SafetyConfig
from controllers.planning.following import idm_acceleration
from controllers.planning.safety import front_gap_needed, rear_gap_needed
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.core.neighbors import Neighbor

CLEARANCE = {"conservative": 150.0, "neutral": 100.0, "aggressive": 50.0}
CAR = FollowingConfig(time_gap=1.2, standstill_gap=2.0, acceleration_max=1.5, deceleration=2.0)
TRUCK = FollowingConfig(time_gap=1.5, standstill_gap=4.0, acceleration_max=0.8, deceleration=1.3)
# Parameters of MOBIL: weight of the others' loss, gain that is worth a change, preference for the
# right lane, and the hardest braking that a new follower may need, positive; the last three [m/s2].
POLITENESS = 0.2
THRESHOLD = 0.15
RIGHT_BIAS = 0.12
SAFE_DECELERATION = 1.5
# Roll-outs of the look-ahead rule: horizon and step [s], distance that a change must gain [m] and
# that the right lane is worth [m]; the latter is less than the former, or the truck would change
# there and back for nothing.
HORIZON, STEP = 14.0, 0.5
CHANGE_COST, RIGHT_GAIN = 9.0, 2.0
# A full service-brake application of a laden truck, positive [m/s2].
HARDEST_BRAKING = 6.0
_SAFETY = SafetyConfig()


def _leader(context: DecisionContext, lane: int) -> Neighbor | None:
    return context.scene.neighbors.leader_in_lane(context.route, lane)


def _follower(context: DecisionContext, lane: int) -> Neighbor | None:
    return context.scene.neighbors.follower_in_lane(context.route, lane)


class ClearanceRule(Memoryless):
    """Changes lanes when the leader is closer than d and the other lane is free for d both ways.

    Distances are bumper gaps of the whole combination. The left lane is checked first, then the
    right. As in the paper, the truck stays in the left lane on a free road.

    Args:
      name: "conservative", "neutral" or "aggressive": d = 150, 100 or 50 m.

    Raises:
      InputError: the name is unknown.
    """

    def __init__(self, name: str) -> None:
        if name not in CLEARANCE:
            raise InputError(f"rule {name!r} is unknown; allowed are: {', '.join(CLEARANCE)}")
        self.name = name
        self.clearance = CLEARANCE[name]

    def decide(self, context: DecisionContext) -> Decision:
        """Returns LEFT or RIGHT when the rule asks for a change, else KEEP."""
        leader = _leader(context, context.lane)
        if leader is None or leader.gap >= self.clearance:
            return Decision.KEEP
        neighbors, route = context.scene.neighbors, context.route
        for side, lane in context.sides():
            if neighbors.is_lane_free(route, lane, self.clearance):
                return side
        return Decision.KEEP


class Mobil(Memoryless):
    """MOBIL for a truck: change where it gains acceleration and costs the others little.

    Kesting, Treiber and Helbing, General lane-changing model MOBIL, TRR 1999 (2007): safety
    criterion on the new follower's deceleration, incentive with politeness, bias to the right lane.
    The truck's accelerations are those of the IDM at the speeds that the lanes offer. The planner's
    gaps are a further safety criterion.
    """

    name = "mobil"

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the side with the greatest incentive above the threshold, else KEEP."""
        best, choice = 0.0, Decision.KEEP
        for side, lane in context.sides():
            gain = _incentive(context, lane)
            gain += RIGHT_BIAS * int(side) - THRESHOLD
            if gain > best:
                best, choice = gain, side
        return choice


def _incentive(context: DecisionContext, lane: int) -> float:
    """Returns the own gain less the others' loss [m/s2]; minus infinity if it is not safe."""
    speed, desired = context.scene.ego.speed, context.reference_speed
    old, new = _leader(context, context.lane), _leader(context, lane)
    behind_new, behind_old = _follower(context, lane), _follower(context, context.lane)
    if not gaps_allow(speed, new, behind_new):
        return -math.inf
    length = context.scene.footprint.length
    own = _acceleration(speed, desired, new) - _acceleration(speed, desired, old)
    loss = 0.0
    if behind_new is not None:
        with_truck, free = _with_and_without(behind_new, new, speed, desired, length)
        if with_truck < -SAFE_DECELERATION:
            return -math.inf
        loss += free - with_truck
    if behind_old is not None and behind_old.gap > 0.0:
        with_truck, free = _with_and_without(behind_old, old, speed, desired, length)
        loss -= free - with_truck
    return own - POLITENESS * loss


def _with_and_without(
    follower: Neighbor, leader: Neighbor | None, speed: float, desired: float, length: float
) -> tuple[float, float]:
    """Returns a follower's accelerations behind the truck and behind the truck's leader [m/s2]."""
    own, wish = follower.speed, max(follower.speed, desired)
    gap = math.inf if leader is None else follower.gap + length + leader.gap
    ahead = 0.0 if leader is None else leader.speed
    with_truck = idm_acceleration(own, wish, follower.gap, speed, CAR)
    return with_truck, idm_acceleration(own, wish, gap, ahead, CAR)


def _acceleration(speed: float, desired: float, leader: Neighbor | None) -> float:
    """Returns the truck's acceleration behind a leader [m/s2]."""
    gap, ahead = (math.inf, 0.0) if leader is None else (leader.gap, leader.speed)
    return idm_acceleration(speed, desired, gap, ahead, TRUCK)


def gaps_allow(speed: float, leader: Neighbor | None, follower: Neighbor | None) -> bool:
    """Returns whether the gaps at both ends are at least the planner's safety gaps."""
    if leader is not None and leader.gap < front_gap_needed(speed, leader.speed, _SAFETY):
        return False
    return follower is None or follower.gap >= rear_gap_needed(speed, follower.speed, _SAFETY)


class LookAhead(Memoryless):
    """Chooses the lane in which the truck comes farthest, by short roll-outs of the lanes.

    In each lane the truck follows the leader by the IDM for some seconds, while the others keep
    their speed. A change costs some distance, and the right lane is worth some; a change must leave
    the planner's safety gaps.
    """

    name = "lookahead"

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the side whose lane leads farther by more than a change costs, else KEEP."""
        best, choice = _roll_out(context, _leader(context, context.lane)), Decision.KEEP
        for side, lane in context.sides():
            leader = _leader(context, lane)
            follower = _follower(context, lane)
            if not gaps_allow(context.scene.ego.speed, leader, follower):
                continue
            distance = _roll_out(context, leader) - CHANGE_COST
            distance += RIGHT_GAIN * int(side)
            if distance > best:
                best, choice = distance, side
        return choice


def _roll_out(context: DecisionContext, leader: Neighbor | None) -> float:
    """Returns the distance that the truck drives over the horizon behind a leader [m]."""
    speed, distance = context.scene.ego.speed, 0.0
    gap, ahead = (math.inf, 0.0) if leader is None else (leader.gap, leader.speed)
    for _ in range(round(HORIZON / STEP)):
        a = idm_acceleration(speed, context.reference_speed, gap, ahead, TRUCK)
        after = max(0.0, speed + max(a, -HARDEST_BRAKING) * STEP)
        moved = 0.5 * (speed + after) * STEP
        distance += moved
        gap += ahead * STEP - moved
        speed = after
    return distance
