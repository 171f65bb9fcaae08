"""Cornering stiffness of the axle groups: the linear yaw-roll model fitted to a steered drive.

Output error in windows of nearly constant speed: the recorded steering drives the model of
`analytic.yaw_roll`. Its response is linear in the initial state, the steering's offset and the
road's cross slope, which pulls all masses aside along a parabola over time; they are solved for.
Motion shows only forces over masses, so the mass must be known.

The friction of the fifth wheel, a few hundred N m, turns a tractor in a gentle bend as a percent of
its steering would, and the tires' stiffness by several percent. The recorded articulation shows its
course (it is elastic over 2 mrad, then slips); its size is fitted and not reported.

A truck slows down for a bend. Its path changes little by that, so that the recorded yaw rates are
scaled to the window's one speed.

Load transfer and saturation bend the tires' law: over a window with lateral acceleration a, a force
`F = C s (1 - k a^2)` has the best linear gain `C (1 - k a_e^2)` with

    a_e^2 = (E[a^4] - E[a] E[a^3]) / Var(a)

(least squares, slip s in proportion to a), so that each window takes the stiffness at its a_e.
Windows with high lateral acceleration are left out.

The ratio of steering wheel to road wheels comes from the two angles, if the log has both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, lstsq
from scipy.ndimage import uniform_filter1d

from iits_mj.analytic import YawRoll
from iits_mj.analytic.roll_bodies import RollData
from iits_mj.analytic.traction import side_share
from iits_mj.analytic.yaw_plane import axles_on_road
from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import Estimate, Free, fit, unseen
from iits_mj.identification.log import Log
from iits_mj.identification.longitudinal import payload_of
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.tire_law import cornering_stiffness, friction

# Units of the linear model: a tractor with a semitrailer.
_UNITS = 2
# Outputs that are compared, if the log has them: place among the states.
_STATES = {"yaw_rate": 1, "trailer_yaw_rate": 2, "articulation": 3}
_PLANE_STATES = 4
# Powers of time in a window's cross slope.
_CROSS_SLOPES = 3
# Samples whose responses are computed at once.
_BLOCK = 16
# Shortest sampling step, and lengths of the windows [s].
_STEP_MIN = 0.04
_WINDOW, _WINDOW_MIN = 6.0, 4.0
_RATIO_WINDOW = 10.0
# More windows than this, evenly over the log, add time and little knowledge.
_WINDOWS_MAX = 100
_SPEED_MIN = 6.0
# The model is linear and at one speed: greatest lateral acceleration [m/s2] and speed range [1].
_ACCELERATION_MAX = 2.0
_SPEED_RANGE = 0.08
# Articulation over which the friction of the fifth wheel is elastic (the plugin's law) [rad], time
# over which the recorded one is smoothed [s], and greatest friction that is allowed [N m].
_WIND_UP, _SMOOTH, _FRICTION_MAX = 0.002, 0.4, 4000.0
# Windows share systems of one speed [m/s] and one lateral acceleration [m/s2], in steps of these.
_SPEED_STEP, _ACCELERATION_STEP = 0.5, 0.5
# Errors of the equivalent linear tires in this range, against the truck itself, and of a linkage
# without compliance [1]; the intervals include them.
_MODEL_ERROR = 0.05
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


_FRICTION = "coupling_friction"
_State = tuple[float, float, float]


@dataclass(frozen=True)
class _Window:
    """A stretch of the log.

    Attributes:
      state: speed [m/s] and equivalent lateral acceleration of the first and the last unit [m/s2],
        rounded.
      steering: angle [rad], (n,); friction: of the fifth wheel over its greatest, against a
        positive rate of the articulation, (n,); signals: by name, (n,) each.
    """

    state: _State
    steering: FloatArray
    friction: FloatArray
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
    plate = parameters.couplings[0].yaw_friction if len(parameters.units) > 1 else 0.0
    free.append(Free(_FRICTION, "N m", max(plate, 1.0), 0.0, _FRICTION_MAX))
    if lacking:
        return unseen(free[:-1], f"the log lacks {', '.join(lacking)}")
    if len(parameters.units) != _UNITS:
        return unseen(
            free[:-1], f"the truck has {len(parameters.units)} units, the linear model has 2"
        )
    if mass is None:
        return unseen(free[:-1], "motion shows it only as a ratio to the mass, which is not known")
    step, windows = _windows(log, parameters)
    if not windows:
        return unseen(free[:-1], "the log has no steered stretch of 4 s at a steady speed")
    scales = {
        name: float(np.sqrt(np.mean([np.var(w.signals[name]) for w in windows])))
        for name in windows[0].signals
    }
    payload = payload_of(parameters, mass)
    longest = max(len(window.steering) for window in windows)
    states = {window.state for window in windows}
    models = {
        speed: YawRoll.from_parameters(parameters, payload, cruise_speed=speed)
        for speed in {state[0] for state in states}
    }
    softened = {s: _softening(parameters, payload, models[s[0]], s) for s in states}
    axles = [axle.tire for axle in axles_on_road(parameters, payload)[1]]

    def residual(values: FloatArray, leaning: bool = True) -> list[FloatArray]:
        divisor = 1.0 if direct else float(values[-2]) if wants_ratio else float(ratio or 1.0)
        factor = {name: values[i] / prior for i, (name, prior) in enumerate(kinds.items())}
        scale = np.array([factor[name] for name in axles])
        responses = {}
        for state, share in softened.items():
            model = models[state[0]]
            model = dataclasses.replace(model, cornering=scale * share * model.cornering)
            responses[state] = _responses(model, state[0], longest, step)
        friction = float(values[-1])
        keep = slice(None if leaning else -_CROSS_SLOPES)
        answers = {state: response[:, :, keep] for state, response in responses.items()}
        return [_errors(answers[w.state], w, divisor, friction, scales) for w in windows]

    # With the cross slopes free, a search from afar may end in a minimum beside the right one.
    _, near = fit(free, lambda values: residual(values, leaning=False), tolerance=1e-3)
    estimates, _ = fit(free, residual, start=near, tolerance=_TOLERANCE)
    return [estimate.widened(_MODEL_ERROR) for estimate in estimates[:-1]]


def _softening(p: TruckParameters, payload: float, model: YawRoll, state: _State) -> FloatArray:
    """Share of the axles' cornering stiffness left at a window's lateral acceleration, (axles,)."""
    speed, *accelerations = state
    data = RollData.from_parameters(p, payload, speed)
    system = model.at(speed)
    # Per lateral acceleration of a steady turn.
    turn = system.steady_state()
    steady = dict(zip(system.states, turn / (speed * turn[1]), strict=True))
    common, shares = p.tire_common, []
    for i, axle in enumerate(axles_on_road(p, payload)[1]):
        tire = p.tires[axle.tire]
        lateral = accelerations[min(int(model.plane.unit[i]), 1)]
        # Per tire.
        load = float(data.cruise_load[i]) / (2 * tire.count)
        moved = float(data.tires[i] / data.track[i]) * steady[f"alpha_{i + 1}"] * lateral
        sides = load + np.array([-1.0, 1.0]) * moved / tire.count
        stiffness = cornering_stiffness(np.array([load, *sides]), tire, common)
        force = float(model.cornering[i]) * steady[f"slip_{i + 1}"] * lateral / (2 * tire.count)
        rho = abs(force) / (friction(load, common.friction_lateral, common) * load)
        bent = float(side_share(common, rho))
        shares.append(0.5 * float(stiffness[1] + stiffness[2]) / float(stiffness[0]) * bent)
    return np.array(shares)


def _equivalent(acceleration: FloatArray) -> float:
    """Lateral acceleration [m/s2], (n,), at which a bent tire has its gain over a window."""
    a = acceleration
    square = (np.mean(a**4) - a.mean() * np.mean(a**3)) / max(float(np.var(a)), 1e-12)
    return _ACCELERATION_STEP * round(float(np.sqrt(max(square, 0.0))) / _ACCELERATION_STEP)


def _errors(
    responses: FloatArray,
    window: _Window,
    divisor: float,
    friction: float,
    scales: Mapping[str, float],
) -> FloatArray:
    """Model less record over all signals; see the module on what is solved for."""
    inputs = (window.steering / divisor, friction * window.friction)
    n = len(window.steering)
    columns, measured = [], []
    for name, scale in scales.items():
        answers = responses[:n, _STATES[name], :].T
        # The state answers one sample later: to this sample's input and to the next one's.
        forced = np.zeros(n)
        for signal, early, late in zip(inputs, answers[0:4:2], answers[1:4:2], strict=True):
            forced[1:] += (
                np.convolve(early, signal)[: n - 1] + np.convolve(late, signal[1:])[: n - 1]
            )
        offset = np.concatenate([[0.0], np.cumsum(answers[0] + answers[1])[:-1]])
        columns.append(np.column_stack([forced, *answers[4:], offset]) / scale)
        measured.append(window.signals[name] / scale)
    basis, target = np.vstack(columns), np.concatenate(measured)
    forced, free = basis[:, 0], basis[:, 1:]
    levels, *_ = lstsq(free, target - forced, lapack_driver="gelsy")
    return np.asarray(forced + free @ levels - target)


def _responses(model: YawRoll, speed: float, length: int, step: float) -> FloatArray:
    """Plane states, shape (length, 4, 11), by samples since a start.

    To unit samples, straight between them (the sample and the one after), of the steering and of a
    moment that closes the articulation; to each initial plane state; and to a lateral acceleration
    of all masses in proportion to powers of time, 0 to 2, as a road's cross slope gives it.
    """
    system = model.at(speed)
    size = len(system.B)
    # Behind the states: inputs and their rises in a step.
    whole = np.zeros((size + 7, size + 7))
    whole[:size, :size], whole[:size, size] = system.A * step, system.B * step
    whole[:size, size + 2] = _closing(model, size) * step
    whole[0, size + 4] = step
    inputs = size + np.array([0, 2, 4, 5])
    whole[inputs, inputs + 1] = 1.0
    power = expm(whole)
    start = np.zeros((size + 7, 7 + _PLANE_STATES))
    for column in (0, 2):
        first, late = power[:size, size + column], power[:size, size + column + 1]
        start[:size, column], start[:size, column + 1] = first - late, late
    start[:_PLANE_STATES, 4:-_CROSS_SLOPES] = np.eye(_PLANE_STATES)
    start[size + 4 :, -_CROSS_SLOPES:] = np.eye(_CROSS_SLOPES)
    # The first powers of a block, applied to the state at each block's start.
    rows = [np.eye(_PLANE_STATES, size + 7)]
    for _ in range(_BLOCK - 1):
        rows.append(rows[-1] @ power)
    jump, states = np.linalg.matrix_power(power, _BLOCK), [start]
    for _ in range(length // _BLOCK):
        states.append(jump @ states[-1])
    found = np.einsum("kij,bjc->bkic", np.array(rows), np.array(states), optimize=True)
    return np.asarray(found.reshape(-1, _PLANE_STATES, 7 + _PLANE_STATES)[:length])


def _closing(model: YawRoll, size: int) -> FloatArray:
    """Rates of the states (size,) by a moment [N m] that reduces the first articulation."""
    force = np.zeros(len(model.inertia))
    force[1:3] = -1.0, 1.0
    rates = np.linalg.solve(model.inertia, force)
    flat = 1 + model.plane.units
    first_rate = 2 * model.plane.units + len(rates) - flat
    found = np.zeros(size)
    found[:flat], found[first_rate : first_rate + len(rates) - flat] = rates[:flat], rates[flat:]
    return found


def _friction(log: Log, time: FloatArray) -> FloatArray:
    """Friction of the fifth wheel over its greatest, (n,); zero without an articulation."""
    if "articulation" not in log:
        return np.zeros_like(time)
    length = max(round(_SMOOTH / (time[1] - time[0])), 1)
    smooth = uniform_filter1d(log.at("articulation", time), length)
    # The wind-up follows the articulation behind a play.
    return (smooth - pitman_angle(smooth, 2.0 * _WIND_UP)) / _WIND_UP


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
    friction = _friction(log, time)
    rates = [signals[name] for name in ("yaw_rate", "trailer_yaw_rate") if name in signals]
    calm = np.max(np.abs(rates), axis=0) * speed < _ACCELERATION_MAX
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
        line = np.polyval(np.polyfit(time[part], speed[part], 1), time[part])
        if abs(line[-1] - line[0]) > _SPEED_RANGE * speed[part].mean():
            continue
        if np.ptp(signals["yaw_rate"][part]) < _YAW_RATE_MIN:
            continue
        own = {name: values[part] for name, values in signals.items()}
        mean = float(speed[part].mean())
        lead, last = (
            _equivalent(mean * own[name])
            for name in (
                "yaw_rate",
                "trailer_yaw_rate" if "trailer_yaw_rate" in own else "yaw_rate",
            )
        )
        mean = _SPEED_STEP * round(mean / _SPEED_STEP)
        # A path has yaw rates in proportion to the speed.
        own = {name: v if name == "articulation" else v * mean / line for name, v in own.items()}
        windows.append(_Window((mean, lead, last), steering[part], friction[part], own))
    return step, windows[:: -(-len(windows) // _WINDOWS_MAX) or 1]
