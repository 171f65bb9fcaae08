"""How the lanes of a net are joined at their ends. Once read, it needs no SUMO to run."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

# The edge that follows an edge on a vehicle's way; None where its way ends.
Onward = Callable[[str], str | None]


@dataclass(frozen=True, slots=True)
class Lane:
    """One lane of a net.

    Attributes:
      id: SUMO's lane id; edge: its edge; index: from the right.
      length: [m].
      links: (lane that begins at this one's end, edge to which it leads).
    """

    id: str
    edge: str
    index: int
    length: float
    links: tuple[tuple[str, str], ...] = ()

    @property
    def internal(self) -> bool:
        """Inside a junction, where nobody changes lanes."""
        return self.edge.startswith(":")

    def beside(self, side: int) -> str:
        """Id of the lane to the right (-1) or left (+1), whether there is one or not."""
        return f"{self.edge}_{self.index + side}"


class LaneGraph:
    """The lanes of a net and how they are joined.

    Args:
      lanes: all of them.
    """

    def __init__(self, lanes: Iterable[Lane]) -> None:
        self.lanes: Mapping[str, Lane] = {lane.id: lane for lane in lanes}
        self._before: dict[str, list[Lane]] = {name: [] for name in self.lanes}
        for lane in self.lanes.values():
            for after, _ in lane.links:
                if lane not in self._before[after]:
                    self._before[after].append(lane)

    @classmethod
    def read(cls, api: Any) -> LaneGraph:
        """The lanes of the net that SUMO has loaded."""
        lanes = []
        for name in api.lane.getIDList():
            edge, _, index = name.rpartition("_")
            links = tuple(
                (link[4] or link[0], link[0].rpartition("_")[0]) for link in api.lane.getLinks(name)
            )
            lanes.append(Lane(name, edge, int(index), api.lane.getLength(name), links))
        return cls(lanes)

    def after(self, lane: Lane, onward: Onward) -> Lane | None:
        """The lane that a vehicle drives on to at a lane's end; None where it cannot go on."""
        if lane.internal:
            return self.lanes[lane.links[0][0]] if lane.links else None
        edge = onward(lane.edge)
        return next((self.lanes[name] for name, target in lane.links if target == edge), None)

    def before(self, lane: Lane) -> list[Lane]:
        """The lanes whose ends lead to a lane's beginning."""
        return self._before[lane.id]

    def from_entries(self, edges: Collection[str], reach: float) -> dict[str, float]:
        """How far the beginnings of lanes are from where traffic enters [m], by lane.

        Args:
          edges: at whose beginnings it enters.
          reach: lanes farther away are left out [m].
        """
        found = {lane.id: 0.0 for lane in self.lanes.values() if lane.edge in edges}
        todo = list(found)
        while todo:
            lane = self.lanes[todo.pop()]
            way = found[lane.id] + lane.length
            for after, _ in lane.links:
                if way < min(reach, found.get(after, math.inf)):
                    found[after] = way
                    todo.append(after)
        return found
