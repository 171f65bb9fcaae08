"""Writes the truck as MJCF from its parameters.

Frames: `tractor` has its origin at the steer axle's centre projected to the ground at rest,
`trailer` at the kingpin; x forward, y left, z up. Every element is named, with axle and side.
At `qpos0` all springs and tires carry their static loads: the truck stands still on a level road.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco

from iits_mj.core.units import GRAVITY
from iits_mj.model import visuals
from iits_mj.model.connections import (
    SIDES,
    add_actuators,
    add_extension,
    add_sensors,
    add_tendons,
    equalized_share,
    text,
)
from iits_mj.model.statics import beam_inertia, sprung, wheel_height, wheel_inertia
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import axle_loads_by_name, laden_trailer, payload_inertial

# Contact bits: the truck's hulls meet the ground (bit 0) and traffic (bit 2), never each other.
TRUCK_CONTYPE, TRUCK_CONAFFINITY = 2, 5
HEAVE_TRAVEL = 0.15  # [m], bump stop to rebound stop from ride height


def truck_spec(parameters: TruckParameters, payload: float) -> mujoco.MjSpec:
    """The truck with its visual geoms, as an editable specification.

    Args:
      parameters: of the truck; `with_payload_height` moves the load up or down.
      payload: [kg], 0 to `parameters.payload.mass_max`.

    Raises:
      InputError: the payload is out of range.
    """
    spec = mujoco.MjSpec.from_string(truck_xml(parameters, payload))
    visuals.decorate(spec, parameters, payload)
    return spec


def truck_xml(parameters: TruckParameters, payload: float) -> str:
    """MJCF text of the truck's mechanics, without visual geoms."""
    payload = parameters.check_payload(payload)
    root = ET.Element("mujoco", model="iits_truck")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(
        root, "option", timestep="0.002", integrator="implicitfast", gravity=f"0 0 {-GRAVITY}"
    )
    add_extension(root, parameters, payload)
    _defaults(root)
    world = ET.SubElement(root, "worldbody")
    _tractor(world, parameters, payload)
    add_tendons(root, parameters, payload)
    add_actuators(root, parameters)
    add_sensors(root, parameters)
    # Standing on a level road: what MuJoCo makes of a keyframe without figures.
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="home")
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _defaults(root: ET.Element) -> None:
    top = ET.SubElement(ET.SubElement(root, "default"), "default", {"class": "truck"})
    hull = ET.SubElement(top, "default", {"class": "hull"})
    ET.SubElement(
        hull,
        "geom",
        type="box",
        group="3",
        mass="0",
        contype=str(TRUCK_CONTYPE),
        conaffinity=str(TRUCK_CONAFFINITY),
        rgba="0.2 0.4 0.8 0.3",
    )
    heave = ET.SubElement(top, "default", {"class": "heave"})
    ET.SubElement(
        heave, "joint", type="slide", axis="0 0 1", range=text(-HEAVE_TRAVEL, HEAVE_TRAVEL)
    )
    roll = ET.SubElement(top, "default", {"class": "roll"})
    ET.SubElement(roll, "joint", type="hinge", axis="1 0 0")
    wheel = ET.SubElement(top, "default", {"class": "wheel"})
    ET.SubElement(wheel, "joint", type="hinge", axis="0 1 0")
    knuckle = ET.SubElement(top, "default", {"class": "knuckle"})
    ET.SubElement(knuckle, "joint", type="hinge", axis="0 0 1", range="-0.9 0.9")


def _inertial(
    body: ET.Element, mass: float, at: tuple[float, float, float], inertia: object
) -> None:
    ET.SubElement(
        body,
        "inertial",
        mass=text(mass),
        pos=text(*at),
        diaginertia=text(*inertia),  # type: ignore[misc]
    )


def _tractor(world: ET.Element, p: TruckParameters, payload: float) -> None:
    body = ET.SubElement(world, "body", name="tractor", childclass="truck")
    ET.SubElement(body, "freejoint", name="tractor_free")
    figures = sprung(p, p.tractor, payload)
    _inertial(body, figures.mass, (-figures.cg_position, 0, figures.cg_height), figures.inertia)
    t = p.tractor
    # The hull of the cab and chassis, for contact with traffic and, upset, with the ground.
    cab_length, low = 2.3, 0.45
    cab = {
        "size": text(0.5 * cab_length, 0.5 * t.width, 0.5 * (t.height - low)),
        "pos": text(t.front_overhang - 0.5 * cab_length, 0, 0.5 * (t.height + low)),
    }
    ET.SubElement(body, "geom", {"name": "tractor_cab_hull", "class": "hull", **cab})
    rear = t.axles[-1].position + 0.9
    chassis_length = rear + t.front_overhang - cab_length
    chassis = {
        "size": text(0.5 * chassis_length, 0.5 * t.width, 0.25),
        "pos": text(t.front_overhang - cab_length - 0.5 * chassis_length, 0, 0.75),
    }
    ET.SubElement(body, "geom", {"name": "tractor_chassis_hull", "class": "hull", **chassis})
    ET.SubElement(body, "site", name="tractor_imu", pos=text(0, 0, 0), size="0.05", group="4")
    cg = text(-t.cg_position, 0, t.cg_height)
    ET.SubElement(body, "site", name="tractor_cg", pos=cg, size="0.05", group="4")
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
            joint.set("range", text(*limit))
    figures = sprung(p, t, payload)
    center = (-figures.cg_position, 0.0, figures.cg_height - f.height)
    _inertial(body, figures.mass, center, figures.inertia)
    ET.SubElement(body, "plugin", plugin="iits.fifth_wheel", instance="fifth_wheel")
    low = 1.05
    box = {
        "size": text(0.5 * t.length, 0.5 * t.width, 0.5 * (t.height - low)),
        "pos": text(t.front_overhang - 0.5 * t.length, 0, 0.5 * (t.height + low) - f.height),
    }
    ET.SubElement(body, "geom", {"name": "trailer_body_hull", "class": "hull", **box})
    axles_middle = sum(axle.position for axle in t.axles) / len(t.axles)
    under = {
        "size": text(0.5 * (t.axles[-1].position - t.axles[0].position) + 0.5, 0.5 * t.width, 0.2),
        "pos": text(-axles_middle, 0, 0.8 - f.height),
    }
    ET.SubElement(body, "geom", {"name": "trailer_bogie_hull", "class": "hull", **under})
    ET.SubElement(body, "site", name="trailer_kingpin", pos="0 0 0", size="0.05", group="4")
    laden = laden_trailer(p, payload)
    cg = text(-laden.cg_position, 0, laden.cg_height - f.height)
    ET.SubElement(body, "site", name="trailer_cg", pos=cg, size="0.05", group="4")
    rear = text(-axles_middle, 0, -f.height)
    ET.SubElement(body, "site", name="trailer_axle_center", pos=rear, size="0.05", group="4")
    middle = t.front_overhang - 0.5 * t.length
    _pressure_center(body, "trailer", (middle, 0, p.aerodynamics.pressure_height - f.height))
    load = payload_inertial(p, payload)
    block = ET.SubElement(body, "body", name="payload")
    at_load = (-load.cg_position, 0.0, load.cg_height - f.height)
    if payload > 0:
        _inertial(block, load.mass, at_load, load.inertia)
    cg = text(*at_load)
    ET.SubElement(block, "site", name="payload_cg", pos=cg, size="0.05", group="4")
    for axle in t.axles:
        _axle(body, p, axle, loads[axle.name], f.height, steered=False)


def _pressure_center(body: ET.Element, unit: str, at: tuple[float, float, float]) -> None:
    point = ET.SubElement(body, "body", name=f"{unit}_pressure_center", pos=text(*at))
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
    """A rigid axle: heave and roll about its roll centre, then two hubs with their wheels."""
    height = wheel_height(p, axle, load)
    body = ET.SubElement(
        unit, "body", name=axle.name, pos=text(-axle.position, 0, height - origin_height)
    )
    arm = 0.5 * axle.spring_spacing**2
    # Spring forces are found so that the axle carries its static load at ride height.
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
