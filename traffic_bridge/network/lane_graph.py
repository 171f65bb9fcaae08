"""Connections between the lanes and edges of a net, and the quickest paths through it."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.road import Route
from traffic_bridge.network.net_file import NetEdge, NetFile, NetLane

# The next edge on a vehicle's way; None at its end.
Onward = Callable[[str], str | None]

LOOK_AHEAD = 400.0  # [m] ahead of a vehicle in which the limits of lanes matter
GENTLE = 1.2  # [m/s2], a deceleration that every vehicle can reach (judgement)
LEAST_SPEED = 0.1  # [m/s]: a limit of nearly zero gives a long time instead of a division by zero

SHORT_EDGE = 1.0  # [m] of an edge that a route may pass without naming its road


class LaneGraph:
    """The lanes of a net and their connections.

    Args:
      lanes: of the net.
      links: (lane that begins at its end, edge to which it leads) of each lane, by id.
      connections: (start, end) of each connection between two lanes, across the junction.

    Attributes:
      lanes: by id, sorted.
    """

    def __init__(
        self,
        lanes: Iterable[NetLane],
        links: Mapping[str, Iterable[tuple[str, str]]],
        connections: Iterable[tuple[str, str]] = (),
    ) -> None:
        self.lanes = {lane.id: lane for lane in sorted(lanes, key=lambda lane: lane.id)}
        self._links = {name: tuple(links.get(name, ())) for name in self.lanes}
        self._before: dict[str, list[NetLane]] = {name: [] for name in self.lanes}
        for lane in self.lanes.values():
            for after, _ in self._links[lane.id]:
                if lane not in self._before[after]:
                    self._before[after].append(lane)
        self._leads_to: dict[str, list[str]] = {}
        for start, end in connections:
            if not start.startswith(":") and self.lanes[end].is_driving:
                self._leads_to.setdefault(start, []).append(end)
        self._reaches: dict[tuple[str, tuple[str, ...]], float] = {}

    @classmethod
    def of(cls, net: NetFile) -> LaneGraph:
        """The lane graph of a net."""
        return cls(net.lanes.values(), net.links, ((c.start, c.end) for c in net.connections))

    def after(self, lane: NetLane, onward: Onward) -> NetLane | None:
        """The next lane of a vehicle at the end of a lane; None if its way ends there."""
        links = self._links[lane.id]
        if lane.internal:
            return self.lanes[links[0][0]] if links else None
        edge = onward(lane.edge)
        return next((self.lanes[name] for name, target in links if target == edge), None)

    def before(self, lane: NetLane) -> list[NetLane]:
        """The lanes whose ends lead to a lane's beginning."""
        return self._before[lane.id]

    def from_entries(self, edges: Collection[str], reach: float) -> dict[str, float]:
        """Distance from the nearest entrance to the beginning of each lane [m], by lane.

        Args:
          edges: edges at whose beginnings traffic enters.
          reach: lanes farther away are omitted [m].
        """
        found = {lane.id: 0.0 for lane in self.lanes.values() if lane.edge in edges}
        todo = list(found)
        while todo:
            lane = self.lanes[todo.pop()]
            distance = found[lane.id] + lane.length
            for after, _ in self._links[lane.id]:
                if distance < min(reach, found.get(after, math.inf)):
                    found[after] = distance
                    todo.append(after)
        return found

    def leads_to(self, lane: str) -> list[str]:
        """The driving lanes to which a lane leads across the junction, sorted."""
        return sorted(self._leads_to.get(lane, ()))

    def reach(self, lane: str, edges: tuple[str, ...]) -> float:
        """Distance from the beginning of a lane within which a vehicle must leave it [m].

        Args:
          lane: on the first edge.
          edges: of the vehicle's way.

        Returns:
          Infinite if the lane leads along all edges; 0 if it is closed to cars.
        """
        key = (lane, edges)
        if key not in self._reaches:
            self._reaches[key] = self._find_reach(lane, edges)
        return self._reaches[key]

    def entry_speed(self, lane: str, position: float, edges: tuple[str, ...]) -> float:
        """Highest speed at which SUMO inserts a vehicle at a position of a lane [m/s].

        SUMO inserts no vehicle faster than the limit of a lane within its stopping distance.

        Args:
          lane: on the first edge.
          position: on the lane [m].
          edges: of the vehicle's way.
        """
        here = self.lanes[lane]
        limit, distance = here.speed, here.length - position
        for edge in edges[1:]:
            if distance > LOOK_AHEAD:
                break
            ahead = [end for end in self.leads_to(lane) if end.rpartition("_")[0] == edge]
            if not ahead:
                break
            lane = ahead[0]
            slowest = self.lanes[lane].speed
            limit = min(limit, max(slowest, math.sqrt(2.0 * GENTLE * max(distance, 0.0))))
            distance += self.lanes[lane].length
        return limit

    def _find_reach(self, lane: str, edges: tuple[str, ...]) -> float:
        if not self.lanes[lane].is_driving:
            return 0.0
        # From the last edge backwards; of several following lanes, the best one counts.
        reach: dict[str, float] = {}
        for here, after in zip(reversed(edges), (None, *reversed(edges[1:])), strict=True):
            at_edge = {}
            for name in (lane,) if here == edges[0] else self._of_edge(here):
                if after is None:
                    at_edge[name] = math.inf
                    continue
                reaches = [reach[end] for end in self._leads_to.get(name, ()) if end in reach]
                at_edge[name] = self.lanes[name].length + max(reaches, default=0.0)
            reach = at_edge
        return reach[lane]

    def _of_edge(self, edge: str) -> list[str]:
        found: list[str] = []
        while (name := f"{edge}_{len(found)}") in self.lanes:
            found.append(name)
        return found


def edges_along(net: NetFile, route: Route, sense: int) -> tuple[str, ...]:
    """The edges that netconvert made of a route's roads, in driving order.

    Args:
      net: of the route's map.
      route: the ego's road.
      sense: +1 along the route, -1 in the opposite direction (empty if there are no edges).

    Raises:
      TrafficError: the net does not hold the route's roads.
    """
    known = sorted(edge.id for edge in net.edges if not edge.internal)
    chain: list[str] = []
    for segment in route.segments if sense > 0 else reversed(route.segments):
        # netconvert turns a road inside a junction into internal lanes between two edges.
        if route.road_map.roads[segment.road_id].junction not in (None, "-1", ""):
            continue
        base = ("-" if segment.direction * sense > 0 else "") + segment.road_id
        # netconvert splits a road into edges such as `-1#1` and `-1.250.00`.
        split = re.compile(re.escape(base) + r"(#\d+|\.\d+(\.\d+)?)*")
        pieces = [edge for edge in known if split.fullmatch(edge)]
        if not pieces and sense < 0:
            return ()
        if not pieces:
            raise TrafficError(
                f"the SUMO net has no edge for road {segment.road_id!r} of the route; "
                "was it made from another map?"
            )
        chain += _in_driving_order(net, pieces)
    return _with_short_edges(net, list(dict.fromkeys(chain)))


def _with_short_edges(net: NetFile, chain: list[str]) -> tuple[str, ...]:
    """Adds the edges of roads that are too short to be pieces of a route."""
    complete = chain[:1]
    for edge in chain[1:]:
        targets = {target for target, _ in net.links_of(complete[-1])}
        if edge not in targets:
            between = (
                target
                for target in sorted(targets)
                if all(lane.length < SHORT_EDGE for lane in net.edge[target].lanes)
                and edge in {after for after, _ in net.links_of(target)}
            )
            complete += list(between)[:1]
        complete.append(edge)
    return tuple(complete)


def _in_driving_order(net: NetFile, pieces: list[str]) -> list[str]:
    """The edges of one road in driving order; a loop begins at any of them."""
    following = {}
    for edge in pieces:
        targets = {target for target, _ in net.links_of(edge)}
        following[edge] = next((e for e in pieces if e in targets and e != edge), None)
    reached = set(following.values())
    ordered = [next((e for e in pieces if e not in reached), min(pieces))]
    while (after := following[ordered[-1]]) is not None and after not in ordered:
        ordered.append(after)
    return ordered


@dataclass(frozen=True)
class MapPath:
    """A path through the map.

    Attributes:
      edges: SUMO edges in driving order, without those inside junctions.
      length: from the beginning of the first edge to the end of the last, with junctions [m].
      time: at the speed limits [s].
    """

    edges: tuple[str, ...]
    length: float
    time: float


class MapPaths:
    """The graph of a net's edges that are open to cars, and the quickest paths through it.

    Paths rely on lane changes: an edge leads to another edge if any of its lanes does.

    Attributes:
      ids: of the edges, sorted.
      entrances: edges without a preceding edge; exits: edges without a following edge.
    """

    def __init__(self, net: NetFile) -> None:
        self._name = net.path.name
        self._edges: dict[str, NetEdge] = {
            edge.id: edge
            for edge in net.edges
            if not edge.internal and any(lane.is_driving for lane in edge.lanes)
        }
        self.ids = tuple(sorted(self._edges))
        self._index = {name: k for k, name in enumerate(self.ids)}
        # (length, time) of the shortest connection inside the junction, for each pair of edges.
        self._links: dict[tuple[str, str], tuple[float, float]] = {}
        for connection in net.connections:
            start, end = net.lanes[connection.start], net.lanes[connection.end]
            if start.internal or not (start.is_driving and end.is_driving):
                continue
            length, time, via = 0.0, 0.0, connection.via
            while via:
                length += net.lanes[via].length
                time += net.lanes[via].length / max(net.lanes[via].speed, LEAST_SPEED)
                via = net.inside.get(via, "")
            key = (start.edge, end.edge)
            self._links[key] = min(self._links.get(key, (length, time)), (length, time))
        self._after: dict[str, tuple[str, ...]] = {
            name: tuple(sorted(end for start, end in self._links if start == name))
            for name in self.ids
        }
        ends = {end for _, end in self._links}
        self.entrances = tuple(name for name in self.ids if name not in ends)
        self.exits = tuple(name for name in self.ids if not self._after[name])

    def after(self, edge: str) -> tuple[str, ...]:
        """The edges that an edge leads to, sorted; InputError if there is no such edge."""
        self._check(edge)
        return self._after[edge]

    def reachable(self, edge: str) -> frozenset[str]:
        """All edges that can be reached from an edge, itself included.

        Raises:
          InputError: there is no such edge.
        """
        times, _ = self._searched
        row = times[self._check(edge)]
        return frozenset(self.ids[int(k)] for k in np.flatnonzero(np.isfinite(row)))

    def exits_from(self, edge: str) -> tuple[str, ...]:
        """The map's exits that can be reached from an edge, sorted."""
        reached = self.reachable(edge)
        return tuple(name for name in self.exits if name in reached)

    def path(self, start: str, end: str) -> MapPath:
        """The path of least travel time at the speed limits.

        Raises:
          InputError: there is no such edge, or no path between the two.
        """
        i, j = self._check(start), self._check(end)
        times, before = self._searched
        if not np.isfinite(times[i, j]):
            reached = ", ".join(sorted(self.reachable(start) - {start})[:8]) or "no other edge"
            raise InputError(
                f"there is no way from edge {start!r} to edge {end!r}; {start!r} leads to {reached}"
            )
        chain = [j]
        while chain[-1] != i:
            chain.append(int(before[i, chain[-1]]))
        edges = tuple(self.ids[k] for k in reversed(chain))
        links = [self._links[pair] for pair in itertools.pairwise(edges)]
        length = sum(self._edges[name].length for name in edges) + sum(link[0] for link in links)
        time = sum(self._time(name) for name in edges) + sum(link[1] for link in links)
        return MapPath(edges, length, time)

    def routes(self) -> tuple[MapPath, ...]:
        """The quickest path from every entrance to every exit that can be reached from it."""
        return tuple(
            self.path(entrance, leave)
            for entrance in self.entrances
            for leave in self.exits_from(entrance)
        )

    def _time(self, edge: str) -> float:
        lanes = [lane for lane in self._edges[edge].lanes if lane.is_driving]
        return self._edges[edge].length / max(max(lane.speed for lane in lanes), LEAST_SPEED)

    def _check(self, edge: str) -> int:
        if edge not in self._index:
            raise InputError(
                f"no edge {edge!r} for cars in {self._name}; there are "
                f"{', '.join(self.ids[:8])}{' ...' if len(self.ids) > 8 else ''}"
            )
        return self._index[edge]

    @cached_property
    def _searched(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Times between all pairs of edges [s], and the last edge before each on the way to it."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        rows, columns, weights = [], [], []
        for (start, end), (_, time) in sorted(self._links.items()):
            rows.append(self._index[start])
            columns.append(self._index[end])
            weights.append(self._time(start) + time)
        shape = (len(self.ids), len(self.ids))
        graph = csr_array((weights, (rows, columns)), shape=shape)
        times, before = dijkstra(graph, return_predecessors=True)
        return times, before
