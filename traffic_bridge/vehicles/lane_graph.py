"""Who is before and behind whom: lanes joined at their ends, and the vehicles on them.

A vehicle's neighbors are those along the lanes it would drive, over the ends of edges and through
junctions, so that gaps are the ones SUMO's car-following sees. Nothing here needs SUMO to run.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from traffic_bridge.vehicles.mobil import MARGIN, Driver, Surroundings, gain

REACH = 300.0  # [m]: a vehicle farther away does not matter
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


@dataclass(slots=True)
class Place:
    """A vehicle on a lane: who, which lane, front bumper's position [m], and its way onward."""

    driver: Driver
    lane: Lane
    position: float
    onward: Onward


class Occupancy:
    """The vehicles of one instant on their lanes.

    Args:
      graph: of the net.
      places: of the vehicles.
      duration: in which a lane change is carried out sideways [s].

    Attributes:
      places: by vehicle name.
    """

    def __init__(self, graph: LaneGraph, places: Iterable[Place], duration: float = 3.5) -> None:
        self._graph = graph
        self._duration = duration
        self.places = {place.driver.name: place for place in places}
        self._leaving: list[tuple[str, Place, float]] = []
        self._rows: dict[str, list[tuple[float, str]]] = {}
        for name, place in self.places.items():
            self._rows.setdefault(place.lane.id, []).append((place.position, name))
        for row in self._rows.values():
            row.sort()

    def note_leaving(self, name: str, lane: str, time: float) -> None:
        """Notes that a vehicle still has a part of its body in a lane that it has left, for a time.

        Args:
          name: of the vehicle.
          lane: id of the lane that it leaves.
          time: until it is out of it [s].
        """
        self._leaving.append((lane, self.places[name], time))

    def is_clear(self, place: Place, lane: Lane) -> bool:
        """Whether a vehicle on a lane beside its own would not meet who is still leaving that."""
        for left, other, time in self._leaving:
            if left != lane.id or other is place:
                continue
            ahead = other.position - other.driver.type.length - place.position
            behind = place.position - place.driver.type.length - other.position
            used = time * (place.driver.speed - other.driver.speed)
            if max(ahead - max(used, 0.0), behind + min(used, 0.0)) < MARGIN:
                return False
        return True

    def move(self, name: str, lane: Lane) -> None:
        """Puts a vehicle onto another lane of its edge, which it leaves in the time of a change."""
        place = self.places[name]
        self.note_leaving(name, place.lane.id, self._duration)
        self._rows[place.lane.id].remove((place.position, name))
        insort(self._rows.setdefault(lane.id, []), (place.position, name))
        place.lane = lane

    def surroundings(self, place: Place, lane: Lane) -> Surroundings:
        """Who is before and behind a vehicle on a lane of its edge.

        A vehicle whose front bumper is level with it or before it is ahead.
        """
        row = self._rows.get(lane.id, [])
        k = bisect_left(row, (place.position, place.driver.name if lane is place.lane else ""))
        mine = k < len(row) and row[k][1] == place.driver.name
        gap_ahead, speed_ahead = self._ahead(place, lane, row, k + mine)
        gap_behind, follower = self._behind(place, lane, row, k - 1)
        return Surroundings(gap_ahead, speed_ahead, gap_behind, follower)

    def _ahead(
        self, place: Place, lane: Lane, row: list[tuple[float, str]], k: int
    ) -> tuple[float, float]:
        way = -place.position  # from the front bumper to the beginning of `lane`
        while k >= len(row):
            way += lane.length
            if way > REACH:
                return math.inf, 0.0
            after = self._graph.after(lane, place.onward)
            if after is None:
                # A lane that ends is left by the vehicle, unless its way ends there too.
                ends = not lane.internal and place.onward(lane.edge) is None
                return (math.inf if ends else way), 0.0
            lane, k = after, 0
            row = self._rows.get(lane.id, [])
        position, name = row[k]
        leader = self.places[name].driver
        if leader is place.driver:  # all around a roundabout
            return math.inf, 0.0
        return way + position - leader.type.length, leader.speed

    def _behind(
        self, place: Place, lane: Lane, row: list[tuple[float, str]], k: int
    ) -> tuple[float, Driver | None]:
        rear = place.position - place.driver.type.length
        if k >= 0:
            position, name = row[k]
            return rear - position, self.places[name].driver
        # Where lanes join, the nearest on any of them counts.
        best: tuple[float, Driver | None] = (math.inf, None)
        todo, known = [(rear, lane)], {lane.id}
        while todo:
            way, lane = todo.pop()
            for before in self._graph.before(lane):
                if before.id in known:
                    continue
                known.add(before.id)
                row = self._rows.get(before.id, [])
                if row:
                    position, name = row[-1]
                    gap = way + before.length - position
                    if gap < min(best[0], REACH) and name != place.driver.name:
                        best = gap, self.places[name].driver
                elif way + before.length < REACH:
                    todo.append((way + before.length, before))
        return best


def decide(
    graph: LaneGraph, occupancy: Occupancy, may_change: Callable[[Place, Lane], bool]
) -> dict[str, Lane]:
    """Lane changes of one round: name -> the lane to go to.

    The vehicles are asked in the order of their names, and each sees the changes decided before
    it, so the result does not hang on SUMO's order and two never take the same gap. Nobody goes to
    a place that another one is about to leave. Of two lanes that gain the same the right one is
    taken.

    Args:
      graph: of the net.
      occupancy: the vehicles; it has the new lanes afterwards.
      may_change: whether a vehicle may go to a lane that lies beside its own.
    """
    changes: dict[str, Lane] = {}
    for name in sorted(occupancy.places):
        place = occupancy.places[name]
        if not place.driver.movable or place.lane.internal:
            continue
        here: Surroundings | None = None
        best, most = None, 0.0
        for side in (-1, 1):
            target = graph.lanes.get(place.lane.beside(side))
            if target is None or not may_change(place, target):
                continue
            if not occupancy.is_clear(place, target):
                continue
            here = here or occupancy.surroundings(place, place.lane)
            there = occupancy.surroundings(place, target)
            value = gain(place.driver, here, there, to_right=side < 0)
            if value is not None and value > most:
                best, most = target, value
        if best is not None:
            occupancy.move(name, best)
            changes[name] = best
    return changes
