"""Types of the numpy arrays that the packages pass to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
"""Indices, such as the results of `np.searchsorted` and `np.argsort`."""
