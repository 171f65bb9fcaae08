"""Stored configurations and trajectories: one `.npz` file for ReSim and RepSim, SI units.

Schema (version 1). n frames, m vehicles, k rows (one a vehicle and frame, sorted by frame):

| array | shape | content |
|---|---|---|
| `meta` | () | JSON text: `schema`, `mode`, `seed`, `config`, `map_hash`, `map_name`, |
| | | `versions`, `digest` |
| `time` | (n,) | traffic time of the frames [s]; the first is the reset |
| `ego` | (n, e) | the truck's state as given, a column per name in `ego_columns`; NaN: none |
| `ego_columns` | (e,) | names of `EgoState`'s scalar fields |
| `vehicle_id`, `vehicle_kind` | (m,) | name and kind |
| `vehicle_size` | (m, 3) | length, width, height [m] |
| `frame_start` | (n + 1,) | rows of frame i are `frame_start[i]` to `frame_start[i + 1]` |
| `vehicle` | (k,) | index into the vehicle arrays |
| `x y z yaw speed acceleration lateral_speed station offset` | (k,) | as in `TrackedVehicle` |
| `lane` | (k,) | index from the right, -1 off the route |
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import itertools
import json
import math
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError
from iits_mj.messages import EgoState, TrackedVehicle

SCHEMA = 1
COLUMNS = (
    "x",
    "y",
    "z",
    "yaw",
    "speed",
    "acceleration",
    "lateral_speed",
    "station",
    "offset",
)
EGO_COLUMNS = tuple(
    field.name for field in dataclasses.fields(EgoState) if field.name != "brake_pressures"
)
_ARRAYS = (
    "meta",
    "time",
    "ego",
    "ego_columns",
    "vehicle_id",
    "vehicle_kind",
    "vehicle_size",
    "frame_start",
    "vehicle",
    "lane",
    *COLUMNS,
)


def versions() -> dict[str, str]:
    """Versions on which a re-run depends."""
    return {"schema": str(SCHEMA), "libsumo": importlib.metadata.version("libsumo")}


class PoseDigest:
    """SHA-256 over every vehicle's name and pose, frame after frame."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, vehicles: Sequence[TrackedVehicle]) -> None:
        """Adds a frame."""
        self._hash.update(struct.pack("<I", len(vehicles)))
        for v in vehicles:
            self._hash.update(v.id.encode())
            self._hash.update(struct.pack("<5d", v.x, v.y, v.z, v.yaw, v.speed))

    def hexdigest(self) -> str:
        """The digest so far."""
        return self._hash.hexdigest()


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A recorded drive: what was asked for, what the truck did, what the others did.

    Attributes:
      meta: see the module's schema.
      time: of the frames [s], shape (n,).
      egos: the truck's state per frame, None where there was none.
      frames: the vehicles per frame, sorted by name.
    """

    meta: dict[str, Any]
    time: NDArray[np.float64]
    egos: tuple[EgoState | None, ...]
    frames: tuple[tuple[TrackedVehicle, ...], ...]

    def save(self, path: str | Path) -> Path:
        """Writes the file; the ending `.npz` is added where it is missing.

        Raises:
          InputError: the file cannot be written.
        """
        path = Path(path)
        path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
        index: dict[str, int] = {}
        first: list[TrackedVehicle] = []
        rows = [vehicle for frame in self.frames for vehicle in frame]
        for vehicle in rows:
            if vehicle.id not in index:
                index[vehicle.id] = len(first)
                first.append(vehicle)
        ego = [
            [math.nan if e is None else float(getattr(e, name)) for name in EGO_COLUMNS]
            for e in self.egos
        ]
        arrays: dict[str, Any] = {
            "meta": np.array(json.dumps(self.meta)),
            "time": self.time,
            "ego": np.array(ego).reshape(len(ego), len(EGO_COLUMNS)),
            "ego_columns": np.array(EGO_COLUMNS),
            "vehicle_id": np.array([v.id for v in first], dtype=str),
            "vehicle_kind": np.array([v.kind for v in first], dtype=str),
            "vehicle_size": np.array([(v.length, v.width, v.height) for v in first]).reshape(-1, 3),
            "frame_start": np.cumsum([0, *(len(frame) for frame in self.frames)]),
            "vehicle": np.array([index[v.id] for v in rows], dtype=np.int32),
            "lane": np.array([v.lane for v in rows], dtype=np.int16),
        }
        for name in COLUMNS:
            arrays[name] = np.array([getattr(v, name) for v in rows], dtype=np.float64)
        try:
            np.savez_compressed(path, **arrays)
        except OSError as error:
            raise InputError(f"recording {path}: cannot be written: {error.strerror}") from error
        return path

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Reads a file.

        Raises:
          InputError: it is missing, damaged, of another schema, or has values not finite.
        """
        try:
            with np.load(Path(path), allow_pickle=False) as file:
                missing = [name for name in _ARRAYS if name not in file.files]
                if missing:
                    raise InputError(f"recording {path}: has no {', '.join(missing)}")
                arrays = {name: file[name] for name in _ARRAYS}
            meta = json.loads(str(arrays["meta"]))
            return cls(meta, arrays["time"], _egos(arrays), _frames(arrays, meta, path))
        except InputError:
            raise
        except (OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(f"recording {path}: cannot be read: {error}") from error


def _egos(arrays: dict[str, Any]) -> tuple[EgoState | None, ...]:
    names = [str(name) for name in arrays["ego_columns"]]
    return tuple(None if np.isnan(row).any() else _ego(names, row) for row in arrays["ego"])


def _ego(names: list[str], row: NDArray[np.float64]) -> EgoState:
    values: dict[str, Any] = dict(zip(names, row.tolist(), strict=True))
    values["gear"] = int(values["gear"])
    values["shift_in_process"] = bool(values["shift_in_process"])
    return EgoState(**values)


def _frames(
    arrays: dict[str, Any], meta: dict[str, Any], path: str | Path
) -> tuple[tuple[TrackedVehicle, ...], ...]:
    if meta.get("schema") != SCHEMA:
        raise InputError(f"recording {path}: schema {meta.get('schema')!r}, this reads {SCHEMA}")
    for name in (*COLUMNS, "time", "vehicle_size"):
        if not np.isfinite(arrays[name]).all():
            raise InputError(f"recording {path}: column {name!r} has values that are not finite")
    start = arrays["frame_start"].tolist()
    if len(start) != len(arrays["time"]) + 1 or start[-1] != len(arrays["vehicle"]):
        raise InputError(f"recording {path}: frame_start does not fit the other arrays")
    ids, kinds = arrays["vehicle_id"].tolist(), arrays["vehicle_kind"].tolist()
    sizes = arrays["vehicle_size"].tolist()
    columns = [arrays[name].tolist() for name in COLUMNS]
    lanes, which = arrays["lane"].tolist(), arrays["vehicle"].tolist()
    rows = []
    for k, v in enumerate(which):
        length, width, height = sizes[v]
        size = {"length": length, "width": width, "height": height}
        pose = {name: column[k] for name, column in zip(COLUMNS, columns, strict=True)}
        rows.append(TrackedVehicle(id=ids[v], kind=kinds[v], lane=lanes[k], **pose, **size))
    return tuple(tuple(rows[a:b]) for a, b in itertools.pairwise(start))
