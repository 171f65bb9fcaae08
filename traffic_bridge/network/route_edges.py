"""The edges of a loaded net along a route's roads."""

from __future__ import annotations

import re
from typing import Any

from iits_mj.errors import TrafficError
from iits_mj.road import Route


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
