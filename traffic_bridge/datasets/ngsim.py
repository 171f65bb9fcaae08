"""Reader of NGSIM's vehicle trajectories (FHWA), as published: feet, and frames of 0.1 s.

Spellings of the header: `Vehicle_ID, Frame_ID, ..., v_Vel, ..., Lane_ID, Preceding, ...` (CSV of
data.transportation.gov, with `Location`), `Vehicle ID, ..., Vehicle Velocity, ..., Lane
Identification, Preceding Vehicle, ...` (data dictionary), and none (the original text files, whose
18 columns are in the dictionary's order).
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError
from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.kinematics import FOOT, check_speeds
from traffic_bridge.datasets.table import Table
from traffic_bridge.datasets.trajectories import Trajectories

FRAME = 0.1  # [s]
UNITS = {"ft": FOOT, "m": 1.0}
LANE_WIDTH = 12.0 * FOOT  # of US-101 and I-80
ARTICULATED_LENGTH = 14.0  # [m]: rigid trucks of the United States have up to about 12.2 m
HIGHEST_LANE = 30
CAR_LENGTH = (3.0, 8.0)  # [m]: where the median length of a set's automobiles must lie

TEXT_COLUMNS = (
    *("Vehicle_ID", "Frame_ID", "Total_Frames", "Global_Time"),
    *("Local_X", "Local_Y", "Global_X", "Global_Y"),
    *("v_Length", "v_Width", "v_Class", "v_Vel", "v_Acc"),
    *("Lane_ID", "Preceding", "Following", "Space_Headway", "Time_Headway"),
)
PAIR_MARKS = ("preceding_local_y", "preceding_vel", "frame_id", "v_vel", "local_y")
MARKS = (("Frame_ID",), ("Local_Y",), ("Lane_ID", "Lane Identification"))


def read_ngsim(
    table: Table,
    path: Path,
    *,
    units: str = "ft",
    main_lanes: int | None = None,
    location: str | None = None,
) -> Trajectories:
    """Trajectories of a published NGSIM table.

    Lane 1 is the leftmost; the index from the right is `main_lanes` minus the number. Offsets are
    from the middle of lanes of 12 ft, counted from the road's left edge. Time is
    `Global_Time` if it exists, because frames restart in every period of a site; its zero is the
    set's first instant.

    Args:
      table: the file's columns.
      path: of the file.
      units: "ft" as published, or "m" for a converted file (also its speeds).
      main_lanes: rows in lanes of greater numbers (ramps) are left out; None: all lanes.
      location: site in the column `Location`, for a file of several sites.

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
    kind = _kinds(classes, length, table)
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


def _kinds(classes: NDArray[np.str_], length: FloatArray, table: Table) -> NDArray[np.str_]:
    """Kind of vehicle by NGSIM's class and the length.

    Class 1, motorcycles, and class 2, automobiles, are "car" (sizes as recorded); class 3 is
    "articulated" from 14 m, otherwise "truck". There may be several classes for a row of the table.
    """
    known = np.isin(classes, ("1", "2", "3"))
    for start in range(0, len(classes), table.rows):
        part = slice(start, start + table.rows)
        table.must(known[part], "v_class", classes[part], "must be 1, 2 or 3")
    trucks = np.where(length >= ARTICULATED_LENGTH, "articulated", "truck")
    return np.where(classes == "3", trucks, "car")


def _chosen(
    table: Table, lane_id: IntArray, main_lanes: int | None, location: str | None
) -> tuple[BoolArray, tuple[str, ...]]:
    """The rows to read as a mask, and notes on the others."""
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
    # Rounded to 0.1 s, because the sites' clocks are off by up to some milliseconds.
    return np.asarray(np.round((stamp - stamp.min()) * 1e-3, 1), dtype=np.float64)


def _check_units(path: Path, length: FloatArray, units: str) -> None:
    """Refuses automobiles whose median length is impossible in the given units."""
    low, high = CAR_LENGTH
    if length.size and not low <= float(np.median(length)) <= high:
        other = "m" if units == "ft" else "ft"
        raise InputError(
            f"data set {path}, column 'v_Length': the median length of automobiles is "
            f"{float(np.median(length)):.1f} m in {units}: is the file in {other}? Then use "
            f"units={other!r}"
        )


def read_ngsim_pairs(table: Table, path: Path) -> Trajectories:
    """Trajectories of reconstructed NGSIM pairs stored as Parquet in SI units, each vehicle once.

    A row is a follower at an instant with its leader. Columns: `vehicle_id`, `frame_id` (0.1 s),
    `local_x` (across, from the road's left edge) and `local_y` (front bumper) [m], `v_length`,
    `v_width` [m], `v_class`, `v_vel` [m/s], `v_acc` [m/s2], `lane_id` (1 is the leftmost),
    `preceding`, and `preceding_local_y`, `_length`, `_width`, `_class`, `_vel`, `_acc`.

    A vehicle that leads in one pair and follows in another has the rows of both. Where it only
    leads, its lane is the follower's and its offset is interpolated between known ones, or zero.

    Raises:
      InputError: a column is missing, a value is impossible, or speeds do not fit the positions;
        the message names row and column.
    """
    count = table.rows
    frame = table.integers("frame_id")
    lane_id = table.integers("lane_id")
    table.must((lane_id >= 1) & (lane_id <= 20), "lane_id", lane_id, "must be 1 to 20")
    lanes = int(lane_id.max())
    follower, leader = table.texts("vehicle_id"), table.texts("preceding")
    across = table.numbers("local_x")

    def both(name: str) -> FloatArray:
        ahead = name.removeprefix("v_")
        return np.concatenate((table.numbers(name), table.numbers(f"preceding_{ahead}")))

    classes = np.concatenate((table.texts("v_class"), table.texts("preceding_class")))
    length = both("v_length")
    names = np.concatenate((follower, leader))
    time = np.tile(frame * FRAME, 2)
    offset = np.concatenate(((lane_id - 0.5) * LANE_WIDTH - across, np.full(count, np.nan)))
    station = both("local_y")
    # A follower's own row comes first, because it has more data than its row as a leader.
    order, new = _first_of_each(names, np.tile(frame, 2), station, table)
    rows = Rows(
        source=f"data set {path}",
        where=lambda k: table.where(int(order[k]) % count),
        name=names[order],
        kind=_kinds(classes, length, table)[order],
        length=length[order],
        width=both("v_width")[order],
        time=time[order],
        lane=(lanes - np.tile(lane_id, 2))[order],
        station=station[order],
        offset=_fill(offset[order], time[order], new),
        speed=both("v_vel")[order],
        acceleration=both("v_acc")[order],
        leader=np.concatenate((leader, np.full(count, "")))[order],
    )
    found = assemble(rows, lanes, LANE_WIDTH)
    # Each column separately, because a wrong one may be the smaller part of both.
    _, vehicle = np.unique(names, return_inverse=True)
    speed = both("v_vel")
    for column, part in (("v_vel", slice(count)), ("preceding_vel", slice(count, None))):
        what = f"{rows.source}, column {column!r}"
        check_speeds(what, vehicle[part], time[part], station[part], speed[part])
    return found


def _first_of_each(
    names: NDArray[np.str_], frame: IntArray, station: FloatArray, table: Table
) -> tuple[IntArray, BoolArray]:
    """First row of every vehicle and frame, sorted, and a mask of the first row of each vehicle."""
    _, number = np.unique(names, return_inverse=True)
    order = np.lexsort((np.arange(len(names)), frame, number))
    again = np.concatenate(([False], (np.diff(number[order]) == 0) & (np.diff(frame[order]) == 0)))
    apart = np.concatenate(([0.0], np.abs(np.diff(station[order]))))
    agree = np.ones(len(names) // 2, dtype=bool)
    agree[order[again & (apart > 0.05)] % len(agree)] = False
    table.must(agree, "local_y", station[: len(agree)], "differs from the same vehicle's other row")
    order = order[~again]
    new = np.concatenate(([True], np.diff(number[order]) != 0))
    return order, new


def _fill(offset: FloatArray, time: FloatArray, new: BoolArray) -> FloatArray:
    """Offsets with the unknown ones interpolated in time within every vehicle."""
    filled = offset.copy()
    for a, b in itertools.pairwise([*np.flatnonzero(new), len(offset)]):
        known = np.isfinite(offset[a:b])
        if not known.any():
            filled[a:b] = 0.0
        elif not known.all():
            filled[a:b] = np.interp(time[a:b], time[a:b][known], offset[a:b][known])
    return filled
