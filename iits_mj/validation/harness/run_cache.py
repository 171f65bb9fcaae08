"""Keeps finished drives, in a folder for each version of the code that drove them."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from types import ModuleType

import controllers
import iits_mj
import traffic_bridge
from iits_mj import kernels
from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.plugin import library_path
from iits_mj.validation.harness.config import ValidateConfig

_KINDS = ("*.py", "*.toml", "*.csv", "*.xml", "*.npz")
# Packages that show, evaluate or learn from a drive, but do not change it. The trained policy is
# identified by the digest of its weights; the fast world has no MuJoCo truck.
NOT_DRIVING = (
    "controllers/decision/fast_world/",
    "controllers/decision/learning/",
    "controllers/decision/weights/",
    "iits_mj/bag/",
    "iits_mj/commands/",
    "iits_mj/envs/",
    "iits_mj/evaluation/",
    "iits_mj/identification/",
    "iits_mj/render/",
    "iits_mj/scale/",
    "iits_mj/suite/",
    "iits_mj/validation/",
)


def driving_files() -> dict[str, Path]:
    """Files on which every drive depends, by their path from the folder of all packages."""
    packages = (controllers, traffic_bridge, iits_mj)
    folders = [Path(str(package.__file__)).parent for package in packages]
    found = {
        f"{folder.name}/{path.relative_to(folder).as_posix()}": path
        for folder in (*folders, mjcf_dir())
        for kind in _KINDS
        for path in folder.rglob(kind)
    }
    return {name: found[name] for name in sorted(found) if not name.startswith(NOT_DRIVING)}


@functools.cache
def code_digest() -> str:
    """SHA-256 over the code, parameters and libraries on which every drive depends, in hex."""
    digest = hashlib.sha256(library_path().read_bytes() + kernels.path().read_bytes())
    for name, path in driving_files().items():
        digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def drive_digest(*drivers: ModuleType) -> str:
    """Twelve hexadecimal digits that identify the code of drives.

    Args:
      drivers: modules that set up the drives, or packages with all of their modules; they are part
        of the digest.
    """
    digest = hashlib.sha256(code_digest().encode())
    for driver in drivers:
        path = Path(str(driver.__file__))
        for file in sorted(path.parent.glob("*.py")) if hasattr(driver, "__path__") else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def runs_folder(config: ValidateConfig, part: str, *drivers: ModuleType) -> Path | None:
    """Folder for the finished drives of a part of the validation; None when none are kept.

    Args:
      config: names the folder of all parts.
      part: of the validation.
      drivers: modules that set up the drives; they are part of the digest.

    Raises:
      InputError: the folder cannot be created.
    """
    if config.runs is None:
        return None
    folder = config.runs / part / drive_digest(*drivers)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"folder {str(folder)!r} for drives cannot be made: {error}") from error
    return folder
