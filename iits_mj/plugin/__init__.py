"""Finds the compiled MuJoCo engine plugin and registers it once per process."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import mujoco

from iits_mj.core import libraries
from iits_mj.core.errors import PluginError
from iits_mj.plugin import pickling

LIBRARY_NAME = "libiits_mj_plugin.so"
# Environment variable with the path of another build, for instance one with sanitizers.
LIBRARY_VARIABLE = "IITS_MJ_PLUGIN"
_registered: Path | None = None


def library_path() -> Path:
    """Returns the path of the compiled plugin library.

    Raises:
      PluginError: it is missing (the package was not built).
    """
    return libraries.library_path(LIBRARY_NAME, LIBRARY_VARIABLE)


def _load(path: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise PluginError(
            f"{path} cannot be loaded into MuJoCo {mujoco.__version__}: {error}; reinstall iits-mj"
        ) from error


@functools.cache
def library() -> ctypes.CDLL:
    """Returns the registered library; a call of its functions releases Python's lock.

    Raises:
      PluginError: see `register`.
    """
    return _load(register())


def register() -> Path:
    """Registers the plugin with MuJoCo and returns the library's path; repeated calls do nothing.

    Raises:
      PluginError: the library is missing, cannot be loaded, or was built for another MuJoCo.
    """
    global _registered
    if _registered is not None:
        return _registered
    path = library_path()
    library = _load(path)
    compiled = int(library.iits_mj_compiled_version())
    if compiled != mujoco.mj_version():
        raise PluginError(
            f"{path} was built for MuJoCo version {compiled}, this is {mujoco.mj_version()}: "
            "reinstall iits-mj with the pinned mujoco"
        )
    mujoco.mj_loadPluginLibrary(str(path))
    pickling.enable()
    _registered = path
    return path
