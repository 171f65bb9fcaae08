"""The paper's three rule baselines: conservative, neutral, aggressive."""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.decision.base import DecisionContext
from controllers.planning.following import FollowingConfig, idm_acceleration
from controllers.planning.safety import SafetyConfig, front_gap_needed, rear_gap_needed
from controllers.planning.surroundings import INTRUSION, Neighbor
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, TrackedVehicle

# --- What drives in which lane around the truck, for the rules: bumper gaps along the route ---


class LaneView:
    """Leaders and followers by lane index.

    A vehicle belongs to a lane while its body reaches 0.3 m or more into it; vehicles that are on
    no lane of the route (lane -1) are left out. Reach is 250 m ahead and behind.
    """

    REACH = 250.0

    def __init__(self, context: DecisionContext) -> None:
        self.context = context
        scene = context.scene
        self.front = scene.ego.station + scene.footprint.front_overhang
        self.rear = self.front - scene.footprint.length
        self._by_lane: dict[int, list[Neighbor]] = {}

    def vehicles(self, lane: int) -> list[Neighbor]:
        """All vehicles of a lane with their gaps, negative beside the truck."""
        if lane not in self._by_lane:
            self._by_lane[lane] = [
                Neighbor(vehicle, self._gap(vehicle))
                for vehicle in self.context.scene.vehicles
                if vehicle.lane >= 0 and self._in_lane(vehicle, lane)
            ]
        return self._by_lane[lane]

    def leader(self, lane: int) -> Neighbor | None:
        """Nearest vehicle whose middle is ahead of the truck's front bumper."""
        ahead = [n for n in self.vehicles(lane) if n.vehicle.station > self.front]
        return min(ahead, key=lambda n: n.gap, default=None)

    def follower(self, lane: int) -> Neighbor | None:
        """Nearest vehicle whose middle is behind the truck's front, those beside included."""
        behind = [n for n in self.vehicles(lane) if n.vehicle.station <= self.front]
        return min(behind, key=lambda n: n.gap, default=None)

    def is_free(self, lane: int, distance: float) -> bool:
        """True when nothing in the lane is nearer than a bumper gap, ahead, beside or behind."""
        return all(neighbor.gap >= distance for neighbor in self.vehicles(lane))

    def _gap(self, vehicle: TrackedVehicle) -> float:
        ahead = vehicle.station - 0.5 * vehicle.length - self.front
        behind = self.rear - vehicle.station - 0.5 * vehicle.length
        return max(ahead, behind)

    def _in_lane(self, vehicle: TrackedVehicle, lane: int) -> bool:
        if abs(vehicle.station - self.front) > self.REACH:
            return False
        route = self.context.route
        middle = float(route.lane_offset(lane, vehicle.station))
        half = 0.5 * float(route.lane_width(lane, vehicle.station))
        return abs(vehicle.offset - middle) < half + 0.5 * vehicle.width - INTRUSION


# --- The paper's three rule baselines: conservative, neutral, aggressive ---

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


# --- MOBIL for a truck: change where it gains speed and costs the others little ---
# Kesting, Treiber and Helbing, General lane-changing model MOBIL, TRR 1999 (2007): safety criterion
# on the new follower's deceleration, incentive with politeness, bias to the right lane. The truck
# is slow to use a gain, so its accelerations are those of the IDM at the speeds that the lanes
# offer.

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


# --- Look ahead: short rollouts of both lanes, and the lane that is faster wins ---
# In each lane the truck follows that lane's leader by the IDM for some seconds, everybody else goes
# on at constant speed. What counts is the way made, the cost of a change, and a small reward for
# the right lane; a change must leave the planner's safety gaps.


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
