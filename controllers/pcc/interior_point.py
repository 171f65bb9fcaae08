"""A primal-dual interior-point method for the speed task, in time linear in the road's length.

Slacks s of all inequalities g(x) >= 0 and their multipliers z follow the central path s z = mu by
Mehrotra's predictor and corrector (S. Mehrotra, SIAM Journal on Optimization 2, 1992; slacks and
merit function as in J. Nocedal and S. Wright, Numerical Optimization, chapter 19). Eliminating the
brake forces interval by interval leaves one system over the nodes, solved in time linear in their
number.

The curvature is exact if it is positive definite, else its convex part. If the quick run makes no
progress, a guarded one lowers mu step by step, and the merit function
`cost - mu sum log s + nu |g - s|` gives the length of each step.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs, dpttrf, dpttrs

from controllers.pcc.problem import Inequalities, Point, Problem
from iits_mj.core.arrays import FloatArray

_INSIDE = 0.05  # least first slack
_MU = 0.1  # first s z
_DIVERGED = 1e9
_EXACT = 1e-9  # gradient of the Lagrangian that further steps do not improve
_ACCEPTED = 100.0  # factor on the tolerances that an optimum may have after the last iteration
_WINDOW = 30  # iterations of the quick run within which the errors must fall to a tenth
_NO_STEP = "the curvature is not positive"
_NO_DRIVE = "no drive keeps all limits: their multipliers have no bound"


@dataclass(frozen=True)
class Settings:
    """Settings of the method.

    Attributes:
      tolerance: of the mean s z and of the inequalities' residuals; that of the Lagrangian's
        gradient is 100 times as large.
      iterations: of one run, at most; time_limit: for both runs [s].
      guarded: True skips the quick run; fallback: False skips the guarded run.
    """

    tolerance: float = 1e-8
    iterations: int = 100
    time_limit: float = 20.0
    guarded: bool = False
    fallback: bool = True


@dataclass(frozen=True)
class Optimum:
    """Result of the method, in the problem's units.

    Attributes:
      b, y: variables, (n + 1,) and (n,).
      time_price: multiplier of the trip time; prices: of the intervals' durations, (n,).
      costate: worth of b at a node for the rest of the drive, (n + 1,); at the last, its cost.
      iterations: of all runs; note: why the optimality conditions do not hold, "" if they do.
    """

    b: FloatArray
    y: FloatArray
    time_price: float
    prices: FloatArray
    costate: FloatArray
    iterations: int
    note: str

    @property
    def converged(self) -> bool:
        """Whether the optimality conditions hold."""
        return not self.note


def minimize(problem: Problem, b: FloatArray, settings: Settings | None = None) -> Optimum:
    """Returns the optimum, or the last iterate, from a guess of b, shape (n + 1,)."""
    settings, began, done = settings or Settings(), time.perf_counter(), 0
    with np.errstate(all="ignore"):
        if not settings.guarded:
            quick = _Run(problem, b, settings, began)
            note = quick.go(guarded=False)
            if not note or quick.late or not settings.fallback:
                return quick.optimum(note)
            done = quick.iterations
        guarded = _Run(problem, b, settings, began, done)
        return guarded.optimum(guarded.go(guarded=True))


class _Run:
    """One run: the iterate `at`, slacks s and multipliers z, shape (m,)."""

    def __init__(
        self,
        problem: Problem,
        guess: FloatArray,
        settings: Settings,
        began: float,
        iterations: int = 0,
    ) -> None:
        self.problem, self.settings, self._began = problem, settings, began
        self.iterations = iterations
        self.limits = limits = Inequalities(problem)
        edge = np.minimum(_INSIDE, 0.1 * (problem.high - problem.low))
        b = np.clip(guess, problem.low + edge, problem.high - edge)
        duration = 2.0 / (np.sqrt(b[:-1]) + np.sqrt(b[1:]))
        y = np.maximum(0.0, -problem.overrun * duration - problem.net(b)) + _INSIDE
        self.at = Point(problem, b, np.minimum(y, 0.5 * (problem.brake + y)))
        value = limits.values(self.at)
        self.s = np.maximum(value, _INSIDE)
        # The bounds of b hold exactly at all times, so that roots are real.
        self.s[limits.nodes] = value[limits.nodes]
        self.s[limits.present == 0.0] = 1.0
        self.z = limits.present * _MU / self.s

    @property
    def late(self) -> bool:
        """Whether the time limit is reached."""
        return time.perf_counter() - self._began > self.settings.time_limit

    def go(self, guarded: bool) -> str:
        """Iterates until the optimality conditions hold; returns "" or why they do not."""
        settings, limits = self.settings, self.limits
        tolerance, dual_tolerance = settings.tolerance, 100.0 * settings.tolerance
        # Newton's last steps make the multipliers exact, if rounding permits it.
        polish = 2 if tolerance <= 1e-8 else 0
        mu, penalty = _MU, 1.0
        errors: list[float] = []
        for _ in range(settings.iterations):
            residual = (limits.values(self.at) - self.s) * limits.present
            slope_b, slope_y = limits.gradient(self.at, self.z)
            # A change of b moves the force by `slope` times as much.
            dual = max(np.abs(slope_b).max() / self.problem.slope[1], np.abs(slope_y).max())
            primal, gap = np.abs(residual).max(), _dot(self.s, self.z) / limits.count
            if not np.isfinite(dual + primal + gap):
                return "the iterates are not finite"
            if primal > tolerance and self.z.max() > _DIVERGED:
                return _NO_DRIVE
            if max(primal, gap) < tolerance and dual < dual_tolerance:
                polish -= 1
                if polish < 0 or dual < _EXACT:
                    return ""
            if self.late:
                return f"the time limit of {settings.time_limit:g} s was reached"
            if guarded:
                mu = self._lower(mu, max(primal, dual))
                penalty = self._guarded_step(residual, mu, penalty)
                if not np.isfinite(penalty):
                    return _NO_STEP
            elif len(errors) > 2 * _WINDOW and min(errors[-_WINDOW:]) > 0.1 * min(
                errors[:-_WINDOW]
            ):
                break
            elif not self._quick_step(residual, gap):
                return _NO_STEP
            errors.append(float(max(primal, gap)))
            self.iterations += 1
        if max(primal, gap) < _ACCEPTED * tolerance and dual < _ACCEPTED * dual_tolerance:
            return ""
        return f"no convergence within {self.iterations} iterations"

    def optimum(self, note: str) -> Optimum:
        """Returns the result; an empty note means that it has converged."""
        by_force, by_duration, by_change, _ = self.limits.slopes(self.at, self.z)
        start, end = self.at.to_nodes(by_force, by_duration, by_change)
        return Optimum(
            self.at.b,
            self.at.y,
            float(self.z[-1]),
            self.limits.prices(self.z),
            np.append(-start, end[-1]),
            self.iterations,
            note,
        )

    def _quick_step(self, residual: FloatArray, mu: float) -> bool:
        """Takes a predictor and corrector step; returns False if there is no direction."""
        system = _System(self)
        if not system.definite:
            return False
        ds, dz, _, _ = system.direction(residual, np.zeros_like(self.s))
        s = self.s + _to_boundary(self.s, ds, 1.0) * ds
        z = self.z + _to_boundary(self.z, dz, 1.0) * dz
        center = (_dot(s, z) / self.limits.count / mu) ** 3
        target = max(center * mu, 0.1 * self.settings.tolerance)
        step = system.direction(residual, (target - ds * dz) * self.limits.present)
        keep = max(0.99, 1.0 - mu)
        self._move(_to_boundary(self.s, step[0], keep), _to_boundary(self.z, step[1], keep), step)
        return True

    def _lower(self, mu: float, error: float) -> float:
        """Returns the next mu, lower if the problem of the last one is solved well enough."""
        off = np.abs(self.s * self.z - mu * self.limits.present).max()
        least = 0.1 * self.settings.tolerance
        while max(error, off) < 10.0 * mu and mu > least:
            mu = max(min(0.2 * mu, mu**1.5), least)
            off = np.abs(self.s * self.z - mu * self.limits.present).max()
        return mu

    def _guarded_step(self, residual: FloatArray, mu: float, penalty: float) -> float:
        """Takes a step that lowers the merit function; returns nu, NaN without a direction."""
        present = self.limits.present
        system = _System(self)
        if not system.definite:
            return float("nan")
        step = system.direction(residual, mu * present)
        ds, dz, db, dy = step
        slope_b, slope_y = self.limits.gradient(self.at, np.zeros_like(self.z))
        drop = _dot(slope_b, db) + _dot(slope_y, dy) - mu * _dot(present / self.s, ds)
        missing = float(np.abs(residual).sum())
        if missing > 0.0:
            penalty = max(penalty, 2.0 * drop / missing)
        drop = min(drop - penalty * missing, 0.0)
        start = self._merit(self.at, self.s, mu, penalty)
        share = _to_boundary(self.s, ds, 0.995)
        for _ in range(25):
            at = Point(self.problem, self.at.b + share * db, self.at.y + share * dy)
            merit = self._merit(at, self.s + share * ds, mu, penalty)
            if merit <= start + 1e-4 * share * drop + 1e-12 * abs(start):
                break
            share *= 0.5
        self._move(share, _to_boundary(self.z, dz, 0.995), step)
        # Multipliers stay near mu / s for any step of the slacks.
        self.z = present * np.clip(self.z, 1e-10 * mu / self.s, 1e10 * mu / self.s)
        return penalty

    def _merit(self, at: Point, s: FloatArray, mu: float, penalty: float) -> float:
        present = self.limits.present
        missing = np.abs((self.limits.values(at) - s) * present).sum()
        return at.cost() - mu * _dot(present, np.log(s)) + penalty * float(missing)

    def _move(self, share_s: float, share_z: float, step: tuple[FloatArray, ...]) -> None:
        ds, dz, db, dy = step
        self.s = self.s + share_s * ds
        self.z = self.z + share_z * dz
        self.at = Point(self.problem, self.at.b + share_s * db, self.at.y + share_s * dy)


class _System:
    """Newton's system at a run's iterate, factored; `definite` if it can be solved."""

    def __init__(self, run: _Run) -> None:
        self._run = run
        limits, at = run.limits, run.at
        intervals, nodes, times = limits.weights(run.z / run.s)
        free = ~limits.pinned
        by_duration = limits.slopes(at, run.z)[1]
        # Exact, then the convex part, then that with a diagonal enlarged beyond rounding errors.
        for convex, more in ((False, 0.0), (True, 0.0), (True, 1e-7)):
            h00, h01, h11, *self._brake = at.curvature(intervals, by_duration, convex)
            diagonal = nodes + 1e-12
            diagonal[:-1] += h00
            diagonal[1:] += h11
            diagonal *= 1.0 + more
            diagonal[limits.pinned] = 1.0
            self._system = NodeSystem(
                diagonal,
                h01 * free[:-1] * free[1:],
                (at.d0 * free[:-1], at.d1 * free[1:]),
                times,
                limits.behind,
            )
            self.definite = self._system.definite
            if self.definite:
                break

    def direction(self, residual: FloatArray, goal: FloatArray) -> tuple[FloatArray, ...]:
        """Returns steps of s, z, b and y to s z = goal, g = s and a stationary Lagrangian."""
        run, limits = self._run, self._run.limits
        weight, u0, u1 = self._brake
        aim = limits.present * (goal - run.z * residual) / run.s
        slope_b, slope_y = limits.gradient(run.at, aim)
        right = -slope_b
        right[:-1] += u0 * slope_y
        right[1:] += u1 * slope_y
        right[limits.pinned] = 0.0
        db = self._system.solve(right)
        dy = -slope_y / weight - u0 * db[:-1] - u1 * db[1:]
        ds = (limits.change(run.at, db, dy) + residual) * limits.present
        dz = limits.present * (goal - run.z * ds) / run.s - run.z
        return ds, dz, db, dy


class NodeSystem:
    """(H + G' C' W C G) x = r with H tridiagonal, G the durations' gradients, C their running sum.

    H has shape (m, m), m = n + 1 nodes. W contains the weights of the times at nodes 1..n. If only
    the last time has a weight, the system is H with a border; else the times and the prices of the
    intervals are further unknowns, ordered by node, and the system has three bands on either side.
    """

    def __init__(
        self,
        diagonal: FloatArray,
        beside: FloatArray,
        gradient: tuple[FloatArray, FloatArray],
        weights: FloatArray,
        inner: bool,
    ) -> None:
        """Factors the system; `definite` is False if H is indefinite or rounding leaves no pivot.

        Args:
          diagonal: of H, shape (n + 1,).
          beside: the diagonal beside it, shape (n,).
          gradient: of the durations by b at start and end of each interval, each (n,).
          weights: of the times at nodes 1..n, shape (n,), none negative.
          inner: whether a weight other than the last is above 0.
        """
        self._d0, self._d1 = gradient
        self._weights, self._inner = weights, inner
        self._beside = beside
        self._diagonal = diagonal
        self._factor, self._below, info = dpttrf(diagonal, beside)
        self.definite = bool(info == 0)
        if self.definite and not inner and weights[-1] > 0.0:
            border = np.zeros(diagonal.size)
            border[:-1] += self._d0
            border[1:] += self._d1
            self._border = border
            self._answer = self._plain(border)
            self._pivot = 1.0 / weights[-1] + float(np.sum(border * self._answer))
        elif self.definite and inner:
            self._bands, self._order, info = dgbtrf(self._banded(), 3, 3)
            self.definite = bool(info == 0)

    def solve(self, right: FloatArray) -> FloatArray:
        """Returns the solution x, shape (n + 1,), of a definite system for a right side."""
        if self._inner:
            n = self._beside.size
            full = np.zeros((n + 1, 3))
            full[:, 0] = right
            solution, _ = dgbtrs(self._bands, 3, 3, full.ravel()[:-1], self._order)
            return np.asarray(solution[0::3])
        x = self._plain(right)
        if self._weights[-1] > 0.0:
            x = x - self._answer * (float(np.sum(self._border * x)) / self._pivot)
        return x

    def _plain(self, right: FloatArray) -> FloatArray:
        solution, _ = dpttrs(self._factor, self._below, right)
        return np.asarray(solution)

    def _banded(self) -> FloatArray:
        """Returns the system of unknowns b[k], t[k], price[k] in LAPACK's band form.

        Rows: b, t and t[k+1] - t[k] - grad d . b = 0. Entry (i, j) is at [3 + i - j, j], below
        three rows for pivoting.
        """
        n = self._beside.size
        room = np.zeros((10, 3 * (n + 1)))
        bands = room[3:]
        bands[3, 0::3] = self._diagonal
        bands[0, 3::3] = self._beside
        bands[6, 0:-3:3] = self._beside
        # Row of b[k]: price[k] d0[k] + price[k-1] d1[k-1].
        bands[1, 2:-3:3] = self._d0
        bands[4, 2:-3:3] = self._d1
        # Row of t[k]: W t[k] + price[k] - price[k-1] = 0; a unit weight keeps t[0] at 0.
        bands[3, 1] = 1.0
        bands[3, 4::3] = self._weights
        bands[2, 5:-3:3] = 1.0
        bands[5, 2:-3:3] = -1.0
        # Row of price[k]: grad d . b + t[k] - t[k+1] = 0, without t[0].
        bands[5, 0:-3:3] = self._d0
        bands[2, 3::3] = self._d1
        bands[4, 4:-3:3] = 1.0
        bands[1, 4::3] = -1.0
        return room[:, :-1]


def _to_boundary(value: FloatArray, step: FloatArray, keep: float) -> float:
    """Returns the greatest share of a step, at most 1, that leaves 1 - `keep` of every value."""
    # If an inequality does not apply, both are 0 and the quotient is NaN, which fmin ignores.
    fall = float(np.fmin.reduce(step / value))
    return 1.0 if fall >= 0.0 else min(1.0, -keep / fall)


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Returns the inner product on one core; BLAS starts threads for long vectors."""
    return float(np.sum(a * b))
