"""Assigns bodies to vehicles: the nearest vehicles of each type get one and keep it while near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj import kernels
from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.vehicles.types import VehicleType

# The distance of a vehicle with a slot counts less, so that two at the edge do not alternate.
LOYALTY = 0.85
APART = 1e12  # [m2] between the types in a common ranking by squared distance

_choose = kernels.function(
    "iits_mirror_choose",
    kernels.Integer,
    *(kernels.Integer, kernels.Address, *2 * [kernels.Real], *3 * [kernels.Address]),
)


@dataclass
class Slot:
    """The bodies for one vehicle in the model.

    Attributes:
      place: index in the pool; type: number of the vehicle type; paint: number of its color.
      vehicle: id of the shown vehicle, None if free.
      row: of the vehicle in the newest frame, -1 if it is not there.
    """

    place: int
    type: int
    paint: int
    vehicle: str | None = None
    row: int = -1


class Slots:
    """The pool of slots and the vehicles in them.

    A type's slots go to its nearest vehicles within range. A vehicle keeps its slot until another
    one is nearer by the factor `LOYALTY`, or until it is out of range by that factor. Free slots of
    the vehicle's own color are preferred; slots that were already empty are preferred to those that
    lose their vehicle in the same frame.

    Args:
      types: of vehicles.
      counts: slots of each type.
      view_range: vehicles farther away get no slot [m].

    Attributes:
      all: every slot, by type; taken: those with a vehicle, in the same order.
      rows: of the vehicles in the newest frame, in the order of `taken`.
    """

    def __init__(
        self, types: Sequence[VehicleType], counts: Sequence[int], view_range: float
    ) -> None:
        self.types = tuple(types)
        pool = [
            (number, k % len(kind.colors))
            for number, (kind, count) in enumerate(zip(types, counts, strict=True))
            for k in range(count)
        ]
        self.all = [Slot(place, number, paint) for place, (number, paint) in enumerate(pool)]
        self._limit = view_range**2
        # The last entry is for vehicles that fit no type.
        self._capacity = np.array([*counts, 0], dtype=np.intp)
        self._sizes = {
            look: [
                (number, np.array([kind.length, kind.width, kind.height]))
                for number, kind in enumerate(types)
                if kind.look == look
            ]
            for look in {kind.look for kind in types}
        }
        self.clear()

    def clear(self) -> None:
        """Frees all slots."""
        for slot in self.all:
            slot.vehicle, slot.row = None, -1
        self.taken: list[Slot] = []
        self.rows = np.zeros(0, dtype=np.intp)
        self._ids: tuple[str, ...] = ()
        self._type_of: dict[str, int] = {}
        self._types = np.zeros(0, dtype=np.intp)
        self._missing = False
        self._rank()

    def assign(self, frame: VehicleFrame, x: float, y: float) -> list[Slot]:
        """Gives the slots to the nearest vehicles of a frame.

        Args:
          frame: of the traffic.
          x: of the truck [m].
          y: of the truck [m].

        Returns:
          Slots that got another vehicle or became free; `taken` and `rows` are updated.
        """
        if frame.ids != self._ids:
            self._read(frame)
        # The first columns are the vehicles' x and y.
        places, _ = frame.addresses
        tables = self._ranking.address, self._work.address, self._chosen.address
        changes = _choose(len(frame), places, x, y, *tables)
        if not changes and not self._missing:
            return []
        chosen = self._chosen.numbers != 0.0
        gone = [slot for slot in self.taken if slot.row < 0 or not chosen[slot.row]]
        for slot in gone:
            slot.vehicle, slot.row = None, -1
        changed = {slot.place: slot for slot in gone}
        held = self._ranking.numbers[3] != 0.0
        for row in np.flatnonzero(chosen & ~held).tolist():
            slot = self._free_slot(int(self._types[row]), frame.ids[row], changed)
            slot.vehicle, slot.row = frame.ids[row], row
            changed[slot.place] = slot
        self.taken = [slot for slot in self.all if slot.vehicle is not None]
        self._missing = False
        self._take_rows()
        return list(changed.values())

    def _free_slot(self, number: int, vehicle: str, changed: dict[int, Slot]) -> Slot:
        kind = self.types[number]
        paint = kind.colors.index(kind.color_of(vehicle))
        free = [slot for slot in self.all if slot.vehicle is None and slot.type == number]
        return min(
            free,
            key=lambda slot: (slot.place in changed, (slot.paint - paint) % len(kind.colors)),
        )

    def _take_rows(self) -> None:
        """Notes the rows of the shown vehicles in the frame, and that they count as nearer."""
        self.rows = np.array([slot.row for slot in self.taken], dtype=np.intp)
        weights, _, _, held = self._ranking.numbers
        held[:] = 0.0
        held[self.rows[self.rows >= 0]] = 1.0
        weights[:] = np.where(held, LOYALTY**2, 1.0)

    def _read(self, frame: VehicleFrame) -> None:
        """Takes a frame whose vehicles differ from the last one's."""
        place = {name: row for row, name in enumerate(frame.ids)}
        known = self._type_of
        if not known.keys() >= place.keys():
            known.update(
                (name, self._type(frame, row)) for name, row in place.items() if name not in known
            )
        self._type_of = {name: known[name] for name in place}
        self._types = np.fromiter(self._type_of.values(), dtype=np.intp, count=len(place))
        self._ids = frame.ids
        for slot in self.taken:
            slot.row = place.get(slot.vehicle or "", -1)
            self._missing = self._missing or slot.row < 0
        self._rank()
        self._take_rows()

    def _rank(self) -> None:
        """Prepares the ranking: the keys up to which vehicles of each type get a slot."""
        count = self._types.size
        ranked = np.sort(self._types)
        place = np.arange(count) - np.searchsorted(ranked, ranked)
        limits = np.where(place < self._capacity[ranked], APART * ranked + self._limit, -1.0)
        # Weights, bases, limits, and the vehicles shown last; then work and result of `_choose`.
        self._ranking = kernels.Table(
            (np.ones(count), APART * self._types, limits, np.zeros(count))
        )
        self._work = kernels.Table(np.empty((2, count)))
        self._chosen = kernels.Table(np.empty(count))

    def _type(self, frame: VehicleFrame, row: int) -> int:
        """Number of the type with the vehicle's look and the most similar size."""
        candidates = self._sizes.get(frame.kinds[row], ())
        size = frame.columns("length", "width", "height")[:, row]
        return min(
            candidates,
            key=lambda entry: float(np.abs(entry[1] - size).sum()),
            default=(len(self.types), size),
        )[0]
