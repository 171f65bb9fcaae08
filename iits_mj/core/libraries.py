"""Finds the compiled libraries of the package."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

from iits_mj.core.errors import PluginError


def library_path(name: str, variable: str) -> Path:
    """Returns the path of a compiled library.

    Args:
      name: of the file.
      variable: environment variable with the path of another build, for instance one with
        sanitizers.

    Raises:
      PluginError: the library is missing (the package was not built).
    """
    if other := os.environ.get(variable):
        return Path(other)
    # In an editable install the library is in site-packages, not beside the sources.
    spec = importlib.util.find_spec("iits_mj")
    folders = list(spec.submodule_search_locations or []) if spec else []
    for folder in folders:
        path = Path(folder) / name
        if path.is_file():
            return path
    raise PluginError(
        f"{name} is not in {folders}: build it with 'pip install .' (a C++17 compiler is needed)"
    )
