"""Yaw damping after a pulse steer (ISO 14791): how fast the swings of the combination decay.

The pulse is a triangle at the steering wheel, 0.2 s up and 0.2 s down. The linear model sets its
size for a given lateral acceleration of the steer axle. The standard leaves shape and size to the
tester; this choice respects the actuator's rate limit. The Australian PBS requires a damping of
0.15 of the worst signal (a number not checked against the text of its Rules).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import LateralSystem, Response, UnitHistories, simulate
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling.lane_change import linear_system
from iits_mj.validation.handling.step_steer import signals, unit_titles
from iits_mj.validation.harness.maneuver import steady_truck
from iits_mj.validation.harness.recorder import SteeringRecord, drive
from iits_mj.validation.pbs.limits import STANDARDS
from iits_mj.validation.pbs.maneuvers import PulseSteer

# PBS, all levels.
REQUIRED = STANDARDS["yaw_damping"].limits[0]
_PULSE = PulseSteer()
_LEAD = 0.5
_LENGTH = 10.0
# Least greatest swing of an oscillation as a share of the decay's range.
_SWINGS = 0.05
# Least counted swing as a share of the greatest.
_FLOOR = 0.01


@dataclass(frozen=True)
class Pulse:
    """One pulse steer.

    Attributes:
      recording: of the truck, from half a second before the pulse.
      model: the linear model's answer to the same road-wheel angle.
      system: the linear model.
      parameters: of the truck.
    """

    recording: SteeringRecord
    model: Response
    system: LateralSystem
    parameters: TruckParameters

    def damping(self) -> dict[str, float]:
        """Damping ratios of the truck by signal."""
        return self._ratios(self.recording)

    def model_damping(self) -> dict[str, float]:
        """Damping ratios of the linear model by the same procedure."""
        return self._ratios(self.model)

    @property
    def free(self) -> BoolArray:
        """Samples after the pulse, shape (n,)."""
        return np.asarray(self.recording.time >= _LEAD + 2.0 * _PULSE.rise)

    def _ratios(self, source: UnitHistories) -> dict[str, float]:
        free = self.free
        *swinging, _ = signals(self.parameters, source)
        found = {title: damping_ratio(values[free]) for title, _, values in swinging}
        name = f"lateral acceleration of the {unit_titles(self.parameters)[-1]}"
        return found | {name: damping_ratio(source.trailer_lateral_acceleration[free])}


def pulse(parameters: TruckParameters, payload: float, speed: float, timestep: float) -> Pulse:
    """A pulse steer at this speed [m/s]; afterwards the steering wheel is held at zero."""
    truck, hold = steady_truck(payload, speed, timestep, parameters=parameters)
    system = linear_system(truck, speed)
    height = _PULSE.peak / _unit_peak(system) * truck.parameters.steering.ratio

    def steering(time: float, _: float) -> float:
        return height * float(_PULSE.steer(np.array(time - _LEAD)))

    record = drive(truck, steering, speed=speed, duration=_LEAD + _LENGTH, hold=hold)
    return Pulse(record, simulate(system, record.time, record.road_wheel), system, parameters)


def _unit_peak(system: LateralSystem) -> float:
    """Peak lateral acceleration of the steer axle per road-wheel angle [m/s2 per rad]."""
    time = np.arange(0.0, 4.0, 0.01)
    answer = simulate(system, time, 1e-3 * _PULSE.steer(time))
    return float(np.max(np.abs(answer.steer_axle_acceleration)) / 1e-3)


def damping_ratio(signal: FloatArray) -> float:
    """Damping ratio of a free decay by the mean ratio of successive amplitudes (ISO 14791).

    With `A_k` the successive half-period amplitudes, `r = mean((A_k + A_{k+1}) / (A_{k+1} +
    A_{k+2}))` and `D = ln r / sqrt(pi^2 + (ln r)^2)`. The sums are distances between extremes, so
    an offset of the signal has no effect.

    Args:
      signal: uniform samples of a free decay, shape (n,).

    Returns:
      1.0 with fewer than three distinct extremes (an aperiodic or similarly damped decay); negative
      for growing swings; NaN for a signal that is not finite.
    """
    if not np.isfinite(signal).all():
        return float("nan")
    span = float(np.ptp(signal))
    if span == 0.0:
        return 1.0
    greatest = float(np.max(np.abs(np.diff(_extremes(signal, 0.0))), initial=0.0))
    if greatest < _SWINGS * span:
        return 1.0
    swings = np.abs(np.diff(_extremes(signal, _FLOOR * greatest)))
    if len(swings) < 2:
        return 1.0
    logarithm = float(np.log(np.mean(swings[:-1] / swings[1:])))
    return float(logarithm / np.hypot(np.pi, logarithm))


def _extremes(signal: FloatArray, floor: float) -> FloatArray:
    """Values of successive local extremes, each more than `floor` from the previous, (k,)."""
    rising = np.sign(np.diff(signal))
    # A plateau belongs to the slope before it.
    for i in np.flatnonzero(rising == 0.0):
        rising[i] = rising[i - 1] if i else 0.0
    turns = np.flatnonzero(rising[1:] * rising[:-1] < 0.0) + 1
    kept: list[float] = []
    for value in (_vertex(signal[i - 1 : i + 2]) for i in turns):
        if not kept or abs(value - kept[-1]) > floor:
            kept.append(value)
        elif len(kept) > 1 and (value - kept[-1]) * (kept[-1] - kept[-2]) > 0.0:
            # After a skipped extreme the same swing continues.
            kept[-1] = value
    return np.array(kept)


def _vertex(three: FloatArray) -> float:
    """Extreme of the parabola through three equidistant samples."""
    slope, bend = 0.5 * (three[2] - three[0]), three[2] - 2.0 * three[1] + three[0]
    return float(three[1] - 0.5 * slope**2 / bend) if bend else float(three[1])


def compare(parameters: TruckParameters, payload: float, kph: float, timestep: float) -> Findings:
    """One pulse steer at a speed [km/h]."""
    done = pulse(parameters, payload, kph * KMH, timestep)
    found = Findings(f"ISO 14791 pulse steer, {payload / 1e3:g} t, {kph:g} km/h")
    measured, wanted = done.damping(), done.model_damping()
    worst, must = min(measured.values()), f">= {REQUIRED:g}"
    found.check("yaw damping, worst signal (PBS)", worst, "1", min(wanted.values()), must)
    for name in [name for name in measured if name.startswith("hitch angle")]:
        found.check(f"yaw damping by the {name}", measured[name], "1", wanted[name])
    mode = "least damped mode of the linear model"
    found.check(mode, done.system.damping_ratio(), "1", "eigenvalues")
    time = done.recording.time - _LEAD
    # The first signal is the yaw rate of the lead unit, the last one the lateral position.
    several = parameters.units[1:]
    for (title, unit, values), (_, _, modeled) in list(
        zip(*(signals(parameters, source) for source in (done.recording, done.model)), strict=True)
    )[1 if several else 0 : -1]:
        linear = Line("yaw-sideslip model", time, modeled, "reference")
        truck = Line("truck", time, values, "simulation")
        found.panel(title, "time [s]", f"{title} [{unit}]", linear, truck)
    return found
