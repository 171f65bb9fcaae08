"""Axle loads at speed and cornering stiffnesses, computed from the truck's parameters."""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import kingpin_load, laden_trailer, static_axle_loads
from iits_mj.parameters.tire_law import cornering_stiffness

__all__ = [
    "axle_cornering_stiffness",
    "cruise_axle_loads",
    "kingpin_load",
    "laden_trailer",
    "static_axle_loads",
]


def cruise_axle_loads(parameters: TruckParameters, payload: float, speed: float) -> FloatArray:
    """Axle loads at constant speed [m/s] on a level road [N], shape (6,), front to rear.

    Statics of the two units with air drag at its height, the pull at the fifth wheel's, rolling
    resistance as a forward shift of each wheel's load, and the drive force at the ground: the drive
    axles carry more and the steer axle less than at rest. Group loads are shared equally.
    """
    air, tires = parameters.aerodynamics, parameters.tires
    rolling = parameters.tire_common.rolling_resistance
    drag = 0.5 * air.density * air.drag_area * speed**2
    drag_tractor, drag_trailer = air.tractor_share * drag, (1.0 - air.tractor_share) * drag
    trailer, tractor, fifth = (
        laden_trailer(parameters, payload),
        parameters.tractor,
        parameters.fifth_wheel,
    )
    front, *drive = tractor.axles

    def lever(axles: tuple[Axle, ...] | list[Axle]) -> float:
        shift = rolling * tires[axles[0].tire].rolling_radius
        return float(np.mean([axle.position for axle in axles])) - shift

    weight = trailer.mass * GRAVITY
    # Moments about the kingpin: the trailer's rolling resistance pulls at the ground, below it.
    group = (weight * trailer.cg_position + drag_trailer * (air.pressure_height - fifth.height)) / (
        lever(parameters.semitrailer.axles) + rolling * fifth.height
    )
    kingpin = weight - group
    pull = drag_trailer + rolling * group
    moment = (
        tractor.mass * GRAVITY * (tractor.cg_position - front.position)
        + kingpin * (fifth.position - front.position)
        + pull * fifth.height
        + drag_tractor * air.pressure_height
    )
    total = tractor.mass * GRAVITY + kingpin
    front_lever, rear_lever = lever([front]) - front.position, lever(drive) - front.position
    rear = (moment - total * front_lever) / (rear_lever - front_lever)
    number = len(parameters.semitrailer.axles)
    loads = [total - rear, *([rear / len(drive)] * len(drive)), *([group / number] * number)]
    return np.array(loads)


def axle_cornering_stiffness(parameters: TruckParameters, loads: FloatArray) -> FloatArray:
    """Cornering stiffness of each axle [N/rad], shape (6,), at axle loads [N], shape (6,)."""
    stiffness = []
    for axle, load in zip(parameters.axles, loads, strict=True):
        tire = parameters.tires[axle.tire]
        tires = 2 * tire.count
        one = cornering_stiffness(load / tires, tire, parameters.tire_common)
        stiffness.append(tires * float(one))
    return np.array(stiffness)
