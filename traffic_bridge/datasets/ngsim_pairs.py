"""Reader of leader-follower pairs of reconstructed NGSIM trajectories, stored as Parquet, in SI.

A row is a follower at an instant together with its leader. Columns used: `vehicle_id`, `frame_id`
(0.1 s), `local_x` (across, from the road's left edge) and `local_y` (front bumper) [m], `v_length`,
`v_width` [m], `v_class`, `v_vel` [m/s], `v_acc` [m/s2], `lane_id` (1 is the leftmost), `preceding`,
and `preceding_local_y`, `_length`, `_width`, `_class`, `_vel`, `_acc`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.ngsim import FRAME, LANE_WIDTH, kinds_of
from traffic_bridge.datasets.speeds import check_speeds
from traffic_bridge.datasets.table import Table
from traffic_bridge.datasets.trajectories import Trajectories

MARKS = ("preceding_local_y", "preceding_vel", "frame_id", "v_vel", "local_y")


def read_ngsim_pairs(table: Table, path: Path) -> Trajectories:
    """Followers and leaders as tracks, each vehicle once.

    A vehicle that leads in one pair and follows in another has the rows of both. Where it only
    leads, its lane is the follower's and its offset is interpolated between the rows in which it is
    known, zero when it never is.

    Raises:
      InputError: a column is missing, or a value is impossible, or speeds are not those of the
        positions; the message names row and column.
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
    # A follower's own row comes first: it knows more than the row that has it as leader.
    order, new = _first_of_each(names, np.tile(frame, 2), station, table)
    rows = Rows(
        source=f"data set {path}",
        where=lambda k: table.where(int(order[k]) % count),
        name=names[order],
        kind=kinds_of(classes, length, table, count)[order],
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
    # Each column by itself: in the rows of both, one that is wrong may be the smaller part.
    _, vehicle = np.unique(names, return_inverse=True)
    speed = both("v_vel")
    for column, part in (("v_vel", slice(count)), ("preceding_vel", slice(count, None))):
        what = f"{rows.source}, column {column!r}"
        check_speeds(what, vehicle[part], time[part], station[part], speed[part])
    return found


def _first_of_each(
    names: NDArray[np.str_], frame: NDArray[np.int64], station: FloatArray, table: Table
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """First row of every vehicle and frame, sorted, and where in these a vehicle begins."""
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


def _fill(offset: FloatArray, time: FloatArray, new: NDArray[np.bool_]) -> FloatArray:
    """Offsets with the unknown ones interpolated in time within every vehicle."""
    filled = offset.copy()
    starts = np.flatnonzero(new)
    for a, b in zip(starts, [*starts[1:], len(offset)], strict=True):
        known = np.isfinite(offset[a:b])
        if known.all():
            continue
        if not known.any():
            filled[a:b] = 0.0
            continue
        filled[a:b] = np.interp(time[a:b], time[a:b][known], offset[a:b][known])
    return filled
