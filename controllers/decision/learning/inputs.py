"""What the inputs of the network usually are, and how far they spread in traffic.

In the observation's units a usual difference of speed is 0.05 and a usual lateral speed of who
changes lanes 0.01, where a distance is 0.3. Adam's steps are about as long for all weights, so the
network is slow to learn what hangs on small numbers; in units of their spread all are alike
(LeCun et al. 1998, "Efficient BackProp", section 4.3). The figures are rounded means and deviations
of drives in the six cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.decision.observation import FRAME_AGES, ROWS

# presence, dx, dy, relative speed, lateral speed, reference speed
_TRUCK_USUAL = (0.0, 1.0, 0.25, 0.4, 0.0, 0.4)
_TRUCK_SPREAD = (1.0, 0.3, 0.25, 0.05, 0.01, 0.05)
_OTHERS_USUAL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)
_OTHERS_SPREAD = (1.0, 0.3, 0.4, 0.05, 0.01, 0.05)


def usual_and_spread() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Of each of the 216 inputs; x is standardized as (x - usual) / spread."""
    others = len(ROWS) - 1
    usual = np.array([_TRUCK_USUAL, *[_OTHERS_USUAL] * others], np.float32)
    spread = np.array([_TRUCK_SPREAD, *[_OTHERS_SPREAD] * others], np.float32)
    return np.tile(usual.ravel(), len(FRAME_AGES)), np.tile(spread.ravel(), len(FRAME_AGES))
