"""Mass, resistances and brake gains: the point mass fitted to the recorded speed.

    (m + J / r^2) v' = s T i / r - m g (sin(theta) + f cos(theta)) - 0.5 rho A v^2
                       - sum b_c F_c - k D

with engine torque T less that of the auxiliaries, overall ratio i with its efficiency, rotating
inertia J of wheels, gearbox and engine, brake force F_c of each circuit from its chambers'
pressures. theta is the effective slope of the combination: by virtual work, the slope under each
axle weighted with the axle's load. Tires roll on the radius of their load, as in the tire plugin.
Beside gravity, only ratios to the mass appear: **torque scale s and mass m cannot be found
together** from motion.

D is the drag of bends, by the balance of power: each axle's side force times its slip angle,
`D = sum C_i alpha_i^2` (the scrub of axle groups is among it), with the slip angles of the yaw-roll
model in a steady turn at the recorded yaw rate of the axle's unit. Its factor k is fitted with the
other parameters and not reported: it stands for the stiffness of the tires, and for a road that
leans into its bends, which the log does not show. Without it a weave of 0.3 m/s2 looks like 10 % of
air drag.

Output error with free initial speeds: in each window the model's acceleration is integrated from
the recorded speed, and the window's mean difference is removed, which eliminates its initial speed.
Noise on the speed is therefore never differentiated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import YawRoll
from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.units import GRAVITY
from iits_mj.identification.brakes import CIRCUITS, circuit_forces, circuit_of_axle
from iits_mj.identification.estimate import Estimate, Free, fit, unseen
from iits_mj.identification.log import PRESSURES, Log, Series
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance, static_axle_loads

_NEEDED = ("speed", "grade", "gear", "engine_torque")
# Below this speed the clutch may slip, and the wheels' losses are not those of rolling [m/s].
_SPEED_MIN = 3.0
# The driveline oscillates after a shift [s].
_SETTLE = 0.5
_WINDOW, _WINDOW_MIN = 30.0, 4.0
# Speeds of the yaw-roll model [m/s].
_CORNERING_SPEEDS = np.arange(2.0, 40.0, 2.0)
# Circuits brake differently if their mean forces in the applications do: least singular value over
# the greatest, of columns of unit length.
_SEPARATE = 0.1
# Noise below this is not the model's error [m/s].
_NOISE_MIN = 0.02
_CORNERING = Free("cornering_drag_scale", "1", 1.0, 0.0, 4.0)
_NO_SCALE = "motion shows it only as a ratio to the mass: give the mass"
_NO_PRESSURES = "the log lacks brake pressures"
_TOGETHER = "the log shows the circuits only together, as brake_gain"


@dataclass(frozen=True)
class Motion:
    """Estimates of longitudinal motion.

    Attributes:
      estimates: mass, resistances, brake gains and torque scale.
      time [s], recorded, before, after: speeds [m/s] with prior and fitted values, shape (m,), the
        windows of the log one after the other; empty without windows.
      mass: fitted, given or prior [kg].
    """

    estimates: tuple[Estimate, ...]
    time: FloatArray
    recorded: FloatArray
    before: FloatArray
    after: FloatArray
    mass: float


def identify_motion(log: Log, parameters: TruckParameters, mass: float | None = None) -> Motion:
    """Fits mass, resistances, brake gains and, with the mass given, the torque's scale."""
    free = _free(parameters, mass)
    prior = {name: f.prior for name, f in free.items()} | {_CORNERING.name: _CORNERING.prior}
    reason = log.lacks(*_NEEDED)
    inputs = None if reason else _inputs(log, parameters, mass)
    if inputs is None or not inputs.windows:
        reason = reason or "the log has no stretch of 4 s above 3 m/s in one gear"
        empty = np.empty(0)
        none = tuple(unseen(list(free.values()), reason))
        return Motion(none, empty, empty, empty, empty, prior["mass"])
    fixed = "engine_torque_scale" if mass is None else "mass"
    gains = [f for name, f in free.items() if name in _circuit_gain_names(parameters)]
    fitting = [f for f in free.values() if f.name != fixed and f not in gains]
    if "yaw_rate" in log:
        fitting.append(_CORNERING)
    estimates, fitted = _fit(inputs, fitting, prior)
    if mass is None:
        # The mass changes the loads of axles and tires: fit again with the fitted mass.
        inputs = _inputs(log, parameters, fitted["mass"])
        estimates, fitted = _fit(inputs, fitting, prior)
        estimates.append(free["engine_torque_scale"].unseen(_NO_SCALE))
    if not inputs.brakes_seen:
        estimates = [e for e in estimates if e.name != "brake_gain"]
        estimates.append(free["brake_gain"].unseen(_NO_PRESSURES))
    others = [f for f in fitting if f.name != "brake_gain"]
    estimates += _circuit_gains(inputs, others, gains, fitted)
    return Motion(
        estimates=tuple(e for e in estimates if e.name != _CORNERING.name),
        time=np.concatenate([inputs.time[w] for w in inputs.windows]),
        recorded=np.concatenate([inputs.speed[w] for w in inputs.windows]),
        before=np.concatenate(_speeds(inputs, prior)),
        after=np.concatenate(_speeds(inputs, fitted)),
        mass=fitted["mass"],
    )


def _free(parameters: TruckParameters, mass: float | None) -> dict[str, Free]:
    """The parameters by name; of two inseparable parameters the later keeps its prior."""
    known = parameters.gross_mass(0.5 * parameters.payload_max) if mass is None else mass
    free = (
        Free("mass", "kg", float(known), 5e3, 1.2e5),
        Free(
            "rolling_resistance",
            "1",
            rolling_resistance(parameters, payload_of(parameters, mass)),
            1e-4,
            0.05,
        ),
        Free("drag_area", "m2", parameters.aerodynamics.drag_area, 0.1, 30.0),
        Free("brake_gain", "1", 1.0, 0.05, 5.0),
        Free("engine_torque_scale", "1", 1.0, 0.2, 3.0),
        *(Free(name, "1", 1.0, 0.05, 5.0) for name in _circuit_gain_names(parameters)),
    )
    return {f.name: f for f in free}


def _circuit_gain_names(parameters: TruckParameters) -> list[str]:
    """Names of the gains of the circuits that the truck has."""
    there = circuit_of_axle(parameters)
    return [f"brake_gain_{name}" for name in CIRCUITS if name in there]


def _fit(
    inputs: _Inputs, free: Sequence[Free], values: Mapping[str, float]
) -> tuple[list[Estimate], dict[str, float]]:
    """Fits the free parameters, each from its value; the others keep theirs."""
    weights = _weights(inputs)

    def trial(found: FloatArray) -> dict[str, float]:
        return {**values, **dict(zip((f.name for f in free), map(float, found), strict=True))}

    def residual(found: FloatArray) -> list[FloatArray]:
        triples = zip(inputs.windows, _speeds(inputs, trial(found)), weights, strict=True)
        return [weight * (speed - inputs.speed[w]) for w, speed, weight in triples]

    started = [dataclasses.replace(f, prior=values[f.name]) for f in free]
    estimates, found = fit(started, residual)
    return estimates, trial(found)


def _weights(inputs: _Inputs) -> list[float]:
    """Weight of each window, 1 on average: the inverse of its noise, by second differences.

    White noise of deviation s has second differences of deviation s sqrt(6).
    """
    noise = [
        max(float(np.std(np.diff(inputs.speed[w], 2))) / np.sqrt(6.0), _NOISE_MIN)
        for w in inputs.windows
    ]
    return [float(np.median(noise)) / value for value in noise]


def _circuit_gains(
    inputs: _Inputs, others: list[Free], gains: list[Free], fitted: Mapping[str, float]
) -> list[Estimate]:
    """The gains of the single circuits, if the log separates them, relative to `brake_gain`.

    Their pressures rise together in ordinary braking, and then only the sum shows.
    """
    if not inputs.brakes_seen:
        return unseen(gains, _NO_PRESSURES)
    if not np.any(np.max(np.abs(inputs.circuit_forces), axis=0) > 0.0):
        return unseen(gains, "the brakes were not used")
    if not _separate(inputs):
        return unseen(gains, _TOGETHER)
    separate, _ = _fit(inputs, [*others, *gains], {**fitted, "brake_gain": 1.0})
    found = separate[len(others) :]
    if all(e.identifiable for e in found):
        return found
    return unseen(gains, _TOGETHER)


def _separate(inputs: _Inputs) -> bool:
    """Whether the circuits' mean forces in the applications are no common multiple of each other.

    The rise and the fall of an application do not count: there, a lag of the brakes that the model
    does not have would look like other gains.
    """
    braking = np.any(inputs.circuit_forces > 0.0, axis=1)
    starts, ends = (np.flatnonzero(np.diff(braking.astype(int)) == step) + 1 for step in (1, -1))
    if len(starts) and len(ends) and ends[0] < starts[0]:
        ends = ends[1:]
    pairs = zip(starts, ends, strict=False)
    means = np.array([inputs.circuit_forces[i:j].mean(axis=0) for i, j in pairs]).reshape(-1, 3)
    means = means[:, np.any(inputs.circuit_forces > 0.0, axis=0)]
    if len(means) < 3:
        return False
    sizes = np.linalg.svd(means / np.linalg.norm(means, axis=0), compute_uv=False)
    return bool(sizes[-1] > _SEPARATE * sizes[0])


def _speeds(inputs: _Inputs, values: Mapping[str, float]) -> list[FloatArray]:
    """The model's speed [m/s] in each window, with the mean of the recorded speed."""
    rate = _acceleration(inputs, values)
    found = []
    for window in inputs.windows:
        rise = Series(inputs.time[window], rate[window]).integral()
        found.append(rise + np.mean(inputs.speed[window] - rise))
    return found


def _acceleration(inputs: _Inputs, values: Mapping[str, float]) -> FloatArray:
    """The model's acceleration [m/s2], shape (n,), at the recorded speed.

    `values` has mass, rolling_resistance, drag_area, engine_torque_scale, brake_gain and
    cornering_drag_scale, and brake_gain_front, _drive, _trailer where a circuit differs from the
    rest.
    """
    mass = values["mass"]
    gains = np.array([values.get(f"brake_gain_{name}", 1.0) for name in CIRCUITS])
    force = (
        values["engine_torque_scale"] * inputs.drive_force
        - mass * GRAVITY * (inputs.slope_sine + values["rolling_resistance"] * inputs.slope_cosine)
        - 0.5 * inputs.density * values["drag_area"] * inputs.speed * np.abs(inputs.speed)
        - values["brake_gain"] * (inputs.circuit_forces @ gains)
        - values[_CORNERING.name] * inputs.cornering_drag
    )
    return np.asarray(force / (mass + inputs.rotating_mass))


@dataclass(frozen=True)
class _Inputs:
    """Inputs of the model, each of shape (n,).

    Attributes:
      time [s], speed [m/s], slope (sine and cosine of the road's angle).
      drive_force: engine force at the wheels for s = 1, less the retarder's [N].
      cornering_drag: of the tires in bends [N]; zero without a yaw rate.
      circuit_forces: of the brake circuits for b = 1 [N], shape (n, 3).
      rotating_mass: J / r^2 [kg]; density: of the air [kg/m3].
      windows: index ranges on which the model holds.
      brakes_seen: whether the log has the brakes' pressures.
    """

    time: FloatArray
    speed: FloatArray
    slope_sine: FloatArray
    slope_cosine: FloatArray
    drive_force: FloatArray
    cornering_drag: FloatArray
    circuit_forces: FloatArray
    rotating_mass: FloatArray
    density: float
    windows: tuple[slice, ...]
    brakes_seen: bool = True


def _inputs(log: Log, parameters: TruckParameters, mass: float | None = None) -> _Inputs:
    """Forces and windows of a log at the samples of its speed.

    Args:
      log: with the signals `_NEEDED`.
      parameters: of driveline, brakes and masses.
      mass: gross mass for the loads of the axles [kg]; default: with half the payload.
    """
    speed = log.series("speed")
    time = speed.time
    gearbox, engine = parameters.gearbox, parameters.engine
    loads = static_axle_loads(parameters, payload_of(parameters, mass))
    radii = _rolling_radii(parameters, loads)
    drive = next(i for i, axle in enumerate(parameters.axles) if axle.driven)
    radius = float(radii[drive])
    gear = np.round(log.held("gear", time)).astype(int)
    forward = np.clip(gear, 1, len(gearbox.ratios)) - 1
    ratio = np.where(gear >= 1, gearbox.ratios[forward] * gearbox.final_drive, 0.0)
    torque = log.at("engine_torque", time)
    if engine.auxiliary_power:
        turning = np.maximum(speed.value * ratio / radius, engine.idle_speed)
        torque = torque - engine.auxiliary_power / turning
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
    grade = _effective_grade(log, parameters, loads, time)
    cosine = 1.0 / np.hypot(1.0, grade)
    return _Inputs(
        time=time,
        speed=speed.value,
        slope_sine=grade * cosine,
        slope_cosine=cosine,
        drive_force=force,
        cornering_drag=_cornering_drag(log, parameters, payload_of(parameters, mass), speed),
        circuit_forces=circuits,
        rotating_mass=np.sum(spin / radii**2) + input_inertia * ratio**2 / radius**2,
        density=parameters.aerodynamics.density,
        windows=_windows(log, time, speed.value, gear, brakes_seen),
        brakes_seen=brakes_seen,
    )


def _cornering_drag(
    log: Log, parameters: TruckParameters, payload: float, speed: Series
) -> FloatArray:
    """Drag of bends at the samples of the speed [N], (n,): sum of side force times slip angle."""
    if "yaw_rate" not in log:
        return np.zeros_like(speed.value)
    # Of each unit, by the square of its yaw rate [N s2], over speed.
    rows = []
    for v in _CORNERING_SPEEDS:
        model = YawRoll.from_parameters(parameters, payload, cruise_speed=float(v))
        system = model.at(float(v))
        turn = system.steady_state()
        slips = turn[-len(model.cornering) :] / turn[1]
        units = model.plane.unit
        rows.append(np.bincount(units, model.cornering * slips**2, model.plane.units))
    drag = np.zeros_like(speed.value)
    for unit, factors in enumerate(np.array(rows).T):
        last = unit and "trailer_yaw_rate" in log
        rate = log.at("trailer_yaw_rate" if last else "yaw_rate", speed.time)
        drag += np.interp(speed.value, _CORNERING_SPEEDS, factors) * rate**2
    return drag


def payload_of(parameters: TruckParameters, mass: float | None) -> float:
    """Payload of this gross mass, within the truck's limits [kg]; half the greatest for None."""
    largest = parameters.payload_max
    if mass is None:
        return 0.5 * largest
    return float(np.clip(mass - parameters.gross_mass(0.0), 0.0, largest))


def _rolling_radii(parameters: TruckParameters, loads: FloatArray) -> FloatArray:
    """Rolling radius of each axle's tires under its load [m], shape (axles,).

    It falls by a third of the deflection beyond that of the nominal load (tire plugin).
    """
    radii = []
    for axle, load in zip(parameters.axles, loads, strict=True):
        tire = parameters.tires[axle.tire]
        per_tire = float(load) / (2 * tire.count)
        excess = (per_tire - parameters.tire_common.nominal_load) / tire.vertical_stiffness
        radii.append(tire.rolling_radius - excess / 3.0)
    return np.array(radii)


def _effective_grade(
    log: Log, parameters: TruckParameters, loads: FloatArray, time: FloatArray
) -> FloatArray:
    """Grade under all axles, weighted with their loads [1], shape (n,)."""
    speed = log.series("speed")
    place = np.interp(time, speed.time, speed.integral())
    road = log.at("grade", time)
    # A stopped truck stays at one place: keep the place increasing for the look-up.
    place = np.maximum.accumulate(place)
    kept = np.concatenate([[True], np.diff(place) > 1e-6])
    behind, origin = [], 0.0
    for unit in parameters.units:
        if unit.coupling:
            origin = origin + unit.coupling.position
        behind += [origin + axle.position for axle in unit.axles]
    felt = np.zeros_like(road)
    for distance, load in zip(behind, loads, strict=True):
        felt += load / loads.sum() * np.interp(place - distance, place[kept], road[kept])
    return felt


def _windows(
    log: Log, time: FloatArray, speed: FloatArray, gear: IntArray, brakes_seen: bool
) -> tuple[slice, ...]:
    """Stretches of 4 to 30 s in one gear, away from shifts, standstill and unseen brakes."""
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
