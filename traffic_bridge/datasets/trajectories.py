"""Recorded trajectories of vehicles on one road in SI units, and their leader-follower pairs.

Every reader of `traffic_bridge.datasets` returns a `Trajectories`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError
from traffic_bridge.vehicles.types import KINDS

INSTANT = 1e-3  # [s]: rows nearer in time than this belong to the same instant
LATEST = 1e8  # [s]
_FLOATS = ("time", "station", "offset", "speed", "acceleration")
_INTEGERS = ("vehicle", "lane", "leader")
_ROWS = (*_FLOATS, *_INTEGERS)


@dataclass(frozen=True, eq=False)
class Trajectories:
    """m vehicles in k rows, one per vehicle and instant, sorted by vehicle, then by time.

    The arrays are checked when the object is made, and are read-only.

    Attributes:
      source: their origin in words, for messages.
      ids: names of the vehicles, each once; kinds: "car", "van", "truck" or "articulated".
      length, width: of the vehicles, shape (m,) [m].
      time: [s], shape (k,), with the data set's zero.
      vehicle: index into the vehicle arrays, shape (k,).
      lane: index from the outside, shape (k,).
      station: of the front bumper along the road, shape (k,) [m].
      offset: of the vehicle's middle from the center of its lane, positive to the left, shape (k,)
        [m].
      speed: along the road, zero or positive, shape (k,) [m/s].
      acceleration: along the road, shape (k,) [m/s2].
      leader: index of the vehicle ahead in the lane, -1 if there is none or it is unknown.
      lane_count: number of lanes of the road.
      lane_width: of the recorded road [m].
      notes: omitted and derived data, in words.

    Raises:
      InputError: an array does not fit the others, or has an impossible value.
    """

    source: str
    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    length: FloatArray
    width: FloatArray
    time: FloatArray
    vehicle: IntArray
    lane: IntArray
    station: FloatArray
    offset: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    leader: IntArray
    lane_count: int
    lane_width: float = 3.5
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Copies the arrays with the right types, checks them, and makes them read-only."""
        for name in ("length", "width", *_FLOATS):
            self._lock(name, np.array(getattr(self, name), dtype=np.float64))
        for name in _INTEGERS:
            self._lock(name, np.array(getattr(self, name), dtype=np.int64))
        self._check_vehicles()
        self._check_rows()

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.time)

    @cached_property
    def start(self) -> IntArray:
        """Rows of vehicle i are `start[i]` to `start[i + 1]`, shape (m + 1,)."""
        return np.searchsorted(self.vehicle, np.arange(len(self.ids) + 1)).astype(np.int64)

    def rows(self, vehicle: int | str) -> slice:
        """Rows of one vehicle, by index or name.

        Raises:
          InputError: there is no such vehicle.
        """
        index = self.index_of(vehicle) if isinstance(vehicle, str) else vehicle
        if not 0 <= index < len(self.ids):
            raise InputError(f"{self.source}: no vehicle {vehicle!r} among {len(self.ids)}")
        return slice(int(self.start[index]), int(self.start[index + 1]))

    def index_of(self, name: str) -> int:
        """Index of a vehicle by its name.

        Raises:
          InputError: there is no such vehicle.
        """
        try:
            return self._index[name]
        except KeyError:
            raise InputError(f"{self.source}: no vehicle {name!r}") from None

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.ids)}

    @cached_property
    def step(self) -> float:
        """Median time between the rows of a vehicle [s]; 0 if none has two rows."""
        gaps = np.diff(self.time)[np.diff(self.vehicle) == 0]
        return float(np.round(np.median(gaps), 6)) if gaps.size else 0.0

    @property
    def duration(self) -> float:
        """From the first to the last row [s]."""
        return float(np.ptp(self.time)) if len(self) else 0.0

    @cached_property
    def leader_rows(self) -> IntArray:
        """Row of each row's leader at the same instant, -1 where there is none, shape (k,)."""
        return self.find_rows(self.leader, self.time)

    def find_rows(self, vehicle: ArrayLike, time: ArrayLike) -> IntArray:
        """Rows of given vehicles at given times, -1 where there is none, shape (n,).

        Args:
          vehicle: indices, shape (n,); negative ones have no row.
          time: [s], shape (n,).
        """
        number = np.asarray(vehicle, dtype=np.int64)
        row = find(
            instant_keys(self.vehicle, self.time), instant_keys(number, np.asarray(time, float))
        )
        return np.where(number >= 0, row, -1)

    def select(self, keep: ArrayLike) -> Trajectories:
        """The rows of a mask of shape (k,); vehicles without rows are left out, also as leaders."""
        mask = np.asarray(keep, dtype=bool)
        if mask.shape != self.time.shape:
            raise InputError(f"mask of shape {mask.shape}: there are {len(self)} rows")
        stay = np.unique(self.vehicle[mask])
        new = np.full(len(self.ids) + 1, -1, dtype=np.int64)
        new[stay] = np.arange(len(stay))
        columns = {name: getattr(self, name)[mask] for name in _FLOATS}
        return replace(
            self,
            ids=tuple(self.ids[i] for i in stay),
            kinds=tuple(self.kinds[i] for i in stay),
            length=self.length[stay],
            width=self.width[stay],
            vehicle=new[self.vehicle[mask]],
            lane=self.lane[mask],
            leader=new[self.leader[mask]],
            **columns,
        )

    def between(self, start: float, end: float) -> Trajectories:
        """The rows from the time `start` up to, not including, `end` [s]."""
        return self.select((self.time >= start - 0.5 * INSTANT) & (self.time < end - 0.5 * INSTANT))

    def _lock(self, name: str, array: NDArray[np.generic]) -> None:
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def _check_vehicles(self) -> None:
        count = len(self.ids)
        if len(set(self.ids)) != count:
            twice = next(name for i, name in enumerate(self.ids) if name in self.ids[:i])
            raise InputError(f"{self.source}: vehicle {twice!r} occurs twice")
        if (
            len(self.kinds) != count
            or self.length.shape != (count,)
            or self.width.shape != (count,)
        ):
            raise InputError(
                f"{self.source}: {count} ids, {len(self.kinds)} kinds, lengths of shape "
                f"{self.length.shape}, widths of shape {self.width.shape}: must be equal numbers"
            )
        for name, kind in zip(self.ids, self.kinds, strict=True):
            if kind not in KINDS:
                raise InputError(
                    f"{self.source}: vehicle {name!r} is a {kind!r}; known are {', '.join(KINDS)}"
                )
        for what, sizes in (("length", self.length), ("width", self.width)):
            wrong = np.flatnonzero(~(np.isfinite(sizes) & (sizes > 0.0) & (sizes < 100.0)))
            if wrong.size:
                raise InputError(
                    f"{self.source}: {what} of vehicle {self.ids[wrong[0]]!r} is "
                    f"{sizes[wrong[0]]:g} m: must be positive and below 100 m"
                )
        if not (1 <= self.lane_count <= 50 and 1.0 <= self.lane_width <= 20.0):
            raise InputError(
                f"{self.source}: {self.lane_count} lanes of {self.lane_width} m: allowed are "
                "1 to 50 lanes of 1 to 20 m"
            )

    def _check_rows(self) -> None:
        shapes = {name: getattr(self, name).shape for name in _ROWS}
        if len(set(shapes.values())) != 1 or self.time.ndim != 1:
            raise InputError(f"{self.source}: columns of different shapes: {shapes}")
        count = len(self.ids)
        if len(self) and not (self.vehicle.min() >= 0 and self.vehicle.max() < count):
            raise InputError(f"{self.source}: a row names a vehicle outside the {count} given")
        for name in _FLOATS:
            column = getattr(self, name)
            self._must(np.isfinite(column), name, column, "must be finite")
        self._must(np.abs(self.time) < LATEST, "time", self.time, "must be below 1e8 s")
        self._must(self.speed >= 0.0, "speed", self.speed, "must be zero or positive")
        later = np.diff(self.time) >= INSTANT
        order = (np.diff(self.vehicle) > 0) | ((np.diff(self.vehicle) == 0) & later)
        self._must(
            np.concatenate(([True], order))[: len(self)],
            "time",
            self.time,
            "rows must be sorted by vehicle, then by increasing time",
        )
        if np.any(np.diff(self.start) == 0):
            empty = int(np.flatnonzero(np.diff(self.start) == 0)[0])
            raise InputError(f"{self.source}: vehicle {self.ids[empty]!r} has no rows")
        in_range = (self.lane >= 0) & (self.lane < self.lane_count)
        self._must(in_range, "lane", self.lane, f"must be 0 to {self.lane_count - 1}")
        known = (self.leader >= -1) & (self.leader < count) & (self.leader != self.vehicle)
        self._must(known, "leader", self.leader, "must be another vehicle's index, or -1")

    def _must(self, good: BoolArray, name: str, column: NDArray[np.generic], what: str) -> None:
        wrong = np.flatnonzero(~good)
        if wrong.size:
            k = int(wrong[0])
            number = int(self.vehicle[k])
            who = self.ids[number] if 0 <= number < len(self.ids) else number
            raise InputError(
                f"{self.source}: {name} of vehicle {who!r} at {self.time[k]:g} s is "
                f"{column[k]:g}: {what}"
            )


def instant_keys(vehicle: IntArray, time: FloatArray) -> IntArray:
    """One integer for each vehicle and instant, in the order of the rows."""
    instant = np.round(time / INSTANT).astype(np.int64)
    return vehicle * np.int64(2**40) + (instant + np.int64(2**38))


def find(keys: NDArray[np.generic], wanted: NDArray[np.generic]) -> IntArray:
    """Index of each wanted key in the increasing keys, -1 where it is missing."""
    if not len(keys):
        return np.full(wanted.shape, -1, dtype=np.int64)
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[place] == wanted, place, -1)


@dataclass(frozen=True, eq=False)
class Pair:
    """A vehicle that follows the same leader without interruption; arrays of shape (n,).

    Attributes:
      follower, leader: names; kind: of the follower.
      lane: of the follower at the beginning, index from the outside.
      leader_length: [m].
      time: [s], evenly spaced.
      station, speed, acceleration: of the follower, front bumper [m], [m/s], [m/s2].
      leader_station, leader_speed, leader_acceleration: of the leader, front bumper.
    """

    follower: str
    leader: str
    kind: str
    lane: int
    leader_length: float
    time: FloatArray
    station: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    leader_station: FloatArray
    leader_speed: FloatArray
    leader_acceleration: FloatArray

    @property
    def gap(self) -> FloatArray:
        """From the follower's front to the leader's rear [m], shape (n,)."""
        return self.leader_station - self.leader_length - self.station

    @property
    def duration(self) -> float:
        """Duration of the pair [s]."""
        return float(self.time[-1] - self.time[0])


def pairs(trajectories: Trajectories, minimum_duration: float = 15.0) -> tuple[Pair, ...]:
    """All stretches in which a vehicle follows one leader and both are recorded.

    A stretch ends when the leader changes, when follower or leader is missing for an instant, or
    when the follower changes lanes.

    Args:
      trajectories: of any source.
      minimum_duration: shorter stretches are left out [s].

    Raises:
      InputError: the duration is not positive.
    """
    if not (np.isfinite(minimum_duration) and minimum_duration > 0.0):
        raise InputError(f"minimum_duration {minimum_duration!r}: must be positive")
    t = trajectories
    ahead = t.leader_rows
    if not len(t):
        return ()
    goes_on = (
        (np.diff(t.vehicle) == 0)
        & (np.diff(t.leader) == 0)
        & (np.diff(t.lane) == 0)
        & (np.diff(t.time) < 1.5 * t.step)
        & (ahead[1:] >= 0)
        & (ahead[:-1] >= 0)
    )
    starts = np.concatenate(([0], np.flatnonzero(~goes_on) + 1))
    ends = np.concatenate((starts[1:], [len(t)]))
    long = (t.time[ends - 1] - t.time[starts] >= minimum_duration - 1e-6) & (ahead[starts] >= 0)
    return tuple(_pair(t, slice(a, b)) for a, b in zip(starts[long], ends[long], strict=True))


def _pair(t: Trajectories, rows: slice) -> Pair:
    ahead = t.leader_rows[rows]
    first = rows.start
    return Pair(
        follower=t.ids[t.vehicle[first]],
        leader=t.ids[t.leader[first]],
        kind=t.kinds[t.vehicle[first]],
        lane=int(t.lane[first]),
        leader_length=float(t.length[t.leader[first]]),
        time=t.time[rows],
        station=t.station[rows],
        speed=t.speed[rows],
        acceleration=t.acceleration[rows],
        leader_station=t.station[ahead],
        leader_speed=t.speed[ahead],
        leader_acceleration=t.acceleration[ahead],
    )
