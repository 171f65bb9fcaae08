"""Fits the Intelligent Driver Model to recorded pairs of leader and follower, by their gap.

Kesting and Treiber, "Calibrating car-following models by using trajectory data: methodological
study", Transportation Research Record 2088 (2008), 148-156: the follower is simulated behind the
recorded leader from its first recorded gap and speed, and the error of the gap is minimized. The
model is integrated with SUMO's time-stepping scheme, so the result is valid in SUMO.

    from traffic_bridge import calibrate, read_trajectories, trimmed
    from traffic_bridge.datasets import pairs

    found = calibrate(trimmed(pairs(read_trajectories(path))))
    found.parameters, found.error
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from traffic_bridge.datasets.trajectories import Pair
from traffic_bridge.vehicles.idm import EXPONENT, PARAMETERS, IdmParameters, acceleration
from traffic_bridge.vehicles.types import VehicleType, read_types

MEASURES = ("mixed", "relative", "absolute")
# Search ranges of v0 [m/s], T [s], s0 [m], a and b [m/s2]. The desired speed of a driver in
# congestion is unknown, so its upper bound is that of a freeway; the least gap is 1 m.
BOUNDS = ((5.0, 40.0), (0.1, 4.0), (1.0, 8.0), (0.1, 5.0), (0.1, 6.0))
# Search range of the time constant of the return from the first headway [s].
MEMORY = (3.0, 300.0)
SLOW = 3.0  # [m/s]: below it a gap says little about the time headway
_STARTS = 128  # parameter sets; the search for a pair begins with the best of them


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    Attributes:
      parameters: the set that fits all pairs best.
      measure: of the error, one of `MEASURES`.
      error: mean of the pairs' errors with that set; 0.2 is 20 %.
      pair_errors: error of each pair with that set, shape (n,).
      memory: time constant with which drivers return from their first headway to that of the set
        [s], see `PairBlock.first_headways`; None: all have the set's headway from the beginning.
    """

    parameters: IdmParameters
    measure: str
    error: float
    pair_errors: FloatArray
    memory: float | None = None


class PairBlock:
    """Pairs in common arrays, which are simulated at once.

    Raises:
      InputError: there is no pair, time steps differ, or a gap is not positive.
    """

    def __init__(self, pairs: Sequence[Pair]) -> None:
        if not pairs:
            raise InputError("no leader-follower pair to calibrate to")
        steps = {round(float(np.median(np.diff(pair.time))), 4) for pair in pairs}
        if len(steps) > 1:
            raise InputError(f"pairs of different time steps {sorted(steps)}: they must be equal")
        self.step = steps.pop()
        shape = (max(len(pair.time) for pair in pairs), len(pairs))
        self.gap, self.leader_speed, self.leader = np.ones(shape), np.zeros(shape), np.zeros(shape)
        self.valid = np.zeros(shape, dtype=bool)
        self.first_speed = np.array([pair.speed[0] for pair in pairs], dtype=float)
        for i, pair in enumerate(pairs):
            n = len(pair.time)
            least = float(np.min(pair.gap))
            if not least > 0.0:
                raise InputError(
                    f"{pair.follower} behind {pair.leader}: least gap {least:.2f} m; must be "
                    "positive"
                )
            self.gap[:n, i], self.leader_speed[:n, i] = pair.gap, pair.leader_speed
            self.leader[:n, i] = pair.leader_station
            self.leader[n:, i] = pair.leader_station[-1]
            self.valid[:n, i] = True

    def first_headways(self, parameters: FloatArray) -> FloatArray:
        """Time headways for which the first gaps and speeds are in equilibrium, shape (m, n) [s].

        They are all that is known of a driver who was not recorded before: a driver with another
        headway than that of the set keeps it for a while.

        Args:
          parameters: shape (5, m, 1).
        """
        v0, _, s0, _, _ = parameters
        free = np.sqrt(np.maximum(1.0 - (self.first_speed / v0) ** EXPONENT, 0.05))
        headway = (self.gap[0] * free - s0) / np.maximum(self.first_speed, SLOW)
        return np.clip(headway, *BOUNDS[PARAMETERS.index("time_headway")])

    def simulate(
        self, parameters: FloatArray, memory: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Drives the followers behind their recorded leaders.

        Args:
          parameters: shape (5, m, 1) for m sets tried on every pair, or (5, m, n) with n pairs.
          memory: time constants of the return from the first headway, shape (m, 1) [s]; None: the
            headway is constant.

        Returns:
          Gap [m] and speed [m/s], shape (steps, m, n), meaningless after a pair's end.
        """
        dt = self.step
        m = parameters.shape[1]
        gaps = np.empty((len(self.gap), m, self.gap.shape[1]))
        speeds = np.empty_like(gaps)
        gaps[0], speeds[0] = self.gap[0], self.first_speed
        moved = np.diff(self.leader, axis=0)
        if memory is not None:
            index = PARAMETERS.index("time_headway")
            set_headway = parameters[index]
            apart = self.first_headways(parameters) - set_headway
            parameters = np.broadcast_to(parameters, (5, *gaps.shape[1:])).copy()
        for k in range(len(self.gap) - 1):
            if memory is not None:
                parameters[index] = set_headway + apart * np.exp(-k * dt / memory)
            a = acceleration(parameters, gaps[k], speeds[k], self.leader_speed[k])
            np.maximum(0.0, speeds[k] + dt * a, out=speeds[k + 1])
            gaps[k + 1] = gaps[k] + moved[k] - dt * speeds[k + 1]
        return gaps, speeds

    def residuals(
        self, parameters: FloatArray, measure: str, memory: FloatArray | None = None
    ) -> FloatArray:
        """Weighted gap errors whose squares sum to the squared error of each pair.

        Returns:
          Shape (steps, m, n), zero after a pair's end.
        """
        gaps, _ = self.simulate(parameters, memory)
        gaps -= self.gap[:, None]
        gaps *= self._weights(measure)[:, None]
        return gaps

    def errors(
        self, parameters: FloatArray, measure: str, memory: FloatArray | None = None
    ) -> FloatArray:
        """Error of every set on every pair, shape (m, n); see `gap_error` and `simulate`."""
        residuals = self.residuals(parameters, measure, memory)
        return np.asarray(np.sqrt(np.einsum("kmn,kmn->mn", residuals, residuals)))

    def _weights(self, measure: str) -> FloatArray:
        count = self.valid.sum(axis=0)
        mean = np.where(self.valid, self.gap, 0.0).sum(axis=0) / count
        # Equations 6 to 8 of Kesting and Treiber: root of the mean square of ds / <s> (absolute),
        # of ds / s (relative), and of ds / sqrt(s <s>) (mixed).
        scale = {
            "absolute": np.broadcast_to(mean, self.gap.shape),
            "relative": self.gap,
            "mixed": np.sqrt(self.gap * mean),
        }[_checked(measure)]
        return np.asarray(np.where(self.valid, 1.0 / (scale * np.sqrt(count)), 0.0))


def trimmed(
    pairs: Sequence[Pair], begin: float = 5.0, end: float = 3.0, least_duration: float = 10.0
) -> tuple[Pair, ...]:
    """Pairs without their first and last seconds, where smoothed trajectories are inaccurate.

    In the reconstructed NGSIM pairs followers begin some 4 m/s too slow, and the gap differs from
    the measured one by 3 m; the errors vanish after 5 s, and reappear 3 s before the end.

    Args:
      pairs: recorded.
      begin: time removed at the beginning [s].
      end: time removed at the end [s].
      least_duration: pairs that are then shorter are omitted [s].

    Raises:
      InputError: a value is negative or not finite.
    """
    if not (np.isfinite([begin, end, least_duration]).all() and min(begin, end) >= 0.0):
        raise InputError(f"trim of {begin!r} s and {end!r} s: must be zero or positive")
    kept = []
    for pair in pairs:
        inside = (pair.time >= pair.time[0] + begin - 1e-6) & (
            pair.time <= pair.time[-1] - end + 1e-6
        )
        if inside.sum() < 2 or np.ptp(pair.time[inside]) < least_duration:
            continue
        arrays = {
            entry.name: getattr(pair, entry.name)[inside]
            for entry in dataclasses.fields(pair)
            if isinstance(getattr(pair, entry.name), np.ndarray)
        }
        kept.append(dataclasses.replace(pair, **arrays))
    return tuple(kept)


def gap_error(pair: Pair, parameters: IdmParameters | FloatArray, measure: str = "mixed") -> float:
    """Error of the simulated gap of one pair, as a fraction (0.2 is 20 %)."""
    values = parameters.as_array() if isinstance(parameters, IdmParameters) else parameters
    return float(PairBlock([pair]).errors(values.reshape(5, 1, 1), measure)[0, 0])


def evaluate(
    pairs: Sequence[Pair],
    parameters: IdmParameters,
    measure: str = "mixed",
    memory: float | None = None,
) -> Calibration:
    """The errors of a parameter set on pairs, for instance on pairs outside the fit."""
    constant = None if memory is None else np.array([[memory]])
    values = parameters.as_array().reshape(5, 1, 1)
    errors = PairBlock(pairs).errors(values, measure, constant)[0]
    return Calibration(parameters, measure, float(errors.mean()), errors, memory)


def calibrate(
    pairs: Sequence[Pair],
    measure: str = "mixed",
    seed: int = 0,
    desired_speed: float | None = None,
    generations: int = 60,
    with_memory: bool = False,
) -> Calibration:
    """The parameter set with the least mean error over all pairs.

    The search is scipy's differential evolution; all pairs and candidates are simulated at once.

    Args:
      pairs: of one time step.
      measure: "mixed", "relative" or "absolute".
      seed: of the search; one seed gives one result.
      desired_speed: fixed v0 [m/s], which congested data do not reveal; None: fitted too.
      generations: at most.
      with_memory: also fits the time constant with which drivers return from the headway of their
        first gap to that of the set.

    Raises:
      InputError: no pairs, or an unknown measure.
    """
    from scipy.optimize import differential_evolution

    block = PairBlock(pairs)
    _checked(measure)

    def objective(candidates: FloatArray) -> FloatArray:
        sets = candidates.reshape(len(bounds), -1, 1)
        memory = np.exp(sets[5]) if with_memory else None
        return np.asarray(np.mean(block.errors(sets[:5], measure, memory), axis=1))

    bounds = [*_bounds(desired_speed)]
    if with_memory:
        bounds.append((float(np.log(MEMORY[0])), float(np.log(MEMORY[1]))))
    found = differential_evolution(
        objective,
        bounds,
        rng=np.random.default_rng(seed),
        maxiter=generations,
        popsize=8,
        tol=1e-4,
        init="sobol",
        updating="deferred",
        vectorized=True,
        polish=False,
    )
    memory = float(np.exp(found.x[5])) if with_memory else None
    return evaluate(pairs, IdmParameters.from_array(found.x[:5]), measure, memory)


def calibrate_each(
    pairs: Sequence[Pair],
    measure: str = "mixed",
    seed: int = 0,
    desired_speed: float | None = None,
    begin: IdmParameters | None = None,
) -> list[Calibration]:
    """A parameter set for every pair: the spread between drivers.

    Bounded nonlinear least squares, started from the best of a Sobol sample and `begin`.

    Args:
      pairs: of one time step.
      measure: see `calibrate`.
      seed: of the sample.
      desired_speed: see `calibrate`.
      begin: a further starting point, for instance the set of all pairs.

    Returns:
      One `Calibration` per pair, in their order.
    """
    from scipy.stats import qmc

    bounds = np.array(_bounds(desired_speed))
    low, high = bounds.T
    sample = qmc.scale(qmc.Sobol(5, rng=np.random.default_rng(seed)).random(_STARTS), low, high)
    if begin is not None:
        sample = np.vstack([np.clip(begin.as_array(), low, high), sample])
    best = PairBlock(pairs).errors(sample.T[:, :, None], measure).argmin(axis=0)
    return [_own(pair, sample[i], bounds, measure) for pair, i in zip(pairs, best, strict=True)]


def calibrate_headways(
    pairs: Sequence[Pair], parameters: IdmParameters, measure: str = "mixed"
) -> list[Calibration]:
    """A time headway for every pair, with common other parameters.

    Drivers differ most in this parameter. Unlike five parameters fitted to half a minute each, the
    result is a population of drivers that is valid on another road.

    Args:
      pairs: of one time step.
      parameters: the common set.
      measure: see `calibrate`.
    """
    low, high = BOUNDS[PARAMETERS.index("time_headway")]
    headways = np.arange(low, high, 0.02)
    sets = np.tile(parameters.as_array()[:, None, None], (1, len(headways), 1))
    sets[PARAMETERS.index("time_headway"), :, 0] = headways
    errors = PairBlock(pairs).errors(sets, measure)
    best = errors.argmin(axis=0)
    return [
        Calibration(
            dataclasses.replace(parameters, time_headway=float(headways[k])),
            measure,
            float(errors[k, i]),
            errors[k, i : i + 1],
        )
        for i, k in enumerate(best)
    ]


def _own(pair: Pair, start: FloatArray, bounds: FloatArray, measure: str) -> Calibration:
    from scipy.optimize import least_squares

    block = PairBlock([pair])
    low, high = bounds.T
    nudge = 1e-6 * (high - low)

    def residuals(values: FloatArray) -> FloatArray:
        return block.residuals(values.reshape(5, 1, 1), measure)[:, 0, 0]

    def jacobian(values: FloatArray) -> FloatArray:
        # All five differences at once; inward at a bound.
        signs = np.where(values + nudge > high, -1.0, 1.0)
        moved = values + np.vstack([np.zeros(5), np.diag(signs * nudge)])
        found = block.residuals(moved.T[:, :, None], measure)[:, :, 0]
        return np.asarray((found[:, 1:] - found[:, :1]) / (signs * nudge))

    inside = np.clip(start, low + nudge, high - nudge)
    found = least_squares(
        residuals, inside, jac=jacobian, bounds=(low, high), x_scale=high - low, max_nfev=40
    )
    error = float(np.sqrt(2.0 * found.cost))
    return Calibration(IdmParameters.from_array(found.x), measure, error, np.array([error]))


def parameter_table(calibrations: Sequence[Calibration]) -> FloatArray:
    """The parameter sets as an array, shape (n, 5), columns in the order of `PARAMETERS`."""
    rows = [dataclasses.astuple(entry.parameters) for entry in calibrations]
    return np.array(rows, dtype=float).reshape(len(rows), len(PARAMETERS))


def _bounds(desired_speed: float | None) -> tuple[tuple[float, float], ...]:
    if desired_speed is None:
        return BOUNDS
    if not (np.isfinite(desired_speed) and desired_speed > 0.0):
        raise InputError(f"desired_speed {desired_speed!r}: must be positive")
    # The searches need an interval; 1 mm/s has no effect.
    return ((desired_speed, desired_speed + 1e-3), *BOUNDS[1:])


def _checked(measure: str) -> str:
    if measure not in MEASURES:
        raise InputError(f"measure {measure!r}: allowed are {', '.join(MEASURES)}")
    return measure


@cache
def calibrated_types() -> tuple[VehicleType, ...]:
    """The default types with the car of `calibrated_types.toml`, fitted to recorded drivers.

    They were fitted in congestion: use them for dense traffic, `TrafficConfig(types=
    calibrated_types())`. Cars stop within 1 m, nearer than the default ones.
    """
    return read_types(Path(__file__).with_name("calibrated_types.toml"))
