"""Paths of the files that the package ships."""

from __future__ import annotations

from pathlib import Path

from iits_mj.core.errors import InputError

_PACKAGE = Path(__file__).resolve().parents[1]
DEFAULT_TRUCK = "tractor_semitrailer_6x4"  # a folder of mjcf/trucks
# Vehicle types of the traffic, read by the SUMO traffic and by the fast world.
VEHICLE_TYPES = _PACKAGE / "parameters" / "vehicle_types.toml"
# Their names and shares in the default traffic of both.
DEFAULT_MIX = (("car", 0.70), ("van", 0.12), ("truck", 0.08), ("articulated", 0.10))


def mjcf_dir() -> Path:
    """Returns the model folder: `mjcf/` beside the sources, or inside the installed package."""
    return _folder("mjcf", f"trucks/{DEFAULT_TRUCK}/truck.toml")


def mjcf_path(name: str) -> Path:
    """Returns the path of a model file, for `mujoco.MjModel.from_xml_path(str(path))`."""
    return _file(mjcf_dir(), name, "model file")


def regulation_path(name: str) -> Path:
    """Returns the path of a scenario of `examples/regulations`, also in the installed package."""
    return _file(_folder("examples/regulations", "road.csv"), name, "scenario")


def _folder(name: str, marker: str) -> Path:
    for candidate in (_PACKAGE.parent / name, _PACKAGE / name):
        if (candidate / marker).is_file():
            return candidate
    raise InputError(f"the folder {name}/ is missing beside {_PACKAGE}; reinstall iits-mj")


def _file(folder: Path, name: str, what: str) -> Path:
    path = folder / name
    if not path.is_file():
        present = ", ".join(sorted(p.name for p in folder.iterdir()))
        raise InputError(f"no {what} {name!r}; there are: {present}")
    return path
