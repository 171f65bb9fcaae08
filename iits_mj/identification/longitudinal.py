"""The point-mass model behind the fit, and the stretches of a log on which it holds.

    (m + J / r^2) v' = s T i / r - m g (sin(theta) + f cos(theta)) - 0.5 rho A v^2 - b F_b

with engine torque T, overall ratio i with its efficiency, rotating inertia J of wheels, gearbox and
engine, and brake force F_b from the chambers' pressures less the push-out pressure. Only ratios to
the mass appear beside gravity: **torque scale s and mass m cannot be found together** from motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.identification.log import PRESSURES, Log
from iits_mj.model.air_brake import torque_slope
from iits_mj.parameters import TruckParameters
from iits_mj.units import GRAVITY

FloatArray = NDArray[np.float64]

# Below this speed the clutch may slip and the wheels' own losses are not those of rolling [m/s].
_SPEED_MIN = 3.0
# The driveline swings on after a shift [s].
_SETTLE = 0.5
_WINDOW = 15.0
_WINDOW_MIN = 4.0


@dataclass(frozen=True)
class Inputs:
    """What the model needs of a log, each of shape (n,).

    Attributes:
      time [s], speed [m/s], slope (sine and cosine of the road's angle).
      drive_force: engine force at the wheels for s = 1 [N].
      brake_force: of the brakes for b = 1 [N].
      rotating_mass: J / r^2 [kg]; density: of the air [kg/m3].
      windows: index ranges on which the model holds.
    """

    time: FloatArray
    speed: FloatArray
    slope_sine: FloatArray
    slope_cosine: FloatArray
    drive_force: FloatArray
    brake_force: FloatArray
    rotating_mass: FloatArray
    density: float
    windows: tuple[slice, ...]


def prepare(log: Log, parameters: TruckParameters) -> Inputs:
    """Forces and windows of a log, with the driveline of these parameters."""
    gearbox, engine = parameters.gearbox, parameters.engine
    gear = np.round(log["gear"]).astype(int)
    forward = np.clip(gear, 1, len(gearbox.ratios)) - 1
    ratio = np.where(gear >= 1, gearbox.ratios[forward] * gearbox.final_drive, 0.0)
    radius = parameters.tires["drive"].rolling_radius
    torque = log["engine_torque"]
    efficiency = gearbox.efficiency * gearbox.driveline_efficiency
    drive = torque * ratio / radius * np.where(torque >= 0.0, efficiency, 1.0 / efficiency)
    wheels = sum(
        2.0 * axle.wheel_inertia_spin / parameters.tires[axle.tire].rolling_radius ** 2
        for axle in parameters.axles
    )
    input_inertia = engine.inertia + gearbox.inertias[forward]
    rotating = wheels + np.where(gear >= 1, input_inertia * ratio**2 / radius**2, 0.0)
    grade = log["grade"]
    cosine = 1.0 / np.hypot(1.0, grade)
    return Inputs(
        time=log["time"],
        speed=log["speed"],
        slope_sine=grade * cosine,
        slope_cosine=cosine,
        drive_force=drive,
        brake_force=brake_force(log, parameters),
        rotating_mass=rotating,
        density=parameters.aerodynamics.density,
        windows=_windows(log, gear),
    )


def brake_force(log: Log, parameters: TruckParameters) -> FloatArray:
    """Brake force at the road [N], shape (n,), from the pressures and the nominal gains."""
    brake = parameters.air_brake
    circuits = [
        (log[PRESSURES[0]], log[PRESSURES[1]]),
        *[(log[PRESSURES[2]], log[PRESSURES[3]])] * (len(parameters.tractor.axles) - 1),
        *[(log[PRESSURES[4]], log[PRESSURES[4]])] * len(parameters.semitrailer.axles),
    ]
    force = np.zeros(len(log["time"]))
    for axle, gain, pressures in zip(
        parameters.axles, torque_slope(parameters), circuits, strict=True
    ):
        radius = parameters.tires[axle.tire].rolling_radius
        for pressure in pressures:
            force += gain * np.maximum(pressure - brake.push_out_pressure, 0.0) / radius
    return force


def acceleration(inputs: Inputs, values: dict[str, float]) -> FloatArray:
    """The model's acceleration [m/s2], shape (n,), at the recorded speed."""
    mass = values["mass"]
    rolling = values["rolling_resistance"] * inputs.slope_cosine
    force = (
        values["engine_torque_scale"] * inputs.drive_force
        - mass * GRAVITY * (inputs.slope_sine + rolling)
        - 0.5 * inputs.density * values["drag_area"] * inputs.speed * np.abs(inputs.speed)
        - values["brake_gain"] * inputs.brake_force
    )
    return force / (mass + inputs.rotating_mass)


def _windows(log: Log, gear: NDArray[np.int_]) -> tuple[slice, ...]:
    """Stretches of 4 to 15 s that roll freely in one gear, away from shifts and standstill."""
    time = log["time"]
    good = (log["speed"] > _SPEED_MIN) & (gear >= 1)
    if "shift_in_process" in log:
        good &= log["shift_in_process"] < 0.5
    changed = np.flatnonzero((np.diff(gear) != 0) | (np.diff(good.astype(int)) > 0)) + 1
    for index in changed:
        good &= ~((time >= time[index]) & (time < time[index] + _SETTLE))
    windows: list[slice] = []
    start = 0
    while start < len(time):
        if not good[start]:
            start += 1
            continue
        stop = start
        while stop < len(time) and good[stop] and time[stop] - time[start] <= _WINDOW:
            stop += 1
        if time[stop - 1] - time[start] >= _WINDOW_MIN:
            windows.append(slice(start, stop))
        start = stop
    return tuple(windows)
