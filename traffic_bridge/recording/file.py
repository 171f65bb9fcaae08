"""Recordings as `.npz` files; the schema is in `traffic_bridge.recording.recording`."""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError
from traffic_bridge.recording.recording import COLUMNS, SCHEMA, Recording
from traffic_bridge.recording.rows import COMMAND_COLUMNS, EGO_COLUMNS, PRESSURES
from traffic_bridge.vehicles.types import KINDS

# --- What a recording's arrays must be like: nothing that is not finite, nobody twice in a frame

if TYPE_CHECKING:
    from traffic_bridge.recording.recording import Recording

PIECE = 1 << 18  # rows looked at together, so that a mapped file is not read into memory at once


def check_arrays(recording: Recording, name: str) -> None:
    """Holds the arrays of a recording against each other.

    Args:
      recording: the recording.
      name: how messages call it.

    Raises:
      InputError: says which array is wrong and where.
    """
    r = recording
    n, m, k = len(r.time), len(r.ids), r.columns.shape[-1]
    from traffic_bridge.recording.recording import COLUMNS

    for array, shape, what in (
        (r.time, (n,), "time"),
        (r.kinds, (m,), "vehicle_kind"),
        (r.sizes, (m, 3), "vehicle_size"),
        (r.start, (n + 1,), "frame_start"),
        (r.vehicle, (k,), "vehicle"),
        (r.lane, (k,), "lane"),
        (r.columns, (len(COLUMNS), k), "columns"),
        (r.ego, (n, len(EGO_COLUMNS)), "ego"),
        (r.commands, (len(r.command_time), len(COMMAND_COLUMNS)), "command"),
    ):
        found = np.shape(array)
        if found != shape:
            raise InputError(f"{name}: {what} has the shape {found}, wanted is {shape}")
    _finite(r.time, name, "time")
    _finite(r.sizes, name, "vehicle_size")
    _finite(r.command_time, name, "command_time")
    _finite(r.commands, name, "command")
    for array, what in ((r.time, "time"), (r.command_time, "command_time")):
        if (np.diff(array) <= 0.0).any():
            place = int(np.argmax(np.diff(array) <= 0.0)) + 1
            raise InputError(
                f"{name}: {what} does not increase: [{place}] = {array[place]:g} s after "
                f"{array[place - 1]:g} s"
            )
    if (r.sizes <= 0.0).any():
        raise InputError(f"{name}: vehicle_size has values that are not positive")
    strange = sorted(set(r.kinds) - set(KINDS))
    if strange:
        raise InputError(f"{name}: vehicle_kind {strange[0]!r}: allowed are {', '.join(KINDS)}")
    _check_rows(r, name, m, k)
    _check_ego(r.ego, name)


def _check_rows(r: Recording, name: str, m: int, k: int) -> None:
    from traffic_bridge.recording.recording import COLUMNS, ranks

    counts = np.diff(r.start)
    if len(r.start) and (r.start[0] != 0 or r.start[-1] != k or (counts < 0).any()):
        raise InputError(f"{name}: frame_start does not fit the other arrays")
    for column, values in zip(COLUMNS, r.columns, strict=True):
        _finite(values, name, column)
    rank, first = ranks(r.ids), np.zeros(k + 1, dtype=bool)
    first[r.start] = True
    before = -1
    for low in range(0, k, PIECE):
        who = np.asarray(r.vehicle[low : low + PIECE])
        if who.min() < 0 or who.max() >= m:
            raise InputError(f"{name}: vehicle has an index that is not 0 to {m - 1}")
        place = np.concatenate(([before], rank[who]))
        bad = (np.diff(place) <= 0) & ~first[low : low + len(who)]
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{name}: vehicle {r.ids[who[row]]!r} is twice in a frame, or a frame is not "
                f"sorted by name (row {low + row})"
            )
        before = int(place[-1])


def _check_ego(ego: NDArray[np.float64], name: str) -> None:
    absent = np.isnan(ego)
    some = absent.any(axis=1) & ~absent.all(axis=1)
    if some.any() or np.isinf(ego).any():
        row = int(np.argmax(some | np.isinf(ego).any(axis=1)))
        raise InputError(f"{name}: ego has values that are not finite in frame {row}")


def _finite(values: NDArray[Any], name: str, what: str) -> None:
    for low in range(0, len(values), PIECE):
        if not np.isfinite(values[low : low + PIECE]).all():
            raise InputError(f"{name}: column {what!r} has values that are not finite")


# --- Recordings as `.npz` files; the schema is in `traffic_bridge.recording.recording` ---

# Fast: figures of traffic hardly get smaller with more effort.
COMPRESSION = 1
_COMMON = ("meta", "time", "ego", "ego_columns", "vehicle_id", "vehicle_kind", "vehicle_size")
_ROWS = ("frame_start", "vehicle", "lane")
_NEW_COLUMNS = ("pitch", "roll", "yaw_rate")
_OF_DRIVES = ("command_time", "command", "truck_hash")


def target(path: Path) -> Path:
    """Where a recording of a path is written: with the ending `.npz`.

    Raises:
      InputError: the path is a folder, with the ending or without.
    """
    named = path if path.suffix == ".npz" or not path.name else path.with_name(path.name + ".npz")
    for each in (path, named):
        if each.is_dir():
            raise InputError(
                f"recording {path}: cannot be written: {each} is a folder; name a file, as in "
                f"{each / 'drive.npz'}"
            )
    return named


def write(recording: Recording, path: Path) -> Path:
    """Writes a file; see `Recording.save`."""
    path = target(path)
    arrays: dict[str, NDArray[Any]] = {
        "meta": np.array(json.dumps(recording.meta)),
        "time": recording.time,
        "ego": recording.ego,
        "ego_columns": np.array(EGO_COLUMNS),
        "vehicle_id": np.array(recording.ids, dtype=np.str_),
        "vehicle_kind": np.array(recording.kinds, dtype=np.str_),
        "vehicle_size": recording.sizes,
        "frame_start": recording.start,
        "vehicle": recording.vehicle,
        "lane": recording.lane,
        **dict(zip(COLUMNS, recording.columns, strict=True)),
        "command_time": recording.command_time,
        "command": recording.commands,
        "truck_hash": recording.truck_hash,
    }
    partial = path.with_name(f".{path.name}.partial")
    try:
        with zipfile.ZipFile(
            partial, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION
        ) as archive:
            for name, array in arrays.items():
                # A fixed time of day: one drive gives one file, byte for byte.
                entry = zipfile.ZipInfo(f"{name}.npy")
                entry.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(entry, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(f"recording {path}: cannot be written: {error.strerror}") from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    return path


def read(path: Path) -> Recording:
    """Reads a file; see `Recording.load`."""
    name = f"recording {path}"
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise InputError(f"{name}: is a single array, not a recording")
            _demand(file.files, _COMMON, name)
            meta = json.loads(str(file["meta"]))
            schema = meta.get("schema") if isinstance(meta, dict) else None
            if schema not in (1, SCHEMA):
                raise InputError(f"{name}: schema {schema!r}, this reads 1 and {SCHEMA}")
            made = _build(file, meta, schema, name)
    except InputError:
        raise
    except (
        OSError,
        ValueError,
        KeyError,
        IndexError,
        TypeError,
        EOFError,
        MemoryError,
        NotImplementedError,
        zlib.error,
        zipfile.BadZipFile,
    ) as error:
        raise InputError(f"{name}: cannot be read: {error}") from error
    made.check(name)
    return made


def _build(file: Any, meta: dict[str, Any], schema: int, name: str) -> Recording:
    stored = COLUMNS if schema == SCHEMA else tuple(c for c in COLUMNS if c not in _NEW_COLUMNS)
    _demand(file.files, (*_ROWS, *stored, *(_OF_DRIVES if schema == SCHEMA else ())), name)
    vehicle = file["vehicle"].astype(np.int32, casting="same_kind")
    columns = np.zeros((len(COLUMNS), len(vehicle)))
    for place, column in enumerate(COLUMNS):
        if column in stored:
            columns[place] = file[column]
    drive = {}
    if schema == SCHEMA:
        drive = {
            "command_time": file["command_time"].astype(np.float64),
            "commands": file["command"].astype(np.float64).reshape(-1, len(COMMAND_COLUMNS)),
            "truck_hash": file["truck_hash"].astype(np.uint64, casting="same_kind"),
        }
    return Recording(
        meta=meta,
        time=file["time"].astype(np.float64),
        ids=tuple(file["vehicle_id"].tolist()),
        kinds=tuple(file["vehicle_kind"].tolist()),
        sizes=file["vehicle_size"].astype(np.float64),
        start=file["frame_start"].astype(np.int64),
        vehicle=vehicle,
        lane=file["lane"].astype(np.int16, casting="same_kind"),
        columns=columns,
        ego=_ego(file["ego"].astype(np.float64), file["ego_columns"].tolist(), schema, name),
        **drive,
    )


def _ego(
    stored: NDArray[np.float64], names: list[str], schema: int, label: str
) -> NDArray[np.float64]:
    """The truck's figures in today's order; brake pressures of version 1 are zero."""
    if stored.shape[1:] != (len(names),):
        raise InputError(f"{label}: ego does not have the {len(names)} columns of ego_columns")
    place = {name: k for k, name in enumerate(names)}
    ego = np.zeros((len(stored), len(EGO_COLUMNS)))
    for k, name in enumerate(EGO_COLUMNS):
        if name in place:
            ego[:, k] = stored[:, place[name]]
        elif schema == SCHEMA or name not in PRESSURES:
            raise InputError(f"{label}: ego_columns has no {name}")
    if schema != SCHEMA:
        ego[np.isnan(stored).any(axis=1)] = math.nan
    return ego


def _demand(there: list[str], wanted: tuple[str, ...], name: str) -> None:
    missing = [array for array in wanted if array not in there]
    if missing:
        raise InputError(f"{name}: has no {', '.join(missing)}")
