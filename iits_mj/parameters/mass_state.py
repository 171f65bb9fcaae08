"""Masses, centers of gravity, inertias and static axle loads of a combination with any payload.

Statics of rigid units in a chain. Positions are meters behind a unit's origin, heights are above
the road. The axles of a group share its load by their `load_share`, so that it acts at its center.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.parameters.truck import TruckParameters
from iits_mj.parameters.units import Axle, Payload, Unit


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
    """Returns a unit with its axles and wheels, without payload."""
    inertia = (unit.inertia_x, unit.inertia_y, unit.inertia_z)
    return Inertial(unit.mass, unit.cg_position, unit.cg_height, inertia)


def payload_inertials(
    parameters: TruckParameters, payload: float, payload_height: float | None = None
) -> tuple[Inertial | None, ...]:
    """Returns each unit's load as a rigid block, whose place and radii of gyration are constant.

    Args:
      parameters: of the truck.
      payload: of all units together [kg], 0 to `parameters.payload_max`.
      payload_height: of the loads' CG above the road [m]; default: the parameters'.

    Returns:
      None for a unit without space for a load.

    Raises:
      InputError: payload or height are not allowed.
    """
    parameters = parameters.with_payload_height(payload_height)

    def block(full: Payload | None, mass: float) -> Inertial | None:
        if full is None:
            return None
        share = mass / full.mass_max
        inertia = (full.inertia_x * share, full.inertia_y * share, full.inertia_z * share)
        return Inertial(mass, full.cg_position, full.cg_height, inertia)

    masses = parameters.unit_payloads(payload)
    return tuple(
        block(unit.payload, mass) for unit, mass in zip(parameters.units, masses, strict=True)
    )


def laden_units(
    parameters: TruckParameters, payload: float, payload_height: float | None = None
) -> tuple[Inertial, ...]:
    """Returns each unit with its load; arguments as of `payload_inertials`."""
    loads = payload_inertials(parameters, payload, payload_height)
    return tuple(
        unit_inertial(unit) if load is None else joined(unit_inertial(unit), load)
        for unit, load in zip(parameters.units, loads, strict=True)
    )


def group_center(axles: Sequence[Axle]) -> float:
    """Returns the mean position of an axle group [m], weighted with the axles' shares of load."""
    weights = [axle.load_share for axle in axles]
    positions = [axle.position for axle in axles]
    if len(set(weights)) == 1:
        return float(np.mean(positions))
    return float(np.average(positions, weights=weights))


def group_shares(axles: Sequence[Axle]) -> list[float]:
    """Returns the share of its group's load that each axle carries, sum 1."""
    total = sum(axle.load_share for axle in axles)
    return [axle.load_share / total for axle in axles]


@dataclass(frozen=True, slots=True)
class Supports:
    """Vertical loads of a combination [N].

    Attributes:
      couplings: of each towed unit on its coupling, (units - 1,).
      groups: of each unit's axle groups (`Unit.groups`), front to rear.
    """

    couplings: tuple[float, ...]
    groups: tuple[tuple[float, ...], ...]


def supports(
    parameters: TruckParameters,
    payload: float,
    *,
    used: float = 0.0,
    drag: float = 0.0,
    resistances: Mapping[str, float] | None = None,
) -> Supports:
    """Returns the loads of couplings and axle groups on a level road, from the last unit forward.

    Statics of rigid units in a chain with inertia forces. Moments about a towed unit's coupling
    give the load of its group, those about the steered axle the load of the motor vehicle's rear.

    Args:
      parameters: of the truck.
      payload: [kg].
      used: friction that every axle uses to brake, deceleration over gravity.
      drag: of the air on the whole combination [N], at its height.
      resistances: rolling resistance of each axle over its load, by name, which acts backward at
        the ground and shifts the load forward; default: none.
    """
    bodies, shares = laden_units(parameters, payload), air_shares(parameters)
    air = parameters.aerodynamics.pressure_height
    couplings: list[float] = []
    groups: list[tuple[float, ...]] = []
    # Of the unit behind: its load on the coupling, and how it pulls backward there.
    load, pull, behind = 0.0, 0.0, None
    chain = list(zip(parameters.units, bodies, shares, strict=True))
    for unit, body, share in reversed(chain):
        weight, wind = body.mass * GRAVITY, share * drag
        height = 0.0 if unit.coupling is None else unit.coupling.height
        carried = behind.position if behind else 0.0
        turned = wind * (air - height)
        if behind:
            turned += pull * (behind.height - height)
        own = body.cg_position - used * (body.cg_height - height)
        levers, drawn = [], []
        for axles in unit.groups(payload):
            radius = parameters.tires[axles[0].tire].rolling_radius
            resistance = resistances[axles[0].name] if resistances else 0.0
            levers.append(group_center(axles) - resistance * radius)
            drawn.append(resistance)
        if unit.coupling is None:
            total, origin = weight + load, group_center(unit.groups(payload)[0])
            front, rear = levers[0] - origin, levers[1] - origin
            moment = weight * (own - origin) + load * (carried - origin) + turned
            on_rear = (moment - total * front) / (rear - front)
            groups.append((total - on_rear, on_rear))
            continue
        lever = levers[0] + (used + drawn[0]) * height
        on_coupling = weight * (1.0 - own / lever) + load * (1.0 - carried / lever) - turned / lever
        on_group = weight + load - on_coupling
        pull = wind + pull - used * weight + (used + drawn[0]) * on_group
        load, behind = on_coupling, unit.coupling
        couplings.append(on_coupling)
        groups.append((on_group,))
    return Supports(tuple(reversed(couplings)), tuple(reversed(groups)))


def air_shares(parameters: TruckParameters) -> tuple[float, ...]:
    """Returns each unit's share of drag and side force, sum 1."""
    total = sum(unit.air_share for unit in parameters.units)
    return tuple(unit.air_share / total for unit in parameters.units)


def coupling_loads(parameters: TruckParameters, payload: float) -> tuple[float, ...]:
    """Returns the vertical load on each coupling at rest on level ground [N], (units - 1,)."""
    return supports(parameters, payload).couplings


def static_axle_loads(parameters: TruckParameters, payload: float) -> FloatArray:
    """Returns axle loads at rest on level ground [N], shape (axles,), front to rear.

    A lifted axle has none.
    """
    return _axle_loads(parameters, payload, supports(parameters, payload))


def _axle_loads(parameters: TruckParameters, payload: float, found: Supports) -> FloatArray:
    """Distributes the groups' loads over their axles."""
    loads = dict.fromkeys((axle.name for axle in parameters.axles), 0.0)
    for unit, on_groups in zip(parameters.units, found.groups, strict=True):
        for axles, load in zip(unit.groups(payload), on_groups, strict=True):
            for axle, share in zip(axles, group_shares(axles), strict=True):
                loads[axle.name] = load * share if share != 1.0 / len(axles) else load / len(axles)
    return np.array(list(loads.values()))


def rolling_resistances(parameters: TruckParameters, loads: FloatArray) -> FloatArray:
    """Returns rolling resistance over load of each axle, (axles,), at axle loads [N], (axles,).

    A tire's coefficient changes with its load as `(load / test load)^(exponent - 1)`.
    """
    found = []
    for axle, load in zip(parameters.axles, loads, strict=True):
        tire = parameters.tires[axle.tire]
        power = tire.rolling_resistance_exponent - 1.0
        one = max(float(load), 1.0) / (2 * tire.count * tire.rolling_resistance_load)
        found.append(tire.rolling_resistance * (one**power if power else 1.0))
    return np.array(found)


def rolling_resistance(parameters: TruckParameters, payload: float) -> float:
    """Returns the combination's rolling resistance over its weight, at rest on level ground."""
    loads = static_axle_loads(parameters, payload)
    each = rolling_resistances(parameters, loads)
    if (each == each[0]).all():
        return float(each[0])
    return float((each * loads).sum() / loads.sum())


def cruise_axle_loads(parameters: TruckParameters, payload: float, speed: float) -> FloatArray:
    """Returns axle loads at constant speed [m/s] on a level road [N], (axles,), front to rear.

    Statics with air drag at its height, the pull at the couplings, rolling resistance as a forward
    shift of each wheel's load, and the drive force at the ground: the drive axles carry more and
    the steer axle less than at rest. At speed 0 the loads are those at rest.
    """
    static = static_axle_loads(parameters, payload)
    if speed <= 0.0:
        return static
    air = parameters.aerodynamics
    each = rolling_resistances(parameters, static)
    names = (axle.name for axle in parameters.axles)
    found = supports(
        parameters,
        payload,
        drag=0.5 * air.density * air.mean_drag_area(speed) * speed**2,
        resistances=dict(zip(names, each.tolist(), strict=True)),
    )
    return _axle_loads(parameters, payload, found)


def wheel_mass(parameters: TruckParameters) -> float:
    """Returns the equivalent mass of the turning wheels [kg], `sum J / r^2`."""
    return sum(
        2.0 * axle.wheel_inertia_spin / parameters.tires[axle.tire].rolling_radius ** 2
        for axle in parameters.axles
    )


def payload_of(parameters: TruckParameters, gross_mass: float) -> float:
    """Returns the payload [kg] of a truck of this gross mass [kg], within what it may carry."""
    return min(max(gross_mass - parameters.gross_mass(0.0), 0.0), parameters.payload_max)


def axle_loads_by_name(parameters: TruckParameters, payload: float) -> dict[str, float]:
    """Returns `static_axle_loads` [N] by the axles' names."""
    loads = static_axle_loads(parameters, payload)
    return {axle.name: float(load) for axle, load in zip(parameters.axles, loads, strict=True)}
