"""Cornering stiffness of the axle groups: the linear yaw-roll model fitted to a steered drive.

Output error in windows of nearly constant speed: the recorded steering drives the model of
`analytic.yaw_roll`. Its response is linear in the initial state and the steering's offset, which
are solved for. Motion shows only forces over masses, so the mass must be known. The model has
neither load transfer nor saturation: windows with high lateral acceleration are left out.

The ratio of steering wheel to road wheels comes from the two angles, if the log has both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from iits_mj.analytic import RollSystem, YawRoll
from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import Estimate, Free, fit, unseen
from iits_mj.identification.log import Log
from iits_mj.identification.longitudinal import payload_of
from iits_mj.parameters import TruckParameters

# Units of the linear model: a tractor with a semitrailer.
_UNITS = 2
# Outputs that are compared, if the log has them: place among the states.
_STATES = {"yaw_rate": 1, "trailer_yaw_rate": 2, "articulation": 3}
_PLANE_STATES = 4
# Shortest sampling step, and lengths of the windows [s].
_STEP_MIN = 0.02
_WINDOW, _WINDOW_MIN = 6.0, 4.0
_RATIO_WINDOW = 10.0
_SPEED_MIN = 6.0
# The model is linear and at one speed: greatest lateral acceleration [m/s2] and speed range [1].
_ACCELERATION_MAX = 2.0
_SPEED_RANGE = 0.08
# Errors of linear tires with static loads in this range, against the truck itself, and of a linkage
# without compliance [1]; the intervals include them.
_MODEL_ERROR = 0.03
_RATIO_MODEL_ERROR = 0.005
# Relative change at which the fit ends: far below the model's own error.
_TOLERANCE = 1e-5
# Least range of the yaw rate in a maneuver [rad/s], and of the steering wheel beyond its play that
# shows a ratio [rad].
_YAW_RATE_MIN = 2e-3
_RANGE_MIN = 0.02


def identify_ratio(log: Log, parameters: TruckParameters) -> Estimate | None:
    """The steering's ratio; None if the log lacks one of the two angles.

    The play of the gear is removed from the steering wheel's angle. The wheel's offset and the
    linkage's lag, in proportion to the steering's rate, are solved for. Side forces bend the
    linkage, which looks like a ratio: half a percent of it in ordinary driving.
    """
    if log.missing("steering_wheel_angle", "road_wheel_angle"):
        return None
    free = _ratio(parameters)
    clock = log.series("road_wheel_angle").time
    time = np.arange(clock[0], clock[-1], max(_STEP_MIN, float(np.median(np.diff(clock)))))
    pitman = pitman_angle(log.at("steering_wheel_angle", time), parameters.steering.dead_band)
    road = log.at("road_wheel_angle", time)
    nuisance = np.column_stack([np.ones_like(road), np.gradient(pitman, time)])
    if np.ptp(pitman) < _RANGE_MIN:
        return free.unseen("the steering was not used")
    length = max(round(_RATIO_WINDOW / (time[1] - time[0])), 2)
    cuts = list(range(length, len(time), length))

    def residual(values: FloatArray) -> list[FloatArray]:
        rest = road - pitman / values[0]
        levels, *_ = np.linalg.lstsq(nuisance, rest, rcond=None)
        # In radians at the steering wheel, so that the fit's tolerances apply.
        return list(np.split(free.prior * (nuisance @ levels - rest), cuts))

    return fit([free], residual)[0][0].widened(_RATIO_MODEL_ERROR)


def _ratio(parameters: TruckParameters) -> Free:
    return Free("steering_ratio", "1", parameters.steering.ratio, 5.0, 60.0)


def pitman_angle(wheel: FloatArray, dead_band: float) -> FloatArray:
    """Steering wheel's angle behind the play of the gear [rad], shape (n,).

    The gear starts in the middle of its play.
    """
    found = np.empty_like(wheel)
    angle = float(wheel[0])
    for index, value in enumerate(wheel):
        angle = min(max(angle, value - 0.5 * dead_band), value + 0.5 * dead_band)
        found[index] = angle
    return found


@dataclass(frozen=True)
class _Window:
    """A stretch of the log: speed [m/s], steering angle [rad], (n,), signals by name, (n,) each."""

    speed: float
    steering: FloatArray
    signals: Mapping[str, FloatArray]


def identify_cornering(
    log: Log, parameters: TruckParameters, mass: float | None, ratio: float | None
) -> list[Estimate]:
    """Cornering coefficient of each kind of tires.

    Args:
      log: with speed, yaw rate and the angle of road wheels or steering wheel.
      parameters: of the truck.
      mass: gross mass [kg]; None if unknown.
      ratio: of the steering if identified; for None it is fitted as well, unless the log has the
        angle of the road wheels.
    """
    used = {axle.tire for axle in parameters.axles}
    kinds = {
        name: tire.cornering_coefficient for name, tire in parameters.tires.items() if name in used
    }
    free = [
        Free(f"cornering_coefficient_{name}", "1/rad", prior, 1.0, 20.0)
        for name, prior in kinds.items()
    ]
    lacking = log.missing("speed", "yaw_rate")
    direct = "road_wheel_angle" in log
    if not direct and "steering_wheel_angle" not in log:
        lacking.append("road_wheel_angle or steering_wheel_angle")
    wants_ratio = not direct and ratio is None
    if wants_ratio:
        free.append(_ratio(parameters))
    if lacking:
        return unseen(free, f"the log lacks {', '.join(lacking)}")
    if len(parameters.units) != _UNITS:
        return unseen(free, f"the truck has {len(parameters.units)} units, the linear model has 2")
    if mass is None:
        return unseen(free, "motion shows it only as a ratio to the mass, which is not known")
    step, windows = _windows(log, parameters)
    if not windows:
        return unseen(free, "the log has no steered stretch of 4 s at a steady speed")
    scales = {
        name: float(np.sqrt(np.mean([np.var(w.signals[name]) for w in windows])))
        for name in windows[0].signals
    }
    payload = payload_of(parameters, mass)
    longest = max(len(window.steering) for window in windows)

    def residual(values: FloatArray) -> list[FloatArray]:
        found = dict(zip(kinds, map(float, values), strict=False))
        trial = _with_cornering(parameters, found)
        divisor = 1.0 if direct else float(values[-1]) if wants_ratio else float(ratio or 1.0)
        responses = {}
        for speed in {window.speed for window in windows}:
            model = YawRoll.from_parameters(trial, payload, cruise_speed=speed)
            responses[speed] = _responses(model.at(speed), longest, step)
        return [_errors(responses[w.speed], w, divisor, scales) for w in windows]

    estimates, _ = fit(free, residual, tolerance=_TOLERANCE)
    return [estimate.widened(_MODEL_ERROR) for estimate in estimates]


def _with_cornering(p: TruckParameters, coefficients: Mapping[str, float]) -> TruckParameters:
    """The truck with these cornering coefficients of its kinds of tires [1/rad]."""
    tires = {
        kind: dataclasses.replace(
            tire, cornering_coefficient=coefficients.get(kind, tire.cornering_coefficient)
        )
        for kind, tire in p.tires.items()
    }
    return dataclasses.replace(p, tires=tires)


def _errors(
    responses: FloatArray, window: _Window, divisor: float, scales: Mapping[str, float]
) -> FloatArray:
    """Model less record over all signals, initial state and steering offset solved for."""
    steering = window.steering / divisor
    n = len(steering)
    columns, measured = [], []
    for name, scale in scales.items():
        early, late, *initial = responses[:n, _STATES[name], :].T
        # The state answers one sample later: to this sample's steering and to the next one's.
        forced = np.zeros(n)
        forced[1:] = (
            np.convolve(early, steering)[: n - 1] + np.convolve(late, steering[1:])[: n - 1]
        )
        offset = np.concatenate([[0.0], np.cumsum(early + late)[:-1]])
        columns.append(np.column_stack([forced, *initial, offset]) / scale)
        measured.append(window.signals[name] / scale)
    basis, target = np.vstack(columns), np.concatenate(measured)
    forced, free = basis[:, 0], basis[:, 1:]
    levels, *_ = np.linalg.lstsq(free, target - forced, rcond=None)
    return np.asarray(forced + free @ levels - target)


def _responses(system: RollSystem, length: int, step: float) -> FloatArray:
    """Plane states, shape (length, 4, 6), by samples since a start.

    To unit samples of steering that is straight between them (its sample and the one after), and
    to each initial plane state.
    """
    size = len(system.B)
    # x' = A x + B u with u' constant: one exponential gives all three matrices.
    whole = np.zeros((size + 2, size + 2))
    whole[:size, :size], whole[:size, size] = system.A * step, system.B * step
    whole[size, size + 1] = 1.0
    power = expm(whole)
    A, first, late = power[:size, :size], power[:size, size], power[:size, size + 1]
    state = np.zeros((size, 2 + _PLANE_STATES))
    state[:, 0], state[:, 1] = first - late, late
    state[:_PLANE_STATES, 2:] = np.eye(_PLANE_STATES)
    found = np.empty((length, _PLANE_STATES, 2 + _PLANE_STATES))
    for k in range(length):
        found[k] = state[:_PLANE_STATES]
        state = A @ state
    return found


def _windows(log: Log, parameters: TruckParameters) -> tuple[float, list[_Window]]:
    """Sampling step [s] and the stretches on which the model holds."""
    clock = log.series("yaw_rate").time
    step = max(_STEP_MIN, float(np.median(np.diff(clock))))
    time = np.arange(clock[0], clock[-1], step)
    speed = log.at("speed", time)
    if "road_wheel_angle" in log:
        steering = log.at("road_wheel_angle", time)
    else:
        steering = pitman_angle(log.at("steering_wheel_angle", time), parameters.steering.dead_band)
    signals = {name: log.at(name, time) for name in _STATES if name in log}
    calm = np.abs(speed * signals["yaw_rate"]) < _ACCELERATION_MAX
    length, least = round(_WINDOW / step), round(_WINDOW_MIN / step)
    windows, start = [], 0
    while start < len(time) - least:
        stop = min(start + length, len(time))
        wild = np.flatnonzero(~calm[start:stop])
        if len(wild):
            stop = start + int(wild[0])
        part = slice(start, stop)
        start = stop + 1 if len(wild) else stop
        if stop - part.start < least or speed[part].min() < _SPEED_MIN:
            continue
        # Compare the ends of a straight line, because noise is no change of speed.
        rise = np.polyfit(time[part], speed[part], 1)[0] * (time[stop - 1] - time[part.start])
        if abs(rise) > _SPEED_RANGE * speed[part].mean():
            continue
        if np.ptp(signals["yaw_rate"][part]) < _YAW_RATE_MIN:
            continue
        # Systems are shared by windows of one speed.
        mean = round(2.0 * float(speed[part].mean())) / 2.0
        windows.append(_Window(mean, steering[part], {n: v[part] for n, v in signals.items()}))
    return step, windows
