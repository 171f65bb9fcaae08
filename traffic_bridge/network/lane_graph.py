"""How the lanes of a net are joined at their ends. Once read, it needs no SUMO to run."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from iits_mj.core.errors import TrafficError
from iits_mj.road import Route
from traffic_bridge.network.net_file import NetFile, NetLane

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


# --- The edges of a loaded net along a route's roads ---


class RouteEdges:
    """Finds the edges that netconvert has made of a route's roads.

    Args:
      api: of the loaded simulation.
      route: the ego's road.
    """

    def __init__(self, api: Any, route: Route) -> None:
        self._api = api
        self._route = route

    def along(self, sense: int) -> tuple[str, ...]:
        """Edges in driving order, along the route (+1) or on its way back (-1, empty for none).

        Raises:
          TrafficError: the net does not hold the route's roads.
        """
        known = [edge for edge in self._api.edge.getIDList() if not edge.startswith(":")]
        segments = self._route.segments if sense > 0 else reversed(self._route.segments)
        chain: list[str] = []
        for segment in segments:
            # A road inside a junction has become internal lanes between two edges.
            if self._in_junction(segment.road_id):
                continue
            base = ("-" if segment.direction * sense > 0 else "") + segment.road_id
            pieces = [e for e in known if e == base or re.fullmatch(_pieces(base), e)]
            if not pieces and sense < 0:
                return ()
            if not pieces:
                raise TrafficError(
                    f"the SUMO net has no edge for road {segment.road_id!r} of the route; "
                    "was it made from another map?"
                )
            chain += self._in_order(pieces)
        return tuple(dict.fromkeys(chain))

    def _in_junction(self, road_id: str) -> bool:
        return self._route.road_map.roads[road_id].junction not in (None, "-1", "")

    def _in_order(self, pieces: list[str]) -> list[str]:
        """Edges that netconvert cut from one road, in driving order (a loop begins anywhere)."""
        following = {}
        for edge in pieces:
            targets = {target for target, _ in links_of(self._api, edge)}
            following[edge] = next((e for e in pieces if e in targets and e != edge), None)
        reached = set(following.values())
        first = next((e for e in pieces if e not in reached), min(pieces))
        ordered = [first]
        while (after := following[ordered[-1]]) is not None and after not in ordered:
            ordered.append(after)
        return ordered


def links_of(api: Any, edge: str) -> list[tuple[str, str]]:
    """(edge, internal lane or "") that can be reached from an edge of a loaded net."""
    found = []
    for i in range(api.edge.getLaneNumber(edge)):
        for link in api.lane.getLinks(f"{edge}_{i}"):
            found.append((link[0].rpartition("_")[0], link[4]))
    return found


def _pieces(base: str) -> str:
    """Pattern of the edges netconvert makes when it splits a road: `-1#1`, `-1.250.00`."""
    return re.escape(base) + r"(#\d+|\.\d+(\.\d+)?)+"


# --- How far one can drive along a way without changing lanes ---

LOOK_AHEAD = 400.0  # [m] in which slower lanes matter
GENTLE = 1.2  # [m/s2], a braking every vehicle can do (judgement)


class LaneWays:
    """Which lanes lead on to which, for the lanes of a net that are open to cars."""

    def __init__(self, net: NetFile) -> None:
        self._lanes = {lane.id: lane for edge in net.edges for lane in edge.lanes}
        self._after: dict[str, list[str]] = {}
        for link in net.connections:
            if not link.start.startswith(":") and self._lanes[link.end].is_driving:
                self._after.setdefault(link.start, []).append(link.end)
        self._rooms: dict[tuple[str, tuple[str, ...]], float] = {}

    def lane(self, name: str) -> NetLane:
        """The net's record of a lane."""
        return self._lanes[name]

    def leads_to(self, lane: str) -> list[str]:
        """Lanes that a lane leads to, over the junction, sorted."""
        return sorted(self._after.get(lane, ()))

    def room(self, lane: str, edges: tuple[str, ...]) -> float:
        """Distance from the beginning of a lane to where one must have left it [m].

        Args:
          lane: on the first edge.
          edges: to drive along.

        Returns:
          Infinite where the lane leads along all edges; 0 where cars may not drive on it.
        """
        key = (lane, edges)
        if key not in self._rooms:
            self._rooms[key] = self._find_room(lane, edges)
        return self._rooms[key]

    def speed(self, lane: str, position: float, edges: tuple[str, ...]) -> float:
        """Highest speed at which SUMO lets a vehicle begin at a place [m/s].

        Nobody begins faster than the limit of a lane within the distance in which it could stop.

        Args:
          lane: on the first edge.
          position: on it [m].
          edges: to drive along.
        """
        here = self._lanes[lane]
        limit, way = here.speed, here.length - position
        for edge in edges[1:]:
            if way > LOOK_AHEAD:
                break
            ahead = [end for end in self.leads_to(lane) if end.rpartition("_")[0] == edge]
            if not ahead:
                break
            lane = ahead[0]
            slowest = self._lanes[lane].speed
            limit = min(limit, max(slowest, math.sqrt(2.0 * GENTLE * max(way, 0.0))))
            way += self._lanes[lane].length
        return limit

    def _find_room(self, lane: str, edges: tuple[str, ...]) -> float:
        if not self._lanes[lane].is_driving:
            return 0.0
        # From the last edge backwards: one lane may be followed by several, the best counts.
        reach: dict[str, float] = {}
        for here, after in zip(reversed(edges), (None, *reversed(edges[1:])), strict=True):
            at_edge = {}
            for name in (lane,) if here == edges[0] else self._of_edge(here):
                if after is None:
                    at_edge[name] = math.inf
                    continue
                rooms = [reach[end] for end in self._after.get(name, ()) if end in reach]
                at_edge[name] = self._lanes[name].length + max(rooms, default=0.0)
            reach = at_edge
        return reach[lane]

    def _of_edge(self, edge: str) -> list[str]:
        found: list[str] = []
        while (name := f"{edge}_{len(found)}") in self._lanes:
            found.append(name)
        return found
