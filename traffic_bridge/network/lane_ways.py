"""How far one can drive along a way without changing lanes."""

from __future__ import annotations

import math

from traffic_bridge.network.net_file import NetFile, NetLane

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
