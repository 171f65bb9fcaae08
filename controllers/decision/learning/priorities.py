"""Which transitions are drawn how often: proportional prioritization (Schaul et al. 2016).

`P(i) = p_i^alpha / sum_k p_k^alpha` with `p_i = |TD error| + floor` (the paper's eq. 1), and
importance weights `w_i = (N P(i))^-beta / max_j w_j` that undo the bias (section 3.4). A new
transition gets the greatest priority so far, so that it is drawn soon.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray

IndexArray = NDArray[np.int64]
_FLOOR = 1e-3


class SumTree:
    """Non-negative masses in a binary tree of sums; all operations take whole arrays."""

    def __init__(self, size: int) -> None:
        self._leaves = 1 << max(0, size - 1).bit_length()
        self._sums = np.zeros(2 * self._leaves)

    @property
    def total(self) -> float:
        """Sum of all masses."""
        return float(self._sums[1])

    def __getitem__(self, index: IndexArray | slice) -> FloatArray:
        return self._sums[self._leaves :][index]

    def set(self, index: IndexArray, mass: FloatArray | float) -> None:
        """Replaces masses. Sums are added up anew from below, so no rounding error grows."""
        node = np.asarray(index) + self._leaves
        self._sums[node] = mass
        while node.size and node[0] > 1:
            node = np.unique(node // 2)
            self._sums[node] = self._sums[2 * node] + self._sums[2 * node + 1]

    def find(self, mass: FloatArray) -> IndexArray:
        """The leaf at which the running sum of masses first exceeds `mass`, in [0, total)."""
        rest = np.array(mass, dtype=float)
        node = np.ones(rest.shape, dtype=np.int64)
        while node.size and node[0] < self._leaves:
            left = self._sums[2 * node]
            # Rounding may carry the rest past the last leaf that has a mass: stay left of it.
            right = (rest >= left) & (self._sums[2 * node + 1] > 0.0)
            rest = np.where(right, rest - left, rest)
            node = 2 * node + right
        return node - self._leaves


class Priorities:
    """Draws indices in proportion to `p^alpha` and tells their importance weights."""

    def __init__(self, capacity: int, exponent: float) -> None:
        self._exponent = exponent
        self._tree = SumTree(capacity)
        self._greatest = 1.0

    def add(self, index: IndexArray) -> None:
        """New transitions, at the greatest priority so far."""
        self._tree.set(index, self._greatest**self._exponent)

    def draw(
        self, count: int, stored: int, beta: float, generator: np.random.Generator
    ) -> tuple[IndexArray, NDArray[np.float32]]:
        """Indices and weights of a batch, one index from each of `count` equal parts of the sum.

        Args:
          count: of the batch.
          stored: transitions in the memory, the N of the weights.
          beta: exponent of the weights.
          generator: of the draw.
        """
        part = (np.arange(count) + generator.random(count)) / count
        index = self._tree.find(part * self._tree.total)
        probability = self._tree[index] / self._tree.total
        weight = (stored * probability) ** -beta
        return index, (weight / weight.max()).astype(np.float32)

    def renew(self, index: IndexArray, error: NDArray[np.floating[Any]]) -> None:
        """Takes up the absolute TD errors of drawn transitions."""
        priority = np.asarray(error, dtype=float) + _FLOOR
        self._greatest = max(self._greatest, float(priority.max()))
        # A transition drawn twice has the same error both times.
        self._tree.set(index, priority**self._exponent)

    def state(self, stored: int) -> dict[str, Any]:
        """For a checkpoint."""
        return {"mass": self._tree[slice(stored)].copy(), "greatest": self._greatest}

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up what `state` gave."""
        mass = np.asarray(state["mass"], dtype=float)
        self._tree.set(np.arange(len(mass)), mass)
        self._greatest = float(state["greatest"])
