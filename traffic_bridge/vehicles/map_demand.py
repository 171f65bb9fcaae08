"""Traffic on the rest of the map: from every entrance to exits drawn by chance."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from traffic_bridge.network.lane_ways import LaneWays
from traffic_bridge.network.map_paths import MapPaths
from traffic_bridge.network.net_file import NetFile, NetLane


class MapDemand:
    """Which trips there are beside the ego's route.

    A trip begins on a lane that leads where it goes, so that nobody has to cross the road at once.
    Its exit is drawn evenly among those that can be reached from there.

    Args:
      net: of the map; ways: its lanes' ways.
      route_edges: edges of the ego's route, whose flow comes from elsewhere.
    """

    def __init__(self, net: NetFile, ways: LaneWays, route_edges: tuple[str, ...]) -> None:
        self._paths = MapPaths(net)
        self._lane_ways = ways
        self._route_edges = frozenset(route_edges)
        self._edges = {edge.id: edge for edge in net.edges}
        self._ways: dict[str, tuple[tuple[str, ...], ...]] = {}

    @cached_property
    def entrances(self) -> tuple[NetLane, ...]:
        """Lanes of every entrance of the map, the route's own beginning left out."""
        names = (name for name in self._paths.entrances if name not in self._route_edges)
        return tuple(lane for name in names for lane in self._lanes(name))

    @cached_property
    def elsewhere(self) -> tuple[NetLane, ...]:
        """Lanes with trips on every edge that is not of the route."""
        return tuple(
            lane
            for name in self._paths.ids
            if name not in self._route_edges
            for lane in self._lanes(name)
        )

    def trip(self, lane: NetLane, rng: np.random.Generator) -> tuple[str, ...]:
        """The edges of a trip from a lane; one random number is drawn, whatever the lane."""
        ways = self._from(lane)
        return ways[int(rng.random() * len(ways))]

    def _lanes(self, edge: str) -> tuple[NetLane, ...]:
        lanes = self._edges[edge].lanes
        return tuple(lane for lane in lanes if lane.is_driving and self._from(lane))

    def _from(self, lane: NetLane) -> tuple[tuple[str, ...], ...]:
        """The ways from a lane to each exit, in the order of the exits' names."""
        if lane.id not in self._ways:
            self._ways[lane.id] = tuple(self._find(lane))
        return self._ways[lane.id]

    def _find(self, lane: NetLane) -> Iterator[tuple[str, ...]]:
        if lane.edge in self._paths.exits:
            yield (lane.edge,)
            return
        onward = sorted({name.rpartition("_")[0] for name in self._lane_ways.leads_to(lane.id)})
        for leave in self._paths.exits_from(lane.edge):
            ways = [
                self._paths.path(after, leave)
                for after in onward
                if leave in self._paths.reachable(after)
            ]
            if ways:
                yield (lane.edge, *min(ways, key=lambda way: (way.time, way.edges)).edges)
            elif not onward:
                yield self._paths.path(lane.edge, leave).edges
