"""Static loads and mass split of the combination: where the springs' preloads come from.

Plain statics of two rigid units on three supports, with equal loads inside the tandem and the
tri-axle. Positions are metres behind the steer axle or behind the kingpin, as in the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.parameters import Axle, Semitrailer, Tractor, TruckParameters
from iits_mj.units import GRAVITY


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], CG behind the unit's origin and above the road [m], principal inertias [kg m2]."""

    mass: float
    cg_position: float
    cg_height: float
    inertia: tuple[float, float, float]


@dataclass(frozen=True)
class StaticLoads:
    """Axle loads front to rear [N], shape (6,), and the load on the fifth wheel [N]."""

    axles: tuple[float, ...]
    fifth_wheel: float


def trailer_total(parameters: TruckParameters, payload: float) -> tuple[float, float]:
    """Mass [kg] and CG behind the kingpin [m] of semitrailer and payload."""
    trailer = parameters.semitrailer
    mass = trailer.mass + payload
    moment = trailer.mass * trailer.cg_position + payload * parameters.payload.cg_position
    return mass, moment / mass


def static_loads(parameters: TruckParameters, payload: float) -> StaticLoads:
    """Axle loads at rest on a level road."""
    tractor, trailer = parameters.tractor, parameters.semitrailer
    mass, cg = trailer_total(parameters, payload)
    tri_center = float(np.mean([axle.position for axle in trailer.axles]))
    tri = mass * GRAVITY * cg / tri_center
    king = mass * GRAVITY - tri
    tandem = tractor.axles[1:]
    tandem_center = float(np.mean([axle.position for axle in tandem]))
    moment = tractor.mass * GRAVITY * tractor.cg_position + king * parameters.fifth_wheel.position
    rear = moment / tandem_center
    front = tractor.mass * GRAVITY + king - rear
    loads = [front] + [rear / len(tandem)] * len(tandem)
    loads += [tri / len(trailer.axles)] * len(trailer.axles)
    return StaticLoads(tuple(loads), king)


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
    width = 0.30 * parameters.tires[axle.tire].count
    diametral = 0.5 * axle.wheel_inertia_spin + axle.wheel_mass * width**2 / 12
    return diametral, axle.wheel_inertia_spin, diametral


def beam_inertia(axle: Axle) -> tuple[float, float, float]:
    """Inertia of the axle without its wheels [kg m2]: a slender beam with a round casing."""
    mass = axle.unsprung_mass - 2 * axle.wheel_mass
    long = mass * axle.track**2 / 12
    return long, mass * 0.15**2, long


def _axle_inertia(parameters: TruckParameters, axle: Axle) -> np.ndarray:
    wheel = np.array(wheel_inertia(parameters, axle))
    shift = axle.wheel_mass * (0.5 * axle.track) ** 2
    return np.array(beam_inertia(axle)) + 2 * wheel + 2 * np.array([shift, 0.0, shift])


def sprung(parameters: TruckParameters, unit: Tractor | Semitrailer, payload: float) -> Inertial:
    """The unit less its axles: what the chassis body of the model weighs.

    The figures of a unit include its axles and wheels; they are taken off by Steiner's theorem.
    """
    loads = dict(
        zip(
            (a.name for a in parameters.axles), static_loads(parameters, payload).axles, strict=True
        )
    )
    parts = [
        (axle, wheel_height(parameters, axle, loads[axle.name]), axle.unsprung_mass)
        for axle in unit.axles
    ]
    mass = unit.mass - sum(m for _, _, m in parts)
    x = (unit.mass * unit.cg_position - sum(m * a.position for a, _, m in parts)) / mass
    z = (unit.mass * unit.cg_height - sum(m * h for _, h, m in parts)) / mass
    inertia = np.array([unit.inertia_x, unit.inertia_y, unit.inertia_z])
    for axle, height, axle_mass in parts:
        dx, dz = axle.position - unit.cg_position, height - unit.cg_height
        inertia -= _axle_inertia(parameters, axle)
        inertia -= axle_mass * np.array([dz**2, dx**2 + dz**2, dx**2])
    dx, dz = x - unit.cg_position, z - unit.cg_height
    inertia -= mass * np.array([dz**2, dx**2 + dz**2, dx**2])
    return Inertial(mass, x, z, (float(inertia[0]), float(inertia[1]), float(inertia[2])))


def payload_inertial(parameters: TruckParameters, payload: float) -> Inertial:
    """The payload as a rigid block; radii of gyration do not change with its mass."""
    full = parameters.payload
    share = payload / full.mass_max
    inertia = (full.inertia_x * share, full.inertia_y * share, full.inertia_z * share)
    return Inertial(payload, full.cg_position, full.cg_height, inertia)
