"""Static roll-over threshold on a tilt table (SAE J2180): gravity tilts until the truck falls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic import laden_trailer
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.units import GRAVITY

FloatArray = NDArray[np.float64]

# The table's rate [rad/s] is slow against the roll mode; the standard allows 0.25 deg/s near the
# end.
_RATE = math.radians(0.5)
_LIMIT = math.radians(45.0)
# The trailer's roll against the table beyond which it is falling [rad].
_FALLING = math.radians(12.0)


@dataclass(frozen=True)
class Tilt:
    """Threshold [g], the tangent of the table's angle; table angle and trailer roll [rad]."""

    threshold: float
    table: FloatArray
    roll: FloatArray


def tilt_table(payload: float, timestep: float = 0.002) -> Tilt:
    """Tilts the standing truck to the right until its trailer falls.

    The threshold is the angle after which no left wheel of the drive and trailer axles touches any
    more, or the trailer's roll runs away, whichever comes first.
    """
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset()
    truck.command(parking_brake=1.0)
    truck.step(round(2.0 / timestep))
    table, roll = [], []
    angle = 0.0
    block = 0.05
    left = [f"{axle.name}_left_tire_force" for axle in truck.parameters.axles[1:]]
    while angle < _LIMIT:
        angle += _RATE * block
        # Tilting to the right: gravity pulls towards -y.
        truck.model.opt.gravity[:] = (0.0, -GRAVITY * math.sin(angle), -GRAVITY * math.cos(angle))
        truck.step(round(block / timestep))
        attitude = truck.data.body("trailer").xmat.reshape(3, 3)
        lean = math.atan2(attitude[2, 1], attitude[2, 2])
        table.append(angle)
        roll.append(lean)
        lifted = all(truck.data.sensor(name).data[2] <= 0.0 for name in left)
        if lifted or abs(lean) > _FALLING:
            break
    return Tilt(math.tan(angle), np.array(table), np.array(roll))


def rigid_threshold(parameters: TruckParameters, payload: float) -> float:
    """Upper bound `T / (2 h)` [g] of a rigid truck on rigid tires, all axles weighted by load."""
    trailer, tractor = laden_trailer(parameters, payload), parameters.tractor
    mass = tractor.mass + trailer.mass
    height = (tractor.mass * tractor.cg_height + trailer.mass * trailer.cg_height) / mass
    track = float(np.mean([axle.track for axle in parameters.axles[1:]]))
    return track / (2.0 * height)
