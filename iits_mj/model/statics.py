"""The truck at rest: wheel heights, and the sprung mass of each unit."""

from __future__ import annotations

from iits_mj.parameters import Axle, TruckParameters, Unit
from iits_mj.parameters.mass_state import (
    Inertial,
    axle_loads_by_name,
    joined,
    unit_inertial,
    without,
)

# Tread width of one tire, and radius of gyration of an axle casing about its own axis [m].
_TIRE_WIDTH = 0.30
_CASING_RADIUS = 0.15
LIFT = 0.10  # [m], of a lifted axle's tires above the road


def wheel_height(parameters: TruckParameters, axle: Axle, load: float) -> float:
    """Returns the height of the wheel center above the road [m] at rest under an axle load [N].

    An axle without load is lifted.
    """
    tire = parameters.tires[axle.tire]
    if load == 0.0:
        return tire.free_radius + LIFT
    return tire.free_radius - load / (2 * tire.count * tire.vertical_stiffness)


def wheel_inertia(parameters: TruckParameters, axle: Axle) -> tuple[float, float, float]:
    """Returns the inertia of a wheel end about x, y (spin), z [kg m2], as a thick ring."""
    width = _TIRE_WIDTH * parameters.tires[axle.tire].count
    diametral = 0.5 * axle.wheel_inertia_spin + axle.wheel_mass * width**2 / 12
    return diametral, axle.wheel_inertia_spin, diametral


def beam_inertia(axle: Axle) -> tuple[float, float, float]:
    """Returns the inertia of an axle without wheels [kg m2], as a slender beam."""
    mass = axle.unsprung_mass - 2 * axle.wheel_mass
    long = mass * axle.track**2 / 12
    return long, mass * _CASING_RADIUS**2, long


def axle_inertial(parameters: TruckParameters, axle: Axle, height: float) -> Inertial:
    """Returns an axle with its wheels as a rigid body."""
    shift = axle.wheel_mass * (0.5 * axle.track) ** 2
    x, y, z = wheel_inertia(parameters, axle)
    wheels = Inertial(
        2 * axle.wheel_mass, axle.position, height, (2 * (x + shift), 2 * y, 2 * (z + shift))
    )
    mass = axle.unsprung_mass - 2 * axle.wheel_mass
    return joined(Inertial(mass, axle.position, height, beam_inertia(axle)), wheels)


def sprung(parameters: TruckParameters, unit: Unit, payload: float) -> Inertial:
    """Returns a unit less its axles, which is the chassis body of the model.

    The parameters of a unit include axles and wheels, which are subtracted with Steiner's theorem.
    The unit is without payload, which is a separate body.
    """
    loads = axle_loads_by_name(parameters, payload)
    axles = [
        axle_inertial(parameters, axle, wheel_height(parameters, axle, loads[axle.name]))
        for axle in unit.axles
    ]
    return without(unit_inertial(unit), *axles)
