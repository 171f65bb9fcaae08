"""A task's observations as one scaled vector."""

from __future__ import annotations

from collections.abc import Mapping

import gymnasium
import numpy as np
from numpy.typing import NDArray

OBSERVATION_MAX = 5.0


class Flat:
    """Lays observations side by side, each divided by its scale and clipped to [-5, 5].

    Args:
      first: observations by name, each of shape (n,); their order is kept.
      scales: usual size of each.

    Attributes:
      names: of the vector's numbers.
      space: the vector's.
    """

    def __init__(
        self, first: Mapping[str, NDArray[np.float64]], scales: Mapping[str, float]
    ) -> None:
        self._scales = {name: scales[name] for name in first}
        self.names = tuple(
            name if len(values) == 1 else f"{name}[{i}]"
            for name, values in first.items()
            for i in range(len(values))
        )
        self.space = gymnasium.spaces.Box(
            -OBSERVATION_MAX, OBSERVATION_MAX, (len(self.names),), np.float32
        )

    def __call__(self, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float32]:
        """The vector of observations of the same names."""
        parts = [values[name] / scale for name, scale in self._scales.items()]
        flat = np.clip(np.concatenate(parts), -OBSERVATION_MAX, OBSERVATION_MAX)
        return flat.astype(np.float32)
