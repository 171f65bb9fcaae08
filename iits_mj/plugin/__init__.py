"""Finds the compiled MuJoCo engine plugin and registers it once per process."""

from __future__ import annotations

import ctypes
import importlib.util
import os
from pathlib import Path

import mujoco

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
    if other := os.environ.get(LIBRARY_VARIABLE):
        return Path(other)
    # In an editable install the library is in site-packages, not beside the sources.
    spec = importlib.util.find_spec("iits_mj")
    folders = list(spec.submodule_search_locations or []) if spec else []
    for folder in folders:
        path = Path(folder) / LIBRARY_NAME
        if path.is_file():
            return path
    raise PluginError(
        f"{LIBRARY_NAME} is not in {folders}: "
        "build it with 'pip install .' (a C++17 compiler is needed)"
    )


def register() -> Path:
    """Registers the plugin with MuJoCo and returns the library's path; repeated calls do nothing.

    Raises:
      PluginError: the library is missing, cannot be loaded, or was built for another MuJoCo.
    """
    global _registered
    if _registered is not None:
        return _registered
    path = library_path()
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise PluginError(
            f"{path} cannot be loaded into MuJoCo {mujoco.__version__}: {error}; reinstall iits-mj"
        ) from error
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
