"""Dead time and time constants of the brake circuits, from the pressures after a brake demand.

A step of the demand becomes a ramp of the supply at the truck's supply rate; the chamber follows it
after a dead time, as a first-order lag. Of each application the level is free (load sensing and
trim change it), and when it builds up a drift in proportion to the time since the response began,
which is what an integrating deceleration control adds. How long the ramp lasts follows from the
level that was fitted before: the fit is done twice.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from iits_mj.identification.brake_force import CIRCUITS, circuit_of_axle
from iits_mj.identification.estimate import Estimate, Free, fit
from iits_mj.identification.log import Log, Series
from iits_mj.parameters import TruckParameters

FloatArray = NDArray[np.float64]

# A demand that jumps by this much [m/s2] and then holds this long [s] is an event; a longer hold
# says no more about the response.
_STEP = 0.3
_HOLD = 1.2
_LONGEST = 2.5
_BEFORE = 0.5
# Groups fewer than this leave no honest interval.
_EVENTS_MIN = 4
# Grid on which the supply and its lag are computed [s].
_GRID = 0.002
_UNUSED = "the log has {} {} of at least {:g} s, {} are wanted"


@dataclass(frozen=True)
class Event:
    """One step of the demand: its time [s], its hold [s], demand before and after [m/s2]."""

    time: float
    hold: float
    before: float
    after: float

    @property
    def rises(self) -> bool:
        """True when the brakes are applied, False when they are released."""
        return self.after > self.before


def identify_brake_response(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Dead time, build-up and release time of each circuit, from demand and pressures."""
    brake = parameters.air_brake
    lacking = log.missing("command_xbr_demand")
    events = [] if lacking else brake_events(log)
    estimates: list[Estimate] = []
    for circuit, names in CIRCUITS.items():
        axle = circuit_of_axle(parameters).index(circuit)
        free = [
            Free(f"{circuit}_dead_time", "s", brake.dead_time[axle], 1e-3, 1.0),
            Free(f"{circuit}_build_up_time", "s", brake.build_up_time_constant[axle], 0.02, 3.0),
            Free(f"{circuit}_release_time", "s", brake.release_time_constant[axle], 0.02, 3.0),
        ]
        absent = lacking + log.missing(names[0])
        if absent:
            reason = f"the log lacks {', '.join(absent)}"
            estimates += [Estimate.unseen(f.name, f.unit, f.prior, reason) for f in free]
            continue
        samples = log.series(names[0])
        rates = {True: brake.supply_rise_rate, False: brake.supply_fall_rate}
        responses = [_Response(event, samples, rates[event.rises]) for event in events]
        estimates += _fit_circuit(free, responses, _uncertainty(log))
    return estimates


class _Response:
    """One event's samples, and the response's shape for trial values of dead time and lag."""

    def __init__(self, event: Event, samples: Series, rate: float) -> None:
        start, stop = event.time - _BEFORE, event.time + event.hold
        near = (samples.time >= start - 1e-9) & (samples.time <= stop + 1e-9)
        self._time = samples.time[near] - event.time
        self._pressure = samples.value[near]
        self._since = np.arange(0.0, event.hold + _GRID, _GRID)
        self._rate = rate
        self.rises = event.rises
        self.set_level(self.span)

    @property
    def span(self) -> float:
        """Range of the recorded pressure [Pa]."""
        return float(np.ptp(self._pressure)) if len(self._pressure) else 0.0

    def set_level(self, level: float) -> None:
        """Sets how far the supply goes [Pa], and with it how long its ramp lasts."""
        self._ramp = np.minimum(self._since * self._rate / max(level, 1.0), 1.0)

    def residual(self, dead_time: float, lag: float, scale: float) -> FloatArray:
        """Model less record in units of `scale`, the free levels solved for."""
        basis, levels = self._solve(dead_time, lag)
        return np.asarray((basis @ levels - self._pressure) / scale)

    def level(self, dead_time: float, lag: float) -> float:
        """How far the supply goes [Pa] with these values, without the drift."""
        return abs(float(self._solve(dead_time, lag)[1][1]))

    def _solve(self, dead_time: float, lag: float) -> tuple[FloatArray, FloatArray]:
        # Exact first-order response to a signal that is straight between the grid's points.
        x = _GRID / lag
        decay = np.exp(-x)
        late = 1.0 - (1.0 - decay) / x
        early = (1.0 - decay) / x - decay
        shape = lfilter([late, early], [1.0, -decay], self._ramp)
        columns = [np.ones_like(self._time), self._look(shape, dead_time)]
        if self.rises:
            columns.append(self._look(np.cumsum(shape) * _GRID, dead_time))
        basis = np.column_stack(columns)
        levels, *_ = np.linalg.lstsq(basis, self._pressure, rcond=None)
        return basis, np.asarray(levels)

    def _look(self, shape: FloatArray, dead_time: float) -> FloatArray:
        return np.asarray(np.interp(self._time - dead_time, self._since, shape, left=0.0))


def _fit_circuit(
    free: list[Free], responses: list[_Response], uncertainty: float
) -> list[Estimate]:
    """Dead time is shared by build-up and release; what has too few events is not fitted."""
    build_up = [response for response in responses if response.rises]
    release = [response for response in responses if not response.rises]
    enough = [len(build_up) >= _EVENTS_MIN, len(release) >= _EVENTS_MIN]
    texts = [("applications", len(build_up)), ("releases", len(release))]
    unseen = {
        k + 1: _UNUSED.format(count, what, _HOLD, _EVENTS_MIN)
        for k, (what, count) in enumerate(texts)
        if not enough[k]
    }
    if not enough[0]:
        # The release alone would hang on the level from which it starts.
        unseen |= {0: unseen[1], 2: unseen.get(2, unseen[1])}
        return [Estimate.unseen(f.name, f.unit, f.prior, unseen[k]) for k, f in enumerate(free)]
    scale = max(response.span for response in build_up)
    fitted = [f for k, f in enumerate(free) if k not in unseen]
    if scale <= 0.0:
        reason = "the pressure never rose"
        return [Estimate.unseen(f.name, f.unit, f.prior, reason) for f in free]

    def residual(values: FloatArray) -> list[FloatArray]:
        groups = [r.residual(values[0], values[1], scale) for r in build_up]
        if enough[1]:
            groups += [r.residual(values[0], values[2], scale) for r in release]
        return groups

    _, values = fit(fitted, residual)
    for response in responses:
        lag = values[1] if response.rises else values[-1]
        response.set_level(response.level(values[0], lag))
    estimates, _ = fit(fitted, residual)
    by_name = {e.name: e for e in estimates}
    dead_time = estimates[0]
    wide = dead_time.half_width + uncertainty
    if dead_time.identifiable and uncertainty > 0.05 * dead_time.value:
        reason = f"the demand's onset is known within {2e3 * uncertainty:.0f} ms only"
        by_name[dead_time.name] = dataclasses.replace(
            Estimate.unseen(dead_time.name, "s", dead_time.prior, reason), half_width=wide
        )
    elif dead_time.identifiable:
        by_name[dead_time.name] = dataclasses.replace(dead_time, half_width=wide)
    return [
        by_name.get(f.name, Estimate.unseen(f.name, f.unit, f.prior, unseen.get(k, "")))
        for k, f in enumerate(free)
    ]


def _uncertainty(log: Log) -> float:
    """Half of the time within which a demand may have begun before the row that shows it [s].

    On a bus the frame itself is the demand; a table shows it at its next row.
    """
    if isinstance(log.signals["command_xbr_demand"], Series):
        return 0.0
    return 0.5 * float(np.median(np.diff(log.series("command_xbr_demand").time)))


def brake_events(log: Log) -> list[Event]:
    """Steps of the brake demand that hold long enough, applications and releases."""
    series = log.series("command_xbr_demand")
    time, demand = series.time, -series.value
    if "command_xbr_mode" in log:
        demand = np.where(log.held("command_xbr_mode", time) > 0.5, demand, 0.0)
    demand = np.maximum(demand, 0.0)
    jumps = np.flatnonzero(np.abs(np.diff(demand)) > 0.02) + 1
    ends = np.append(time[jumps[1:]], time[-1:])[: len(jumps)]
    events = []
    last = -np.inf
    for index, end in zip(jumps, ends, strict=True):
        start, before, after = float(time[index]), float(demand[index - 1]), float(demand[index])
        hold = min(float(end) - start, _LONGEST)
        from_rest = before == 0.0 or after == 0.0
        if abs(after - before) >= _STEP and hold >= _HOLD and start - last > _HOLD and from_rest:
            events.append(Event(start, hold, before, after))
        last = start
    return events
