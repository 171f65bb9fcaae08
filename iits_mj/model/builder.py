"""Writes the truck as MJCF from its parameters.

Frames: `tractor` has its origin at the steer axle's centre projected to the ground at rest, `trailer`
at the kingpin; x forward, y left, z up. Every element is named, axle and side in the name. At
`qpos0` all springs and tires carry their static loads, so the truck stands still on a level road.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import mujoco

from iits_mj.model import air_brake, powertrain, visuals
from iits_mj.model.statics import (
    beam_inertia,
    payload_inertial,
    sprung,
    static_loads,
    wheel_height,
    wheel_inertia,
)
from iits_mj.parameters import GRAVITY, Axle, TruckParameters

SIDES = ("left", "right")
# Contact bits: the truck's hulls meet the ground (bit 0) and traffic (bit 2), never each other.
TRUCK_CONTYPE, TRUCK_CONAFFINITY = 2, 5
HEAVE_TRAVEL = 0.15  # [m], bump stop to rebound stop from ride height
POWERTRAIN_SIGNALS = powertrain.SIGNALS
AIR_BRAKE_SIGNALS = air_brake.SIGNALS


def truck_spec(parameters: TruckParameters, payload: float) -> mujoco.MjSpec:
    """The truck with its visual geoms, as an editable specification.

    Args:
      parameters: of the truck.
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
    _extension(root, parameters, payload)
    _defaults(root)
    world = ET.SubElement(root, "worldbody")
    _tractor(world, parameters, payload)
    _tendons(root, parameters, payload)
    _actuators(root, parameters)
    _sensors(root, parameters)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _text(*numbers: float) -> str:
    return " ".join(f"{number:.10g}" for number in numbers)


def _instance(plugin: ET.Element, name: str, config: Mapping[str, str]) -> None:
    element = ET.SubElement(plugin, "instance", name=name)
    for key, value in config.items():
        ET.SubElement(element, "config", key=key, value=value)


def _extension(root: ET.Element, p: TruckParameters, payload: float) -> None:
    extension = ET.SubElement(root, "extension")

    def plugin(name: str) -> ET.Element:
        return ET.SubElement(extension, "plugin", plugin=f"iits.{name}")

    tire = plugin("tire")
    for kind, figures in p.tires.items():
        config = {**vars(figures), **vars(p.tire_common)}
        _instance(tire, f"tire_{kind}", {key: _text(value) for key, value in config.items()})
    steer, tandem = p.tractor.axles[0], p.tractor.axles[1:]
    wheelbase = sum(axle.position for axle in tandem) / len(tandem) - steer.position
    names = ("ratio", "dead_band", "angle_max", "rate_max", "stiffness", "time_constant")
    steering = {name: _text(getattr(p.steering, name)) for name in names}
    steering |= {"wheelbase": _text(wheelbase), "track": _text(steer.track)}
    _instance(plugin("steering"), "steering", steering)
    names = ("roll_stiffness", "roll_damping", "roll_lash", "yaw_friction")
    fifth_wheel = {name: _text(getattr(p.fifth_wheel, name)) for name in names}
    _instance(plugin("fifth_wheel"), "fifth_wheel", fifth_wheel)
    air = plugin("aerodynamics")
    share = p.aerodynamics.tractor_share
    for unit, part in (("tractor", share), ("trailer", 1.0 - share)):
        config = {
            "density": _text(p.aerodynamics.density),
            "drag_area": _text(part * p.aerodynamics.drag_area),
            "side_area": _text(part * p.aerodynamics.side_area),
        }
        _instance(air, f"aerodynamics_{unit}", config)
    _instance(plugin("powertrain"), "powertrain", powertrain.config(p))
    _instance(plugin("air_brake"), "air_brake", air_brake.config(p, p.gross_mass(payload)))


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
        heave, "joint", type="slide", axis="0 0 1", range=_text(-HEAVE_TRAVEL, HEAVE_TRAVEL)
    )
    roll = ET.SubElement(top, "default", {"class": "roll"})
    ET.SubElement(roll, "joint", type="hinge", axis="1 0 0")
    wheel = ET.SubElement(top, "default", {"class": "wheel"})
    ET.SubElement(wheel, "joint", type="hinge", axis="0 1 0")
    knuckle = ET.SubElement(top, "default", {"class": "knuckle"})
    ET.SubElement(knuckle, "joint", type="hinge", axis="0 0 1", range="-0.9 0.9")


def _inertial(body: ET.Element, mass: float, at: tuple[float, float, float], inertia: object) -> None:
    ET.SubElement(
        body,
        "inertial",
        mass=_text(mass),
        pos=_text(*at),
        diaginertia=_text(*inertia),  # type: ignore[misc]
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
        "size": _text(0.5 * cab_length, 0.5 * t.width, 0.5 * (t.height - low)),
        "pos": _text(t.front_overhang - 0.5 * cab_length, 0, 0.5 * (t.height + low)),
    }
    ET.SubElement(body, "geom", {"name": "tractor_cab_hull", "class": "hull", **cab})
    rear = t.axles[-1].position + 0.9
    chassis_length = rear + t.front_overhang - cab_length
    chassis = {
        "size": _text(0.5 * chassis_length, 0.5 * t.width, 0.25),
        "pos": _text(t.front_overhang - cab_length - 0.5 * chassis_length, 0, 0.75),
    }
    ET.SubElement(body, "geom", {"name": "tractor_chassis_hull", "class": "hull", **chassis})
    ET.SubElement(body, "site", name="tractor_imu", pos=_text(0, 0, 0), size="0.05", group="4")
    cg = _text(-t.cg_position, 0, t.cg_height)
    ET.SubElement(body, "site", name="tractor_cg", pos=cg, size="0.05", group="4")
    _pressure_center(body, "tractor", (t.front_overhang, 0, p.aerodynamics.pressure_height))
    loads = dict(zip((a.name for a in p.axles), static_loads(p, payload).axles, strict=True))
    for axle in t.axles:
        _axle(body, p, axle, loads[axle.name], 0.0, steered=axle is t.axles[0])
    _trailer(body, p, payload, loads)


def _trailer(tractor: ET.Element, p: TruckParameters, payload: float, loads: dict) -> None:
    f, t = p.fifth_wheel, p.semitrailer
    at = _text(-f.position, 0, f.height)
    body = ET.SubElement(tractor, "body", name="trailer", pos=at)
    joints = (
        ("yaw", "0 0 1", (-f.yaw_limit, f.yaw_limit)),
        ("pitch", "0 1 0", (f.pitch_min, f.pitch_max)),
        ("roll", "1 0 0", None),
    )
    for name, axis, limit in joints:
        joint = ET.SubElement(body, "joint", name=f"fifth_wheel_{name}", type="hinge", axis=axis)
        if limit:
            joint.set("range", _text(*limit))
    figures = sprung(p, t, payload)
    center = (-figures.cg_position, 0.0, figures.cg_height - f.height)
    _inertial(body, figures.mass, center, figures.inertia)
    ET.SubElement(body, "plugin", plugin="iits.fifth_wheel", instance="fifth_wheel")
    low = 1.05
    box = {
        "size": _text(0.5 * t.length, 0.5 * t.width, 0.5 * (t.height - low)),
        "pos": _text(t.front_overhang - 0.5 * t.length, 0, 0.5 * (t.height + low) - f.height),
    }
    ET.SubElement(body, "geom", {"name": "trailer_body_hull", "class": "hull", **box})
    axles_middle = sum(axle.position for axle in t.axles) / len(t.axles)
    under = {
        "size": _text(0.5 * (t.axles[-1].position - t.axles[0].position) + 0.5, 0.5 * t.width, 0.2),
        "pos": _text(-axles_middle, 0, 0.8 - f.height),
    }
    ET.SubElement(body, "geom", {"name": "trailer_bogie_hull", "class": "hull", **under})
    ET.SubElement(body, "site", name="trailer_kingpin", pos="0 0 0", size="0.05", group="4")
    cg = _text(-t.cg_position, 0, t.cg_height - f.height)
    ET.SubElement(body, "site", name="trailer_cg", pos=cg, size="0.05", group="4")
    rear = _text(-axles_middle, 0, -f.height)
    ET.SubElement(body, "site", name="trailer_axle_center", pos=rear, size="0.05", group="4")
    middle = t.front_overhang - 0.5 * t.length
    _pressure_center(body, "trailer", (middle, 0, p.aerodynamics.pressure_height - f.height))
    load = payload_inertial(p, payload)
    block = ET.SubElement(body, "body", name="payload")
    if payload > 0:
        at_load = (-load.cg_position, 0.0, load.cg_height - f.height)
        _inertial(block, load.mass, at_load, load.inertia)
    for axle in t.axles:
        _axle(body, p, axle, loads[axle.name], f.height, steered=False)


def _pressure_center(body: ET.Element, unit: str, at: tuple[float, float, float]) -> None:
    point = ET.SubElement(body, "body", name=f"{unit}_pressure_center", pos=_text(*at))
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
        unit, "body", name=axle.name, pos=_text(-axle.position, 0, height - origin_height)
    )
    arm = 0.5 * axle.spring_spacing**2
    # Spring forces are found so that the axle carries its static load at ride height.
    rate = 2 * axle.spring_rate * (1 - _equalized_share(p, axle))
    heave = {"name": f"{axle.name}_heave", "class": "heave", "damping": _text(2 * axle.damping)}
    if rate > 0:
        preload = (load - axle.unsprung_mass * GRAVITY) * (1 - _equalized_share(p, axle))
        heave |= {"stiffness": _text(rate), "springref": _text(-preload / rate)}
    ET.SubElement(body, "joint", heave)
    roll = {
        "name": f"{axle.name}_roll",
        "class": "roll",
        "pos": _text(0, 0, axle.roll_center_height),
        "stiffness": _text(axle.spring_rate * arm + axle.auxiliary_roll_stiffness),
        "damping": _text(axle.damping * arm),
    }
    ET.SubElement(body, "joint", roll)
    _inertial(body, axle.unsprung_mass - 2 * axle.wheel_mass, (0, 0, 0), beam_inertia(axle))
    for side, sign in zip(SIDES, (1, -1), strict=True):
        name = f"{axle.name}_{side}"
        hub = ET.SubElement(
            body, "body", name=f"{name}_hub", pos=_text(0, sign * 0.5 * axle.track, 0)
        )
        if steered:
            knuckle = {
                "name": f"{name}_knuckle",
                "class": "knuckle",
                "damping": _text(p.steering.damping),
                "armature": _text(p.steering.knuckle_inertia),
            }
            ET.SubElement(hub, "joint", knuckle)
            _inertial(hub, 1.0, (0, 0, 0), (0.1, 0.1, 0.1))
        ET.SubElement(hub, "plugin", plugin="iits.air_brake", instance="air_brake")
        wheel = ET.SubElement(hub, "body", name=f"{name}_wheel")
        ET.SubElement(wheel, "joint", {"name": f"{name}_spin", "class": "wheel"})
        mass = axle.wheel_mass - (1.0 if steered else 0.0)
        _inertial(wheel, mass, (0, 0, 0), wheel_inertia(p, axle))
        ET.SubElement(wheel, "plugin", plugin="iits.tire", instance=f"tire_{axle.tire}")


def _equalized_share(p: TruckParameters, axle: Axle) -> float:
    """Share of the axle's spring that acts through the group's load compensation."""
    if axle is p.tractor.axles[0]:
        return 0.0
    return (p.tractor if axle in p.tractor.axles else p.semitrailer).load_equalization


def _tendons(root: ET.Element, p: TruckParameters, payload: float) -> None:
    tendon = ET.SubElement(root, "tendon")
    drive = [axle for axle in p.tractor.axles if axle.tire == "drive"]
    shaft = ET.SubElement(tendon, "fixed", name="propeller_shaft")
    for axle in drive:
        for side in SIDES:
            # Open differentials: shaft speed is the mean of the wheels, torque splits equally.
            share = p.gearbox.final_drive / (2 * len(drive))
            ET.SubElement(shaft, "joint", joint=f"{axle.name}_{side}_spin", coef=_text(share))
    linkage = ET.SubElement(tendon, "fixed", name="steering_linkage")
    for side in SIDES:
        ET.SubElement(linkage, "joint", joint=f"{p.tractor.axles[0].name}_{side}_knuckle", coef="0.5")
    # Load compensation: a spring on the sum of the group's heave pushes every axle alike.
    loads = dict(zip((a.name for a in p.axles), static_loads(p, payload).axles, strict=True))
    for name, axles in (("tandem", p.tractor.axles[1:]), ("triaxle", p.semitrailer.axles)):
        share = _equalized_share(p, axles[0])
        rate = 2 * axles[0].spring_rate * share / len(axles)
        if rate <= 0:
            continue
        preload = share * (loads[axles[0].name] - axles[0].unsprung_mass * GRAVITY)
        length = _text(preload / rate, preload / rate)
        group = ET.SubElement(
            tendon, "fixed", name=f"{name}_heave", stiffness=_text(rate), springlength=length
        )
        for axle in axles:
            ET.SubElement(group, "joint", joint=f"{axle.name}_heave", coef="-1")


def _actuators(root: ET.Element, p: TruckParameters) -> None:
    actuator = ET.SubElement(root, "actuator")
    angle = p.steering.angle_max
    rows = (
        ("accelerator_pedal", "powertrain", "propeller_shaft", (0, 1)),
        ("xbr_demand", "air_brake", "propeller_shaft", (-10, 0)),
        ("xbr_mode", "air_brake", "propeller_shaft", (0, 2)),
        ("steering_wheel_angle", "steering", "steering_linkage", (-angle, angle)),
        ("parking_brake", "air_brake", "propeller_shaft", (0, 1)),
        ("engine_brake", "powertrain", "propeller_shaft", (0, 1)),
        ("transmission_mode", "powertrain", "propeller_shaft", (0, 2)),
    )
    for name, instance, tendon, limit in rows:
        ET.SubElement(
            actuator,
            "plugin",
            name=name,
            plugin=f"iits.{instance}",
            instance=instance,
            tendon=tendon,
            ctrlrange=_text(*limit),
        )


def _sensors(root: ET.Element, p: TruckParameters) -> None:
    sensor = ET.SubElement(root, "sensor")

    def plugin(name: str, instance: str, **more: str) -> None:
        kind = instance if instance in ("powertrain", "air_brake", "steering") else "tire"
        ET.SubElement(
            sensor, "plugin", name=name, plugin=f"iits.{kind}", instance=instance, **more
        )

    for name in POWERTRAIN_SIGNALS:
        plugin(name, "powertrain")
    for name in AIR_BRAKE_SIGNALS:
        plugin(name, "air_brake")
    plugin("steering_wheel_position", "steering")
    for side in SIDES:
        knuckle = f"{p.tractor.axles[0].name}_{side}_knuckle"
        ET.SubElement(sensor, "jointpos", name=f"steer_angle_{side}", joint=knuckle)
    for name in ("yaw", "pitch", "roll"):
        ET.SubElement(sensor, "jointpos", name=f"articulation_{name}", joint=f"fifth_wheel_{name}")
    ET.SubElement(sensor, "jointvel", name="articulation_rate", joint="fifth_wheel_yaw")
    ET.SubElement(sensor, "framepos", name="tractor_position", objtype="body", objname="tractor")
    ET.SubElement(sensor, "framequat", name="tractor_orientation", objtype="body", objname="tractor")
    ET.SubElement(sensor, "velocimeter", name="tractor_velocity", site="tractor_imu")
    ET.SubElement(sensor, "gyro", name="tractor_gyro", site="tractor_imu")
    ET.SubElement(sensor, "accelerometer", name="tractor_acceleration", site="tractor_cg")
    ET.SubElement(sensor, "gyro", name="trailer_gyro", site="trailer_cg")
    ET.SubElement(sensor, "velocimeter", name="trailer_velocity", site="trailer_cg")
    ET.SubElement(sensor, "accelerometer", name="trailer_acceleration", site="trailer_cg")
    for axle in p.axles:
        for side in SIDES:
            wheel = f"{axle.name}_{side}_wheel"
            for signal in ("tire_force", "tire_slip"):
                name = f"{axle.name}_{side}_{signal}"
                plugin(name, f"tire_{axle.tire}", objtype="body", objname=wheel)
