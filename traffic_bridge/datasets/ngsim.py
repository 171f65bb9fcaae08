"""What NGSIM's data sets share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from traffic_bridge.datasets.table import Table

FloatArray = NDArray[np.float64]

FRAME = 0.1  # [s]
FOOT = 0.3048  # [m]
LANE_WIDTH = 12.0 * FOOT  # of US-101 and I-80
ARTICULATED_LENGTH = 14.0  # [m]: a rigid truck of the United States is hardly longer than 12.2 m


def kinds_of(
    classes: NDArray[np.str_], length: FloatArray, table: Table, rows: int
) -> NDArray[np.str_]:
    """Kind of vehicle by NGSIM's class and the length.

    Class 1, motorcycles, and class 2, automobiles, are "car" (sizes as recorded); class 3 is
    "articulated" from 14 m, otherwise "truck".

    Args:
      classes: "1", "2" or "3", shape (k,).
      length: of the vehicles, shape (k,) [m].
      table: for messages.
      rows: of the table, which `classes` may hold several times over.

    Raises:
      InputError: another class.
    """
    known = np.isin(classes, ("1", "2", "3"))
    for start in range(0, len(classes), rows):
        part = slice(start, start + rows)
        table.must(known[part], "v_class", classes[part], "must be 1, 2 or 3")
    trucks = np.where(length >= ARTICULATED_LENGTH, "articulated", "truck")
    return np.where(classes == "3", trucks, "car")
