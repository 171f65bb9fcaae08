"""The speed planner's problem in units of its own: values, gradients, curvature.

Nodes k = 0..n, intervals of length ds between them. Variables: b = v^2 at the nodes and y, the
brake force, in the intervals. With the net force N that the motion asks for, linear in b, the
engine's force at the wheels is F = N + y. The duration of an interval is d = 2 ds / (v0 + v1):
exact for constant force, and convex in b.

    minimize   sum [f0 d + f1 F ds/eta + f2 (F ds/eta)^2 / d + k_a a^2 d] - worth b[n]
    subject to 0 <= y <= B_max,  -P_drag d <= F ds/eta <= P_max d,  b within bounds,
               t[n] <= T,  t[k] >= fence[k]  with  t[k] = d[0] + ... + d[k-1]

The fuel is jointly convex in (F, d). Its curvature in b is a sum of squares and m d'' with m the
Lagrangian's derivative by d: where m >= 0 the problem is convex there.

Units inside: b by 400 m2/s2, force by what full power gives at 20 m/s, time by ds / 20 m/s, fuel by
what full power burns in that time. All variables and multipliers are then of the order of 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray


@dataclass(frozen=True)
class Problem:
    """One problem of n intervals in its own units; see the module.

    Attributes:
      inertia: net force per difference of b; air: per mean of b; resistance: of grade and tires,
        shape (n,).
      fuel: coefficients of d, F and F^2 / d; calm: of (b1 - b0)^2 d; worth: of the last b.
      overrun: P_drag / P_max; full: 1, or a little more so that there is room inside; brake:
        greatest y.
      low, high: bounds of b, shape (n + 1,), equal where fixed.
      time_max: greatest t[n], inf for none; fence: least t at nodes 1..n, shape (n,), 0 for none.
    """

    inertia: float
    air: float
    resistance: FloatArray
    fuel: tuple[float, float, float]
    calm: float
    worth: float
    overrun: float
    full: float
    brake: float
    low: FloatArray
    high: FloatArray
    time_max: float
    fence: FloatArray

    @property
    def intervals(self) -> int:
        """Number of intervals n."""
        return self.resistance.size

    @property
    def slope(self) -> tuple[float, float]:
        """Derivatives of the net force by b at the start and at the end of an interval."""
        return 0.5 * self.air - self.inertia, 0.5 * self.air + self.inertia

    def net(self, b: FloatArray) -> FloatArray:
        """Net force of the intervals, shape (n,)."""
        first, last = self.slope
        return first * b[:-1] + last * b[1:] + self.resistance


class Point:
    """The problem at b (n + 1,) and y (n,): durations with derivatives, force, times, cost."""

    def __init__(self, problem: Problem, b: FloatArray, y: FloatArray) -> None:
        self.problem, self.b, self.y = problem, b, y
        v = np.sqrt(b)
        self._v0, self._v1 = v[:-1], v[1:]
        self._total = self._v0 + self._v1
        self.duration = 2.0 / self._total
        square = -1.0 / (self._total * self._total)
        # Derivatives of the duration by b at both ends.
        self.d0, self.d1 = square / self._v0, square / self._v1
        self.force = problem.net(b) + y
        self.pull = self.force / self.duration  # power over full power
        self.time = np.cumsum(self.duration)  # at nodes 1..n
        self.change = np.diff(b)
        self._cost_slope: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def cost(self) -> float:
        """Of the whole drive."""
        p = self.problem
        c0, c1, c2 = p.fuel
        rate = c0 + c1 * self.pull + c2 * self.pull**2 + p.calm * self.change**2
        return float(np.sum(rate * self.duration)) - p.worth * float(self.b[-1])

    def cost_slope(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives of an interval's cost by force, duration and change of b, each (n,)."""
        if self._cost_slope is None:
            p = self.problem
            c0, c1, c2 = p.fuel
            self._cost_slope = (
                c1 + 2.0 * c2 * self.pull,
                c0 - c2 * self.pull**2 + p.calm * self.change**2,
                2.0 * p.calm * self.change * self.duration,
            )
        return self._cost_slope

    def to_nodes(
        self, by_force: FloatArray, by_duration: FloatArray, by_change: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives by b at the start and at the end of each interval, y held; each (n,)."""
        first, last = self.problem.slope
        start = first * by_force + self.d0 * by_duration - by_change
        end = last * by_force + self.d1 * by_duration + by_change
        return start, end

    def curvature(
        self,
        weights: tuple[FloatArray, FloatArray, FloatArray],
        by_duration: FloatArray,
        convex: bool = False,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Second derivatives with y eliminated, and what gives y back.

        By y and b an interval has the squares `w_i (dy + u_i . db)^2`: of the brake's bounds (u =
        0), of overrun, of full power and of the fuel. Their least over dy is
        `sum_i<j w_i w_j ((u_i - u_j) . db)^2 / sum w`, which has no cancelling terms however large
        the weights of active bounds are.

        Args:
          weights: multiplier over slack of the brake's bounds (both together), of overrun and of
            full power, each (n,).
          by_duration: derivative of the Lagrangian by the durations, (n,).
          convex: True leaves out what may be negative; the result is then positive semidefinite.

        Returns:
          Curvature by b at (start, start), (start, end), (end, end); the sum of weights; the mean u
          at start and end. Each (n,).
        """
        p = self.problem
        first, last = p.slope
        brake, overrun, full = weights
        d, d0, d1, pull = self.duration, self.d0, self.d1, self.pull
        fuel = 2.0 * p.fuel[2] / d
        weight = brake + overrun + full + fuel
        # u_i = slope + x_i grad d; x: the pull of overrun, less that of full power, less its own.
        shares = (overrun / weight, full / weight, fuel / weight)
        mass = shares[0] + shares[1] + shares[2]
        mean = shares[0] * p.overrun - shares[1] * p.full - shares[2] * pull
        along = brake * mass
        cross = brake * mean
        across = shares[0] * p.overrun**2 + shares[1] * p.full**2 + shares[2] * pull**2
        across = brake * across + overrun * shares[1] * (p.overrun + p.full) ** 2
        across += overrun * shares[2] * (p.overrun + pull) ** 2
        across += full * shares[2] * (p.full - pull) ** 2
        h00 = along * first * first + 2.0 * cross * first * d0 + across * d0 * d0
        h01 = along * first * last + cross * (first * d1 + last * d0) + across * d0 * d1
        h11 = along * last * last + 2.0 * cross * last * d1 + across * d1 * d1
        # Of the durations themselves.
        v0, v1, total = self._v0, self._v1, self._total
        if convex:
            by_duration = np.maximum(by_duration, 0.0)
        cube, square = by_duration / total**3, 0.5 * by_duration / total**2
        h00 += (cube + square / v0) / v0**2
        h01 += cube / (v0 * v1)
        h11 += (cube + square / v1) / v1**2
        if p.calm:
            twist = 2.0 * p.calm * (np.zeros_like(d) if convex else self.change)
            own = 2.0 * p.calm * d
            h00 += own - 2.0 * twist * d0
            h01 += twist * (d0 - d1) - own
            h11 += own + 2.0 * twist * d1
        return h00, h01, h11, weight, mass * first + mean * d0, mass * last + mean * d1
