"""Types of the numpy arrays that the packages pass to each other."""

from __future__ import annotations

from typing import Any

import numpy as np

# Written out, because truck files are read by the types of the parameters: `typing.get_origin` of
# these is `np.ndarray`. Of numpy's own `NDArray[...]` it no longer is from numpy 2.5 on.
BoolArray = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]
FloatArray = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
IntArray = np.ndarray[tuple[Any, ...], np.dtype[np.int64]]
IndexArray = np.ndarray[tuple[Any, ...], np.dtype[np.intp]]
"""Indices, such as the results of `np.searchsorted` and `np.argsort`."""
