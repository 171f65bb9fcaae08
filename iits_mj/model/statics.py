"""How the truck stands at rest: wheel heights, and the mass of a unit less its axles."""

from __future__ import annotations

from iits_mj.parameters import Axle, Semitrailer, Tractor, TruckParameters
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


def tire_deflection(parameters: TruckParameters, axle: Axle, load: float) -> float:
    """Deflection of the axle's tires [m] under this axle load [N]."""
    tire = parameters.tires[axle.tire]
    return load / (2 * tire.count * tire.vertical_stiffness)


def wheel_height(parameters: TruckParameters, axle: Axle, load: float) -> float:
    """Height of the wheel centre above the road at rest [m]."""
    radius = parameters.tires[axle.tire].free_radius
    return radius - tire_deflection(parameters, axle, load)


def wheel_inertia(parameters: TruckParameters, axle: Axle) -> tuple[float, float, float]:
    """Inertia of one wheel end about x, y (spin), z [kg m2]: a thick ring of the tires' width."""
    width = _TIRE_WIDTH * parameters.tires[axle.tire].count
    diametral = 0.5 * axle.wheel_inertia_spin + axle.wheel_mass * width**2 / 12
    return diametral, axle.wheel_inertia_spin, diametral


def beam_inertia(axle: Axle) -> tuple[float, float, float]:
    """Inertia of the axle without its wheels [kg m2]: a slender beam with a round casing."""
    mass = axle.unsprung_mass - 2 * axle.wheel_mass
    long = mass * axle.track**2 / 12
    return long, mass * _CASING_RADIUS**2, long


def axle_inertial(parameters: TruckParameters, axle: Axle, height: float) -> Inertial:
    """The whole axle, wheels at rest."""
    shift = axle.wheel_mass * (0.5 * axle.track) ** 2
    x, y, z = wheel_inertia(parameters, axle)
    wheels = Inertial(
        2 * axle.wheel_mass, axle.position, height, (2 * (x + shift), 2 * y, 2 * (z + shift))
    )
    mass = axle.unsprung_mass - 2 * axle.wheel_mass
    return joined(Inertial(mass, axle.position, height, beam_inertia(axle)), wheels)


def sprung(parameters: TruckParameters, unit: Tractor | Semitrailer, payload: float) -> Inertial:
    """The unit less its axles: what the chassis body of the model weighs.

    The figures of a unit include its axles and wheels; they are taken off by Steiner's theorem. The
    semitrailer's are without the payload, which is a body of its own.
    """
    loads = axle_loads_by_name(parameters, payload)
    axles = [
        axle_inertial(parameters, axle, wheel_height(parameters, axle, loads[axle.name]))
        for axle in unit.axles
    ]
    return without(unit_inertial(unit), *axles)
