"""Handling measures of the linear models: responses, gains, critical speed, amplification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from iits_mj.analytic.yaw_plane import LateralSystem, YawPlane
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import static_axle_loads
from iits_mj.parameters.tire_law import axle_cornering_stiffness


class UnitHistories:
    """Time histories of a combination of n units, with those of its first and last unit by name.

    A dataclass that inherits this class has the arrays as fields.

    Attributes:
      y: of the first axle's center in the ground frame [m], shape (m,).
      yaw_rates: of the units [rad/s], shape (m, n).
      articulations: yaw ahead minus yaw behind [rad], shape (m, n - 1).
      lateral_accelerations: of the units' CGs [m/s2], shape (m, n).
      rolls: of the units [rad], shape (m, n).
    """

    y: FloatArray
    yaw_rates: FloatArray
    articulations: FloatArray
    lateral_accelerations: FloatArray
    rolls: FloatArray

    @property
    def yaw_rate(self) -> FloatArray:
        """Of the lead unit [rad/s]."""
        return self.yaw_rates[:, 0]

    @property
    def lateral_acceleration(self) -> FloatArray:
        """Of the lead unit's CG [m/s2]."""
        return self.lateral_accelerations[:, 0]

    @property
    def roll(self) -> FloatArray:
        """Of the lead unit [rad]."""
        return self.rolls[:, 0]

    @property
    def articulation(self) -> FloatArray:
        """Of the first coupling [rad]."""
        return self.articulations[:, 0]

    @property
    def trailer_yaw_rate(self) -> FloatArray:
        """Of the last unit [rad/s]."""
        return self.yaw_rates[:, -1]

    @property
    def trailer_lateral_acceleration(self) -> FloatArray:
        """Of the last unit's CG [m/s2]."""
        return self.lateral_accelerations[:, -1]

    @property
    def trailer_roll(self) -> FloatArray:
        """Of the last unit [rad]."""
        return self.rolls[:, -1]


@dataclass(frozen=True)
class Response(UnitHistories):
    """Time histories of a combination of n units, of shape (m,) where not noted.

    Attributes:
      time: [s]; steer: road-wheel angle [rad].
      lateral_velocity: of the model's reference point, lead unit's frame [m/s].
      yaw_rates: of the units [rad/s], shape (m, n).
      articulations: yaw ahead minus yaw behind [rad], shape (m, n - 1).
      yaw: of the lead unit [rad]; x, y: first axle's center in the ground frame [m].
      lateral_accelerations: of the units' CGs [m/s2], shape (m, n).
      steer_axle_acceleration: lateral, of the first axle's center at the road [m/s2].
      rolls: of the units [rad], shape (m, n); zero in a model without roll.
    """

    time: FloatArray
    steer: FloatArray
    lateral_velocity: FloatArray
    yaw_rates: FloatArray
    articulations: FloatArray
    yaw: FloatArray
    x: FloatArray
    y: FloatArray
    lateral_accelerations: FloatArray
    steer_axle_acceleration: FloatArray
    rolls: FloatArray


def simulate(system: LateralSystem, time: FloatArray, steer: FloatArray) -> Response:
    """Response of a truck that runs straight to a sampled road-wheel angle.

    The linear equations are solved exactly for an input linear between samples; the ground track
    uses the full sine and cosine of the heading, so that a long turn stays correct.

    Args:
      system: the model at one speed.
      time: uniform samples [s], shape (n,), n >= 2.
      steer: road-wheel angle at the samples [rad], shape (n,).

    Raises:
      InputError: the vectors do not fit, are not finite, or time is not uniform.
    """
    time, steer = np.asarray(time, dtype=float), np.asarray(steer, dtype=float)
    if time.ndim != 1 or time.shape != steer.shape or time.size < 2:
        raise InputError(f"time {time.shape} and steer {steer.shape}: two equal vectors are needed")
    steps = np.diff(time)
    if not (np.all(np.isfinite(steps)) and steps[0] > 0.0 and np.ptp(steps) < 1e-6 * steps[0]):
        raise InputError("time must increase in finite, uniform steps")
    if not np.all(np.isfinite(steer)):
        raise InputError("steer holds a value that is not finite")
    states = _states(system, steer, float(steps[0]))
    rates = states @ system.A.T + np.outer(steer, system.B)
    model, v, units = system.model, system.speed, system.model.units
    yaw = _integrate(time, states[:, 1])
    lateral = states[:, 0] + (model.reference - model.position[0]) * states[:, 1]
    return Response(
        time=time,
        steer=steer,
        lateral_velocity=states[:, 0],
        yaw_rates=states[:, 1 : 1 + units],
        articulations=states[:, 1 + units : 2 * units],
        yaw=yaw,
        x=_integrate(time, v * np.cos(yaw) - lateral * np.sin(yaw)),
        y=_integrate(time, v * np.sin(yaw) + lateral * np.cos(yaw)),
        lateral_accelerations=system.cg_accelerations(states, rates),
        steer_axle_acceleration=system.steer_axle_acceleration(states, rates),
        rolls=system.roll_angles(states),
    )


def _states(system: LateralSystem, steer: FloatArray, step: float) -> FloatArray:
    """States at uniform samples from rest; exact for an input linear between them."""
    n = len(system.B)
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n] = system.A * step, system.B * step
    block[n, n + 1] = 1.0
    whole = expm(block)
    held, ramp = whole[:n, n], whole[:n, n + 1]
    pushes = np.outer(steer[:-1], held) + np.outer(np.diff(steer), ramp)
    advance, states = whole[:n, :n].T, np.zeros((len(steer), n))
    for i, push in enumerate(pushes):
        states[i + 1] = states[i] @ advance + push
    return states


def unit_track(answer: Response, system: LateralSystem, unit: int, position: float) -> FloatArray:
    """Returns the track of a point of a unit in the ground frame of a response [m], shape (m, 2).

    Args:
      answer: of the model.
      system: that gave it.
      unit: index of the unit; -1 is the last one.
      position: of the point behind the unit's origin [m].
    """
    model, unit = system.model, unit % system.model.units
    lengths = [*model.couplings[:unit], position]
    lengths[0] -= model.position[0]
    track, heading = np.column_stack([answer.x, answer.y]), answer.yaw
    for k, length in enumerate(lengths):
        if k:
            heading = heading - answer.articulations[:, k - 1]
        track = track - length * np.column_stack([np.cos(heading), np.sin(heading)])
    return track


def step_response(system: LateralSystem, steer: float, duration: float = 10.0) -> Response:
    """Response to a step of the road-wheel angle [rad] at time zero, sampled every 10 ms."""
    time = np.linspace(0.0, duration, round(duration / 0.01) + 1)
    return simulate(system, time, np.full_like(time, steer))


def yaw_rate_gain(system: LateralSystem) -> float:
    """Returns yaw rate over road-wheel angle [1/s] in the steady state, stable or not."""
    return float(system.steady_state()[1])


def understeer_gradient(model: YawPlane, speed: float = 20.0) -> float:
    """Understeer gradient [rad s2/m] of the linear model: d(delta - L/R) / d(lateral acceleration).

    The model's steer angle is exactly `delta = L' / R + K a_y`, where L' is the wheelbase with
    the scrub of tandem and tri-axle, so that K follows from any two speeds.
    """
    slow, fast = model.at(0.5 * speed), model.at(speed)
    per_curvature = [1.0 / yaw_rate_gain(s) * s.speed for s in (slow, fast)]
    return (per_curvature[1] - per_curvature[0]) / (fast.speed**2 - slow.speed**2)


def understeer_gradient_by_loads(parameters: TruckParameters, payload: float) -> float:
    """Returns `K = (W_f / C_f - W_r / C_r) / g` [rad s2/m] from static axle loads (textbook)."""
    loads = static_axle_loads(parameters, payload)
    stiffness = axle_cornering_stiffness(parameters, loads)
    front, rear = parameters.lead.groups(payload)
    names = [axle.name for axle in parameters.axles]
    ratios = []
    for group in (front, rear):
        places = [names.index(axle.name) for axle in group]
        ratios.append(loads[places].sum() / stiffness[places].sum())
    return float(ratios[0] - ratios[1]) / GRAVITY


def critical_speed(model: YawPlane, limit: float = 100.0) -> float:
    """Lowest speed [m/s] at which the linear model is not stable; `inf` when stable to `limit`.

    Any instability counts: the oversteering tractor's, which grows without swinging and is the
    textbook's critical speed `sqrt(-L' / K)`, and the swinging of the trailer.

    Args:
      model: of the truck.
      limit: end of the search, which has 400 steps [m/s]; the result is refined by bisection.
    """
    positive("limit", limit, "m/s")
    low = 0.0
    for high in np.linspace(limit / 400.0, limit, 400):
        if not model.at(high).stable:
            break
        low = float(high)
    else:
        return float("inf")
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if model.at(middle).stable else (low, middle)
    return float(high)


def single_sine(
    period: float, duration: float, step: float = 0.01
) -> tuple[FloatArray, FloatArray]:
    """Time [s] and one full sine of amplitude 1 that starts at 1 s (ISO 14791, 7.5).

    Args:
      period: of the sine [s].
      duration: of the signal [s], at least one second and the period.
      step: of time [s].
    """
    if not (period > 0.0 and 1.0 + period <= duration < np.inf and step > 0.0):
        raise InputError(
            f"period {period!r} s, duration {duration!r} s, step {step!r} s: must be positive, and"
            " one second and the period must fit into the duration"
        )
    time = np.arange(0.0, duration, step)
    phase = (time - 1.0) / period
    return time, np.where((phase >= 0.0) & (phase <= 1.0), np.sin(2.0 * np.pi * phase), 0.0)


def rearward_amplification(system: LateralSystem, frequency: float = 0.4) -> float:
    """Peak lateral acceleration of the last unit's CG over the steer axle's, for a single sine.

    Args:
      system: the model at one speed; InputError if it is not stable.
      frequency: of the sine [Hz]; 0.4 Hz is ISO 14791's.
    """
    _require_stable(system, "rearward amplification")
    positive("frequency", frequency, "Hz")
    # Both peaks occur during the sine or in the first swings after it.
    time, steer = single_sine(1.0 / frequency, 2.0 / frequency + 8.0)
    response = simulate(system, time, 1e-2 * steer)
    peak = np.max(np.abs(response.steer_axle_acceleration))
    return float(np.max(np.abs(response.trailer_lateral_acceleration)) / peak)


def amplification(system: LateralSystem, frequency: FloatArray) -> FloatArray:
    """Lateral acceleration of each unit's CG over the steer axle's in steady sine steering.

    Args:
      system: the model at one speed; InputError if it is not stable.
      frequency: [Hz], shape (m,).

    Returns:
      Shape (m, n) of the n units.
    """
    _require_stable(system, "rearward amplification")
    frequency = np.atleast_1d(frequency)
    states = system.frequency_response(frequency)
    rates = 2j * np.pi * frequency[:, None] * states
    front = system.steer_axle_acceleration(states, rates)
    return np.abs(system.cg_accelerations(states, rates) / front[:, None])


def worst_rearward_amplification(system: LateralSystem) -> tuple[float, float]:
    """(gain, frequency [Hz]) of the last unit's greatest amplification from 0.05 to 2 Hz.

    The ratio is 1 in the limit of slow steering; without a resonance the greatest value is at the
    search's lower end.

    Args:
      system: the model at one speed; InputError if it is not stable.
    """
    frequency = np.geomspace(0.05, 2.0, 200)
    gain = amplification(system, frequency)[:, -1]
    best = int(np.argmax(gain))
    return float(gain[best]), float(frequency[best])


def steady_off_tracking(system: LateralSystem, radius: float) -> float:
    """Path radius of the last unit's axle group minus the steer axle's [m], in a steady turn.

    Negative: the last unit runs inside (low speed); positive: outside (high speed).

    The articulations are the linear model's: the radius must be several times the truck's length.

    Args:
      system: the model at one speed; InputError if it is not stable.
      radius: of the steer axle's path [m].
    """
    _require_stable(system, "steady off-tracking")
    model, v = system.model, system.speed
    # Per yaw rate; the reference's lateral velocity gives its distance ahead of the turn's center.
    state = system.steady_state() / yaw_rate_gain(system)
    ahead = model.reference - float(model.position[0]) + state[0]
    if not (np.isfinite(radius) and radius > abs(ahead)):
        raise InputError(f"radius {radius!r} m must be greater than {abs(ahead):.2f} m")
    across = np.sqrt(radius**2 - ahead**2)
    # Headings of the units against the lead unit's, to the outside of the turn.
    headings = np.concatenate([[0.0], np.cumsum(state[1 + model.units : 2 * model.units])])
    headings *= v / across
    lengths = np.array([*model.couplings, model.group(model.units - 1)])
    lengths[0] -= model.reference
    rear = np.array([-lengths @ np.cos(headings), lengths @ np.sin(headings)])
    center = np.array([-state[0], across])
    return float(np.linalg.norm(rear - center) - radius)


def _require_stable(system: LateralSystem, what: str) -> None:
    if not system.stable:
        raise InputError(f"{what} at {system.speed:.2f} m/s: the truck is not stable there")


def _integrate(time: FloatArray, rate: FloatArray) -> FloatArray:
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])
