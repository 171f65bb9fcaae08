"""Reads and writes recordings as `.npz` files; `docs/traffic_data.md` describes their arrays."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_json, read_npz
from iits_mj.core.output_files import OutputFile
from traffic_bridge.recording.rows import (
    COLUMNS,
    COMMAND_COLUMNS,
    EGO_COLUMNS,
    PRESSURES,
    SCHEMA,
    ego_columns,
    signal_rows,
    signals_of,
)

SIZE_MAX = 2**30  # bytes unpacked; an hour among 100 vehicles has a quarter of it
COMPRESSION = 1  # the fastest: higher levels hardly make the files smaller
_COMMON = ("meta", "time", "ego", "ego_columns", "vehicle_id", "vehicle_kind", "vehicle_size")
_ROWS = ("frame_start", "vehicle", "lane")
_NEW_COLUMNS = ("pitch", "roll", "yaw_rate")
_OF_DRIVES = ("command_time", "command", "truck_hash")
_SIGNALS = "signals"  # since version 0.1.0


def target(path: Path) -> Path:
    """The path to which a recording is written: with the ending `.npz`.

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


def write(fields: Mapping[str, Any], path: Path) -> Path:
    """Writes the fields of a `Recording` to a file; see `Recording.save`."""
    path = target(path)
    arrays: dict[str, NDArray[Any]] = {
        "meta": np.array(json.dumps(fields["meta"])),
        "time": fields["time"],
        "ego": fields["ego"],
        "ego_columns": np.array(ego_columns(fields["ego"].shape[1])),
        "vehicle_id": np.array(fields["ids"], dtype=np.str_),
        "vehicle_kind": np.array(fields["kinds"], dtype=np.str_),
        "vehicle_size": fields["sizes"],
        "frame_start": fields["start"],
        "vehicle": fields["vehicle"],
        "lane": fields["lane"],
        **dict(zip(COLUMNS, fields["columns"], strict=True)),
        "command_time": fields["command_time"],
        "command": fields["commands"],
        "truck_hash": fields["truck_hash"],
        "signals": np.array(json.dumps(signal_rows(fields["signals"]))),
    }
    with (
        OutputFile(path, "recording") as partial,
        zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION) as archive,
    ):
        for name, array in arrays.items():
            # Without the time of day, so that the same drive gives the same bytes.
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)
    return path


def read(path: Path) -> dict[str, Any]:
    """Reads the fields of a `Recording` from a file; see `Recording.load`."""
    name = f"recording {path}"
    arrays = read_npz(
        path, "recording", SIZE_MAX, _COMMON, (*_ROWS, *COLUMNS, *_OF_DRIVES, _SIGNALS)
    )
    meta = read_json(str(arrays["meta"]), f"{name}: its meta")
    schema = meta.get("schema") if isinstance(meta, dict) else None
    if schema not in (1, SCHEMA):
        raise InputError(f"{name}: schema {schema!r}: this version reads 1 and {SCHEMA}")
    try:
        return _fields(arrays, meta, schema, name)
    except (ValueError, IndexError, TypeError, MemoryError) as error:
        raise InputError(f"{name}: cannot be read: {error}") from error


def _fields(
    file: dict[str, NDArray[Any]], meta: dict[str, Any], schema: int, name: str
) -> dict[str, Any]:
    stored = COLUMNS if schema == SCHEMA else tuple(c for c in COLUMNS if c not in _NEW_COLUMNS)
    _require(list(file), (*_ROWS, *stored, *(_OF_DRIVES if schema == SCHEMA else ())), name)
    vehicle = file["vehicle"].astype(np.int32, casting="same_kind")
    columns = np.zeros((len(COLUMNS), len(vehicle)))
    for place, column in enumerate(COLUMNS):
        if column in stored:
            columns[place] = file[column]
    fields = {
        "meta": meta,
        "time": file["time"].astype(np.float64),
        "ids": tuple(file["vehicle_id"].tolist()),
        "kinds": tuple(file["vehicle_kind"].tolist()),
        "sizes": file["vehicle_size"].astype(np.float64),
        "start": file["frame_start"].astype(np.int64),
        "vehicle": vehicle,
        "lane": file["lane"].astype(np.int16, casting="same_kind"),
        "columns": columns,
        "ego": _ego(file["ego"].astype(np.float64), file["ego_columns"].tolist(), schema, name),
    }
    if schema == SCHEMA:
        fields |= {
            "command_time": file["command_time"].astype(np.float64),
            "commands": file["command"].astype(np.float64).reshape(-1, len(COMMAND_COLUMNS)),
            "truck_hash": file["truck_hash"].astype(np.uint64, casting="same_kind"),
        }
    if _SIGNALS in file:
        label = f"{name}: its signals"
        fields["signals"] = signals_of(read_json(str(file[_SIGNALS]), label), label)
    return fields


def _ego(
    stored: NDArray[np.float64], names: list[str], schema: int, label: str
) -> NDArray[np.float64]:
    """The truck's states in the present order of columns; version 1 has zero brake pressures."""
    if stored.shape[1:] != (len(names),):
        raise InputError(f"{label}: ego does not have the {len(names)} columns of ego_columns")
    place = {name: k for k, name in enumerate(names)}
    # Version 1 has no brake pressures, and no version has fewer other columns.
    columns = EGO_COLUMNS if schema != SCHEMA else ego_columns(max(len(names), len(EGO_COLUMNS)))
    ego = np.zeros((len(stored), len(columns)))
    for k, name in enumerate(columns):
        if name in place:
            ego[:, k] = stored[:, place[name]]
        elif schema == SCHEMA or name not in PRESSURES:
            raise InputError(f"{label}: ego_columns has no {name}")
    if schema != SCHEMA:
        ego[np.isnan(stored).any(axis=1)] = math.nan
    return ego


def _require(there: list[str], wanted: tuple[str, ...], name: str) -> None:
    missing = [array for array in wanted if array not in there]
    if missing:
        raise InputError(f"{name}: has no {', '.join(missing)}")
