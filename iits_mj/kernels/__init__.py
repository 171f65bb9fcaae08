"""Compiled functions of the drive: C++ without MuJoCo and Python, called through `ctypes`.

A kernel computes what Python would compute in many small steps, with the same operations in the
same order, so that both give the same bits. The Python form of each kernel is in its test. The
functions hold Python's lock: they take microseconds.

Arrays are passed by `address`; the caller keeps them alive, contiguous and of type float64.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PluginError
from iits_mj.core.libraries import library_path

LIBRARY_NAME = "libiits_mj_kernels.so"
LIBRARY_VARIABLE = "IITS_MJ_KERNELS"

Address = ctypes.c_void_p
Integer = ctypes.c_ssize_t
Real = ctypes.c_double


def path() -> Path:
    """Returns the path of the compiled library.

    Raises:
      PluginError: it is missing (the package was not built).
    """
    return library_path(LIBRARY_NAME, LIBRARY_VARIABLE)


@functools.cache
def _library() -> ctypes.PyDLL:
    file = path()
    try:
        return ctypes.PyDLL(str(file))
    except OSError as error:
        raise PluginError(f"{file} cannot be loaded: {error}; reinstall iits-mj") from error


def function(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    """Returns a function of the library.

    Args:
      name: of the function.
      result: type of the result, `Real`, `Integer` or None.
      arguments: their types, `Real`, `Integer` or `Address`.

    Raises:
      PluginError: the library is missing, or is another build that has no such function.
    """
    found: Any = getattr(_library(), name, None)
    if found is None:
        raise PluginError(f"{path()} has no function {name}: rebuild it with 'make build'")
    found.restype, found.argtypes = result, arguments
    return found


def address(array: np.ndarray[Any, Any]) -> int:
    """Returns the address of an array's first element; keep the array alive while it is used.

    Raises:
      ValueError: the array is not contiguous.
    """
    buffer: Any = array
    try:
        # Takes a quarter of the time of the array's own interface.
        return ctypes.addressof(ctypes.c_char.from_buffer(buffer))
    except (TypeError, ValueError):  # not contiguous, read-only or empty
        if not array.flags.c_contiguous:
            raise ValueError("a kernel needs a contiguous array") from None
        return int(array.__array_interface__["data"][0])


class Table:
    """Constant numbers for kernels, with their address; a copy or pickle has its own address.

    Args:
      numbers: an array of any shape, stored as contiguous float64.
    """

    def __init__(self, numbers: ArrayLike) -> None:
        self.numbers = np.ascontiguousarray(numbers, dtype=float)
        self.address = address(self.numbers)

    def __reduce__(self) -> tuple[type[Table], tuple[FloatArray]]:
        return Table, (self.numbers,)
