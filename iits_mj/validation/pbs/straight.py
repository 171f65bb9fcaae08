"""The simulated truck on the straight road of `rough_road`.

The driver holds the steer axle on the middle by its distance a little ahead and the integral of it,
which balances the cross slope. The lateral acceleration per steer angle of the linear model sets
the driver's gain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import yaw_rate_gain
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.parameters import TruckParameters, Unit
from iits_mj.truck import Truck
from iits_mj.validation.handling.lane_change import linear_system
from iits_mj.validation.harness.recorder import PERIOD, SpeedHold, sampled
from iits_mj.validation.pbs.maneuvers import StraightPath
from iits_mj.validation.pbs.rough_road import FLAT, START, RoughRoad

# The driver: preview [s], lateral acceleration per distance [1/s2] and per its integral [1/s3].
_PREVIEW, _GAIN, _INTEGRAL = 2.0, 1.0, 0.1
# Height of the lower corners of a body over its height.
_LOW = 0.3


@dataclass(frozen=True)
class StraightDrive:
    """The truck on the rough straight.

    Attributes:
      speed: [m/s], shape (m,).
      steer_axle: its offset to the left [m], shape (m,).
      points: corners of all units on the measured stretch [m], shape (m, points, 2).
    """

    speed: FloatArray
    steer_axle: FloatArray
    points: FloatArray


def straight_path(
    parameters: TruckParameters, payload: float, timestep: float, seed: int = 0
) -> StraightDrive:
    """Drives the rough straight with a payload [kg]; the seed is of its unevenness."""
    path, steering = StraightPath(), parameters.steering
    truck = Truck.load(
        payload,
        parameters=parameters,
        timestep=timestep,
        visuals=False,
        edit_spec=RoughRoad.of(path, seed).add_to,
    )
    truck.reset(station=0.8 * FLAT, speed=path.speed)
    bodies = [truck.data.body(unit.name) for unit in parameters.units]
    outer = [_outer_points(unit) for unit in parameters.units]
    gain = path.speed * yaw_rate_gain(linear_system(truck, path.speed))
    hold, total = SpeedHold(), 0.0

    def command(_: float, state: EgoState) -> VehicleCommand:
        nonlocal total
        ahead = state.y + _PREVIEW * state.speed * math.sin(state.yaw)
        total += state.y * PERIOD
        angle = -(_GAIN * ahead + _INTEGRAL * total) / gain
        return hold.command(path.speed - state.speed, steering.ratio * angle)

    def read(state: EgoState) -> list[float]:
        row = [state.speed, state.y]
        for body, points in zip(bodies, outer, strict=True):
            row += (body.xpos[:2] + points @ body.xmat.reshape(3, 3)[:2].T).ravel().tolist()
        return row

    length = START + path.length + 0.5 * FLAT
    limit = 2.0 * length / path.speed
    table = sampled(truck, command, read, limit, lambda state: state.x > length)
    rear = table[:, 3::2].min(axis=1)
    kept = table[rear >= START]
    return StraightDrive(kept[:, 1], kept[:, 2], kept[:, 3:].reshape(len(kept), -1, 2))


def _outer_points(unit: Unit) -> FloatArray:
    """Corners of a unit's body, low and high, in its frame, shape (8, 3) [m]."""
    origin = 0.0 if unit.coupling is None else unit.coupling.height
    ends = (unit.front_overhang, unit.front_overhang - unit.length)
    sides = (0.5 * unit.width, -0.5 * unit.width)
    heights = (_LOW * unit.height - origin, unit.height - origin)
    return np.array([(x, y, z) for z in heights for x in ends for y in sides])
