"""Registers the environments of iits_mj when Gymnasium is imported, and costs nothing before.

Gymnasium reads no entry points since 1.0, so an installed package has no way to be known to
`gymnasium.make` without an import. This file and the `.pth` beside it lie in `site-packages`:
Python reads the latter at its start. Nothing of iits_mj is loaded until an environment is made;
which ones there are is in the package's metadata (`pyproject.toml`, "iits_mj.environments").
"""

from __future__ import annotations

import sys
import warnings
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

WATCHED = "gymnasium.envs"
DISTRIBUTION = "iits-mj"
GROUP, VECTOR_GROUP = "iits_mj.environments", "iits_mj.vector_environments"


def declared() -> dict[str, dict[str, Any]]:
    """Arguments of `gymnasium.register` by environment id, from the package's metadata."""
    from importlib.metadata import distribution

    found: dict[str, dict[str, Any]] = {}
    for point in distribution(DISTRIBUTION).entry_points:
        names = {GROUP: "entry_point", VECTOR_GROUP: "vector_entry_point"}
        if point.group in names:
            found.setdefault(f"iits_mj/{point.name}", {})[names[point.group]] = point.value
    return found


def register() -> None:
    """Registers what is not registered yet."""
    from gymnasium.envs.registration import register, registry

    for name, entry_points in declared().items():
        if name not in registry:
            register(name, **entry_points)


class Finder(MetaPathFinder):
    """Finds Gymnasium's module of environments once, and registers ours when it was loaded."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The spec of the watched module with a loader that registers; None for all others."""
        if fullname != WATCHED:
            return None
        sys.meta_path.remove(self)
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.loader is None:
            return None
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            try:
                register()
            except Exception as error:
                # Whoever uses Gymnasium for something else must not suffer.
                warnings.warn(f"iits_mj registers no environments: {error}", stacklevel=2)

        spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec


def watch() -> None:
    """Waits for Gymnasium to be imported; registers at once if it was."""
    if WATCHED in sys.modules:
        register()
    elif not any(isinstance(finder, Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, Finder())
