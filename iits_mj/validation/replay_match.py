"""What a cruise on the truck tells the planner: power that is left on climbs, speed to be set.

Gear changes interrupt the pull, the turbocharger must catch up after them, and the gearbox shifts
down at some 1200 rpm: over a whole climb the truck has much less than its engine's greatest power.
The planner's point mass gets the power with which its own cruise takes as long as the driven one.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, brakeable, cruise, durations, fastest_below
from iits_mj.core.arrays import FloatArray
from iits_mj.errors import PlanningError
from iits_mj.validation.closed_loop import CONTROL_PERIOD, Record

_FLOORED = 0.99
# Time in which the engine's torque builds up, and climbing that is needed to judge [s].
_BUILD_UP, _CLIMBING = 6.0, 30.0
# Least power over that with the torque built up; other causes of delay are not to pass for it [1].
_LEAST_SHARE = 0.6
# Of the power that a plan counts on: so much is all of it [1].
_ALL = 0.98
_HALVINGS = 30


def climbing_power(record: Record) -> float | None:
    """Mean engine power on climbs, accelerator floored and torque built up [W]; None without."""
    pulling = (record["pedal"] >= _FLOORED) & (record["shift"] == 0.0)
    # The last sample at which it did not pull: so long ago the torque has built up.
    rows = np.arange(pulling.size)
    since = rows - np.maximum.accumulate(np.where(pulling, 0, rows))
    built_up = since * CONTROL_PERIOD > _BUILD_UP
    if np.count_nonzero(built_up) * CONTROL_PERIOD < _CLIMBING:
        return None
    return float(np.mean((record["engine_torque"] * record["engine_speed"])[built_up]))


def with_power_of(
    vehicle: PointMass, road: RoadProfile, record: Record, v_set: float, v_start: float, time: float
) -> PointMass:
    """The point mass whose cruise takes as long as the driven one; as it is where none climbs.

    Args:
      vehicle: with the engine's greatest power.
      road: that was driven.
      record: of the driven cruise.
      v_set: its set speed [m/s].
      v_start: its speed at the road's begin [m/s].
      time: that it took [s].
    """
    built_up = climbing_power(record)
    if built_up is None:
        return vehicle
    high = min(built_up, vehicle.power_max)
    low = _LEAST_SHARE * high

    def with_power(power: float) -> PointMass:
        return dataclasses.replace(vehicle, power_max=power)

    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if cruise_time(with_power(middle), road, v_set, v_start) > time:
            low = middle
        else:
            high = middle
    return with_power(high)


def with_all_power(
    vehicle: PointMass, strongest: PointMass, road: RoadProfile, planned: FloatArray, v_max: float
) -> FloatArray:
    """Node speeds (n + 1,) [m/s] of a plan, raised where it takes all the power it counts on.

    From the plan's speed at the stretch's begin with the engine's greatest power, and back to the
    plan behind its end by coasting.

    Args:
      vehicle: for which the plan was made.
      strongest: the same with the engine's greatest power.
      road: its profile.
      planned: node speeds (n + 1,) [m/s].
      v_max: of the band [m/s].
    """
    full = vehicle.power(planned, road) >= _ALL * vehicle.power_max
    raised = np.concatenate([[False], full])
    cap = np.where(raised, np.maximum(np.minimum(road.v_limit, v_max), planned), planned) ** 2
    fastest = fastest_below(strongest, road, cap)
    coasting = np.sqrt(np.maximum(brakeable(strongest, road, fastest**2, 0.0), 0.0))
    return np.where(raised, np.maximum(planned, np.minimum(fastest, coasting)), planned)


def set_speed(vehicle: PointMass, road: RoadProfile, mean: float, top: float) -> float:
    """Set speed with which the model's cruise has a mean speed, `top` at most [m/s]."""
    low, high = mean, max(top, mean)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if cruise_time(vehicle, road, middle, middle) > road.length / mean:
            low = middle
        else:
            high = middle
    return high


def cruise_time(vehicle: PointMass, road: RoadProfile, v_set: float, v_start: float) -> float:
    """Trip time of the model's cruise [s]; infinite where its power does not do."""
    try:
        speed = cruise(vehicle, road, v_set, min(v_set, v_start))
    except PlanningError:
        return math.inf
    return float(durations(speed, road).sum())
