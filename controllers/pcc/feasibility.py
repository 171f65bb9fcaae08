"""Why a task has no solution, told before it is solved.

Necessary conditions, each a pass over the nodes: bounds that leave no speed, limits that the brakes
cannot meet, climbs beyond full power, an end speed out of reach, a trip time that is too short, a
fence that even the slowest drive passes too early.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, brakeable, durations, fastest_below
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError

if TYPE_CHECKING:
    from controllers.pcc.solver import Task

_HALVINGS = 40
_SLACK = 1e-6  # [m2/s2] and relative: rounding of the passes themselves


def require_feasible(vehicle: PointMass, task: Task) -> FloatArray:
    """The greatest node speeds (n + 1,) that any drive of the task has.

    Raises:
      PlanningError: no drive keeps to the task's limits, with the reason.
    """
    road, low = task.road, task.b_low
    high = np.minimum(task.b_high, 1e4)
    empty = np.flatnonzero(low > high + 1e-9)
    if empty.size:
        k = int(empty[0])
        raise PlanningError(
            f"at station {road.station[k]:.0f} m the least speed {math.sqrt(low[k]):.2f} m/s is "
            f"above the greatest {math.sqrt(max(high[k], 0.0)):.2f} m/s"
        )
    # The engine's drag helps the brakes.
    drag = vehicle.power_drag * vehicle.efficiency / math.sqrt(float(low.min()))
    cap = brakeable(vehicle, road, high, vehicle.brake_max + drag)
    steep = np.flatnonzero(low > cap + _SLACK)
    if steep.size:
        k = int(steep[-1])
        ahead = k + int(np.flatnonzero(high[k:] - cap[k:] <= _SLACK)[0])
        raise PlanningError(
            f"the brakes ({vehicle.brake_max / 1e3:.0f} kN) cannot take the least speed "
            f"{math.sqrt(low[k]):.2f} m/s at station {road.station[k]:.0f} m down to the "
            f"{math.sqrt(high[ahead]):.2f} m/s allowed at station {road.station[ahead]:.0f} m"
        )
    fastest = fastest_below(vehicle, road, cap)
    slow = np.flatnonzero(fastest**2 < low * (1.0 - _SLACK) - _SLACK)
    if slow.size:
        k = int(slow[0])
        where = "the end speed" if k == road.intervals else "the least speed"
        raise PlanningError(
            f"{where} {math.sqrt(low[k]):.2f} m/s at station {road.station[k]:.0f} m is out of "
            f"reach: full power ({vehicle.power_max / 1e3:.0f} kW) brings {vehicle.mass:.0f} kg to "
            f"{fastest[k]:.2f} m/s there"
        )
    _require_time(vehicle, task, high, fastest)
    return fastest


def enough_speeds(
    vehicle: PointMass, road: RoadProfile, low: FloatArray, fastest: FloatArray
) -> FloatArray:
    """Least node speeds (n + 1,) from which full power still reaches all least speeds ahead.

    Args:
      vehicle: the truck.
      road: with n intervals.
      low: least speeds, shape (n + 1,).
      fastest: greatest speeds of any drive, shape (n + 1,), at least `low`.
    """
    push, half = vehicle.inertial_mass / (2.0 * road.step), 0.5 * vehicle.drag
    work = 2.0 * vehicle.efficiency * vehicle.power_max
    slope = vehicle.slope_force(road.grade)

    def missing(k: int, v: float, w: float) -> float:
        """Force that full power lacks to come from v to w in interval k [N]."""
        return float((push + half) * w * w + (half - push) * v * v + slope[k] - work / (v + w))

    speed = np.array(low, dtype=float)
    lacks = (push + half) * low[1:] ** 2 + (half - push) * low[:-1] ** 2 + slope
    for last in np.flatnonzero(lacks > work / (low[1:] + low[:-1]))[::-1]:
        for k in range(int(last), -1, -1):
            w, below, above = float(speed[k + 1]), float(speed[k]), float(fastest[k])
            if missing(k, below, w) <= 0.0:
                break
            # Halving keeps to the side from which w is not reached: never more than is needed.
            for _ in range(_HALVINGS):
                middle = 0.5 * (below + above)
                if missing(k, middle, w) > 0.0:
                    below = middle
                else:
                    above = middle
            speed[k] = below
    return speed


def _require_time(vehicle: PointMass, task: Task, high: FloatArray, fastest: FloatArray) -> None:
    road = task.road
    if math.isfinite(task.time_max):
        shortest = float(durations(fastest, road).sum())
        if shortest > task.time_max * (1.0 + 1e-9):
            lawful = float(durations(np.sqrt(high), road).sum())
            cause = f"even at the speed limits the road takes {lawful:.1f} s"
            if lawful <= task.time_max:
                cause = f"at full power within the limits the road takes {shortest:.1f} s"
            raise PlanningError(f"trip time {task.time_max:.1f} s is too short: {cause}")
    if task.fence.max() <= 0.0:
        return
    clock = np.cumsum(durations(_slowest(vehicle, task), road))
    early = np.flatnonzero(clock < task.fence[1:] - 1e-6)
    if early.size:
        k = int(early[0])
        raise PlanningError(
            f"the fence at station {road.station[k + 1]:.0f} m opens at {task.fence[k + 1]:.1f} s; "
            f"even with full brakes the truck is there at {clock[k]:.1f} s"
        )
    if math.isfinite(task.time_max) and task.fence.max() > task.time_max:
        raise PlanningError(
            f"trip time {task.time_max:.1f} s is too short: a fence opens at "
            f"{task.fence.max():.1f} s only"
        )


def _slowest(vehicle: PointMass, task: Task) -> FloatArray:
    """A speed at the nodes that no drive is below: full brakes down to the least speeds."""
    road = task.road
    twice = 2.0 * road.step / vehicle.inertial_mass
    half = 0.5 * vehicle.drag * twice
    drag = twice * vehicle.power_drag * vehicle.efficiency * 2.0
    fall = (twice * (vehicle.brake_max + vehicle.slope_force(road.grade))).tolist()
    v = math.sqrt(task.b_low[0])
    speeds = [v]
    for k, least in enumerate(np.sqrt(task.b_low[1:]).tolist()):
        end = least
        # The engine's drag falls with the end speed: from below, each round comes closer.
        for _ in range(4):
            b = (v * v * (1.0 - half) - fall[k] - drag / (v + end)) / (1.0 + half)
            end = max(least, math.sqrt(max(b, 0.0)))
        v = end
        speeds.append(v)
    return np.array(speeds)
