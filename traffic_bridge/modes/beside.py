"""Which lanes a vehicle reaches into beside its own: SUMO knows one lane a vehicle."""

from __future__ import annotations

from collections.abc import Iterable

from iits_mj.road import Route
from traffic_bridge.network.lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session

# A vehicle counts as being in a second lane as well from this overlap on [m].
OVERLAP = 0.3


class Beside:
    """The lanes beside the one that a vehicle is in, along the route and against it.

    Args:
      session: the running SUMO.
      lanes: of the route.
      route: the ego's road.
    """

    def __init__(self, session: Session, lanes: RouteLanes, route: Route) -> None:
        self._lanes = lanes
        self._route = route
        get_width = session.api.lane.getWidth
        open_lanes = {table.id for edge in lanes.oncoming_edges for table in lanes.of_edge(edge)}
        # First and last station, half the width [m], table.
        self._opposite = [
            (float(table.station[-1]), float(table.station[0]), 0.5 * get_width(table.id), table)
            for table in lanes.tables.values()
            if table.direction < 0 and (table.id in open_lanes or table.edge.startswith(":"))
        ]

    def edges(self, width: float, offsets: Iterable[float]) -> tuple[float, float]:
        """Offsets that the sides of a body of a width count as reaching to, left and right [m]."""
        half = 0.5 * width - OVERLAP
        known = tuple(offsets)
        return max(known) + half, min(known) - half

    def second(self, lane: int, station: float, edges: Iterable[float]) -> int:
        """The lane of the route other than its own that a body reaches into, -1 for none.

        Args:
          lane: its own.
          station: of its front bumper [m].
          edges: see `edges`.
        """
        for edge in edges:
            other = int(self._route.lane_at(station, edge))
            if other not in (-1, lane) and self.table(other, station) is not None:
                return other
        return -1

    def table(self, lane: int, station: float) -> LaneTable | None:
        """SUMO's lane of a lane of the route, None where there is none."""
        return self._lanes.covering(lane, station) or self._lanes.find(lane, station)

    def opposite(self, station: float, edges: Iterable[float]) -> LaneTable | None:
        """The oncoming lane that a body reaches into, None where it does not; see `second`."""
        for edge in edges if self._opposite else ():
            # Most of the time the side is in a lane of the route.
            if self._route.lane_at(station, edge) < 0 and (found := self._at(station, edge)):
                return found
        return None

    def _at(self, station: float, offset: float) -> LaneTable | None:
        for low, high, half, table in self._opposite:
            if not low <= station <= high:
                continue
            if abs(offset - table.at(table.position_of(station))[1]) < half:
                return table
        return None
