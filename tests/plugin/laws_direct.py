"""Calls single laws of the plugin, which laws_direct.cc exports, without MuJoCo."""

import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

import iits_mj

PACKAGE = Path(iits_mj.plugin.__file__).parents[1]
WHOLE = (
    "wheel_active",
    "drive_columns",
    "drive_state",
    "shift_choice",
)  # functions that return an int


@functools.cache
def library():
    """Compiles and loads the laws; skips the test without a compiler or the sources."""
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CXX", "c++"), "g++"))), None)
    if compiler is None or not (PACKAGE / "plugin" / "laws").is_dir():
        pytest.skip("no C++ compiler, or the plugin's sources are not installed")
    source = Path(__file__).parent / "laws_direct.cc"
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "laws_direct.so"
        command = [compiler, *flags, "-shared", "-fPIC", f"-I{PACKAGE}", source, "-o", built]
        subprocess.run(command, check=True)
        return ctypes.CDLL(str(built))


def law(name, *arguments):
    """Calls a function of laws_direct.cc; it writes into arguments that are float arrays."""
    function = getattr(library(), name)
    function.restype = ctypes.c_int if name in WHOLE else ctypes.c_double
    converted = []
    for argument in arguments:
        if isinstance(argument, (int, np.integer)):
            converted.append(ctypes.c_int(argument))
        elif isinstance(argument, float):
            converted.append(ctypes.c_double(argument))
        else:
            if not isinstance(argument, np.ndarray):
                argument = np.array(argument, dtype=float)
            assert argument.dtype == float
            converted.append(argument.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
            converted[-1].array = argument  # keeps it alive
    return function(*converted)
