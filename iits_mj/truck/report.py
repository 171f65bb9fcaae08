"""Reads the reports of the truck's control units from sensors and controls."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np

from iits_mj.core.messages import TruckReport
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import laden_units

_FIELDS = tuple(field.name for field in dataclasses.fields(TruckReport))
# Sensor and index of the fields whose sensor has another name.
_SENSORS = {
    "accelerator_pedal": ("accelerator_pedal_position", 0),
    "asr_engine_active": ("slip_control_active", 0),
    "asr_brake_active": ("slip_control_active", 1),
    "gear_engaged": ("powertrain_report", 0),
    "input_shaft_speed": ("powertrain_report", 1),
    "engine_torque_mode": ("powertrain_report", 2),
    "engine_torque_percent_driver": ("powertrain_report", 3),
    "engine_load_percent": ("powertrain_report", 4),
}
_SIDES = ("left", "right")
# Vertical part of a tire's force.
_VERTICAL = 2


def sensor_addresses(model: mujoco.MjModel, prefix: str) -> dict[str, int]:
    """Returns the first index of each sensor of a truck in `sensordata`, by name without prefix."""
    sensors = [model.sensor(i) for i in range(model.nsensor)]
    return {
        sensor.name.removeprefix(prefix): int(sensor.adr[0])
        for sensor in sensors
        if sensor.name.startswith(prefix)
    }


class Reporter:
    """Reads `TruckReport` from a model's data.

    Args:
      model: a compiled scene.
      parameters: of the truck.
      payload: of the truck [kg].
      prefix: of the truck's names in the model.
    """

    def __init__(
        self, model: mujoco.MjModel, parameters: TruckParameters, payload: float, prefix: str = ""
    ) -> None:
        address = sensor_addresses(model, prefix)
        actuators = {
            model.actuator(i).name.removeprefix(prefix): i
            for i in range(model.nactuator)
            if model.actuator(i).name.startswith(prefix)
        }
        controls = {name: int(model.actuator_ctrladr[i]) for name, i in actuators.items()}
        # The sensor `wheel_speeds` holds angular speeds of all wheels, the field speeds in m/s.
        places = {n: _SENSORS.get(n, (n, 0)) for n in _FIELDS if n != "wheel_speeds"}
        lead, gearbox = parameters.lead, parameters.gearbox
        rear = [i for i, axle in enumerate(lead.axles) if not axle.steered]
        for k, side in enumerate(_SIDES if len(rear) > 1 else ()):
            places[f"brake_pressure_rear2_{side}"] = ("brake_pressures", 2 * rear[1] + k)
        sensed = {name: address[s] + i for name, (s, i) in places.items() if s in address}
        commanded = {n: controls[n] for n in _FIELDS if n in controls and n not in sensed}
        self._names = (*sensed, *commanded)
        self._sensed = np.array(list(sensed.values()))
        self._commanded = np.array(list(commanded.values()))
        self._spins = address["wheel_speeds"] + np.arange(2 * len(lead.axles))
        self._radii = np.repeat([parameters.tires[a.tire].rolling_radius for a in lead.axles], 2)
        ends = [f"{axle.name}_{side}" for axle in parameters.axles for side in _SIDES]
        self._forces = np.array([address[f"{end}_tire_force"] + _VERTICAL for end in ends])
        drive = parameters.tires[parameters.driven_axles[0].tire]
        self._meters_per_radian = drive.rolling_radius / gearbox.final_drive
        self._ratios = {-1: gearbox.reverse_ratio} | dict(enumerate(gearbox.ratios.tolist(), 1))
        masses = [body.mass for body in laden_units(parameters, payload)]
        self._constants = {
            "xbr_acceleration_limit": float(model.actuator(f"{prefix}xbr_demand").ctrlrange[0]),
            "tractor_mass": masses[0],
            "trailer_mass": sum(masses[1:]),
            "cargo_mass": payload,
        }

    def read(self, data: mujoco.MjData, abs_operational: bool) -> TruckReport:
        """Returns the report at the last step or observation; None without a sensor."""
        readings = data.sensordata
        numbers = readings[self._sensed].tolist() + data.ctrl[self._commanded].tolist()
        known: dict[str, Any] = dict(zip(self._names, numbers, strict=True))
        loads = readings[self._forces].reshape(-1, 2).sum(axis=1)
        return TruckReport(
            **known,
            **self._constants,
            abs_operational=float(abs_operational),
            gear_ratio=self._ratios.get(round(known["gear_engaged"])),
            wheel_based_speed=abs(known["propeller_shaft_speed"]) * self._meters_per_radian,
            wheel_speeds=tuple(np.abs(readings[self._spins] * self._radii).tolist()),
            axle_loads=tuple(loads.tolist()),
        )
