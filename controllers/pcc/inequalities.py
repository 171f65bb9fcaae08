"""The inequalities of the speed planner's problem in one vector, and the Lagrangian they make.

Order: 4 n of the intervals (brake force, room of the brake, overrun, full power), 2 (n + 1) of the
nodes (above the low bound, below the high one), n fences where there are any, the trip time. What
is not there (pinned nodes, open fences, no trip time) has `present` 0 and never a multiplier.
"""

from __future__ import annotations

import numpy as np

from controllers.pcc.problem import Point, Problem
from iits_mj.core.arrays import FloatArray

Slopes = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
_PINNED = 1e-9


class Inequalities:
    """All g(x) >= 0 of a problem; vectors of shape (m,).

    Attributes:
      pinned: nodes whose b is fixed, shape (n + 1,); fenced: whether any fence is there.
      present: 1 where an inequality is there, else 0, shape (m,); count: how many are.
      nodes: where the bounds of b stand in the vector.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        n = self._n = problem.intervals
        self.pinned = problem.high - problem.low < _PINNED
        self.fenced = bool((problem.fence > 0.0).any())
        self.timed = bool(np.isfinite(problem.time_max))
        present = [np.ones(4 * n), np.tile(~self.pinned, 2)]
        if self.fenced:
            present.append(problem.fence > 0.0)
        present.append(np.array([self.timed]))
        self.present = np.concatenate(present).astype(float)
        self.count = float(self.present.sum())
        self.nodes = slice(4 * n, 6 * n + 2)

    def values(self, at: Point) -> FloatArray:
        """All g(x); 1 in place of a trip time that is not there."""
        p = self.problem
        free = p.time_max - at.time[-1] if self.timed else 1.0
        parts = [
            at.y,
            p.brake - at.y,
            at.force + p.overrun * at.duration,
            p.full * at.duration - at.force,
            at.b - p.low,
            p.high - at.b,
        ]
        if self.fenced:
            parts.append(at.time - p.fence)
        return np.concatenate([*parts, np.array([free])])

    def change(self, at: Point, db: FloatArray, dy: FloatArray) -> FloatArray:
        """First-order change of all g(x) for steps of b (n + 1,) and y (n,)."""
        p = self.problem
        first, last = p.slope
        duration = at.d0 * db[:-1] + at.d1 * db[1:]
        force = first * db[:-1] + last * db[1:] + dy
        time = np.cumsum(duration)
        parts = [dy, -dy, force + p.overrun * duration, p.full * duration - force]
        parts += [db, -db]
        if self.fenced:
            parts.append(time)
        return np.concatenate([*parts, -time[-1:]])

    def prices(self, z: FloatArray) -> FloatArray:
        """What a unit of each interval's duration costs by trip time and fences, shape (n,)."""
        n = self._n
        price = np.full(n, z[-1])
        if self.fenced:
            # A fence is pressed less by every duration before it.
            price -= np.cumsum(z[6 * n + 2 : 7 * n + 2][::-1])[::-1]
        return price

    def slopes(self, at: Point, z: FloatArray) -> Slopes:
        """Derivatives of `cost - z g` by force, duration, change of b and y, each (n,)."""
        brake, room, overrun, full = z[: 4 * self._n].reshape(4, self._n)
        by_force, by_duration, by_change = at.cost_slope()
        by_force = by_force - overrun + full
        by_duration = by_duration + self.prices(z)
        by_duration -= self.problem.overrun * overrun + self.problem.full * full
        return by_force, by_duration, by_change, by_force - brake + room

    def gradient(self, at: Point, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient of `cost - z g` by b, zero where pinned, and by y."""
        n = self._n
        by_force, by_duration, by_change, by_brake = self.slopes(at, z)
        start, end = at.to_nodes(by_force, by_duration, by_change)
        above, below = z[self.nodes].reshape(2, n + 1)
        gradient = below - above
        gradient[:-1] += start
        gradient[1:] += end
        gradient[-1] -= self.problem.worth
        gradient[self.pinned] = 0.0
        return gradient, by_brake

    def weights(
        self, ratio: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray, FloatArray]:
        """Multipliers over slacks as weights: of the intervals, the nodes, and times at 1..n."""
        n = self._n
        brake, room, overrun, full = ratio[: 4 * n].reshape(4, n)
        times = np.zeros(n)
        if self.fenced:
            times += ratio[6 * n + 2 : 7 * n + 2]
        times[-1] += ratio[-1]
        return (brake + room, overrun, full), ratio[self.nodes].reshape(2, n + 1).sum(axis=0), times
