"""MOBIL lane changes on top of the Intelligent Driver Model, as pure functions.

Kesting, Treiber and Helbing, "General lane-changing model MOBIL for car-following models",
Transportation Research Record 1999 (2007), 86-94; IDM: Treiber, Hennecke and Helbing, "Congested
traffic states in empirical observations and microscopic simulations", Phys. Rev. E 62 (2000).
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from traffic_bridge.vehicles import VehicleType

FREE_GAP = 1e4  # [m]


@dataclass(frozen=True)
class Driver:
    """A vehicle as MOBIL sees it.

    Attributes:
      name: of the vehicle.
      station: of the front bumper [m]; lane: index from the right.
      speed, desired_speed: [m/s].
      type: its behaviour; movable: False for vehicles that decide elsewhere (the ego).
    """

    name: str
    station: float
    lane: int
    speed: float
    desired_speed: float
    type: VehicleType
    movable: bool = True


def idm_acceleration(driver: Driver, leader: Driver | None) -> float:
    """IDM acceleration behind a leader, or on a free road [m/s2]; delta = 4.

    a [1 - (v / v0)^4 - (s* / s)^2] with s* = s0 + max(0, v T + v dv / (2 sqrt(a b))).
    """
    kind, v = driver.type, driver.speed
    free = 1.0 - (v / max(driver.desired_speed, 0.1)) ** 4
    if leader is None:
        return kind.acceleration * free
    gap = max(leader.station - leader.type.length - driver.station, 0.1)
    root = 2.0 * math.sqrt(kind.acceleration * kind.deceleration)
    wanted = v * kind.time_headway + v * (v - leader.speed) / root
    return kind.acceleration * (free - ((kind.minimum_gap + max(0.0, wanted)) / gap) ** 2)


def neighbors(
    drivers: Sequence[Driver], driver: Driver, lane: int
) -> tuple[Driver | None, Driver | None]:
    """The next vehicle ahead and the next behind on a lane, other than the driver's own."""
    ahead: Driver | None = None
    behind: Driver | None = None
    for other in drivers:
        if other.lane != lane or other.name == driver.name:
            continue
        if other.station >= driver.station:
            if ahead is None or other.station < ahead.station:
                ahead = other
        elif behind is None or other.station > behind.station:
            behind = other
    return ahead, behind


def incentive(
    drivers: Sequence[Driver], driver: Driver, target: int, margin: float = 2.0
) -> float | None:
    """What a change to a neighboring lane gains above its threshold [m/s2]; None if not safe.

    Safety criterion: the new follower need not brake harder than b_safe, and there is room.
    Incentive criterion: (a~_c - a_c) + p [(a~_n - a_n) + (a~_o - a_o)] > a_th, with a bias to the
    right: the threshold is lower by a_bias to the right and higher by it to the left.

    Args:
      drivers: every vehicle near the driver.
      driver: who decides.
      target: lane index.
      margin: least free distance before and behind after the change [m].
    """
    kind = driver.type
    new_leader, new_follower = neighbors(drivers, driver, target)
    if new_leader is not None:
        if new_leader.station - new_leader.type.length - driver.station < margin:
            return None
        if idm_acceleration(driver, new_leader) < -kind.safe_braking:
            return None
    new_after = new_before = 0.0
    if new_follower is not None:
        if driver.station - kind.length - new_follower.station < margin:
            return None
        new_after = idm_acceleration(new_follower, driver)
        new_before = idm_acceleration(new_follower, new_leader)
        if new_after < -kind.safe_braking:
            return None
    old_leader, old_follower = neighbors(drivers, driver, driver.lane)
    own = idm_acceleration(driver, new_leader) - idm_acceleration(driver, old_leader)
    old = 0.0
    if old_follower is not None:
        old = idm_acceleration(old_follower, old_leader) - idm_acceleration(old_follower, driver)
    bias = kind.keep_right_bias if target < driver.lane else -kind.keep_right_bias
    return own + kind.politeness * (new_after - new_before + old) - kind.change_threshold + bias


def decide(
    drivers: Sequence[Driver],
    may_change: Callable[[Driver, int], bool],
    reach: float = 300.0,
) -> dict[str, int]:
    """Lane changes of one round: name -> target lane.

    The vehicles are asked in the order of their names, and each sees the changes decided before
    it, so the result does not hang on SUMO's order and two never take the same gap.

    Args:
      drivers: all vehicles.
      may_change: whether a driver may go to a lane (it exists, is not closed, rest since the last).
      reach: vehicles within this distance matter [m].
    """
    state = {driver.name: driver for driver in drivers}
    ordered = sorted(drivers, key=lambda driver: driver.station)
    stations = [driver.station for driver in ordered]
    changes: dict[str, int] = {}
    for name in sorted(state):
        driver = state[name]
        if not driver.movable:
            continue
        low = bisect_left(stations, driver.station - reach)
        high = bisect_right(stations, driver.station + reach)
        near = [state[other.name] for other in ordered[low:high]]
        best, gain = driver.lane, 0.0
        for target in (driver.lane - 1, driver.lane + 1):
            if not may_change(driver, target):
                continue
            value = incentive(near, driver, target)
            if value is not None and value > gain:
                best, gain = target, value
        if best != driver.lane:
            changes[name] = best
            state[name] = replace(driver, lane=best)
    return changes
