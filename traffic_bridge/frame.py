"""The vehicles at one instant, by columns: what every mode returns.

A frame is a sequence of `TrackedVehicle`; its rows are made when they are asked for. Who needs
numbers of all vehicles (the mirror, a recording, an observation) takes the columns.
"""

from __future__ import annotations

import itertools
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NoReturn, overload

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import is_number, is_whole, shown
from iits_mj.core.errors import InputError
from iits_mj.core.messages import TrackedVehicle

COLUMNS = (
    "x",
    "y",
    "z",
    "yaw",
    "pitch",
    "roll",
    "yaw_rate",
    "speed",
    "acceleration",
    "lateral_speed",
    "station",
    "offset",
    "length",
    "width",
    "height",
)
_PLACE = {name: k for k, name in enumerate(COLUMNS)}


class VehicleFrame(Sequence[TrackedVehicle]):
    """The vehicles at one instant, sorted by id. Not to be changed.

    Args:
      ids: names, sorted, n of them.
      kinds: of each, see `TrackedVehicle`.
      lanes: index of the ego route's lane, -1 off it, shape (n,).
      columns: the figures named by `COLUMNS`, shape (len(COLUMNS), n); not copied.

    Attributes:
      ids, kinds, lanes: as given.
    """

    __slots__ = ("_columns", "_rows", "ids", "kinds", "lanes")

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

    @classmethod
    def empty(cls) -> VehicleFrame:
        """A frame without vehicles."""
        return cls((), (), np.zeros(0, dtype=np.intp), np.zeros((len(COLUMNS), 0)))

    @classmethod
    def of(cls, vehicles: Iterable[TrackedVehicle]) -> VehicleFrame:
        """A frame of the given vehicles; one that is a frame already is returned as it is.

        Raises:
          InputError: something is no vehicle, two have one id, or a figure is no finite number.
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
            raise InputError(f"vehicle {twice!r} is there twice")
        if not all(isinstance(row.kind, str) and is_whole(row.lane) for row in rows):
            _refuse(rows)
        try:
            table = np.array([[getattr(row, name) for row in rows] for name in COLUMNS])
        except ValueError:  # something with a length of its own
            _refuse(rows)
        if table.dtype.kind not in "iuf" or not np.isfinite(table).all():
            _refuse(rows)
        lanes = np.array([row.lane for row in rows], dtype=np.intp)
        columns = table.astype(np.float64).reshape(len(COLUMNS), len(rows))
        return cls(ids, [row.kind for row in rows], lanes, columns)

    @property
    def values(self) -> FloatArray:
        """All figures, shape (n, len(COLUMNS))."""
        return self._columns.T

    def column(self, name: str) -> FloatArray:
        """One figure of all vehicles, shape (n,).

        Raises:
          InputError: there is no such column.
        """
        return self._columns[_place(name)]

    def columns(self, *names: str) -> FloatArray:
        """Several figures of all vehicles, shape (len(names), n), copied.

        Raises:
          InputError: there is no such column.
        """
        return self._columns[[_place(name) for name in names]]

    def find(self, vehicle: str) -> TrackedVehicle | None:
        """The vehicle of an id, None if it is not there.

        Raises:
          InputError: the id is no text.
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

    def near(self, x: float, y: float, distance: float) -> VehicleFrame:
        """The vehicles whose centre is within a distance of a point of the map [m]."""
        dx, dy = self._columns[0] - x, self._columns[1] - y
        return self.select(dx * dx + dy * dy <= distance * distance)

    # Sequence ----------------------------------------------------------------------------------

    def _all(self) -> tuple[TrackedVehicle, ...]:
        if self._rows is None:
            self._rows = tuple(
                TrackedVehicle(
                    id=name, kind=kind, lane=lane, **dict(zip(COLUMNS, row, strict=True))
                )
                for name, kind, lane, row in zip(
                    self.ids, self.kinds, self.lanes.tolist(), self._columns.T.tolist(), strict=True
                )
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
    """Names the first figure that is not what it should be."""
    for row in rows:
        if not isinstance(row.kind, str):
            raise InputError(f"vehicle {row.id!r}: kind is {shown(row.kind)}: not a text")
        if not is_whole(row.lane):
            raise InputError(f"vehicle {row.id!r}: lane is {shown(row.lane)}: not a whole number")
        for name in COLUMNS:
            if not is_number(value := getattr(row, name)):
                raise InputError(f"vehicle {row.id!r}: {name} is {shown(value)}: not finite")
    raise InputError("a vehicle has a figure beyond what a float holds")
