"""Ways through a map: which edges lead where, the quickest path, entrances and exits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError
from traffic_bridge.network.net_file import NetEdge, NetFile

LEAST_SPEED = 0.1  # [m/s]: a limit of nearly nothing is a long time, not a division by zero


@dataclass(frozen=True)
class MapPath:
    """A way through the map.

    Attributes:
      edges: SUMO edges in driving order, those inside junctions left out.
      length: from the beginning of the first to the end of the last, junctions included [m].
      time: at the speed limits [s].
    """

    edges: tuple[str, ...]
    length: float
    time: float


class MapPaths:
    """The graph of a net's edges that cars may drive on.

    A path counts on lane changes: where any lane of an edge leads on, the edge does.
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
        lanes = {lane.id: lane for edge in net.edges for lane in edge.lanes}
        inside = {c.start: c.via for c in net.connections if c.start.startswith(":")}
        # (length, time) of the shortest way inside the junction, for each pair of edges.
        self._links: dict[tuple[str, str], tuple[float, float]] = {}
        for connection in net.connections:
            start, end = lanes[connection.start], lanes[connection.end]
            if start.internal or not (start.is_driving and end.is_driving):
                continue
            length, time, via = 0.0, 0.0, connection.via
            while via:
                length += lanes[via].length
                time += lanes[via].length / max(lanes[via].speed, LEAST_SPEED)
                via = inside.get(via, "")
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
        """Edges that an edge leads to, sorted.

        Raises:
          InputError: there is no such edge.
        """
        self._check(edge)
        return self._after[edge]

    def reachable(self, edge: str) -> frozenset[str]:
        """Edges one can come to from an edge, itself included.

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
        """The path of the least travel time at the speed limits.

        Raises:
          InputError: there is no such edge, or no way from the one to the other.
        """
        i, j = self._check(start), self._check(end)
        times, before = self._searched
        if not np.isfinite(times[i, j]):
            raise InputError(
                f"there is no way from edge {start!r} to edge {end!r}; from {start!r} one comes to "
                f"{', '.join(sorted(self.reachable(start) - {start})[:8]) or 'no other edge'}"
            )
        chain = [j]
        while chain[-1] != i:
            chain.append(int(before[i, chain[-1]]))
        edges = tuple(self.ids[k] for k in reversed(chain))
        ways = [self._links[pair] for pair in itertools.pairwise(edges)]
        length = sum(self._edges[name].length for name in edges) + sum(way[0] for way in ways)
        time = sum(self._time(name) for name in edges) + sum(way[1] for way in ways)
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
        """Times between all pairs of edges [s], and the edge before each on the way to it."""
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
