"""Scripted drivers, one per task: baselines that solve it from its observations alone.

environment = suite.load("truck", "dock")
driver = suite.DRIVERS["dock"]
step = environment.reset()
while not step.last():
step = environment.step(driver(step.observation))
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.suite.scene import TURN_RADIUS
from iits_mj.suite.tasks import (
    CutInTask,
    Dock,
    EmergencyStop,
    LaneChange,
    LaneKeep,
    Stop,
    TightTurn,
)
from iits_mj.suite.tasks.encounters import SIGHT, STANDSTILL, Encounter
from iits_mj.suite.tasks.path import PATH_PREVIEW

ScriptedDriver = Callable[[Mapping[str, FloatArray]], FloatArray]

# Ratio of steering wheel to road wheels, wheelbase [m], compensated understeer [s2/m].
_RATIO, _WHEELBASE, _UNDERSTEER = 21.0, 4.6, 0.01
# Kingpin to the trailer's axle group [m].
_TRAILER = 7.7


def cruise(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Controls the speed in proportion to its error, with feedforward of the grade."""
    drive = 0.3 - 0.6 * _one(seen, "speed_error") + 8.0 * float(seen["grade_ahead"][0])
    return _clipped(drive)


def stop(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Follows the speed profile of a stop at the line with 1.2 m/s2."""
    error = _one(seen, "speed_error")
    # The profile is flat beyond the distance of a stop from 20 m/s.
    braking = _one(seen, "speed") - error < 20.0
    return _clipped(-0.5 * error - (1.2 / Stop.brake_max if braking else 0.0))


def hill_start(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Sets the pedal by the grade, higher while the truck rolls back."""
    return _clipped(0.5 + 4.0 * _one(seen, "grade") + 2.0 * max(_one(seen, "rolled_back"), 0.0))


def lane_keep(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Steers by feedforward of the curvature 25 m ahead and feedback of offset and heading."""
    ahead = float(seen["curvature_ahead"][1])
    wheels = (_WHEELBASE + _UNDERSTEER * 20.0**2 * 0.8) * ahead
    wheels -= 0.02 * _one(seen, "lane_error") + 0.35 * _one(seen, "heading_error")
    return _steered(_speed_held(seen), wheels, LaneKeep.steer_max)


def platoon(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Keeps the lane and the gap by speed and acceleration of the truck ahead."""
    action = lane_keep(seen)
    wanted = 0.8 * _one(seen, "acceleration_ahead") + 0.12 * _one(seen, "gap_error")
    wanted -= 0.7 * _one(seen, "speed_error")
    action[0] = np.clip(0.25 + 0.7 * wanted if wanted > -0.35 else 0.25 * wanted, -1.0, 1.0)
    return action


def lane_change(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Steers by the curvature of the path 20 m ahead."""
    here, near, far = 0.0, *(float(v) for v in seen["path_ahead"][[1, 2]])
    first, second = PATH_PREVIEW[1], PATH_PREVIEW[2]
    bend = 2.0 * ((far - near) / (second - first) - (near - here) / first) / second
    speed = _one(seen, "speed")
    wheels = (_WHEELBASE + _UNDERSTEER * speed**2) * bend
    wheels -= 0.03 * _one(seen, "lane_error") + 0.4 * _one(seen, "heading_error")
    return _steered(_speed_held(seen), wheels, LaneChange.steer_max)


def tight_turn(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Steers along the arc, with feedback of offset and heading."""
    turning = 0.0 < _one(seen, "past_entry") < 0.5 * math.pi * TURN_RADIUS
    wheels = math.atan(_WHEELBASE / TURN_RADIUS) if turning else 0.0
    wheels -= 0.9 * _one(seen, "heading_error") + 0.35 * _one(seen, "offset")
    drive = 0.35 + 0.8 * (TightTurn.target - _one(seen, "speed"))
    return _steered(drive, wheels, TightTurn.steer_max)


def dock(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Steers the articulation with the tractor, and the trailer with the articulation."""
    distance, aside = _one(seen, "distance"), _one(seen, "aside")
    heading, bend = _one(seen, "trailer_heading"), _one(seen, "articulation")
    wanted = float(np.clip(_TRAILER * (0.22 * heading - 0.018 * aside), -0.35, 0.35))
    wheels = math.atan(_WHEELBASE * (math.sin(bend) / _TRAILER + 0.45 * (bend - wanted)))
    backward = 0.15 + min(0.08 * max(distance - 0.1, 0.0), 1.0)
    if distance < 0.15:
        return _steered(-0.5, wheels, Dock.steer_max)
    drive = 0.1 + 0.8 * (backward + _one(seen, "speed"))
    return _steered(drive, wheels, Dock.steer_max)


def cut_in(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Follows at the wanted speed; brakes as hard as it must."""
    return _followed(seen, CutInTask.brake_max)


def emergency_stop(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Follows at the wanted speed; brakes as hard as it must."""
    return _followed(seen, EmergencyStop.brake_max)


def highway(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Overtakes a slower vehicle if the adjacent lane is free."""
    ahead, behind = seen["ahead"].reshape(-1, 3), seen["behind"].reshape(-1, 3)
    own = ahead[np.abs(ahead[:, 1]) < 2.0]
    if not len(own) or own[0, 0] > 80.0 or own[0, 2] > 0.5:
        return np.zeros(1)
    side = 1.0 if _one(seen, "offset") < 2.0 else -1.0
    beside = np.abs(ahead[:, 1] - 4.0 * side) < 2.0
    room = float(np.min(ahead[beside, 0], initial=250.0))
    followers = behind[np.abs(behind[:, 1] - 4.0 * side) < 2.0, 0]
    free = (followers < -45.0).all()
    return np.array([side if free and room > own[0, 0] + 30.0 else 0.0])


DRIVERS: dict[str, ScriptedDriver] = {
    driver.__name__: driver
    for driver in (
        *(cruise, stop, hill_start, lane_keep, lane_change, tight_turn, dock),
        *(cut_in, emergency_stop, highway),
    )
}


def _one(seen: Mapping[str, FloatArray], name: str) -> float:
    return float(seen[name][0])


def _followed(seen: Mapping[str, FloatArray], brake_max: float) -> FloatArray:
    """Returns the pedal for the wanted speed, or the braking that ends an approach 3 m behind."""
    gap, closing = _one(seen, "gap"), _one(seen, "closing_speed")
    wanted = -_one(seen, "speed_error")
    if abs(_one(seen, "beside")) < 3.5 and gap < SIGHT:
        needed = 0.5 * max(closing, 0.0) ** 2 / max(gap - STANDSTILL, 0.5)
        needed -= min(_one(seen, "car_acceleration"), 0.0)
        if needed > 0.7 and gap < 2.0 * _one(seen, "speed"):
            wanted = min(wanted, -1.3 * needed)
    target = _one(seen, "speed") - _one(seen, "speed_error")
    if target < 0.5:
        return _clipped(min(wanted / brake_max, -0.3))
    # The engine's drag alone brakes gently.
    pedal = 0.3 * target / Encounter.target + 0.5 * wanted
    return _clipped(max(pedal, 0.0) if wanted > -0.7 else wanted / brake_max)


def _speed_held(seen: Mapping[str, FloatArray]) -> float:
    return 0.3 - 0.5 * _one(seen, "speed_error")


def _steered(drive: float, wheels: float, steer_max: float) -> FloatArray:
    """Returns the action of a pedal and a road-wheel angle [rad]."""
    return np.clip(np.array([drive, _RATIO * wheels / steer_max]), -1.0, 1.0)


def _clipped(drive: float) -> FloatArray:
    return np.clip(np.array([drive]), -1.0, 1.0)
