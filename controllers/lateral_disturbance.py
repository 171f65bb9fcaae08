"""Estimates what pushes the truck sideways besides its tires: wind, cross-slope, model error.

The truck's lateral motion is compared with what the linear model said a step ago; what is left, as
three accelerations of (lateral speed, yaw rate, trailer yaw rate), is believed over a short time
(disturbance observer with first-order filter, Ohnishi 1987). It sees a gust in the yaw rates long
before the truck is off its path.
"""

from __future__ import annotations

import numpy as np

from controllers.lateral_gains import Gains
from iits_mj.core.arrays import FloatArray


class DisturbanceObserver:
    """One call every control step.

    Attributes:
      value: the estimate, (3,) [m/s2, rad/s2, rad/s2].
    """

    def __init__(self, time: float, step: float) -> None:
        """Believes a disturbance over `time` [s], called every `step` [s]."""
        self._share = 1.0 - float(np.exp(-step / time))
        self.reset()

    def reset(self) -> None:
        """No disturbance, nothing remembered."""
        self.value = np.zeros(3)
        self._expected: FloatArray | None = None

    def update(self, state: FloatArray, gains: Gains) -> FloatArray:
        """The estimate after a step.

        Args:
          state: (w, r, r_t, articulation, road wheel angle) now, (5,).
          gains: of the present speed.
        """
        if self._expected is not None:
            seen = gains.blame @ (state[:3] - self._expected)
            self.value = self.value + self._share * (seen - self.value)
        self._expected = gains.motion @ state
        return self.value

    def rest(self) -> None:
        """Forgets the expectation: the next step is judged from anew; the estimate fades."""
        self._expected = None
        self.value = (1.0 - self._share) * self.value
