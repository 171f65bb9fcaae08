"""Brake circuits: their forces from chamber pressures, and their dead time and build-up time.

A step of the brake demand becomes a ramp of the supply at the truck's supply rate; the chamber
follows after a dead time, with a first-order lag. The level of each application is free (load
sensing and trim change it), and so is the part that the deceleration control adds: it measures the
response through its filter, integrates the deficit, and requests it on the same path. The length of
the ramp follows from the fitted level, so the fit runs twice. Releases are not used, because the
controller determines their shape.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.identification.estimate import Estimate, Free, fit, unseen
from iits_mj.identification.log import PRESSURES, Log, Series
from iits_mj.model.air_brake import circuits, torque_slope
from iits_mj.parameters import TruckParameters

# Recorded pressures of each circuit; the trailer reports one pressure for both sides.
CIRCUITS: dict[str, tuple[str, ...]] = {
    "front": PRESSURES[0:2],
    "drive": PRESSURES[2:4],
    "trailer": PRESSURES[4:5],
}
# An event is a jump of the demand by `_STEP` [m/s2] that holds for `_HOLD` [s]; later changes come
# from the deceleration control. Demands up to `_NOTHING` are rounding on the bus.
_NOTHING = 0.02
_STEP = 0.3
_HOLD = 1.0
_LONGEST = 1.0
_BEFORE = 0.5
# Time after which the last application has left the chambers [s].
_RELEASED = 1.5
# The brakes give what the driveline does not: its torque must change by less in an event [N m].
_TORQUE_CHANGE = 20.0
# Fewer groups give no reliable interval.
_EVENTS_MIN = 4
# Errors of the fit against the truck itself, on a level road without noise: its control compares
# with one lag for all circuits. Of the dead time [s], and of the build-up time [1].
_DEAD_TIME_ERROR, _BUILD_UP_ERROR = 0.002, 0.04
# Dead times of single applications of a table: beyond the prior, their grid, and a finer one around
# the best of it [s].
_DEAD_TIME_ADDED, _DEAD_TIME_STEP = 0.25, 0.016
_DEAD_TIMES_NEAR = np.linspace(-0.008, 0.008, 5)
# Grid on which the supply and its lag are computed [s].
_GRID = 0.002


def circuit_of_axle(parameters: TruckParameters) -> list[str]:
    """Name of the circuit of each axle, front to rear."""
    return [list(CIRCUITS)[number] for number in circuits(parameters)]


def circuit_forces(
    log: Log, parameters: TruckParameters, time: FloatArray, radii: FloatArray
) -> FloatArray:
    """Brake force of the circuits at the road with the parameters' gains [N], shape (n, 3).

    The pressure above push-out brakes; during a release, the friction of the mechanism holds up to
    `hysteresis_pressure` more than the pressure in the chamber.

    Args:
      log: with the five brake pressures.
      parameters: of the truck.
      time: of the forces [s], shape (n,).
      radii: rolling radius of each axle's tires [m], shape (axles,).
    """
    brake = parameters.air_brake
    forces = np.zeros((len(time), len(CIRCUITS)))
    slopes = torque_slope(parameters)
    for column, (name, signals) in enumerate(CIRCUITS.items()):
        chambers = [_held_pressure(log.at(s, time), brake.hysteresis_pressure) for s in signals]
        sides = [chamber - brake.push_out_pressure for chamber in chambers]
        both = (2.0 / len(sides)) * np.sum(np.maximum(sides, 0.0), axis=0)
        for axle, circuit in enumerate(circuit_of_axle(parameters)):
            if circuit == name:
                forces[:, column] += slopes[axle] * both / radii[axle]
    return forces


def _held_pressure(pressure: FloatArray, width: float) -> FloatArray:
    """Pressure held by the mechanism's friction: up to `width` above the chamber's, shape (n,)."""
    through = np.empty_like(pressure)
    held = 0.0
    for index, value in enumerate(pressure):
        held = min(max(held, value), value + width)
        through[index] = held if value > 0.0 else 0.0
    return through


@dataclass(frozen=True)
class Event:
    """An application of the brakes by one step of the demand.

    Attributes:
      time, hold: of the step, and how long it holds [s].
      missing: deceleration that the road's slope takes away, as a share of the demand. The control
        finds it missing from the start; it knows the engine's drag and the rolling resistance.
    """

    time: float
    hold: float
    missing: float


def identify_brake_response(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Dead time and build-up time of each circuit, from demand and pressures."""
    events = brake_events(log) if "command_xbr_demand" in log else []
    estimates: list[Estimate] = []
    brake = parameters.air_brake
    for circuit, names in CIRCUITS.items():
        if circuit not in circuit_of_axle(parameters):
            continue
        axle = parameters.axles[circuit_of_axle(parameters).index(circuit)].brake
        line = brake.trailer_line_delay if circuit == "trailer" else 0.0
        build_up = axle.build_up_time_constant
        free = [
            Free(f"{circuit}_dead_time", "s", axle.dead_time + line, 1e-3, 1.0),
            Free(f"{circuit}_build_up_time", "s", build_up, 0.02, 3.0),
        ]
        lacks = log.lacks("command_xbr_demand", names[0])
        if lacks:
            estimates += unseen(free, lacks)
            continue
        rate, filtering = brake.supply_rise_rate, brake.filter_time_constant
        pressure = log.series(names[0])
        responses = [
            _Response(e, pressure, rate, filtering, brake.trim_gain * e.missing) for e in events
        ]
        estimates += _fit_circuit(free, responses, _uncertainty(log))
    return estimates


class _Response:
    """One event's samples, and the response's shape for trial values of dead time and lag."""

    def __init__(
        self, event: Event, samples: Series, rate: float, control_lag: float, drift: float
    ) -> None:
        start, stop = event.time - _BEFORE, event.time + event.hold
        near = (samples.time >= start - 1e-9) & (samples.time <= stop + 1e-9)
        self._time = samples.time[near] - event.time
        self._pressure = samples.value[near]
        self._since = np.arange(0.0, event.hold + _GRID, _GRID)
        self._rate, self._control_lag, self._drift = rate, control_lag, drift
        self.set_level(self.span)

    @property
    def span(self) -> float:
        """Range of the recorded pressure [Pa]."""
        return float(np.ptp(self._pressure)) if len(self._pressure) else 0.0

    def set_level(self, level: float) -> None:
        """Sets the final level of the supply [Pa], and with it the length of its ramp."""
        self._ramp = np.minimum(self._since * self._rate / max(level, 1.0), 1.0)
        self._ramp += self._drift * self._since

    def residual(self, dead_time: float, lag: float, scale: float) -> FloatArray:
        """Model less record in units of `scale`, with the best free levels."""
        basis, levels = self._solve(dead_time, lag)
        return np.asarray((basis @ levels - self._pressure) / scale)

    def level(self, dead_time: float, lag: float) -> float:
        """The final level of the supply [Pa] with these values, without the drift."""
        return abs(float(self._solve(dead_time, lag)[1][1]))

    def _solve(self, dead_time: float, lag: float) -> tuple[FloatArray, FloatArray]:
        shape = _lagged(self._ramp, lag)
        seen = np.interp(self._since - dead_time, self._since, shape, left=0.0)
        added = _lagged(np.cumsum(_lagged(seen, self._control_lag)) * _GRID, lag)
        basis = np.column_stack(
            [np.ones_like(self._time), self._look(shape, dead_time), self._look(added, dead_time)]
        )
        levels, *_ = np.linalg.lstsq(basis, self._pressure, rcond=None)
        return basis, np.asarray(levels)

    def _look(self, shape: FloatArray, dead_time: float) -> FloatArray:
        return np.asarray(np.interp(self._time - dead_time, self._since, shape, left=0.0))


def _lagged(signal: FloatArray, lag: float) -> FloatArray:
    """First-order response from rest, exact for a signal that is linear between grid points."""
    x = _GRID / lag
    decay = np.exp(-x)
    late = 1.0 - (1.0 - decay) / x
    early = (1.0 - decay) / x - decay
    return np.asarray(lfilter([late, early], [1.0, -decay], signal))


def _fit_circuit(
    free: list[Free], responses: list[_Response], uncertainty: float
) -> list[Estimate]:
    """Fits one circuit; if the demands' onset is uncertain [s], its build-up time alone."""
    scale = max((response.span for response in responses), default=0.0)
    reason = ""
    if len(responses) < _EVENTS_MIN:
        reason = (
            f"the log has {len(responses)} applications that hold for {_HOLD:g} s, "
            f"{_EVENTS_MIN} are needed"
        )
    elif scale <= 0.0:
        reason = "the pressure did not rise"
    if reason:
        return unseen(free, reason)

    if uncertainty > 0.05 * free[0].prior:
        # Each application has a dead time of its own.
        own = np.arange(-2.0 * uncertainty, free[0].prior + _DEAD_TIME_ADDED, _DEAD_TIME_STEP)

        def best(r: _Response, lag: float, times: FloatArray) -> tuple[float, FloatArray]:
            trials = [(float(d), r.residual(float(d), lag, scale)) for d in times]
            return min(trials, key=lambda pair: float(pair[1] @ pair[1]))

        def nearest(values: FloatArray) -> list[tuple[float, FloatArray]]:
            around = [(r, best(r, values[0], own)[0]) for r in responses]
            return [best(r, values[0], middle + _DEAD_TIMES_NEAR) for r, middle in around]

        _, values = fit(free[1:], lambda values: [error for _, error in nearest(values)])
        for response, (dead_time, _) in zip(responses, nearest(values), strict=True):
            response.set_level(response.level(dead_time, values[0]))
        (build_up,), _ = fit(free[1:], lambda values: [error for _, error in nearest(values)])
        reason = f"the demand's onset is known within {2e3 * uncertainty:.0f} ms only"
        return [free[0].unseen(reason), build_up.widened(_BUILD_UP_ERROR)]

    def residual(values: FloatArray) -> list[FloatArray]:
        return [r.residual(values[0], values[1], scale) for r in responses]

    _, values = fit(free, residual)
    for response in responses:
        response.set_level(response.level(values[0], values[1]))
    (delay, build_up), _ = fit(free, residual)
    wide = float(np.hypot(delay.half_width, _DEAD_TIME_ERROR)) + uncertainty
    return [dataclasses.replace(delay, half_width=wide), build_up.widened(_BUILD_UP_ERROR)]


def _uncertainty(log: Log) -> float:
    """Half of the time by which a demand may begin before its first row [s].

    On a bus the frame itself is the demand; a table has it in its next row.
    """
    if isinstance(log.signals["command_xbr_demand"], Series):
        return 0.0
    return 0.5 * float(np.median(np.diff(log.series("command_xbr_demand").time)))


def brake_events(log: Log) -> list[Event]:
    """Steps of the brake demand from zero that hold long enough."""
    series = log.series("command_xbr_demand")
    time, demand = series.time, np.maximum(-series.value, 0.0)
    if "command_xbr_mode" in log:
        demand = np.where(log.held("command_xbr_mode", time) > 0.5, demand, 0.0)
    demand = np.where(demand > _NOTHING, demand, 0.0)
    jumps = np.flatnonzero(np.abs(np.diff(demand)) > _NOTHING) + 1
    ends = np.append(time[jumps[1:]], time[-1:])[: len(jumps)]
    return [
        Event(
            float(time[index]),
            float(min(end - time[index], _LONGEST)),
            -GRAVITY * float(log.at("grade", time[index])) / float(demand[index])
            if "grade" in log
            else 0.0,
        )
        for index, end in zip(jumps, ends, strict=True)
        if not np.any(demand[np.searchsorted(time, time[index] - _RELEASED) : index])
        and demand[index] >= _STEP
        and end - time[index] >= _HOLD
        and time[index] - time[0] >= _BEFORE
        and _calm(log, float(time[index]))
    ]


def _calm(log: Log, start: float) -> bool:
    """Whether the driveline's torque is steady from before an application until its end.

    The brake control deducts the driveline's braking: an engine that still pulls, or a gear change,
    gives the demand on the chambers another shape than a step.
    """
    for name, most in (("engine_torque", _TORQUE_CHANGE), ("shift_in_process", 0.5)):
        if name in log:
            series = log.series(name)
            near = (series.time > start - _BEFORE) & (series.time < start + _LONGEST)
            if near.any() and np.ptp(series.value[near]) > most:
                return False
    return True
