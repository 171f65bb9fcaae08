"""Dead time and build-up time of the brake circuits, from the pressures after a brake demand.

A step of the demand becomes a ramp of the supply at the truck's supply rate; the chamber follows it
after a dead time, as a first-order lag. Of each application the level is free (load sensing and
trim change it), and so is the size of what the deceleration control adds: it sees the response
through its filter, integrates what is missing, and asks for that on the same way. How long the ramp
lasts follows from the level that was fitted before: the fit is done twice. A release says nothing
here: its shape is the controller's.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import Estimate, Free, fit
from iits_mj.identification.log import PRESSURES, Log, Series
from iits_mj.model.air_brake import torque_slope
from iits_mj.parameters import TruckParameters

# --- Force of the friction brakes from the recorded chamber pressures, circuit by circuit ---

# Circuit to the pressures recorded of it; the trailer reports one for both sides.
CIRCUITS: dict[str, tuple[str, ...]] = {
    "front": PRESSURES[0:2],
    "drive": PRESSURES[2:4],
    "trailer": PRESSURES[4:5],
}


def circuit_of_axle(parameters: TruckParameters) -> list[str]:
    """Name of the circuit of each axle, front to rear."""
    drive = len(parameters.tractor.axles) - 1
    return ["front", *["drive"] * drive, *["trailer"] * len(parameters.semitrailer.axles)]


def circuit_forces(
    log: Log, parameters: TruckParameters, time: FloatArray, radii: FloatArray
) -> FloatArray:
    """Brake force of the circuits at the road with the parameters' gains [N], shape (n, 3).

    A brake pulls with the pressure above push-out; when it is let off, the friction of its
    mechanism holds up to `hysteresis_pressure` more than the chamber has.

    Args:
      log: has the five brake pressures.
      parameters: of the truck.
      time: at which the forces are wanted [s], shape (n,).
      radii: rolling radius of each axle's tires [m], shape (6,).
    """
    brake = parameters.air_brake
    forces = np.zeros((len(time), len(CIRCUITS)))
    names = list(CIRCUITS)
    slopes = torque_slope(parameters)
    for column, names_of_circuit in enumerate(CIRCUITS.values()):
        sides = [
            play(log.at(name, time), brake.hysteresis_pressure) - brake.push_out_pressure
            for name in names_of_circuit
        ]
        both = (2.0 / len(sides)) * np.sum(np.maximum(sides, 0.0), axis=0)
        for axle, circuit in enumerate(circuit_of_axle(parameters)):
            if circuit == names[column]:
                forces[:, column] += slopes[axle] * both / radii[axle]
    return forces


def play(pressure: FloatArray, width: float) -> FloatArray:
    """The pressure that the mechanism lets through: never below, up to `width` above, (n,)."""
    through = np.empty_like(pressure)
    held = 0.0
    for index, value in enumerate(pressure):
        held = min(max(held, value), value + width)
        through[index] = held if value > 0.0 else 0.0
    return through


# --- Dead time and build-up time of the brake circuits, from the pressures after a brake demand ---

# A demand that jumps by this much [m/s2] and then holds this long [s] is an event; what comes later
# is the deceleration control's, not the response. Smaller demands are the bus's rounding.
_NOTHING = 0.02
_STEP = 0.3
_HOLD = 1.0
_LONGEST = 1.0
_BEFORE = 0.5
# Groups fewer than this leave no honest interval.
_EVENTS_MIN = 4
# Grid on which the supply and its lag are computed [s].
_GRID = 0.002


@dataclass(frozen=True)
class Event:
    """An application of the brakes by one step of the demand: its time and its hold [s]."""

    time: float
    hold: float


def identify_brake_response(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Dead time and build-up time of each circuit, from demand and pressures."""
    lacking = log.missing("command_xbr_demand")
    events = [] if lacking else brake_events(log)
    estimates: list[Estimate] = []
    brake = parameters.air_brake
    for circuit, names in CIRCUITS.items():
        dead_time, build_up = prior_response(parameters, circuit)
        free = [
            Free(f"{circuit}_dead_time", "s", dead_time, 1e-3, 1.0),
            Free(f"{circuit}_build_up_time", "s", build_up, 0.02, 3.0),
        ]
        absent = lacking + log.missing(names[0])
        if absent:
            reason = f"the log lacks {', '.join(absent)}"
            estimates += [Estimate.unseen(f.name, f.unit, f.prior, reason) for f in free]
            continue
        rate, filtering = brake.supply_rise_rate, brake.filter_time_constant
        responses = [_Response(e, log.series(names[0]), rate, filtering) for e in events]
        estimates += _fit_circuit(free, responses, _uncertainty(log))
    return estimates


def prior_response(parameters: TruckParameters, circuit: str) -> tuple[float, float]:
    """Dead time from the demand on and build-up time of a circuit [s], by the parameters."""
    brake = parameters.air_brake
    axle = circuit_of_axle(parameters).index(circuit)
    line = brake.trailer_line_delay if circuit == "trailer" else 0.0
    return brake.dead_time[axle] + line, brake.build_up_time_constant[axle]


class _Response:
    """One event's samples, and the response's shape for trial values of dead time and lag."""

    def __init__(self, event: Event, samples: Series, rate: float, control_lag: float) -> None:
        start, stop = event.time - _BEFORE, event.time + event.hold
        near = (samples.time >= start - 1e-9) & (samples.time <= stop + 1e-9)
        self._time = samples.time[near] - event.time
        self._pressure = samples.value[near]
        self._since = np.arange(0.0, event.hold + _GRID, _GRID)
        self._rate, self._control_lag = rate, control_lag
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
    """First-order response from rest, exact for a signal straight between the grid's points."""
    x = _GRID / lag
    decay = np.exp(-x)
    late = 1.0 - (1.0 - decay) / x
    early = (1.0 - decay) / x - decay
    return np.asarray(lfilter([late, early], [1.0, -decay], signal))


def _fit_circuit(
    free: list[Free], responses: list[_Response], uncertainty: float
) -> list[Estimate]:
    """Fits one circuit; `uncertainty` of the demands' onset [s] adds to that of the dead time."""
    scale = max((response.span for response in responses), default=0.0)
    reason = ""
    if len(responses) < _EVENTS_MIN:
        reason = (
            f"the log has {len(responses)} applications that hold for {_HOLD:g} s, "
            f"{_EVENTS_MIN} are wanted"
        )
    elif scale <= 0.0:
        reason = "the pressure never rose"
    if reason:
        return [Estimate.unseen(f.name, f.unit, f.prior, reason) for f in free]

    def residual(values: FloatArray) -> list[FloatArray]:
        return [r.residual(values[0], values[1], scale) for r in responses]

    _, values = fit(free, residual)
    for response in responses:
        response.set_level(response.level(values[0], values[1]))
    (dead_time, build_up), _ = fit(free, residual)
    wide = dead_time.half_width + uncertainty
    if dead_time.identifiable and uncertainty > 0.05 * dead_time.value:
        reason = f"the demand's onset is known within {2e3 * uncertainty:.0f} ms only"
        dead_time = Estimate.unseen(dead_time.name, "s", dead_time.prior, reason)
    return [dataclasses.replace(dead_time, half_width=wide), build_up]


def _uncertainty(log: Log) -> float:
    """Half of the time within which a demand may have begun before the row that shows it [s].

    On a bus the frame itself is the demand; a table shows it at its next row.
    """
    if isinstance(log.signals["command_xbr_demand"], Series):
        return 0.0
    return 0.5 * float(np.median(np.diff(log.series("command_xbr_demand").time)))


def brake_events(log: Log) -> list[Event]:
    """Steps of the brake demand from nothing that hold long enough."""
    series = log.series("command_xbr_demand")
    time, demand = series.time, np.maximum(-series.value, 0.0)
    if "command_xbr_mode" in log:
        demand = np.where(log.held("command_xbr_mode", time) > 0.5, demand, 0.0)
    demand = np.where(demand > _NOTHING, demand, 0.0)
    jumps = np.flatnonzero(np.abs(np.diff(demand)) > _NOTHING) + 1
    ends = np.append(time[jumps[1:]], time[-1:])[: len(jumps)]
    return [
        Event(float(time[index]), float(min(end - time[index], _LONGEST)))
        for index, end in zip(jumps, ends, strict=True)
        if demand[index - 1] == 0.0
        and demand[index] >= _STEP
        and end - time[index] >= _HOLD
        and time[index] - time[0] >= _BEFORE
    ]
