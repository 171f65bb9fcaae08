"""Masses, centers of gravity, inertias and static axle loads of the truck with any payload.

Statics of two rigid units on three supports. Positions are meters behind the steer axle (tractor)
or behind the kingpin (semitrailer and payload), heights are above the road. The axles of tandem and
tri-axle share their group's load equally, so that each group acts at its center.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.options import option
from iits_mj.core.units import GRAVITY
from iits_mj.parameters.truck import Axle, TruckParameters, Unit

# Greatest payload of the shipped truck [kg]: `payload.mass_max` of mjcf/truck.toml.
MAX_PAYLOAD = 36_000.0


def payload_option(
    default: float | None = MAX_PAYLOAD, help: str = "load on the semitrailer"
) -> Any:
    """Returns a dataclass field for the payload [kg], bounded by the shipped truck's maximum."""
    return option(default, help=help, unit="kg", low=0.0, high=MAX_PAYLOAD, metavar="KG")


@dataclass(frozen=True, slots=True)
class Inertial:
    """A rigid body on the truck's middle plane.

    Attributes:
      mass: [kg].
      cg_position: of its center of gravity, behind the unit's origin [m].
      cg_height: above the road [m].
      inertia: about x, y, z through its own CG [kg m2]. The product Ixz of joined bodies (less than
        1 % of Iz) is neglected; the MJCF includes it, because there the load is a separate body.
    """

    mass: float
    cg_position: float
    cg_height: float
    inertia: tuple[float, float, float]

    @property
    def inertia_x(self) -> float:
        """In roll [kg m2]."""
        return self.inertia[0]

    @property
    def inertia_z(self) -> float:
        """In yaw [kg m2]."""
        return self.inertia[2]

    def about(self, position: float, height: float) -> FloatArray:
        """Returns the inertia about another point of the middle plane, (3,), by Steiner."""
        dx, dz = self.cg_position - position, self.cg_height - height
        return np.array(self.inertia) + self.mass * np.array([dz**2, dx**2 + dz**2, dx**2])


def joined(*parts: Inertial) -> Inertial:
    """Returns the parts as one rigid body."""
    mass = sum(part.mass for part in parts)
    position = sum(part.mass * part.cg_position for part in parts) / mass
    height = sum(part.mass * part.cg_height for part in parts) / mass
    total = sum(part.about(position, height) for part in parts)
    return Inertial(mass, position, height, tuple(map(float, np.asarray(total))))  # type: ignore[arg-type]


def without(whole: Inertial, *parts: Inertial) -> Inertial:
    """Returns a rigid body less some of its parts."""
    negative = [
        Inertial(-part.mass, part.cg_position, part.cg_height, tuple(-i for i in part.inertia))  # type: ignore[arg-type]
        for part in parts
    ]
    return joined(whole, *negative)


def unit_inertial(unit: Unit) -> Inertial:
    """Returns a unit with its axles and wheels; the semitrailer without payload."""
    inertia = (unit.inertia_x, unit.inertia_y, unit.inertia_z)
    return Inertial(unit.mass, unit.cg_position, unit.cg_height, inertia)


def payload_inertial(
    parameters: TruckParameters, payload: float, payload_height: float | None = None
) -> Inertial:
    """Returns the payload as a rigid block, whose place and radii of gyration are constant.

    Args:
      parameters: of the truck.
      payload: [kg], 0 to `parameters.payload.mass_max`.
      payload_height: of its CG above the road [m]; default: the parameters'.

    Raises:
      InputError: payload or height are not allowed.
    """
    parameters = parameters.with_payload_height(payload_height)
    full, mass = parameters.payload, parameters.check_payload(payload)
    share = mass / full.mass_max
    inertia = (full.inertia_x * share, full.inertia_y * share, full.inertia_z * share)
    return Inertial(mass, full.cg_position, full.cg_height, inertia)


def laden_trailer(
    parameters: TruckParameters, payload: float, payload_height: float | None = None
) -> Inertial:
    """Returns the semitrailer with its payload; arguments as of `payload_inertial`."""
    return joined(
        unit_inertial(parameters.semitrailer),
        payload_inertial(parameters, payload, payload_height),
    )


def group_center(axles: Sequence[Axle]) -> float:
    """Returns the mean position of an axle group [m]."""
    return float(np.mean([axle.position for axle in axles]))


def kingpin_load(parameters: TruckParameters, payload: float) -> float:
    """Returns the vertical load on the fifth wheel at rest on level ground [N]."""
    trailer = laden_trailer(parameters, payload)
    group = group_center(parameters.semitrailer.axles)
    return trailer.mass * GRAVITY * (1.0 - trailer.cg_position / group)


def static_axle_loads(parameters: TruckParameters, payload: float) -> FloatArray:
    """Returns axle loads at rest on level ground [N], shape (6,), front to rear."""
    tractor, trailer_axles = parameters.tractor, parameters.semitrailer.axles
    front, *drive = tractor.axles
    kingpin, origin = kingpin_load(parameters, payload), front.position
    moment = tractor.mass * GRAVITY * (tractor.cg_position - origin)
    moment += kingpin * (parameters.fifth_wheel.position - origin)
    rear = moment / (group_center(drive) - origin)
    steer = tractor.mass * GRAVITY + kingpin - rear
    on_trailer = laden_trailer(parameters, payload).mass * GRAVITY - kingpin
    loads = [steer, *([rear / len(drive)] * len(drive))]
    return np.array(loads + [on_trailer / len(trailer_axles)] * len(trailer_axles))


def cruise_axle_loads(parameters: TruckParameters, payload: float, speed: float) -> FloatArray:
    """Returns axle loads at constant speed [m/s] on a level road [N], shape (6,), front to rear.

    Statics of the two units with air drag at its height, the pull at the fifth wheel's, rolling
    resistance as a forward shift of each wheel's load, and the drive force at the ground: the drive
    axles carry more and the steer axle less than at rest. At speed 0 the loads are those at rest.
    """
    if speed <= 0.0:
        return static_axle_loads(parameters, payload)
    air, tires = parameters.aerodynamics, parameters.tires
    rolling = parameters.tire_common.rolling_resistance
    drag = 0.5 * air.density * air.drag_area * speed**2
    drag_tractor, drag_trailer = air.tractor_share * drag, (1.0 - air.tractor_share) * drag
    tractor, fifth = parameters.tractor, parameters.fifth_wheel
    trailer = laden_trailer(parameters, payload)
    front, *drive = tractor.axles

    def lever(axles: Sequence[Axle]) -> float:
        shift = rolling * tires[axles[0].tire].rolling_radius
        return group_center(axles) - shift

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


def axle_loads_by_name(parameters: TruckParameters, payload: float) -> dict[str, float]:
    """Returns `static_axle_loads` [N] by the axles' names."""
    loads = static_axle_loads(parameters, payload)
    return {axle.name: float(load) for axle, load in zip(parameters.axles, loads, strict=True)}
