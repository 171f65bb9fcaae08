"""How the braking force is shared between the circuits, as tables for a light and a heavy truck.

Either by axle load, so that every axle uses the same friction, as an EBS with load sensing aims
at; or in proportion to the pressures of the release's tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from iits_mj.mass_state import group_center, laden_trailer
from iits_mj.parameters import TruckParameters
from iits_mj.units import GRAVITY

# Decelerations of the table by axle loads [m/s2]: friction allows no more.
_DEMAND = np.arange(0.0, 11.0)


@dataclass(frozen=True)
class Distribution:
    """Shares of the braking force.

    Attributes:
      mass_light, mass_heavy: gross masses that the tables are for [kg].
      demand: deceleration [m/s2], shape (n,).
      light, heavy: shares of (front, drive, trailer) circuits, sum 1, shape (n, 3).
    """

    mass_light: float
    mass_heavy: float
    demand: FloatArray
    light: FloatArray
    heavy: FloatArray


def circuits(parameters: TruckParameters) -> list[int]:
    """Circuit of each axle, front to rear: 0 front, 1 drive, 2 trailer."""
    rear = len(parameters.tractor.axles) - 1
    return [0] + [1] * rear + [2] * len(parameters.semitrailer.axles)


def distribution(parameters: TruckParameters) -> Distribution:
    """The tables that `parameters.air_brake.distribution` names.

    Raises:
      InputError: there is none of that name.
    """
    name = parameters.air_brake.distribution
    if name == "axle_loads":
        return _by_axle_loads(parameters)
    if name == "table":
        return _by_table(parameters)
    raise InputError(
        f"parameter truck.air_brake.distribution = {name!r}: allowed are 'axle_loads' and 'table'"
    )


def group_loads(parameters: TruckParameters, payload: float, deceleration: float) -> FloatArray:
    """Loads of steer axle, tandem and tri-axle in braking on the level [N], shape (3,).

    Statics with inertia forces of two rigid units, when every axle brakes in proportion to its load
    (friction used z = a / g). About the kingpin, on the road below it the brake force of the
    tri-axle; about the steer axle's contact, the trailer's push at the height of the kingpin.
    """
    tractor, coupling = parameters.tractor, parameters.fifth_wheel
    trailer = laden_trailer(parameters, payload)
    used = deceleration / GRAVITY
    group = group_center(parameters.semitrailer.axles)
    turning = trailer.cg_position - used * (trailer.cg_height - coupling.height)
    on_trailer = trailer.mass * GRAVITY * turning / (group + used * coupling.height)
    kingpin = trailer.mass * GRAVITY - on_trailer
    push = used * kingpin
    origin = tractor.axles[0].position
    moment = tractor.mass * GRAVITY * (tractor.cg_position - origin - used * tractor.cg_height)
    moment += kingpin * (coupling.position - origin) - push * coupling.height
    drive = moment / (group_center(tractor.axles[1:]) - origin)
    steer = tractor.mass * GRAVITY + kingpin - drive
    return np.array([steer, drive, on_trailer])


def _by_axle_loads(parameters: TruckParameters) -> Distribution:
    full = parameters.payload.mass_max

    def shares(payload: float) -> FloatArray:
        loads = np.array([group_loads(parameters, payload, a) for a in _DEMAND])
        loads = np.maximum(loads, 0.0)
        return np.asarray(loads / loads.sum(axis=1, keepdims=True))

    light, heavy = parameters.gross_mass(0.0), parameters.gross_mass(full)
    return Distribution(light, heavy, _DEMAND, shares(0.0), shares(full))


def _by_table(parameters: TruckParameters) -> Distribution:
    brake = parameters.air_brake
    slope = np.zeros(3)
    radius = np.array([parameters.tires[axle.tire].rolling_radius for axle in parameters.axles])
    np.add.at(slope, circuits(parameters), np.asarray(brake.torque_per_pressure) / radius)

    def shares(pressure: FloatArray) -> FloatArray:
        force = pressure * slope
        return np.asarray(force / force.sum(axis=1, keepdims=True))

    return Distribution(
        brake.mass_light,
        brake.mass_heavy,
        brake.demand,
        shares(brake.pressure_light),
        shares(brake.pressure_heavy),
    )
