"""One number out of a table: the fast form of `np.interp` for a single place."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence


def interpolate(x: float, places: Sequence[float], values: Sequence[float]) -> float:
    """The value at x between those of the places, beyond them those of the ends.

    The same bits as `np.interp`, in a fraction of its time where the table is a list of floats.

    Args:
      x: a number; NaN gives NaN.
      places: rising, one at least.
      values: finite, as many.
    """
    if math.isnan(x):
        return x
    row = bisect_right(places, x) - 1
    if row < 0:
        return values[0]
    low = places[row]
    if row == len(places) - 1 or low == x:
        return values[row]
    value = values[row]
    return (values[row + 1] - value) / (places[row + 1] - low) * (x - low) + value
