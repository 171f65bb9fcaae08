"""Where finished drives are kept: a folder for each version of the code that drove them."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from types import ModuleType

import controllers
import iits_mj
import traffic_bridge
from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.plugin import library_path
from iits_mj.validation.harness.config import ValidateConfig

_KINDS = ("*.py", "*.toml", "*.csv", "*.xml", "*.npz")
# What only shows, judges or learns from a drive does not change it; a drive of the trained policy
# is told by its weights' own digest, and the fast world drives no MuJoCo truck.
_NOT_DRIVING = {"validation", "render", "commands", "identification", "suite", "envs"}
_NOT_DRIVING |= {"learning", "weights", "fast_world", "scale", "bag"}


@functools.cache
def code_digest() -> str:
    """Hexadecimal digest over what every drive of the truck depends on: code, figures, plugin."""
    digest = hashlib.sha256(library_path().read_bytes())
    packages = [Path(str(package.__file__)).parent for package in (controllers, traffic_bridge)]
    for folder in (*packages, mjcf_dir(), Path(iits_mj.__file__).parent):
        for path in sorted(p for kind in _KINDS for p in folder.rglob(kind)):
            inside = path.relative_to(folder)
            if not _NOT_DRIVING.intersection(inside.parts):
                digest.update(inside.as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def drive_digest(*drivers: ModuleType) -> str:
    """Twelve hexadecimal digits of the code of drives.

    Args:
      drivers: modules that set up the drives, or packages with all of their modules: a change of
        them counts, too.
    """
    digest = hashlib.sha256(code_digest().encode())
    for driver in drivers:
        path = Path(str(driver.__file__))
        for file in sorted(path.parent.glob("*.py")) if hasattr(driver, "__path__") else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def runs_folder(config: ValidateConfig, part: str, *drivers: ModuleType) -> Path | None:
    """The folder for the finished drives of a part of the validation; None when none are kept.

    Args:
      config: names the folder.
      part: of the validation.
      drivers: modules of this package that set up the drives: a change of them counts, too.

    Raises:
      InputError: the folder cannot be made.
    """
    if config.runs is None:
        return None
    folder = config.runs / part / drive_digest(*drivers)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"folder {str(folder)!r} for drives cannot be made: {error}") from error
    return folder
