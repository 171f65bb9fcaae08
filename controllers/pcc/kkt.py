"""The linear systems of the interior-point method: cost linear in the number of nodes."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs, dpttrf, dpttrs

from iits_mj.core.arrays import FloatArray


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
