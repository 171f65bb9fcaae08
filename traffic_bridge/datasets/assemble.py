"""Makes `Trajectories` from a reader's rows in any order; common to all data sets."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError
from traffic_bridge.datasets.kinematics import check_speeds
from traffic_bridge.datasets.trajectories import (
    INSTANT,
    LATEST,
    Trajectories,
    find,
    instant_keys,
)

LONGEST_GAP = 1.0  # [s]: a vehicle that is missing for longer continues as another one
# [m] more than the distance at 100 m/s: a vehicle that jumps farther continues as another one.
LEAP = 10.0
FASTEST = 150.0  # [m/s]
FARTHEST = 1e6  # [m]


@dataclass(frozen=True, eq=False)
class Rows:
    """The k rows of a reader, in SI units and in any order.

    Attributes:
      source: the file, for messages.
      where: describes the row of an index, for instance "line 12".
      name: of the vehicle, shape (k,), numbers or text.
      kind: of the vehicle, shape (k,).
      length, width, time, station, offset, speed: as in `Trajectories`, shape (k,).
      lane: index from the outside, shape (k,).
      acceleration: shape (k,), or None to derive it from the speeds.
      leader: name of the vehicle ahead, shape (k,), or None to find it by lane and station.
      speed_column: the speed's name in the file, for the comparison with the positions; None: no
        comparison.
    """

    source: str
    where: Callable[[int], str]
    name: NDArray[np.generic]
    kind: NDArray[np.str_]
    length: FloatArray
    width: FloatArray
    time: FloatArray
    lane: IntArray
    station: FloatArray
    offset: FloatArray
    speed: FloatArray
    acceleration: FloatArray | None = None
    leader: NDArray[np.generic] | None = None
    speed_column: str | None = None

    def must(self, good: BoolArray, column: str, what: str) -> None:
        """Raises InputError for the first row that is not good, naming file, row and column."""
        wrong = np.flatnonzero(~good)
        if wrong.size:
            k = int(wrong[0])
            raise InputError(
                f"{self.source}, {self.where(k)}: {column} of vehicle {str(self.name[k])!r} {what}"
            )


def assemble(
    rows: Rows, lane_count: int, lane_width: float, notes: tuple[str, ...] = ()
) -> Trajectories:
    """Sorts rows into tracks.

    Repeated rows count once. A vehicle that is missing for more than a second or jumps gets a new
    name (`7#2`): some data sets reuse their names, and SUMO moves stuck vehicles elsewhere.

    Raises:
      InputError: there are no rows, a value is impossible, a vehicle is at two places at once, or
        the speeds do not fit the positions.
    """
    if not len(rows.time):
        raise InputError(f"{rows.source}: no rows")
    for column in ("time", "station", "offset", "speed", "length", "width"):
        rows.must(np.isfinite(getattr(rows, column)), column, "is not a finite number")
    rows.must(np.abs(rows.time) < LATEST, "time", f"is beyond {LATEST:g} s")
    rows.must(rows.speed >= 0.0, "speed", "is negative")
    rows.must(rows.speed < FASTEST, "speed", f"is above {FASTEST:g} m/s")
    rows.must(np.abs(rows.station) < FARTHEST, "station", f"is beyond {FARTHEST:g} m")
    rows.must(rows.length > 0.0, "length", "is not positive")
    rows.must(rows.width > 0.0, "width", "is not positive")
    rows.must((rows.lane >= 0) & (rows.lane < lane_count), "lane", f"is outside {lane_count} lanes")
    names, vehicle = np.unique(rows.name, return_inverse=True)
    order, repeated = _sorted(rows, vehicle.astype(np.int64))
    vehicle, time = vehicle[order], rows.time[order]
    speed, station, lane = rows.speed[order], rows.station[order], rows.lane[order]
    new = np.concatenate(([True], np.diff(vehicle) != 0))
    gap, way = np.diff(time), np.abs(np.diff(station))
    apart = np.concatenate(([False], (gap > LONGEST_GAP) | (way > LEAP + 100.0 * gap)))
    part = np.cumsum(new | apart) - 1
    first = np.flatnonzero(new | apart)
    if repeated:
        notes = (*notes, f"{repeated} rows that repeat another one are left out")
    if len(first) > len(names):
        notes = (
            *notes,
            f"{len(first) - len(names)} tracks begin again after a gap of more than "
            f"{LONGEST_GAP:g} s or a jump",
        )
    if rows.speed_column is not None:
        what = f"{rows.source}, column {rows.speed_column!r}"
        check_speeds(what, part, time, station, speed)
    if rows.acceleration is None:
        acceleration = _slope(time, speed, first)
    else:
        rows.must(np.isfinite(rows.acceleration), "acceleration", "is not a finite number")
        acceleration = rows.acceleration[order]
    if rows.leader is None:
        leader = _leaders_ahead(time, lane, station, part)
    else:
        leader = _leaders(names, vehicle, time, part, rows.leader[order])
    return Trajectories(
        source=rows.source,
        ids=_unique_names(names, vehicle[first]),
        kinds=tuple(str(kind) for kind in rows.kind[order][first]),
        length=rows.length[order][first],
        width=rows.width[order][first],
        time=time,
        vehicle=part,
        lane=lane,
        station=station,
        offset=rows.offset[order],
        speed=speed,
        acceleration=acceleration,
        leader=leader,
        lane_count=lane_count,
        lane_width=lane_width,
        notes=notes,
    )


def _leaders_ahead(
    time: FloatArray, lane: IntArray, station: FloatArray, vehicle: IntArray
) -> IntArray:
    """The next vehicle ahead in the same lane at the same instant, -1 for none."""
    instant = np.round(time / INSTANT).astype(np.int64)
    order = np.lexsort((station, lane, instant))
    together = (np.diff(instant[order]) == 0) & (np.diff(lane[order]) == 0)
    leader = np.full(len(time), -1, dtype=np.int64)
    leader[order[:-1][together]] = vehicle[order[1:][together]]
    return leader


def _sorted(rows: Rows, vehicle: IntArray) -> tuple[IntArray, int]:
    """Order by vehicle and time, without repeated rows, and the number of these."""
    order = np.lexsort((rows.time, vehicle))
    same = (np.diff(vehicle[order]) == 0) & (np.diff(rows.time[order]) < INSTANT)
    a, b = order[:-1][same], order[1:][same]
    alike = (
        (np.abs(rows.station[a] - rows.station[b]) < 1e-6)
        & (rows.lane[a] == rows.lane[b])
        & (np.abs(rows.speed[a] - rows.speed[b]) < 1e-6)
    )
    if not alike.all():
        k = int(np.flatnonzero(~alike)[0])
        raise InputError(
            f"{rows.source}, {rows.where(int(a[k]))} and {rows.where(int(b[k]))}: vehicle "
            f"{str(rows.name[a[k]])!r} is at two places at {rows.time[a[k]]:g} s"
        )
    return order[np.concatenate(([True], ~same))], len(a)


def _slope(time: FloatArray, speed: FloatArray, first: IntArray) -> FloatArray:
    """Derivative of the speed within every track; zero for a track of one row."""
    slope = np.zeros_like(speed)
    for a, b in itertools.pairwise([*first, len(time)]):
        if b - a > 1:
            slope[a:b] = np.gradient(speed[a:b], time[a:b])
    return slope


def _leaders(
    names: NDArray[np.generic],
    vehicle: IntArray,
    time: FloatArray,
    part: IntArray,
    leader: NDArray[np.generic],
) -> IntArray:
    """Track of the named leader at the same instant, -1 if it is not in the set."""
    named = find(names, leader)
    row = find(instant_keys(vehicle, time), instant_keys(named, time))
    return np.where((named >= 0) & (row >= 0) & (part[row] != part), part[row], -1)


def _unique_names(names: NDArray[np.generic], vehicle: IntArray) -> tuple[str, ...]:
    """Names of the tracks: the vehicle's name, with #2, #3 ... for its later tracks."""
    result, last, count = [], -1, 0
    for v in vehicle.tolist():
        count = count + 1 if v == last else 1
        last = v
        result.append(str(names[v]) if count == 1 else f"{names[v]}#{count}")
    return tuple(result)
