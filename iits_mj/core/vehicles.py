"""Other road users: one vehicle, and all vehicles of one instant as columns."""

from __future__ import annotations

import itertools
from bisect import bisect_left
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn, overload

import numpy as np
from numpy.typing import NDArray

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import is_number, is_whole, shown
from iits_mj.core.errors import InputError


@dataclass(frozen=True, slots=True)
class TrackedVehicle:
    """Another road user. Its pose is that of the bounding box's center, on the ground.

    Attributes:
      id: stable name.
      kind: "car", "van", "truck" (rigid), "articulated", "pedestrian", "bicycle" or "obstacle".
      x, y, z, yaw: [m], [rad]. Where x, y and z are all zero, the pose is unknown and station and
        offset give the place.
      pitch, roll: of the road under it, in its own direction [rad], pitch positive nose down.
      yaw_rate: [rad/s].
      speed: along its heading [m/s]; acceleration: [m/s2].
      lateral_speed: across the lane, positive to the left [m/s].
      station, offset: of the box's center on the ego route [m].
      lane: index from the outside on the ego route; -1 when it is not on it.
      length, width, height: [m].
    """

    id: str
    kind: str = "car"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    lateral_speed: float = 0.0
    station: float = 0.0
    offset: float = 0.0
    lane: int = 0
    length: float = 4.8
    width: float = 1.9
    height: float = 1.5
    pitch: float = 0.0
    roll: float = 0.0
    yaw_rate: float = 0.0


COLUMNS = (
    *("x", "y", "z", "yaw", "pitch", "roll", "yaw_rate", "speed", "acceleration"),
    *("lateral_speed", "station", "offset", "length", "width", "height"),
)
_PLACE = {name: k for k, name in enumerate(COLUMNS)}


class VehicleFrame(Sequence[TrackedVehicle]):
    """The vehicles at one instant, sorted by id, as columns. Read-only.

    It is a sequence of `TrackedVehicle`, whose rows are made on first use. Code that needs numbers
    of all vehicles (the mirror, a recording, `Neighbors`) reads the columns.

    Args:
      ids: names, sorted, n of them.
      kinds: of each, see `TrackedVehicle`.
      lanes: index of the ego route's lane, -1 off it, shape (n,).
      columns: the numbers named by `COLUMNS`, shape (len(COLUMNS), n); not copied.

    Attributes:
      ids, kinds, lanes: as given.
    """

    __slots__ = ("_addresses", "_columns", "_rows", "ids", "kinds", "lanes")

    def __init__(
        self,
        ids: Sequence[str],
        kinds: Sequence[str],
        lanes: NDArray[np.intp],
        columns: FloatArray,
    ) -> None:
        self.ids = tuple(ids)
        self.kinds = tuple(kinds)
        self.lanes = lanes
        self._columns = columns
        self._rows: tuple[TrackedVehicle, ...] | None = None
        self._addresses: tuple[int, int] | None = None

    def __reduce__(self) -> tuple[type[VehicleFrame], tuple[Any, ...]]:
        return VehicleFrame, (self.ids, self.kinds, self.lanes, self._columns)

    @classmethod
    def empty(cls) -> VehicleFrame:
        """A frame without vehicles."""
        return cls((), (), np.zeros(0, dtype=np.intp), np.zeros((len(COLUMNS), 0)))

    @classmethod
    def of(cls, vehicles: Iterable[TrackedVehicle]) -> VehicleFrame:
        """A frame of the given vehicles; a frame is returned unchanged.

        Raises:
          InputError: an entry is not a vehicle, two share an id, or a number is not finite.
        """
        if isinstance(vehicles, cls):
            return vehicles
        if not isinstance(vehicles, Iterable):
            raise InputError(f"a frame is made of TrackedVehicles, not of {shown(vehicles)}")
        rows = list(vehicles)
        for row in rows:
            if not isinstance(row, TrackedVehicle):
                raise InputError(f"a frame is made of TrackedVehicles, {shown(row)} is none")
            if not isinstance(row.id, str):
                raise InputError(f"vehicle {shown(row.id)}: its id must be a text")
        rows.sort(key=lambda vehicle: vehicle.id)
        ids = [row.id for row in rows]
        if len(set(ids)) != len(ids):
            twice = next(a for a, b in itertools.pairwise(ids) if a == b)
            raise InputError(f"vehicle {twice!r} occurs twice")
        if not all(isinstance(row.kind, str) and is_whole(row.lane) for row in rows):
            _refuse(rows)
        try:
            table = np.array([[getattr(row, name) for row in rows] for name in COLUMNS])
        except ValueError:  # entries of different lengths
            _refuse(rows)
        if table.dtype.kind not in "iuf" or not np.isfinite(table).all():
            _refuse(rows)
        lanes = np.array([row.lane for row in rows], dtype=np.intp)
        columns = table.astype(np.float64).reshape(len(COLUMNS), len(rows))
        return cls(ids, [row.kind for row in rows], lanes, columns)

    @classmethod
    def joined(cls, *frames: VehicleFrame) -> VehicleFrame:
        """The vehicles of several frames, whose ids all differ."""
        ids = [name for frame in frames for name in frame.ids]
        kinds = [kind for frame in frames for kind in frame.kinds]
        order = sorted(range(len(ids)), key=ids.__getitem__)
        return cls(
            [ids[k] for k in order],
            [kinds[k] for k in order],
            np.concatenate([frame.lanes for frame in frames])[order],
            np.concatenate([frame.values for frame in frames]).T[:, order],
        )

    @property
    def values(self) -> FloatArray:
        """All numbers, shape (n, len(COLUMNS))."""
        return self._columns.T

    @property
    def addresses(self) -> tuple[int, int]:
        """Addresses for kernels: of the columns, shape (len(COLUMNS), n), and of the lanes."""
        if self._addresses is None:
            # A frame may hold views of another table.
            self._columns = np.ascontiguousarray(self._columns)
            self.lanes = np.ascontiguousarray(self.lanes)
            self._addresses = kernels.address(self._columns), kernels.address(self.lanes)
        return self._addresses

    def column(self, name: str) -> FloatArray:
        """One column, shape (n,).

        Raises:
          InputError: there is no such column.
        """
        return self._columns[_place(name)]

    def columns(self, *names: str) -> FloatArray:
        """A copy of several columns, shape (len(names), n).

        Raises:
          InputError: there is no such column.
        """
        return self._columns[[_place(name) for name in names]]

    def find(self, vehicle: str) -> TrackedVehicle | None:
        """The vehicle with an id, None if there is none.

        Raises:
          InputError: the id is not a text.
        """
        if not isinstance(vehicle, str):
            raise InputError(f"vehicle {shown(vehicle)}: its id is a text")
        place = bisect_left(self.ids, vehicle)
        if place < len(self.ids) and self.ids[place] == vehicle:
            return self[place]
        return None

    def select(self, chosen: NDArray[Any]) -> VehicleFrame:
        """The vehicles of a mask of shape (n,), or of increasing indices."""
        chosen = np.asarray(chosen)
        where = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        if where.size == len(self):
            return self
        picks = where.tolist()
        return VehicleFrame(
            [self.ids[k] for k in picks],
            [self.kinds[k] for k in picks],
            self.lanes[where],
            self._columns[:, where],
        )

    def without(self, names: Container[str]) -> VehicleFrame:
        """The vehicles whose ids are not among those given."""
        return self.select(np.array([name not in names for name in self.ids], dtype=bool))

    def near(self, x: float, y: float, distance: float) -> VehicleFrame:
        """The vehicles whose center is within a distance of a point of the map [m]."""
        dx, dy = self._columns[0] - x, self._columns[1] - y
        return self.select(dx * dx + dy * dy <= distance * distance)

    def _all(self) -> tuple[TrackedVehicle, ...]:
        if self._rows is None:
            columns = (self.ids, self.kinds, self.lanes.tolist(), self._columns.T.tolist())
            self._rows = tuple(
                TrackedVehicle(id=i, kind=kind, lane=lane, **dict(zip(COLUMNS, row, strict=True)))
                for i, kind, lane, row in zip(*columns, strict=True)
            )
        return self._rows

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[TrackedVehicle]:
        return iter(self._all())

    @overload
    def __getitem__(self, index: int) -> TrackedVehicle: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[TrackedVehicle, ...]: ...
    def __getitem__(self, index: int | slice) -> TrackedVehicle | tuple[TrackedVehicle, ...]:
        return self._all()[index]

    def __eq__(self, other: object) -> bool:
        if isinstance(other, VehicleFrame):
            return (
                self.ids == other.ids
                and self.kinds == other.kinds
                and np.array_equal(self.lanes, other.lanes)
                and np.array_equal(self._columns, other._columns)
            )
        if isinstance(other, Sequence):
            return self._all() == tuple(other)
        return NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"VehicleFrame of {len(self)}: {', '.join(self.ids[:5])}{' ...' * (len(self) > 5)}"


def _place(column: str) -> int:
    try:
        return _PLACE[column]
    except (KeyError, TypeError):
        raise InputError(f"column {shown(column)}: allowed are {', '.join(COLUMNS)}") from None


def _refuse(rows: Sequence[TrackedVehicle]) -> NoReturn:
    """Raises an error that names the first value of a wrong type or that is not finite."""
    for row in rows:
        if not isinstance(row.kind, str):
            raise InputError(f"vehicle {row.id!r}: kind is {shown(row.kind)}: not a text")
        if not is_whole(row.lane):
            raise InputError(f"vehicle {row.id!r}: lane is {shown(row.lane)}: not a whole number")
        for name in COLUMNS:
            if not is_number(value := getattr(row, name)):
                raise InputError(f"vehicle {row.id!r}: {name} is {shown(value)}: not finite")
    raise InputError("a number of a vehicle is beyond the range of a float")
