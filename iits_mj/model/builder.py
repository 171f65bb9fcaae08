"""Builds the truck's MJCF from its parameters.

Frames: the origin of `tractor` is the steer axle's center projected to the ground at rest, that of
`trailer` is the kingpin; x forward, y left, z up. Every element is named, with axle and side. At
`qpos0` all springs and tires carry their static loads, so that the truck rests on a level road.
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
    equalized_share,
)
from iits_mj.model.statics import beam_inertia, sprung, wheel_height, wheel_inertia
from iits_mj.model.visuals import decorate
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import (
    axle_loads_by_name,
    group_center,
    laden_trailer,
    payload_inertial,
)

# Contact bits: the truck's hulls collide with ground (bit 0) and traffic (bit 2), not each other.
TRUCK_CONTYPE, TRUCK_CONAFFINITY = 2, 5
LENGTH_MAX = 100.0  # [m]
HEAVE_TRAVEL = 0.15  # [m], bump stop to rebound stop from ride height


def truck_spec(
    parameters: TruckParameters, payload: float, *, visuals: bool = True
) -> mujoco.MjSpec:
    """Returns the truck as an editable specification.

    Args:
      parameters: of the truck; `with_payload_height` changes the height of the load.
      payload: [kg], 0 to `parameters.payload.mass_max`.
      visuals: adds the visual geoms; the physics is the same without, a step takes less time.

    Raises:
      InputError: the payload is out of range, or no truck has such parameters.
    """
    parameters.check_payload(payload)
    in_range("parameter semitrailer.length", parameters.semitrailer.length, 1.0, LENGTH_MAX, "m")
    try:
        spec = mujoco.MjSpec.from_string(truck_xml(parameters, payload))
        if visuals:
            decorate(spec, parameters, payload)
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
    _tractor(world, parameters, payload)
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


def _tractor(world: ET.Element, p: TruckParameters, payload: float) -> None:
    body = ET.SubElement(world, "body", name="tractor", childclass="truck")
    ET.SubElement(body, "freejoint", name="tractor_free")
    chassis = sprung(p, p.tractor, payload)
    _inertial(body, chassis.mass, (-chassis.cg_position, 0, chassis.cg_height), chassis.inertia)
    t = p.tractor
    cab_length, low = 2.3, 0.45
    _hull(
        body,
        "tractor_cab_hull",
        (0.5 * cab_length, 0.5 * t.width, 0.5 * (t.height - low)),
        (t.front_overhang - 0.5 * cab_length, 0, 0.5 * (t.height + low)),
    )
    rear = t.axles[-1].position + 0.9
    length = rear + t.front_overhang - cab_length
    middle = t.front_overhang - cab_length - 0.5 * length
    _hull(body, "tractor_chassis_hull", (0.5 * length, 0.5 * t.width, 0.25), (middle, 0, 0.75))
    _site(body, "tractor_imu", (0, 0, 0))
    _site(body, "tractor_cg", (-t.cg_position, 0, t.cg_height))
    _pressure_center(body, "tractor", (t.front_overhang, 0, p.aerodynamics.pressure_height))
    loads = axle_loads_by_name(p, payload)
    for axle in t.axles:
        _axle(body, p, axle, loads[axle.name], 0.0, steered=axle is t.axles[0])
    _trailer(body, p, payload, loads)


def _trailer(
    tractor: ET.Element, p: TruckParameters, payload: float, loads: dict[str, float]
) -> None:
    f, t = p.fifth_wheel, p.semitrailer
    at = text(-f.position, 0, f.height)
    body = ET.SubElement(tractor, "body", name="trailer", pos=at)
    joints = (
        ("yaw", "0 0 1", (-f.yaw_limit, f.yaw_limit)),
        ("pitch", "0 1 0", (f.pitch_min, f.pitch_max)),
        ("roll", "1 0 0", None),
    )
    for name, axis, limit in joints:
        joint = ET.SubElement(body, "joint", name=f"fifth_wheel_{name}", type="hinge", axis=axis)
        if limit:
            joint.set("range", text(limit))
    chassis = sprung(p, t, payload)
    center = (-chassis.cg_position, 0.0, chassis.cg_height - f.height)
    _inertial(body, chassis.mass, center, chassis.inertia)
    ET.SubElement(body, "plugin", plugin="iits.fifth_wheel", instance="fifth_wheel")
    low, middle = 1.05, t.front_overhang - 0.5 * t.length
    size = (0.5 * t.length, 0.5 * t.width, 0.5 * (t.height - low))
    _hull(body, "trailer_body_hull", size, (middle, 0, 0.5 * (t.height + low) - f.height))
    group = group_center(t.axles)
    size = (0.5 * (t.axles[-1].position - t.axles[0].position) + 0.5, 0.5 * t.width, 0.2)
    _hull(body, "trailer_bogie_hull", size, (-group, 0, 0.8 - f.height))
    _site(body, "trailer_kingpin", (0, 0, 0))
    laden = laden_trailer(p, payload)
    _site(body, "trailer_cg", (-laden.cg_position, 0, laden.cg_height - f.height))
    _site(body, "trailer_axle_center", (-group, 0, -f.height))
    _pressure_center(body, "trailer", (middle, 0, p.aerodynamics.pressure_height - f.height))
    load = payload_inertial(p, payload)
    block = ET.SubElement(body, "body", name="payload")
    center = (-load.cg_position, 0.0, load.cg_height - f.height)
    if payload > 0:
        _inertial(block, load.mass, center, load.inertia)
    _site(block, "payload_cg", center)
    for axle in t.axles:
        _axle(body, p, axle, loads[axle.name], f.height, steered=False)


def _pressure_center(body: ET.Element, unit: str, at: tuple[float, float, float]) -> None:
    point = ET.SubElement(body, "body", name=f"{unit}_pressure_center", pos=text(at))
    ET.SubElement(point, "plugin", plugin="iits.aerodynamics", instance=f"aerodynamics_{unit}")


def _axle(
    unit: ET.Element,
    p: TruckParameters,
    axle: Axle,
    load: float,
    origin_height: float,
    *,
    steered: bool,
) -> None:
    """Adds a rigid axle: heave and roll about its roll center, two hubs, their wheels."""
    height = wheel_height(p, axle, load)
    body = ET.SubElement(
        unit, "body", name=axle.name, pos=text(-axle.position, 0, height - origin_height)
    )
    arm = 0.5 * axle.spring_spacing**2
    # The spring's preload carries the axle's static load at ride height.
    rate = 2 * axle.spring_rate * (1 - equalized_share(p, axle))
    heave = {"name": f"{axle.name}_heave", "class": "heave", "damping": text(2 * axle.damping)}
    if rate > 0:
        preload = (load - axle.unsprung_mass * GRAVITY) * (1 - equalized_share(p, axle))
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
    for side, sign in zip(SIDES, (1, -1), strict=True):
        name = f"{axle.name}_{side}"
        hub = ET.SubElement(
            body, "body", name=f"{name}_hub", pos=text(0, sign * 0.5 * axle.track, 0)
        )
        if steered:
            knuckle = {
                "name": f"{name}_knuckle",
                "class": "knuckle",
                "damping": text(p.steering.damping),
                "armature": text(p.steering.knuckle_inertia),
            }
            ET.SubElement(hub, "joint", knuckle)
            _inertial(hub, 1.0, (0, 0, 0), (0.1, 0.1, 0.1))
        ET.SubElement(hub, "plugin", plugin="iits.air_brake", instance="air_brake")
        wheel = ET.SubElement(hub, "body", name=f"{name}_wheel")
        ET.SubElement(wheel, "joint", {"name": f"{name}_spin", "class": "wheel"})
        mass = axle.wheel_mass - (1.0 if steered else 0.0)
        _inertial(wheel, mass, (0, 0, 0), wheel_inertia(p, axle))
        ET.SubElement(wheel, "plugin", plugin="iits.tire", instance=f"tire_{axle.tire}")
