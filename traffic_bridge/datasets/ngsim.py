"""Reader of NGSIM's vehicle trajectories (FHWA), as published: feet, and frames of 0.1 s.

Spellings of the header: `Vehicle_ID, Frame_ID, ..., v_Vel, ..., Lane_ID, Preceding, ...` (CSV of
data.transportation.gov, with `Location`), `Vehicle ID, ..., Vehicle Velocity, ..., Lane
Identification, Preceding Vehicle, ...` (data dictionary), and none (the original text files, whose
18 columns stand in the dictionary's order).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.table import Table
from traffic_bridge.datasets.trajectories import Trajectories

FRAME = 0.1  # [s]
FOOT = 0.3048  # [m]
UNITS = {"ft": FOOT, "m": 1.0}
LANE_WIDTH = 12.0 * FOOT  # of US-101 and I-80
ARTICULATED_LENGTH = 14.0  # [m]: a rigid truck of the United States is hardly longer than 12.2 m
HIGHEST_LANE = 30
CAR_LENGTH = (3.0, 8.0)  # [m]: where the median length of a set's automobiles must lie

TEXT_COLUMNS = (
    "Vehicle_ID",
    "Frame_ID",
    "Total_Frames",
    "Global_Time",
    "Local_X",
    "Local_Y",
    "Global_X",
    "Global_Y",
    "v_Length",
    "v_Width",
    "v_Class",
    "v_Vel",
    "v_Acc",
    "Lane_ID",
    "Preceding",
    "Following",
    "Space_Headway",
    "Time_Headway",
)
MARKS = (("Frame_ID",), ("Local_Y",), ("Lane_ID", "Lane Identification"))


def read_ngsim(
    table: Table,
    path: Path,
    *,
    units: str = "ft",
    main_lanes: int | None = None,
    location: str | None = None,
) -> Trajectories:
    """A published NGSIM table.

    Lane 1 is the leftmost; the index from the right is `main_lanes` minus the number. Offsets are
    from the middle of lanes of 12 ft, counted from the road's left edge. Time is that of
    `Global_Time` where it is given, since frames begin anew in every period of a site; its zero is
    the set's first instant.

    Args:
      table: the file's columns.
      path: of the file.
      units: "ft" as published, or "m" for a file somebody has converted (also its speeds).
      main_lanes: rows in lanes of greater numbers (ramps) are left out; None keeps all lanes.
      location: which site, for a file that holds several, as in its column `Location`.

    Raises:
      InputError: a column is missing, a value is impossible, or the units cannot be right.
    """
    if units not in UNITS:
        raise InputError(f"units {units!r}: allowed are {', '.join(UNITS)}")
    scale = UNITS[units]
    lane_id = table.integers("Lane_ID", "Lane Identification")
    keep, notes = _chosen(table, lane_id, main_lanes, location)
    table.must(
        ~keep | (lane_id <= HIGHEST_LANE), "Lane_ID", lane_id, f"must be 0 to {HIGHEST_LANE}"
    )
    lanes = int(lane_id[keep].max())
    length = table.numbers("v_Length", "Vehicle Length") * scale
    classes = table.texts("v_Class", "Vehicle Class")
    if table.rows and classes[0].endswith(".0"):
        classes = np.char.replace(classes, ".0", "")
    kind = kinds_of(classes, length, table, table.rows)
    _check_units(path, length[keep & (classes == "2")], units)
    across = table.numbers("Local_X") * scale
    preceding = table.integers("Preceding", "Preceding Vehicle", "Preceeding")
    where = np.flatnonzero(keep)
    rows = Rows(
        source=f"data set {path}",
        where=lambda k: table.where(int(where[k])),
        name=table.integers("Vehicle_ID")[keep],
        kind=kind[keep],
        length=length[keep],
        width=table.numbers("v_Width", "Vehicle Width")[keep] * scale,
        time=_time(table)[keep],
        lane=lanes - lane_id[keep],
        station=table.numbers("Local_Y")[keep] * scale,
        offset=((lane_id - 0.5) * LANE_WIDTH - across)[keep],
        speed=table.numbers("v_Vel", "Vehicle Velocity")[keep] * scale,
        acceleration=table.numbers("v_Acc", "Vehicle Acceleration")[keep] * scale,
        leader=preceding[keep],
        speed_column=table.name("v_Vel", "Vehicle Velocity"),
    )
    return assemble(rows, lanes, LANE_WIDTH, notes)


def kinds_of(
    classes: NDArray[np.str_], length: FloatArray, table: Table, rows: int
) -> NDArray[np.str_]:
    """Kind of vehicle by NGSIM's class and the length.

    Class 1, motorcycles, and class 2, automobiles, are "car" (sizes as recorded); class 3 is
    "articulated" from 14 m, otherwise "truck".

    Args:
      classes: "1", "2" or "3", shape (k,).
      length: of the vehicles, shape (k,) [m].
      table: for messages.
      rows: of the table, which `classes` may hold several times over.

    Raises:
      InputError: another class.
    """
    known = np.isin(classes, ("1", "2", "3"))
    for start in range(0, len(classes), rows):
        part = slice(start, start + rows)
        table.must(known[part], "v_class", classes[part], "must be 1, 2 or 3")
    trucks = np.where(length >= ARTICULATED_LENGTH, "articulated", "truck")
    return np.where(classes == "3", trucks, "car")


def _chosen(
    table: Table, lane_id: NDArray[np.int64], main_lanes: int | None, location: str | None
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Which rows to read, and notes on the others."""
    keep = np.ones(table.rows, dtype=bool)
    notes = []
    table.must(lane_id >= 0, "Lane_ID", lane_id, f"must be 0 to {HIGHEST_LANE}")
    if table.has("Location"):
        sites = table.texts("Location")
        there = sorted(set(sites.tolist()))
        if location is None and len(there) > 1:
            raise InputError(
                f"data set {table.path}: holds {', '.join(there)}: choose one by location"
            )
        if location is not None:
            if location not in there:
                raise InputError(
                    f"data set {table.path}: location {location!r}: it holds {', '.join(there)}"
                )
            keep &= sites == location
    elif location is not None:
        raise InputError(f"data set {table.path}: location {location!r}: it has no such column")
    if (lane_id[keep] == 0).any():
        notes.append(f"{int((lane_id[keep] == 0).sum())} rows in lane 0 are left out")
        keep &= lane_id != 0
    if main_lanes is not None:
        if not 1 <= main_lanes <= HIGHEST_LANE:
            raise InputError(f"main_lanes {main_lanes!r}: allowed is 1 to {HIGHEST_LANE}")
        ramps = keep & (lane_id > main_lanes)
        keep &= ~ramps
        notes.append(f"{int(ramps.sum())} rows in lanes above {main_lanes} are left out")
    if not keep.any():
        raise InputError(f"data set {table.path}: no row is in a lane from 1 up")
    return keep, tuple(notes)


def _time(table: Table) -> FloatArray:
    """Seconds since the set's first instant."""
    frame = table.integers("Frame_ID")
    if not table.has("Global_Time"):
        return frame.astype(np.float64) * FRAME
    stamp = table.numbers("Global_Time")
    table.must(stamp >= 0.0, "Global_Time", stamp, "must be milliseconds since 1970")
    # To the nearest tenth of a second: the sites' clocks are off by up to some milliseconds.
    return np.asarray(np.round((stamp - stamp.min()) * 1e-3, 1), dtype=np.float64)


def _check_units(path: Path, length: FloatArray, units: str) -> None:
    low, high = CAR_LENGTH
    if length.size and not low <= float(np.median(length)) <= high:
        other = "m" if units == "ft" else "ft"
        raise InputError(
            f"data set {path}, column 'v_Length': automobiles of {float(np.median(length)):.1f} m "
            f"in the middle, read in {units}: is the file in {other}? Say units={other!r} then"
        )
