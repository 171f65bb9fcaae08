"""Masses and forces of longitudinal motion: the point mass fitted to the recorded speed.

Output error with free initial speeds: in each window the model's acceleration is integrated from
the recorded speed, and the window's mean difference is taken out, which eliminates its initial
speed. Noise on the speed is therefore never differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.brakes import CIRCUITS
from iits_mj.identification.estimate import Estimate, Free, fit
from iits_mj.identification.log import Log
from iits_mj.identification.longitudinal import NEEDED, Inputs, acceleration, prepare
from iits_mj.parameters import TruckParameters

# Most trusted first: of two that the log cannot tell apart, the later one keeps its prior.
MOTION = ("mass", "rolling_resistance", "drag_area", "brake_gain", "engine_torque_scale")
CIRCUIT_GAINS = tuple(f"brake_gain_{name}" for name in CIRCUITS)
_UNITS = {"mass": "kg", "drag_area": "m2"}
_LIMITS = {
    "mass": (5e3, 1.2e5),
    "rolling_resistance": (1e-4, 0.05),
    "drag_area": (0.1, 30.0),
    "engine_torque_scale": (0.2, 3.0),
}
_GAIN_LIMITS = (0.05, 5.0)
# Less noise than this is not what the model falls short of [m/s].
_NOISE_MIN = 0.02
_NO_SCALE = "motion shows it only as a ratio to the mass: give the mass"


@dataclass(frozen=True)
class Motion:
    """What motion showed.

    Attributes:
      estimates: of `MOTION` and `CIRCUIT_GAINS`.
      time [s], recorded, before, after: speeds [m/s] with prior and fitted values, shape (m,), the
        windows of the log one after the other; empty when the model holds nowhere.
      mass: the best there is, fitted, given or prior [kg].
    """

    estimates: tuple[Estimate, ...]
    time: FloatArray
    recorded: FloatArray
    before: FloatArray
    after: FloatArray
    mass: float


def identify_motion(log: Log, parameters: TruckParameters, mass: float | None = None) -> Motion:
    """Fits mass, resistances, brake gains and, with the mass given, the torque's scale."""
    prior = _prior(parameters, mass)
    lacking = log.missing(*NEEDED)
    inputs = None if lacking else prepare(log, parameters, mass)
    if inputs is None or not inputs.windows:
        reason = (
            f"the log lacks {', '.join(lacking)}"
            if lacking
            else "the log has no stretch of 4 s above 3 m/s in one gear"
        )
        unseen = [
            Estimate.unseen(n, _UNITS.get(n, "1"), prior[n], reason)
            for n in (*MOTION, *CIRCUIT_GAINS)
            if n in prior
        ]
        empty = np.empty(0)
        return Motion(tuple(unseen), empty, empty, empty, empty, prior["mass"])
    names = [n for n in MOTION if n != ("engine_torque_scale" if mass is None else "mass")]
    estimates, fitted = _fit(inputs, names, prior)
    if mass is None:
        # The mass shares itself among axles and tires: once more, with what it was found to be.
        inputs = prepare(log, parameters, fitted["mass"])
        estimates, fitted = _fit(inputs, names, prior)
        scale = Estimate.unseen("engine_torque_scale", "1", 1.0, _NO_SCALE)
        estimates = [*estimates, scale]
    if not inputs.brakes_seen:
        estimates = [e for e in estimates if e.name != "brake_gain"]
        estimates.append(Estimate.unseen("brake_gain", "1", 1.0, "the log lacks brake pressures"))
    return Motion(
        estimates=(*estimates, *_circuit_gains(inputs, names, fitted)),
        time=np.concatenate([inputs.time[w] for w in inputs.windows]),
        recorded=np.concatenate([inputs.speed[w] for w in inputs.windows]),
        before=np.concatenate(speeds(inputs, prior)),
        after=np.concatenate(speeds(inputs, fitted)),
        mass=fitted["mass"],
    )


def speeds(inputs: Inputs, values: dict[str, float]) -> list[FloatArray]:
    """The model's speed [m/s] in each window, its mean laid on the recorded one."""
    rate = acceleration(inputs, values)
    found = []
    for window in inputs.windows:
        steps = 0.5 * (rate[window][1:] + rate[window][:-1]) * np.diff(inputs.time[window])
        rise = np.concatenate([[0.0], np.cumsum(steps)])
        found.append(rise + np.mean(inputs.speed[window] - rise))
    return found


def _fit(
    inputs: Inputs, names: Sequence[str], prior: dict[str, float]
) -> tuple[list[Estimate], dict[str, float]]:
    free = [Free(n, _UNITS.get(n, "1"), prior[n], *_LIMITS.get(n, _GAIN_LIMITS)) for n in names]

    weights = _weights(inputs)

    def trial(values: FloatArray) -> dict[str, float]:
        return {**prior, **dict(zip(names, map(float, values), strict=True))}

    def residual(values: FloatArray) -> list[FloatArray]:
        model = speeds(inputs, trial(values))
        triples = zip(inputs.windows, model, weights, strict=True)
        return [weight * (speed - inputs.speed[w]) for w, speed, weight in triples]

    estimates, values = fit(free, residual)
    return estimates, trial(values)


def _weights(inputs: Inputs) -> list[float]:
    """Weight of each window, 1 on average: the inverse of its noise, by second differences.

    White noise of deviation s has second differences of deviation s sqrt(6).
    """
    noise = [
        max(float(np.std(np.diff(inputs.speed[w], 2))) / np.sqrt(6.0), _NOISE_MIN)
        for w in inputs.windows
    ]
    return [float(np.median(noise)) / value for value in noise]


def _circuit_gains(
    inputs: Inputs, names: Sequence[str], fitted: dict[str, float]
) -> list[Estimate]:
    """The circuits' gains one by one, where the log tells them apart, relative to `brake_gain`.

    Their pressures rise together in ordinary braking, and then only the sum is seen.
    """
    reason = "the log shows the circuits only together, as brake_gain"
    if not inputs.brakes_seen:
        reason = "the log lacks brake pressures"
    elif np.any(np.max(np.abs(inputs.circuit_forces), axis=0) > 0.0):
        others = [n for n in names if n != "brake_gain"]
        separate, _ = _fit(inputs, [*others, *CIRCUIT_GAINS], {**fitted, "brake_gain": 1.0})
        gains = [e for e in separate if e.name in CIRCUIT_GAINS]
        if all(e.identifiable for e in gains):
            return gains
    else:
        reason = "the brakes were not used"
    return [Estimate.unseen(name, "1", 1.0, reason) for name in CIRCUIT_GAINS]


def _prior(parameters: TruckParameters, mass: float | None) -> dict[str, float]:
    middle = parameters.gross_mass(0.5 * parameters.payload.mass_max)
    return {
        "mass": middle if mass is None else float(mass),
        "rolling_resistance": parameters.tire_common.rolling_resistance,
        "drag_area": parameters.aerodynamics.drag_area,
        "brake_gain": 1.0,
        "engine_torque_scale": 1.0,
        **dict.fromkeys(CIRCUIT_GAINS, 1.0),
    }
