"""Builds the truck's MJCF from its parameters.

Frames: the origin of the motor vehicle, `tractor`, is the steer axle's center projected to the
ground at rest, that of a towed unit is its coupling point; x forward, y left, z up. Every element
is named, with axle and side. At `qpos0` all springs and tires carry their static loads, so that the
truck rests on a level road.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco
from numpy.typing import ArrayLike

from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import GRAVITY
from iits_mj.model.attributes import text
from iits_mj.model.connections import (
    SIDES,
    add_actuators,
    add_extension,
    add_sensors,
    add_tendons,
    alone_share,
)
from iits_mj.model.statics import beam_inertia, sprung, wheel_height, wheel_inertia
from iits_mj.model.visuals import decorate
from iits_mj.parameters import Axle, Coupling, TruckParameters, Unit
from iits_mj.parameters.mass_state import (
    Inertial,
    axle_loads_by_name,
    group_center,
    laden_units,
    payload_inertials,
)

# Contact bits: the truck's hulls collide with ground (bit 0) and traffic (bit 2), not each other.
TRUCK_CONTYPE, TRUCK_CONAFFINITY = 2, 5
LENGTH_MAX = 100.0  # [m]
HEAVE_TRAVEL = 0.15  # [m], bump stop to rebound stop from ride height
_KNUCKLE_MASS = 1.0  # [kg], taken from the wheel
_CAB_LENGTH, _CAB_LOW = 2.3, 0.45  # [m]; the second one above the road
_BODY_LOW = 1.05  # [m], of a load body above the road


def truck_spec(
    parameters: TruckParameters, payload: float, *, visuals: bool = True
) -> mujoco.MjSpec:
    """Returns the truck as an editable specification.

    Args:
      parameters: of the truck; `with_payload_height` changes the height of the load.
      payload: [kg], 0 to `parameters.payload_max`.
      visuals: adds the visual geoms; the physics is the same without, a step takes less time.

    Raises:
      InputError: the payload is out of range, or no truck has such parameters.
    """
    parameters.check_payload(payload)
    in_range("the truck's length", parameters.length, 1.0, LENGTH_MAX, "m")
    try:
        spec = mujoco.MjSpec.from_string(truck_xml(parameters, payload))
        if visuals:
            decorate(spec, parameters, payload)
    except InputError:
        raise
    except (ValueError, ArithmeticError, LookupError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"no truck can be built from these parameters: {reason}") from error
    return spec


def truck_xml(parameters: TruckParameters, payload: float) -> str:
    """Returns the MJCF text of the truck's mechanics, without visual geoms."""
    payload = parameters.check_payload(payload)
    root = ET.Element("mujoco", model="iits_truck")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    physics = {"timestep": str(TIMESTEP), "integrator": "implicitfast"}
    ET.SubElement(root, "option", physics, gravity=f"0 0 {-GRAVITY}")
    add_extension(root, parameters, payload)
    _defaults(root)
    world = ET.SubElement(root, "worldbody")
    _units(world, parameters, payload)
    add_tendons(root, parameters, payload)
    add_actuators(root, parameters)
    add_sensors(root, parameters)
    # A keyframe without numbers is `qpos0`: standing on a level road.
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="home")
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _defaults(root: ET.Element) -> None:
    top = ET.SubElement(ET.SubElement(root, "default"), "default", {"class": "truck"})

    def add(name: str, kind: str, **values: str) -> None:
        ET.SubElement(ET.SubElement(top, "default", {"class": name}), kind, values)

    contact = {"contype": str(TRUCK_CONTYPE), "conaffinity": str(TRUCK_CONAFFINITY)}
    add("hull", "geom", type="box", group="3", mass="0", **contact, rgba="0.2 0.4 0.8 0.3")
    travel = text(-HEAVE_TRAVEL, HEAVE_TRAVEL)
    add("heave", "joint", type="slide", axis="0 0 1", range=travel)
    add("roll", "joint", type="hinge", axis="1 0 0")
    add("wheel", "joint", type="hinge", axis="0 1 0")
    add("knuckle", "joint", type="hinge", axis="0 0 1", range="-0.9 0.9")


def _inertial(
    body: ET.Element, mass: float, at: ArrayLike, inertia: tuple[float, float, float]
) -> None:
    """Adds mass and inertia; raises InputError for what no body can have."""
    low, middle, high = sorted(inertia)
    if not (mass > 0.0 and low > 0.0 and low + middle >= high * (1.0 - 1e-9)):
        shown = ", ".join(f"{value:.4g}" for value in inertia)
        raise InputError(
            f"body {body.get('name')!r} would have a mass of {mass:.4g} kg and inertias of {shown} "
            "kg m2 about x, y, z, less its axles and wheels: each must be above zero, none more "
            "than the sum of the others; check mass, cg_position, cg_height, inertia_x, inertia_y "
            "and inertia_z, and unsprung_mass and wheel_mass of the axles"
        )
    values = {"mass": text(mass), "pos": text(at), "diaginertia": text(inertia)}
    ET.SubElement(body, "inertial", values)


def _hull(
    body: ET.Element, name: str, size: tuple[float, float, float], at: tuple[float, float, float]
) -> None:
    """Adds a box that collides with traffic and, after a rollover, the ground; half `size` [m]."""
    shape = {"name": name, "class": "hull", "size": text(size), "pos": text(at)}
    ET.SubElement(body, "geom", shape)


def _site(body: ET.Element, name: str, at: tuple[float, float, float]) -> None:
    ET.SubElement(body, "site", name=name, pos=text(at), size="0.05", group="4")


def _units(world: ET.Element, p: TruckParameters, payload: float) -> None:
    """Adds the chain of units: each one is a child of the unit ahead."""
    loads = axle_loads_by_name(p, payload)
    bodies, blocks = laden_units(p, payload), payload_inertials(p, payload)
    names = ("", *p.coupling_names)
    ahead, height = world, 0.0
    payload_name = "payload"
    for unit, coupling, laden, load in zip(p.units, names, bodies, blocks, strict=True):
        if unit.coupling is None:
            body = ET.SubElement(ahead, "body", name=unit.name, childclass="truck")
            ET.SubElement(body, "freejoint", name=f"{unit.name}_free")
        else:
            at = (-unit.coupling.position, 0, unit.coupling.height - height)
            body = ET.SubElement(ahead, "body", name=unit.name, pos=text(at))
            height = unit.coupling.height
            _hinges(body, unit.coupling, coupling)
        chassis = sprung(p, unit, payload)
        center = (-chassis.cg_position, 0.0, chassis.cg_height - height)
        _inertial(body, chassis.mass, center, chassis.inertia)
        if unit.coupling is None:
            _lead_hulls(body, unit)
            _site(body, f"{unit.name}_imu", (0, 0, 0))
        else:
            ET.SubElement(body, "plugin", plugin="iits.fifth_wheel", instance=coupling)
            _towed_hulls(body, unit, height)
            _site(body, f"{unit.name}_kingpin", (0, 0, 0))
        _site(body, f"{unit.name}_cg", (-laden.cg_position, 0, laden.cg_height - height))
        if unit.coupling is not None or unit is p.last:
            rear = group_center(unit.groups(payload)[-1])
            _site(body, f"{unit.name}_axle_center", (-rear, 0, -height))
        pressure = (pressure_position(unit), 0, p.aerodynamics.pressure_height - height)
        _pressure_center(body, unit.name, pressure)
        if load is not None:
            _payload(body, payload_name, load, height)
            payload_name = f"{unit.name}_payload"
        for axle in unit.axles:
            _axle(body, p, axle, loads[axle.name], height, alone_share(p, axle, payload))
        ahead = body


def _hinges(body: ET.Element, coupling: Coupling, name: str) -> None:
    joints = (
        ("yaw", "0 0 1", (-coupling.yaw_limit, coupling.yaw_limit)),
        ("pitch", "0 1 0", (coupling.pitch_min, coupling.pitch_max)),
        ("roll", "1 0 0", None),
    )
    for part, axis, limit in joints:
        joint = ET.SubElement(body, "joint", name=f"{name}_{part}", type="hinge", axis=axis)
        if limit:
            joint.set("range", text(limit))


def _lead_hulls(body: ET.Element, unit: Unit) -> None:
    """Cab, and behind it the chassis of a tractor or the load body of a rigid truck."""
    _hull(
        body,
        f"{unit.name}_cab_hull",
        (0.5 * _CAB_LENGTH, 0.5 * unit.width, 0.5 * (unit.height - _CAB_LOW)),
        (unit.front_overhang - 0.5 * _CAB_LENGTH, 0, 0.5 * (unit.height + _CAB_LOW)),
    )
    length = unit.length - _CAB_LENGTH
    middle = unit.front_overhang - _CAB_LENGTH - 0.5 * length
    size, at = (0.5 * length, 0.5 * unit.width, 0.25), (middle, 0, 0.75)
    _hull(body, f"{unit.name}_chassis_hull", size, at)
    if unit.kind == "rigid_truck":
        size = (0.5 * length, 0.5 * unit.width, 0.5 * (unit.height - _BODY_LOW))
        _hull(body, f"{unit.name}_body_hull", size, (middle, 0, 0.5 * (unit.height + _BODY_LOW)))


def _towed_hulls(body: ET.Element, unit: Unit, height: float) -> None:
    """Load body, unless it is a dolly, and the axles' group; `height` of the unit's origin."""
    middle = unit.front_overhang - 0.5 * unit.length
    if unit.kind != "dolly":
        size = (0.5 * unit.length, 0.5 * unit.width, 0.5 * (unit.height - _BODY_LOW))
        at = (middle, 0, 0.5 * (unit.height + _BODY_LOW) - height)
        _hull(body, f"{unit.name}_body_hull", size, at)
    first, last = unit.axles[0].position, unit.axles[-1].position
    size = (0.5 * (last - first) + 0.5, 0.5 * unit.width, 0.2)
    _hull(body, f"{unit.name}_bogie_hull", size, (-0.5 * (first + last), 0, 0.8 - height))


def _payload(unit: ET.Element, name: str, load: Inertial, height: float) -> None:
    """Adds a unit's load as a body of its own; `height` of the unit's origin."""
    block = ET.SubElement(unit, "body", name=name)
    center = (-load.cg_position, 0.0, load.cg_height - height)
    if load.mass > 0:
        _inertial(block, load.mass, center, load.inertia)
    _site(block, f"{name}_cg", center)


def pressure_position(unit: Unit) -> float:
    """Returns where air pushes a unit, ahead of its origin [m].

    At the front of a motor vehicle, where by slender-body theory its side force acts, and in the
    middle of a towed unit.
    """
    front = unit.front_overhang
    return front if unit.coupling is None else front - 0.5 * unit.length


def _pressure_center(body: ET.Element, unit: str, at: tuple[float, float, float]) -> None:
    point = ET.SubElement(body, "body", name=f"{unit}_pressure_center", pos=text(at))
    ET.SubElement(point, "plugin", plugin="iits.aerodynamics", instance=f"aerodynamics_{unit}")


def _axle(
    unit: ET.Element,
    p: TruckParameters,
    axle: Axle,
    load: float,
    origin_height: float,
    alone: float,
) -> None:
    """Adds a rigid axle: heave and roll about its roll center, two hubs, their wheels.

    Args:
      unit: its body.
      p: parameters of the truck.
      axle: to add.
      load: on the road [N], 0 for a lifted axle.
      origin_height: of the unit's origin above the road [m].
      alone: share of the spring that acts without load compensation.
    """
    height = wheel_height(p, axle, load)
    body = ET.SubElement(
        unit, "body", name=axle.name, pos=text(-axle.position, 0, height - origin_height)
    )
    arm = 0.5 * axle.spring_spacing**2
    # The spring's preload carries the axle's static load at ride height, or a lifted axle.
    rate = 2 * axle.spring_rate * alone
    heave = {"name": f"{axle.name}_heave", "class": "heave", "damping": text(2 * axle.damping)}
    if rate > 0:
        preload = (load - axle.unsprung_mass * GRAVITY) * alone
        heave |= {"stiffness": text(rate), "springref": text(-preload / rate)}
    ET.SubElement(body, "joint", heave)
    roll = {
        "name": f"{axle.name}_roll",
        "class": "roll",
        "pos": text(0, 0, axle.roll_center_height),
        "stiffness": text(axle.spring_rate * arm + axle.auxiliary_roll_stiffness),
        "damping": text(axle.damping * arm),
    }
    ET.SubElement(body, "joint", roll)
    _inertial(body, axle.unsprung_mass - 2 * axle.wheel_mass, (0, 0, 0), beam_inertia(axle))
    turns = axle.steered or axle.self_steering is not None
    for side, sign in zip(SIDES, (1, -1), strict=True):
        name = f"{axle.name}_{side}"
        hub = ET.SubElement(
            body, "body", name=f"{name}_hub", pos=text(0, sign * 0.5 * axle.track, 0)
        )
        if turns:
            _knuckle(hub, p, axle, name)
        ET.SubElement(hub, "plugin", plugin="iits.air_brake", instance="air_brake")
        wheel = ET.SubElement(hub, "body", name=f"{name}_wheel")
        ET.SubElement(wheel, "joint", {"name": f"{name}_spin", "class": "wheel"})
        mass = axle.wheel_mass - (_KNUCKLE_MASS if turns else 0.0)
        _inertial(wheel, mass, (0, 0, 0), wheel_inertia(p, axle))
        ET.SubElement(wheel, "plugin", plugin="iits.tire", instance=f"tire_{axle.tire}")


def _knuckle(hub: ET.Element, p: TruckParameters, axle: Axle, name: str) -> None:
    """Adds the kingpin of a hub: at the wheel's center, or ahead of it on a self-steering axle."""
    inertia = {"armature": text(p.steering.knuckle_inertia)}
    joint = {"name": f"{name}_knuckle", "class": "knuckle"}
    own = axle.self_steering
    if own is None:
        joint |= {"damping": text(p.steering.damping)} | inertia
    else:
        joint |= {
            "pos": text(own.trail, 0, 0),
            "range": text(-own.angle_max, own.angle_max),
            "stiffness": text(own.stiffness),
            "damping": text(own.damping),
        } | inertia
    ET.SubElement(hub, "joint", joint)
    _inertial(hub, _KNUCKLE_MASS, (0, 0, 0), (0.1, 0.1, 0.1))
