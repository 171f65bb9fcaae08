"""Which lanes of the route lead onto others."""

from __future__ import annotations

from collections.abc import Sequence

from traffic_bridge.network.lanes import LaneTable, RouteLanes


def upstream(lanes: RouteLanes, tables: Sequence[LaneTable], distance: float) -> list[LaneTable]:
    """The route's lanes from which one comes onto given ones by driving straight on.

    Args:
      lanes: of the route.
      tables: the lanes to arrive on.
      distance: how far back of their beginnings to look [m].

    Returns:
      Lanes other than the given ones, the nearest first, junction-internal ones included.
    """
    reached = {table.id for table in tables}
    found: list[LaneTable] = []
    ends = [(table.id, distance) for table in tables]
    while ends:
        here, left = ends.pop(0)
        for name in lanes.before(here):
            table = lanes.tables.get(name)
            on_route = table is not None and table.lane >= 0 and table.direction > 0
            if left <= 0.0 or name in reached or table is None or not on_route:
                continue
            reached.add(name)
            found.append(table)
            ends.append((name, left - table.length))
    return found
