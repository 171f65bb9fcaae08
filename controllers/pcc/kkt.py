"""The linear systems of the interior-point method: cost linear in the number of nodes."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs, dpttrf, dpttrs

from controllers.pcc.problem import Point, Problem
from iits_mj.core.arrays import FloatArray

# --- The inequalities of the speed planner's problem in one vector, and the Lagrangian they make
# Order: 4 n of the intervals (brake force, room of the brake, overrun, full power), 2 (n + 1) of
# the nodes (above the low bound, below the high one), n fences where there are any, the trip time.
# What is not there (pinned nodes, open fences, no trip time) has `present` 0 and never a
# multiplier.

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


# --- The linear systems of the interior-point method: cost linear in the number of nodes ---


class NodeSystem:
    """(H + G' C' W C G) x = r with H tridiagonal, G the durations' gradients, C their running sum.

    H has shape (m, m), m = n + 1 nodes. W holds the weights of the times at nodes 1..n. Where only
    the last time has a weight the system is H with a border; else the times and the prices of the
    intervals join the unknowns, ordered by node, and the system has three bands on either side.
    """

    def __init__(
        self,
        diagonal: FloatArray,
        beside: FloatArray,
        gradient: tuple[FloatArray, FloatArray],
        weights: FloatArray,
        fenced: bool,
    ) -> None:
        """Factors the system; `definite` is False where H is not, or rounding leaves no pivot.

        Args:
          diagonal: of H, shape (n + 1,).
          beside: the diagonal beside it, shape (n,).
          gradient: of the durations by b at start and end of each interval, each (n,).
          weights: of the times at nodes 1..n, shape (n,), none negative.
          fenced: whether weights but the last are above 0.
        """
        self._d0, self._d1 = gradient
        self._weights, self._fenced = weights, fenced
        self._beside = beside
        self._diagonal = diagonal
        self._factor, self._below, info = dpttrf(diagonal, beside)
        self.definite = bool(info == 0)
        if self.definite and not fenced and weights[-1] > 0.0:
            border = np.zeros(diagonal.size)
            border[:-1] += self._d0
            border[1:] += self._d1
            self._border = border
            self._answer = self._plain(border)
            self._pivot = 1.0 / weights[-1] + float(np.sum(border * self._answer))
        elif self.definite and fenced:
            self._bands, self._order, info = dgbtrf(self._banded(), 3, 3)
            self.definite = bool(info == 0)

    def solve(self, right: FloatArray) -> FloatArray:
        """The solution x, shape (n + 1,), for a right side of that shape; H must be definite."""
        if self._fenced:
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
        """Unknowns b[k], t[k], price[k] by node; rows: b, t and t[k+1] - t[k] - grad d . b = 0.

        In LAPACK's form: entry (i, j) stands at [3 + i - j, j], below three rows for its pivoting.
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
        # Row of t[k]: W t[k] + price[k] - price[k-1] = 0; t[0] is 0, kept by a unit weight.
        bands[3, 1] = 1.0
        bands[3, 4::3] = self._weights
        bands[2, 5:-3:3] = 1.0
        bands[5, 2:-3:3] = -1.0
        # Row of price[k]: grad d . b + t[k] - t[k+1] = 0, with t[0] left out.
        bands[5, 0:-3:3] = self._d0
        bands[2, 3::3] = self._d1
        bands[4, 4:-3:3] = 1.0
        bands[1, 4::3] = -1.0
        return room[:, :-1]
