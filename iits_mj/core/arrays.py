"""Types of the numpy arrays that the packages pass to each other."""

from __future__ import annotations

from typing import Any

import numpy as np

# Written out: from numpy 2.5 on `NDArray` is an alias whose parts `typing.get_origin` does not give
# to those who read the types of fields.
BoolArray = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]
FloatArray = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
IntArray = np.ndarray[tuple[Any, ...], np.dtype[np.int64]]
IndexArray = np.ndarray[tuple[Any, ...], np.dtype[np.intp]]
"""Indices, such as the results of `np.searchsorted` and `np.argsort`."""
