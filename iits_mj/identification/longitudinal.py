"""The point-mass model behind the fit, and the stretches of a log on which it holds.

    (m + J / r^2) v' = s T i / r - m g (sin(theta) + f cos(theta)) - 0.5 rho A v^2 - sum b_c F_c

with engine torque T, overall ratio i with its efficiency, rotating inertia J of wheels, gearbox and
engine, brake force F_c of each circuit from its chambers' pressures. theta is the slope that the
combination feels: by virtual work, that under each axle weighed with the axle's load. Tires roll on
the radius of their load, as the tire plugin has it.

Only ratios to the mass appear beside gravity: **torque scale s and mass m cannot be found
together** from motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.identification.brakes import CIRCUITS, circuit_forces
from iits_mj.identification.log import PRESSURES, Log
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import static_axle_loads

IntArray = NDArray[np.int_]

NEEDED = ("speed", "grade", "gear", "engine_torque")
# Below this speed the clutch may slip and the wheels' own losses are not those of rolling [m/s].
_SPEED_MIN = 3.0
# The driveline swings on after a shift [s].
_SETTLE = 0.5
_WINDOW = 30.0
_WINDOW_MIN = 4.0


@dataclass(frozen=True)
class Inputs:
    """What the model needs of a log, each of shape (n,).

    Attributes:
      time [s], speed [m/s], slope (sine and cosine of the road's angle).
      drive_force: engine force at the wheels for s = 1, less the retarder's [N].
      brake_force: of the brakes for b = 1 [N]; circuit_forces: the same by circuit, shape (n, 3).
      rotating_mass: J / r^2 [kg]; density: of the air [kg/m3].
      windows: index ranges on which the model holds.
      brakes_seen: whether the log has the brakes' pressures.
    """

    time: FloatArray
    speed: FloatArray
    slope_sine: FloatArray
    slope_cosine: FloatArray
    drive_force: FloatArray
    brake_force: FloatArray
    circuit_forces: FloatArray
    rotating_mass: FloatArray
    density: float
    windows: tuple[slice, ...]
    brakes_seen: bool = True


def prepare(log: Log, parameters: TruckParameters, mass: float | None = None) -> Inputs:
    """Forces and windows of a log at the samples of its speed.

    Args:
      log: with the signals `NEEDED`.
      parameters: of driveline, brakes and masses.
      mass: gross mass that shares itself among the axles [kg]; default: with half the payload.
    """
    speed = log.series("speed")
    time = speed.time
    gearbox, engine = parameters.gearbox, parameters.engine
    loads = static_axle_loads(parameters, payload_of(parameters, mass))
    radii = rolling_radii(parameters, loads)
    drive = next(i for i, axle in enumerate(parameters.axles) if axle.tire == "drive")
    radius = float(radii[drive])
    gear = np.round(log.held("gear", time)).astype(int)
    forward = np.clip(gear, 1, len(gearbox.ratios)) - 1
    ratio = np.where(gear >= 1, gearbox.ratios[forward] * gearbox.final_drive, 0.0)
    torque = log.at("engine_torque", time)
    efficiency = gearbox.efficiency * gearbox.driveline_efficiency
    force = torque * ratio / radius * np.where(torque >= 0.0, efficiency, 1.0 / efficiency)
    if "retarder_torque" in log:
        force = force - log.at("retarder_torque", time) * gearbox.final_drive / radius
    spin = np.array([2.0 * axle.wheel_inertia_spin for axle in parameters.axles])
    input_inertia = engine.inertia + gearbox.inertias[forward]
    brakes_seen = not log.missing(*PRESSURES)
    circuits = np.zeros((len(time), len(CIRCUITS)))
    if brakes_seen:
        circuits = circuit_forces(log, parameters, time, radii)
    grade = felt_grade(log, parameters, loads, time)
    cosine = 1.0 / np.hypot(1.0, grade)
    return Inputs(
        time=time,
        speed=speed.value,
        slope_sine=grade * cosine,
        slope_cosine=cosine,
        drive_force=force,
        brake_force=np.sum(circuits, axis=1),
        circuit_forces=circuits,
        rotating_mass=np.sum(spin / radii**2) + input_inertia * ratio**2 / radius**2,
        density=parameters.aerodynamics.density,
        windows=_windows(log, time, speed.value, gear, brakes_seen),
        brakes_seen=brakes_seen,
    )


def acceleration(inputs: Inputs, values: dict[str, float]) -> FloatArray:
    """The model's acceleration [m/s2], shape (n,), at the recorded speed.

    `values` has mass, rolling_resistance, drag_area, engine_torque_scale and brake_gain, and
    brake_gain_front, _drive, _trailer where a circuit differs from the rest.
    """
    mass = values["mass"]
    gains = np.array([values.get(f"brake_gain_{name}", 1.0) for name in CIRCUITS])
    force = (
        values["engine_torque_scale"] * inputs.drive_force
        - mass * GRAVITY * (inputs.slope_sine + values["rolling_resistance"] * inputs.slope_cosine)
        - 0.5 * inputs.density * values["drag_area"] * inputs.speed * np.abs(inputs.speed)
        - values["brake_gain"] * (inputs.circuit_forces @ gains)
    )
    return np.asarray(force / (mass + inputs.rotating_mass))


def payload_of(parameters: TruckParameters, mass: float | None) -> float:
    """Payload that this gross mass means, within the truck's limits; half of it for None [kg]."""
    largest = parameters.payload.mass_max
    if mass is None:
        return 0.5 * largest
    return float(np.clip(mass - parameters.gross_mass(0.0), 0.0, largest))


def rolling_radii(parameters: TruckParameters, loads: FloatArray) -> FloatArray:
    """Rolling radius of each axle's tires under its load [m], shape (6,).

    It falls by a third of the deflection beyond that of the nominal load (tire plugin).
    """
    radii = []
    for axle, load in zip(parameters.axles, loads, strict=True):
        tire = parameters.tires[axle.tire]
        per_tire = float(load) / (2 * tire.count)
        excess = (per_tire - parameters.tire_common.nominal_load) / tire.vertical_stiffness
        radii.append(tire.rolling_radius - excess / 3.0)
    return np.array(radii)


def felt_grade(
    log: Log, parameters: TruckParameters, loads: FloatArray, time: FloatArray
) -> FloatArray:
    """Grade under all axles, weighed with their loads [1], shape (n,)."""
    speed = log.series("speed")
    steps = 0.5 * (speed.value[1:] + speed.value[:-1]) * np.diff(speed.time)
    place = np.interp(time, speed.time, np.concatenate([[0.0], np.cumsum(steps)]))
    road = log.at("grade", time)
    # A standing truck stays at one place: keep the place increasing for the look-up.
    place = np.maximum.accumulate(place)
    kept = np.concatenate([[True], np.diff(place) > 1e-6])
    behind = [axle.position for axle in parameters.tractor.axles]
    behind += [
        parameters.fifth_wheel.position + axle.position for axle in parameters.semitrailer.axles
    ]
    felt = np.zeros_like(road)
    for distance, load in zip(behind, loads, strict=True):
        felt += load / loads.sum() * np.interp(place - distance, place[kept], road[kept])
    return felt


def _windows(
    log: Log, time: FloatArray, speed: FloatArray, gear: IntArray, brakes_seen: bool
) -> tuple[slice, ...]:
    """Stretches of 4 to 30 s that roll freely in one gear, away from shifts and standstill."""
    good = (speed > _SPEED_MIN) & (gear >= 0)
    if "shift_in_process" in log:
        good &= log.held("shift_in_process", time) < 0.5
    unseen = [] if brakes_seen else ["command_xbr_mode", "command_brake_pedal"]
    unseen += [] if "retarder_torque" in log else ["command_retarder"]
    for name in unseen:
        if name in log:
            good &= log.held(name, time) < 1e-3
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
