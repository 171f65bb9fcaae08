"""Engine, clutch, gearbox and driveline: attributes and sensors of the plugin `iits.powertrain`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.model.attributes import PLUGIN_DIGITS, plugin_attributes, text
from iits_mj.parameters import TruckParameters

# Names of the truck's sensors, in the order of the model. The plugin has a few more, see its
# manual; each sensor costs MuJoCo about 0.02 us a step.
SIGNALS = (
    "gear",
    "shift_in_process",
    "engine_speed",
    "engine_torque",
    "engine_torque_percent",
    "torque_loss_percent",
    "fuel_rate",
    "fuel_used",
    "clutch_engagement",
    "propeller_shaft_torque",
    "propeller_shaft_speed",
    "accelerator_pedal_position",
    "engine_brake_torque",
    "engine_brake_torque_percent_intended",
    "engine_brake_torque_percent_available",
    "retarder_torque",
    "retarder_torque_percent_intended",
    "retarder_torque_percent_available",
    "retarder_heat",
    "engine_work",
    "driveline_loss",
    "retarder_work",
    "driveline_energy",
    "powertrain_report",
)


def config(parameters: TruckParameters) -> dict[str, str]:
    """Returns the attributes of the plugin instance `powertrain`.

    A parameter of the sections `engine`, `retarder`, `clutch`, `gearbox` and `gearbox.shifting` is
    passed on by its name; those of retarder and clutch get the section's name as prefix.
    """
    engine, gearbox = parameters.engine, parameters.gearbox
    driven = next(axle for axle in parameters.tractor.axles if axle.tire == "drive")
    speed, torque = full_load(parameters)
    found = plugin_attributes(engine, "inertia", digits=PLUGIN_DIGITS)
    for name in ("retarder", "clutch"):
        section = plugin_attributes(getattr(parameters, name), digits=PLUGIN_DIGITS)
        found |= {f"{name}_{key}": value for key, value in section.items()}
    found |= plugin_attributes(gearbox, "inertias", digits=PLUGIN_DIGITS)
    found |= plugin_attributes(gearbox.shifting, digits=PLUGIN_DIGITS)
    arrays: dict[str, ArrayLike] = {
        "engine_inertia": engine.inertia,
        "full_load_speed": speed,
        "full_load_torque": torque,
        "gear_inertias": gearbox.inertias,
        "wheel_radius": parameters.tires[driven.tire].rolling_radius,
    }
    for table, rows, columns, values, name in (
        (engine.pedal_map, "speed", "pedal", "torque", "pedal_map"),
        (engine.fuel_map, "torque", "speed", "consumption", "fuel_map"),
        (gearbox.upshift, "gear", "pedal", "speed", "upshift"),
        (gearbox.downshift, "gear", "pedal", "speed", "downshift"),
    ):
        arrays[f"{name}_{rows}"] = table.rows
        arrays[f"{name}_{columns}"] = table.columns
        arrays[f"{name}_{values}"] = table.values
    return found | {name: text(value, digits=PLUGIN_DIGITS) for name, value in arrays.items()}


def full_load(parameters: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Returns the full-load curve [rad/s], [N m] from idle to governed speed.

    The measured curve covers 700 to 1800 rpm. It is extended below by a straight line, and above at
    constant power, like its last 200 rpm.
    """
    engine = parameters.engine
    speed, torque = list(engine.full_load_speed), list(engine.full_load_torque)
    if engine.idle_speed < speed[0]:
        slope = (torque[1] - torque[0]) / (speed[1] - speed[0])
        torque.insert(0, max(0.0, torque[0] + slope * (engine.idle_speed - speed[0])))
        speed.insert(0, engine.idle_speed)
    power = speed[-1] * torque[-1]
    for point in np.linspace(speed[-1], engine.governed_speed, 4)[1:]:
        if point > speed[-1]:
            speed.append(float(point))
            torque.append(power / float(point))
    return np.array(speed), np.array(torque)
