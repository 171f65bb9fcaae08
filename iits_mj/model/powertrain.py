"""Engine, clutch, gearbox, driveline: parameters as attributes of the plugin `iits.powertrain`."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.powertrain import Clutch, EngineScalars, Retarder

# Local names of the sensors of the truck, in the order of the model. The plugin knows a few more,
# see its manual; every sensor costs MuJoCo about 0.02 us a step.
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

# Attributes of the plugin that carry the prefix here but not in the truck's sections.
_PREFIXES = {"retarder": Retarder, "clutch": Clutch}
_GEARBOX_SCALARS = (
    "final_drive",
    "efficiency",
    "driveline_efficiency",
    "start_gear",
    "reverse_ratio",
    "shift_cut_time",
    "synchronization_time",
    "synchronization_time_max",
    "synchronized_difference",
    "clutch_engagement_time",
    "clutch_close_time",
    "clutch_torque_max",
    "driveline_stiffness",
    "driveline_damping",
    "loss_reversal_speed",
    "downshift_delay",
    "downshift_margin",
    "min_gear_time",
)


def config(parameters: TruckParameters) -> dict[str, str]:
    """Attributes of the plugin instance `powertrain`, as text."""
    engine, gearbox = parameters.engine, parameters.gearbox
    driven = next(axle for axle in parameters.tractor.axles if axle.tire == "drive")
    attributes = {
        f"engine_{name}" if name == "inertia" else name: _text(getattr(engine, name))
        for name in _names(EngineScalars)
    }
    for prefix, kind in _PREFIXES.items():
        section = getattr(parameters, prefix)
        attributes |= {f"{prefix}_{name}": _text(getattr(section, name)) for name in _names(kind)}
    attributes |= {name: _text(getattr(gearbox, name)) for name in _GEARBOX_SCALARS}
    attributes |= {name: _text(value) for name, value in vars(gearbox.shifting).items()}
    speed, torque = full_load(parameters)
    attributes |= {
        "full_load_speed": _text(speed),
        "full_load_torque": _text(torque),
        "pedal_map_speed": _text(engine.pedal_map.rows),
        "pedal_map_pedal": _text(engine.pedal_map.columns),
        "pedal_map_torque": _text(engine.pedal_map.values),
        "fuel_map_torque": _text(engine.fuel_map.rows),
        "fuel_map_speed": _text(engine.fuel_map.columns),
        "fuel_map_consumption": _text(engine.fuel_map.values),
        "ratios": _text(gearbox.ratios),
        "gear_inertias": _text(gearbox.inertias),
        "shift_strategy": gearbox.shift_strategy,
        "wheel_radius": _text(parameters.tires[driven.tire].rolling_radius),
    }
    for name, table in (("upshift", gearbox.upshift), ("downshift", gearbox.downshift)):
        attributes |= {
            f"{name}_gear": _text(table.rows),
            f"{name}_pedal": _text(table.columns),
            f"{name}_speed": _text(table.values),
        }
    return attributes


def full_load(parameters: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Full-load curve [rad/s], [N m] from idle to governed speed.

    The measured curve ends at 700 and 1800 rpm. Below it is continued in a straight line, above
    with constant power, as its last 200 rpm are.
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


def _names(kind: type) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(values))
