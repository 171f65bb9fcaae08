"""Engine, clutch, gearbox and driveline: attributes and sensors of the plugin `iits.powertrain`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.model.attributes import PLUGIN_DIGITS, plugin_attributes, text
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.powertrain import Gearbox
from iits_mj.parameters.tables import Table2D

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


def signals(parameters: TruckParameters) -> tuple[str, ...]:
    """Returns the names of a truck's sensors: without auxiliaries there is no work of theirs."""
    return (*SIGNALS, "auxiliary_work") if parameters.engine.auxiliary_power else SIGNALS


def config(parameters: TruckParameters) -> dict[str, str]:
    """Returns the attributes of the plugin instance `powertrain`.

    A parameter of the sections `engine`, `retarder`, `clutch`, `gearbox` and `gearbox.shifting` is
    passed on by its name; those of retarder and clutch get the section's name as prefix.
    """
    engine, gearbox = parameters.engine, parameters.gearbox
    speed, torque = full_load(parameters)
    other = [
        "inertia",
        "full_load_speed",
        "full_load_torque",
        "auxiliaries",
        "power",
        "fuel_factor",
    ]
    if engine.fuel_rate_map.values.size:
        other.append("idle_fuel_rate")
    found = plugin_attributes(engine, *other, digits=PLUGIN_DIGITS)
    for name in ("retarder", "clutch"):
        section = plugin_attributes(getattr(parameters, name), digits=PLUGIN_DIGITS)
        found |= {f"{name}_{key}": value for key, value in section.items()}
    found |= plugin_attributes(gearbox, "inertias", "loss_map", "loss_maps", digits=PLUGIN_DIGITS)
    found |= plugin_attributes(gearbox.shifting, digits=PLUGIN_DIGITS)
    arrays: dict[str, ArrayLike] = {
        "engine_inertia": engine.inertia,
        "full_load_speed": speed,
        "full_load_torque": torque,
        "gear_inertias": gearbox.inertias,
        "wheel_radius": parameters.tires[parameters.driven_axles[0].tire].rolling_radius,
    }
    rate, axle = engine.fuel_rate_map, gearbox.axle_loss
    for table, rows, columns, values in (
        (engine.pedal_map, "pedal_map_speed", "pedal_map_pedal", "pedal_map_torque"),
        (engine.fuel_map, "fuel_map_torque", "fuel_map_speed", "fuel_map_consumption"),
        (
            Table2D(rate.columns, rate.rows, rate.values.T),
            *("fuel_rate_torque", "fuel_rate_speed", "fuel_rate_values"),
        ),
        (gearbox.upshift, "upshift_gear", "upshift_pedal", "upshift_speed"),
        (gearbox.downshift, "downshift_gear", "downshift_pedal", "downshift_speed"),
        (axle, "axle_loss_speed", "axle_loss_torque", "axle_losses"),
    ):
        if table.values.size:
            arrays |= {rows: table.rows, columns: table.columns, values: table.values}
    if engine.fuel_factor != 1.0:
        arrays["fuel_factor"] = engine.fuel_factor
    if engine.auxiliary_power:
        arrays["auxiliary_power"] = engine.auxiliary_power
    if gearbox.loss_maps:
        arrays |= _gear_losses(gearbox)
    return found | {name: text(value, digits=PLUGIN_DIGITS) for name, value in arrays.items()}


def _gear_losses(gearbox: Gearbox) -> dict[str, ArrayLike]:
    """The gears' maps of losses, which in the plugin have common axes."""
    tables = list(gearbox.loss_maps.values())
    speed = np.unique(np.concatenate([table.rows for table in tables]))
    torque = np.unique(np.concatenate([table.columns for table in tables]))
    return {
        "gear_loss_speed": speed,
        "gear_loss_torque": torque,
        "gear_losses": [table.resampled(speed, torque).values for table in tables],
        "gear_loss_map": gearbox.loss_map,
    }


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
