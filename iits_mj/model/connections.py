"""Plugin instances, tendons, controls and sensors of the truck's MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

from iits_mj.core.units import GRAVITY
from iits_mj.model import air_brake, powertrain
from iits_mj.model.attributes import plugin_attributes, text
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import axle_loads_by_name, group_center, kingpin_load
from iits_mj.parameters.tire_law import nominal_cornering_coefficient

SIDES = ("left", "right")


def _instance(plugin: ET.Element, name: str, config: Mapping[str, str]) -> None:
    element = ET.SubElement(plugin, "instance", name=name)
    for key, value in config.items():
        ET.SubElement(element, "config", key=key, value=value)


def tire_config(p: TruckParameters, kind: str) -> dict[str, float]:
    """Returns the attributes of the tire plugin for one kind of tire, at nominal load."""
    tire = p.tires[kind]
    config = {**vars(tire), **vars(p.tire_common)}
    del config["cornering_load"]
    config["cornering_coefficient"] = nominal_cornering_coefficient(tire, p.tire_common)
    return config


def add_extension(root: ET.Element, p: TruckParameters, payload: float) -> None:
    """Adds every plugin instance with its configuration."""
    extension = ET.SubElement(root, "extension")

    def plugin(name: str) -> ET.Element:
        return ET.SubElement(extension, "plugin", plugin=f"iits.{name}")

    tire = plugin("tire")
    for kind in p.tires:
        values = tire_config(p, kind)
        _instance(tire, f"tire_{kind}", {key: text(value) for key, value in values.items()})
    steer, tandem = p.tractor.axles[0], p.tractor.axles[1:]
    wheelbase = group_center(tandem) - steer.position
    # The other parameters of the section are those of MuJoCo's joints.
    steering = plugin_attributes(p.steering, "damping", "knuckle_inertia")
    steering |= {"wheelbase": text(wheelbase), "track": text(steer.track)}
    _instance(plugin("steering"), "steering", steering)
    of_joints = ("position", "height", "yaw_limit", "pitch_min", "pitch_max")
    fifth_wheel = plugin_attributes(p.fifth_wheel, *of_joints)
    fifth_wheel["kingpin_load"] = text(kingpin_load(p, payload))
    _instance(plugin("fifth_wheel"), "fifth_wheel", fifth_wheel)
    air = plugin("aerodynamics")
    share = p.aerodynamics.tractor_share
    for unit, part in (("tractor", share), ("trailer", 1.0 - share)):
        config = {
            "density": text(p.aerodynamics.density),
            "drag_area": text(part * p.aerodynamics.drag_area),
            "side_area": text(part * p.aerodynamics.side_area),
        }
        _instance(air, f"aerodynamics_{unit}", config)
    _instance(plugin("powertrain"), "powertrain", powertrain.config(p))
    _instance(plugin("air_brake"), "air_brake", air_brake.config(p))


def equalized_share(p: TruckParameters, axle: Axle) -> float:
    """Returns the share of the axle's spring that acts through load compensation."""
    if axle is p.tractor.axles[0]:
        return 0.0
    return (p.tractor if axle in p.tractor.axles else p.semitrailer).load_equalization


def add_tendons(root: ET.Element, p: TruckParameters, payload: float) -> None:
    """Adds propeller shaft, steering linkage and load compensation of the axle groups."""
    tendon = ET.SubElement(root, "tendon")
    drive = [axle for axle in p.tractor.axles if axle.tire == "drive"]
    shaft = ET.SubElement(tendon, "fixed", name="propeller_shaft")
    for axle in drive:
        for side in SIDES:
            # Open differentials: shaft speed is the mean of the wheels, torque splits equally.
            share = p.gearbox.final_drive / (2 * len(drive))
            ET.SubElement(shaft, "joint", joint=f"{axle.name}_{side}_spin", coef=text(share))
    linkage = ET.SubElement(tendon, "fixed", name="steering_linkage")
    for side in SIDES:
        ET.SubElement(
            linkage, "joint", joint=f"{p.tractor.axles[0].name}_{side}_knuckle", coef="0.5"
        )
    # Load compensation: a spring on the sum of the group's heave acts equally on every axle.
    loads = axle_loads_by_name(p, payload)
    for name, axles in (("tandem", p.tractor.axles[1:]), ("triaxle", p.semitrailer.axles)):
        share = equalized_share(p, axles[0])
        rate = 2 * axles[0].spring_rate * share / len(axles)
        if rate <= 0:
            continue
        preload = share * (loads[axles[0].name] - axles[0].unsprung_mass * GRAVITY)
        length = text(preload / rate, preload / rate)
        group = ET.SubElement(
            tendon, "fixed", name=f"{name}_heave", stiffness=text(rate), springlength=length
        )
        for axle in axles:
            ET.SubElement(group, "joint", joint=f"{axle.name}_heave", coef="-1")


def add_actuators(root: ET.Element, p: TruckParameters) -> None:
    """Adds the controls, in the order of `VehicleCommand`."""
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
        ("retarder", "powertrain", "propeller_shaft", (0, 1)),
        ("brake_pedal", "air_brake", "propeller_shaft", (0, 1)),
        ("xbr_ebi_mode", "air_brake", "propeller_shaft", (0, 2)),
    )
    for name, instance, tendon, limit in rows:
        ET.SubElement(
            actuator,
            "plugin",
            name=name,
            plugin=f"iits.{instance}",
            instance=instance,
            tendon=tendon,
            ctrlrange=text(*limit),
        )


def add_sensors(root: ET.Element, p: TruckParameters) -> None:
    """Adds one named sensor per signal."""
    sensor = ET.SubElement(root, "sensor")

    def plugin(name: str, instance: str, **more: str) -> None:
        kind = instance if instance in ("powertrain", "air_brake", "steering") else "tire"
        attributes = {"name": name, "plugin": f"iits.{kind}", "instance": instance, **more}
        ET.SubElement(sensor, "plugin", attributes)

    for name in powertrain.SIGNALS:
        plugin(name, "powertrain")
    for name in air_brake.SIGNALS:
        plugin(name, "air_brake")
    plugin("steering_wheel_position", "steering")
    for side in SIDES:
        knuckle = f"{p.tractor.axles[0].name}_{side}_knuckle"
        ET.SubElement(sensor, "jointpos", name=f"steer_angle_{side}", joint=knuckle)
    for name in ("yaw", "pitch", "roll"):
        ET.SubElement(sensor, "jointpos", name=f"articulation_{name}", joint=f"fifth_wheel_{name}")
    ET.SubElement(sensor, "jointvel", name="articulation_rate", joint="fifth_wheel_yaw")
    ET.SubElement(sensor, "framepos", name="tractor_position", objtype="body", objname="tractor")
    ET.SubElement(
        sensor, "framequat", name="tractor_orientation", objtype="body", objname="tractor"
    )
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
