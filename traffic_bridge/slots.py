"""Who is shown in which body: the nearest of each type, who keep it while they are near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from traffic_bridge.frame import VehicleFrame
from traffic_bridge.vehicles import VehicleType

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# A vehicle with a slot counts as this much nearer, so that two at the edge do not take turns.
LOYALTY = 0.85


@dataclass
class Slot:
    """Place for one vehicle in the model.

    Attributes:
      place: in the pool; type: number of the vehicle type; paint: number of its color.
      vehicle: who is shown there.
      row: of the vehicle in the newest frame.
    """

    place: int
    type: int
    paint: int
    vehicle: str | None = None
    row: int = -1


class Slots:
    """The pool of slots and who has them.

    A type's slots go to its nearest vehicles within range. Who has one keeps it until another
    without one is nearer by the factor `LOYALTY`, or until it is out of range by that factor. A
    free slot of the vehicle's own color is preferred, and one that was empty already to one that
    loses its vehicle in the same frame.

    Args:
      types: of vehicles.
      counts: slots of each type.
      view_range: beyond it nobody gets a slot [m].
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
        # The last place is for vehicles that no type fits.
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
        """Takes everybody's slot."""
        for slot in self.all:
            slot.vehicle, slot.row = None, -1
        self.taken: list[Slot] = []
        self._holders: dict[str, Slot] = {}
        self._ids: tuple[str, ...] = ()
        self._types = np.zeros(0, dtype=np.intp)
        self._held = np.zeros(0, dtype=bool)
        self._type_of: dict[str, int] = {}

    def assign(self, frame: VehicleFrame, x: float, y: float) -> list[Slot]:
        """Gives the slots to the nearest vehicles of a frame.

        Args:
          frame: of the traffic.
          x: where the truck is [m].
          y: as x.

        Returns:
          Slots that changed hands or were left; `taken` and the slots' rows are new as well.
        """
        same = frame.ids == self._ids
        if not same:
            self._read(frame)
        if not frame.ids and not self.taken:
            return []
        dx, dy = frame.column("x") - x, frame.column("y") - y
        key = (dx * dx + dy * dy) * np.where(self._held, LOYALTY**2, 1.0)
        # Stable: equally near vehicles come by their ids.
        order = np.lexsort((key, self._types))
        types = self._types[order]
        rank = np.arange(types.size) - np.searchsorted(types, types)
        chosen = np.zeros(types.size, dtype=bool)
        chosen[order] = (rank < self._capacity[types]) & (key[order] <= self._limit)
        gone = [slot for slot in self.taken if slot.row < 0 or not chosen[slot.row]]
        if not gone and np.count_nonzero(chosen) == len(self.taken):
            return []
        return self._hand_over(frame, gone, np.flatnonzero(chosen & ~self._held).tolist())

    def _hand_over(self, frame: VehicleFrame, gone: list[Slot], rows: list[int]) -> list[Slot]:
        for slot in gone:
            if slot.row >= 0:
                self._held[slot.row] = False
            del self._holders[slot.vehicle or ""]
            slot.vehicle, slot.row = None, -1
        changed = {slot.place: slot for slot in gone}
        for row in rows:
            number, name = int(self._types[row]), frame.ids[row]
            kind = self.types[number]
            paint = kind.colors.index(kind.color_of(name))
            free = [slot for slot in self.all if slot.vehicle is None and slot.type == number]
            slot = min(
                free,
                key=lambda s: (s.place in changed, (s.paint - paint) % len(kind.colors)),
            )
            slot.vehicle, slot.row = name, row
            self._held[row] = True
            self._holders[name] = slot
            changed[slot.place] = slot
        self.taken = [slot for slot in self.all if slot.vehicle is not None]
        return list(changed.values())

    def _read(self, frame: VehicleFrame) -> None:
        """Takes a frame of other vehicles than the last one."""
        place = {name: row for row, name in enumerate(frame.ids)}
        self._held = np.zeros(len(place), dtype=bool)
        for slot in self.taken:
            slot.row = place.get(slot.vehicle or "", -1)
            if slot.row >= 0:
                self._held[slot.row] = True
        known = self._type_of
        if not known.keys() >= place.keys():
            known.update(
                (name, self._type(frame, row)) for name, row in place.items() if name not in known
            )
        self._type_of = {name: known[name] for name in place}
        self._types = np.fromiter(self._type_of.values(), dtype=np.intp, count=len(place))
        self._ids = frame.ids

    def _type(self, frame: VehicleFrame, row: int) -> int:
        """The type of a vehicle's look whose size is the nearest to its own."""
        candidates = self._sizes.get(frame.kinds[row], ())
        size = frame.columns("length", "width", "height")[:, row]
        return min(
            candidates,
            key=lambda entry: float(np.abs(entry[1] - size).sum()),
            default=(len(self.types), size),
        )[0]
