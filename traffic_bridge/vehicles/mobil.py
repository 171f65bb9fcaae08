"""The lane-change model MOBIL with the Intelligent Driver Model, as pure functions.

MOBIL compares the accelerations of the deciding vehicle (c), its new follower (n) and its old
follower (o) before (`a`) and after (`a~`) the change:

    safety      a~_n >= -b_safe, a~_c >= -b_safe, and room for the vehicle
    symmetric   a~_c - a_c + p (a~_n - a_n + a~_o - a_o) > a_th
    keep right  to the right   a~_c^eur - a_c + p (a~_o - a_o) > a_th - a_bias
                to the left    a~_c - a_c^eur + p (a~_n - a_n) > a_th + a_bias

a^eur is the acceleration on the right lane if overtaking on the right is forbidden: the smaller one
of both lanes, if v_c > v of the leader on the left lane > v_crit. Vehicle types with
`keep_right_bias` a_bias = 0 follow the symmetric rule, others the keep-right rule.

Kesting, Treiber and Helbing, "General lane-changing model MOBIL for car-following models",
Transportation Research Record 1999 (2007), 86-94; IDM: Treiber, Hennecke and Helbing, "Congested
traffic states in empirical observations and microscopic simulations", Phys. Rev. E 62 (2000).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from traffic_bridge.vehicles.idm import LEAST_GAP
from traffic_bridge.vehicles.types import VehicleType

CRITICAL_SPEED = 60.0 / 3.6  # [m/s]: v_crit of the paper; below it passing right is allowed
MARGIN = 2.0  # [m] that must be free ahead and behind after a change


@dataclass(frozen=True, slots=True)
class MobilDriver:
    """State and parameters of a vehicle in MOBIL.

    Attributes:
      name: of the vehicle.
      speed, desired_speed: [m/s].
      type: its behavior and length.
      movable: False for vehicles that MOBIL does not control (the ego, stopped vehicles).
    """

    name: str
    speed: float
    desired_speed: float
    type: VehicleType
    movable: bool = True


@dataclass(frozen=True, slots=True)
class LaneNeighbors:
    """The leader and follower of a vehicle on its own lane or on one that it may change to.

    Attributes:
      gap_ahead: from its front bumper to the leader's rear [m]; inf without a leader.
      speed_ahead: of the leader [m/s]; the end of a lane counts as a stopped leader.
      gap_behind: from its rear bumper to the follower's front [m]; inf without a follower.
      follower: the vehicle behind.
    """

    gap_ahead: float = math.inf
    speed_ahead: float = 0.0
    gap_behind: float = math.inf
    follower: MobilDriver | None = None


def idm_acceleration(driver: MobilDriver, gap: float = math.inf, speed_ahead: float = 0.0) -> float:
    """IDM acceleration behind a leader, or on a free road [m/s2]; delta = 4.

    a [1 - (v / v0)^4 - (s* / s)^2] with s* = s0 + max(0, v T + v dv / (2 sqrt(a b))).

    Args:
      driver: the follower.
      gap: to the leader's rear bumper [m]; inf for a free road.
      speed_ahead: of the leader [m/s].
    """
    kind, v = driver.type, driver.speed
    free = 1.0 - (v / max(driver.desired_speed, 0.1)) ** 4
    if gap == math.inf:
        return kind.acceleration * free
    root = 2.0 * math.sqrt(kind.acceleration * kind.deceleration)
    wanted = v * kind.time_headway + v * (v - speed_ahead) / root
    share = (kind.minimum_gap + max(0.0, wanted)) / max(gap, LEAST_GAP)
    return kind.acceleration * (free - share * share)


def incentive(
    driver: MobilDriver, here: LaneNeighbors, there: LaneNeighbors, to_right: bool
) -> float | None:
    """The incentive of a lane change above its threshold [m/s2]; None if it is not safe.

    Args:
      driver: the deciding vehicle.
      here: its neighbors on its own lane.
      there: its neighbors on the target lane.
      to_right: whether the target lane is to the right.
    """
    kind = driver.type
    if there.gap_ahead < MARGIN or there.gap_behind < MARGIN:
        return None
    own_after = idm_acceleration(driver, there.gap_ahead, there.speed_ahead)
    if own_after < -kind.safe_braking:
        return None
    new_follower = 0.0
    if there.follower is not None:
        after = idm_acceleration(there.follower, there.gap_behind, driver.speed)
        if after < -kind.safe_braking:
            return None
        new_follower = after - _behind_the_leader(driver, there)
    old_follower = 0.0
    if here.follower is not None:
        before = idm_acceleration(here.follower, here.gap_behind, driver.speed)
        old_follower = _behind_the_leader(driver, here) - before
    own_before = idm_acceleration(driver, here.gap_ahead, here.speed_ahead)
    if kind.keep_right_bias == 0.0:
        others = new_follower + old_follower
        threshold = kind.change_threshold
    elif to_right:
        others = old_follower
        own_after = _european(driver, own_after, own_before, here)
        threshold = kind.change_threshold - kind.keep_right_bias
    else:
        others = new_follower
        own_before = _european(driver, own_before, own_after, there)
        threshold = kind.change_threshold + kind.keep_right_bias
    return own_after - own_before + kind.politeness * others - threshold


def _behind_the_leader(driver: MobilDriver, lane: LaneNeighbors) -> float:
    """Acceleration of a lane's follower without the driver between it and the leader."""
    assert lane.follower is not None
    gap = lane.gap_behind + driver.type.length + lane.gap_ahead
    return idm_acceleration(lane.follower, gap, lane.speed_ahead)


def _european(driver: MobilDriver, right: float, left: float, left_lane: LaneNeighbors) -> float:
    """Acceleration on the right lane without overtaking the left lane's leader on the right."""
    if left_lane.gap_ahead < math.inf and driver.speed > left_lane.speed_ahead > CRITICAL_SPEED:
        return min(right, left)
    return right
