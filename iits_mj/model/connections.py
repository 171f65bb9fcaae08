"""Plugin instances, tendons, controls and sensors of the truck's MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

from iits_mj.core.messages import TransmissionMode
from iits_mj.core.units import GRAVITY
from iits_mj.model import air_brake, powertrain
from iits_mj.model.attributes import plugin_attributes, text
from iits_mj.parameters import Aerodynamics, Axle, TruckParameters, Unit
from iits_mj.parameters.mass_state import (
    air_shares,
    axle_loads_by_name,
    coupling_loads,
    group_center,
)
from iits_mj.parameters.tire_law import nominal_cornering_coefficient

SIDES = ("left", "right")
# Parameters of a coupling that its hinges have, not the plugin.
_OF_JOINTS = ("kind", "position", "height", "yaw_limit", "pitch_min", "pitch_max")
_TIE_ROD = 2e5  # [N m/rad], between the knuckles of a self-steering axle


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
    if tire.rolling_resistance_exponent == 1.0:
        del config["rolling_resistance_load"], config["rolling_resistance_exponent"]
    return config


def articulation_names(p: TruckParameters) -> list[str]:
    """Returns the names of the couplings' sensors: "articulation", "articulation2" and so on."""
    return [f"articulation{i or ''}" for i in (0, *range(2, len(p.units)))][: len(p.units) - 1]


def add_extension(root: ET.Element, p: TruckParameters, payload: float) -> None:
    """Adds every plugin instance with its configuration."""
    extension = ET.SubElement(root, "extension")

    def plugin(name: str) -> ET.Element:
        return ET.SubElement(extension, "plugin", plugin=f"iits.{name}")

    tire = plugin("tire")
    for kind in p.tires:
        values = tire_config(p, kind)
        _instance(tire, f"tire_{kind}", {key: text(value) for key, value in values.items()})
    front, rear = p.lead.groups(payload)
    center = group_center(rear)
    # The other parameters of the section are those of MuJoCo's joints.
    steering = plugin_attributes(p.steering, "damping", "knuckle_inertia")
    steering |= {
        "wheelbase": text([center - axle.position for axle in front]),
        "track": text([axle.track for axle in front]),
    }
    _instance(plugin("steering"), "steering", steering)
    if p.coupling_names:
        fifth_wheel = plugin("fifth_wheel")
    loads = coupling_loads(p, payload)
    for unit, name, load in zip(p.units[1:], p.coupling_names, loads, strict=True):
        assert unit.coupling is not None
        config = plugin_attributes(unit.coupling, *_OF_JOINTS)
        config["kingpin_load"] = text(max(load, 0.0))
        if unit.coupling.kind == "turntable":
            config["turntable"] = "1"
        _instance(fifth_wheel, name, config)
    air = plugin("aerodynamics")
    for unit, share in zip(p.units, air_shares(p), strict=True):
        _instance(air, f"aerodynamics_{unit.name}", _air_config(p.aerodynamics, share))
    _instance(plugin("powertrain"), "powertrain", powertrain.config(p))
    _instance(plugin("air_brake"), "air_brake", air_brake.config(p, payload))


def _air_config(air: Aerodynamics, share: float) -> dict[str, str]:
    """Attributes of the air at one unit, which has a share of the areas."""
    config = {
        "density": text(air.density),
        "drag_area": text(share * air.drag_area),
        "side_area": text(share * air.side_area),
    }
    if air.drag_yaw_angle:
        config["drag_yaw_angle"] = text(air.drag_yaw_angle)
        config["drag_area_increase"] = text([share * area for area in air.drag_area_increase])
    if air.mean_wind:
        config["mean_wind"] = text(air.mean_wind)
    return config


def alone_share(p: TruckParameters, axle: Axle, payload: float) -> float:
    """Returns the share of the axle's spring that acts without load compensation."""
    for unit in p.units:
        for group in unit.groups(payload):
            if axle in group and len(group) > 1:
                return 1 - unit.load_equalization
    return 1.0


def add_tendons(root: ET.Element, p: TruckParameters, payload: float) -> None:
    """Adds propeller shaft, steering linkage and load compensation of the axle groups."""
    tendon = ET.SubElement(root, "tendon")
    shaft = ET.SubElement(tendon, "fixed", name="propeller_shaft")
    for axle in p.driven_axles:
        for side in SIDES:
            # Open differentials: shaft speed is the mean of the wheels, torque splits equally.
            share = p.gearbox.final_drive / (2 * len(p.driven_axles))
            ET.SubElement(shaft, "joint", joint=f"{axle.name}_{side}_spin", coef=text(share))
    front, _ = p.lead.groups(payload)
    linkage = ET.SubElement(tendon, "fixed", name="steering_linkage")
    for axle in front:
        for side in SIDES:
            joint = {"joint": f"{axle.name}_{side}_knuckle", "coef": text(0.5 / len(front))}
            ET.SubElement(linkage, "joint", joint)
    loads = axle_loads_by_name(p, payload)
    for unit in p.units:
        for place, group in enumerate(unit.groups(payload)):
            name = f"{unit.name}_{'front_' if place == 0 and unit.coupling is None else ''}heave"
            _equalize(tendon, name, unit, group, loads)
    for axle in p.axles:
        if axle.self_steering is not None:
            rod = {"name": f"{axle.name}_tie_rod", "stiffness": text(_TIE_ROD), "springlength": "0"}
            track_rod = ET.SubElement(tendon, "fixed", rod)
            for side, sign in zip(SIDES, ("1", "-1"), strict=True):
                joint = {"joint": f"{axle.name}_{side}_knuckle", "coef": sign}
                ET.SubElement(track_rod, "joint", joint)


def _equalize(
    tendon: ET.Element, name: str, unit: Unit, axles: Sequence[Axle], loads: Mapping[str, float]
) -> None:
    """Load compensation: a spring on the sum of a group's heave, which loads axles by their shares.

    Where the axles carry different loads, each one's heave counts by its load on the springs.
    """
    share = unit.load_equalization
    if len(axles) < 2 or share <= 0.0:
        return
    sprung = [loads[axle.name] - axle.unsprung_mass * GRAVITY for axle in axles]
    weights = [1.0 if one == sprung[0] else one / sprung[0] for one in sprung]
    # All the group's springs, in parallel if every weight is 1.
    stiffness = 2 * sum(axle.spring_rate for axle in axles) / len(axles)
    rate = stiffness * share * len(axles) / sum(weights) ** 2
    preload = share * sprung[0]
    length = text(preload / rate, preload / rate)
    group = ET.SubElement(tendon, "fixed", name=name, stiffness=text(rate), springlength=length)
    for axle, weight in zip(axles, weights, strict=True):
        ET.SubElement(group, "joint", joint=f"{axle.name}_heave", coef=text(-weight))


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
        ("transmission_mode", "powertrain", "propeller_shaft", (0, TransmissionMode.GEAR_18)),
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

    for name in powertrain.signals(p):
        plugin(name, "powertrain")
    for name in air_brake.SIGNALS:
        plugin(name, "air_brake")
    plugin("steering_wheel_position", "steering")
    plugin("steering_wheel_torque", "steering")
    for side in SIDES:
        knuckle = f"{p.lead.axles[0].name}_{side}_knuckle"
        ET.SubElement(sensor, "jointpos", name=f"steer_angle_{side}", joint=knuckle)
    for name, coupling in zip(articulation_names(p), p.coupling_names, strict=True):
        for part in ("yaw", "pitch", "roll"):
            joint = f"{coupling}_{part}"
            ET.SubElement(sensor, "jointpos", name=f"{name}_{part}", joint=joint)
        ET.SubElement(sensor, "jointvel", name=f"{name}_rate", joint=f"{coupling}_yaw")
    lead = p.lead.name
    ET.SubElement(sensor, "framepos", name=f"{lead}_position", objtype="body", objname=lead)
    ET.SubElement(sensor, "framequat", name=f"{lead}_orientation", objtype="body", objname=lead)
    ET.SubElement(sensor, "velocimeter", name=f"{lead}_velocity", site=f"{lead}_imu")
    ET.SubElement(sensor, "gyro", name=f"{lead}_gyro", site=f"{lead}_imu")
    ET.SubElement(sensor, "accelerometer", name=f"{lead}_acceleration", site=f"{lead}_cg")
    for unit in p.units[1:]:
        for kind, name in (
            ("gyro", "gyro"),
            ("velocimeter", "velocity"),
            ("accelerometer", "acceleration"),
        ):
            ET.SubElement(sensor, kind, name=f"{unit.name}_{name}", site=f"{unit.name}_cg")
    for axle in p.axles:
        for side in SIDES:
            wheel = f"{axle.name}_{side}_wheel"
            for signal in ("tire_force", "tire_slip"):
                name = f"{axle.name}_{side}_{signal}"
                plugin(name, f"tire_{axle.tire}", objtype="body", objname=wheel)
