"""SUMO's lanes on the ego's route: (lane, position) <-> (station, offset)."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import TrafficError
from iits_mj.road import Route
from iits_mj.road.elements import DRIVING_TYPES
from iits_mj.road.road_frames import RoadFrames
from traffic_bridge.network.lane_graph import LaneGraph, edges_along
from traffic_bridge.network.lane_surface import LaneSurfaces
from traffic_bridge.network.lane_table import (
    LanePoses,
    LaneTable,
    locate_along,
    locate_each,
    route_pose,
    sample_shape,
    sample_spacing,
    surface_pose,
)
from traffic_bridge.network.net_file import NetFile
from traffic_bridge.session import Session

GAP = 10.0  # [m] between edges, at most: netconvert's internal lanes at a change of lanes
ASTRAY = 50.0  # [m] from its road's stations, at most, of a point on a lane
HOPS = 4  # lanes that the truck may pass in one step: internal lanes can be short


class RouteLanes:
    """The lanes of a loaded net relative to the route, and the edges of the route.

    The positions of the route's lanes come from the route, on whose geometry the truck drives; the
    positions of other lanes come from their roads (`LaneSurfaces`).

    Attributes:
      net: as in the file; route: the ego's road.
      edges: ids of SUMO's edges in driving order; oncoming_edges: in the opposite direction.
      tables: lanes of the route by SUMO lane id, with junction-internal and oncoming lanes.
      graph: the connections between the lanes of the net.
      poses: of all lanes on which vehicles have been, on any road.

    Raises:
      TrafficError: the net does not hold the route's roads, or they are not connected.
    """

    def __init__(
        self, session: Session, net: NetFile, route: Route, oncoming: bool = False
    ) -> None:
        self.net = net
        self.route = route
        self.tables: dict[str, LaneTable] = {}
        self.poses = LanePoses(self.table)
        self.graph = LaneGraph.of(net)
        self.oncoming_edges: tuple[str, ...] = ()
        with session.guard("reading the network"):
            self.edges = edges_along(net, route, 1)
            self._build(self.edges, 1)
            self._ordered = _by_lane(t for edge in self.edges for t in self.of_edge(edge))
            self._whole = _by_lane(t for t in self.tables.values() if t.lane >= 0)
            if oncoming:
                self.oncoming_edges = edges_along(net, route, -1)
                self._build(self.oncoming_edges, -1)
        self.bind(session)

    def table(self, lane: str) -> LaneTable:
        """Table of any lane of the net; the tables of other roads are made on demand."""
        found = self.tables.get(lane)
        return self._table_off_route(lane) if found is None else found

    def before(self, lane: str) -> tuple[str, ...]:
        """Ids of the lanes that lead to a lane, with internal lanes, sorted."""
        return tuple(sorted(before.id for before in self.graph.before(self.graph.lanes[lane])))

    @cached_property
    def boxes(self) -> tuple[list[str], FloatArray]:
        """Ids of all lanes of the net, and the box around each in SUMO's coordinates.

        The boxes are left, bottom, right, top [m], shape (4, n).
        """
        shapes = [lane.shape for lane in self.graph.lanes.values()]
        boxes = [(*shape.min(axis=0), *shape.max(axis=0)) for shape in shapes]
        return list(self.graph.lanes), np.array(boxes).T

    def bind(self, session: Session) -> None:
        """Closes shoulders and other lanes that are not for driving in a new simulation."""
        with session.guard("setting the rules of the lanes"):
            for table in self.tables.values():
                drivable = table.lane >= 0 or self._is_oncoming(table)
                if not drivable and not table.edge.startswith(":"):
                    session.api.lane.setDisallowed(table.id, ["all"])

    def of_edge(self, edge: str) -> list[LaneTable]:
        """Driving lanes of an edge, from the right."""
        tables = (self.tables[lane.id] for lane in self.net.edge[edge].lanes)
        return [table for table in tables if table.lane >= 0 or self._is_oncoming(table)]

    def _is_oncoming(self, table: LaneTable) -> bool:
        return table.direction < 0 and (self.net.lanes[table.id].kind or "driving") in DRIVING_TYPES

    def find(self, lane: int, station: float) -> LaneTable | None:
        """The SUMO lane of a route lane at most `GAP` from a station, never an internal lane.

        Between two edges SUMO has internal lanes of some meters; there the nearer edge counts.
        """
        starts, tables = self._ordered.get(lane, ([], []))
        k = bisect_right(starts, station)
        near = [
            (max(table.station[0] - station, station - table.station[-1]), i, table)
            for i, table in enumerate(tables[max(k - 1, 0) : k + 1])
        ]
        distance, _, table = min(near, default=(math.inf, 0, None))
        return table if distance <= GAP else None

    def covering(self, lane: int, station: float) -> LaneTable | None:
        """The SUMO lane of a route lane at a station, also an internal lane; None in a gap."""
        starts, tables = self._whole.get(lane, ([], []))
        k = bisect_right(starts, station) - 1
        return tables[k] if k >= 0 and station <= tables[k].station[-1] else None

    def distance(self, begin: str, position: float, end: LaneTable, target: float) -> float | None:
        """Distance to drive from a position on one lane to a position on another lane [m].

        Args:
          begin: SUMO's lane where the distance begins.
          position: on it [m].
          end: the lane where the distance ends, at most `HOPS` lanes farther.
          target: position on it [m].

        Returns:
          The distance in SUMO's measure, None if the first lane does not lead to the other.
        """
        name, covered = end.id, target
        for _ in range(HOPS):
            if name == begin:
                return covered - position
            before = self.before(name)
            if begin not in before and len(before) != 1:
                return None
            name = begin if begin in before else before[0]
            covered += self.table(name).length
        return None

    def within(self, start: float, end: float, lane: int | None = None) -> list[LaneTable]:
        """Driving lanes of the route that overlap an interval of station."""
        return [
            table
            for table in self.tables.values()
            if table.direction > 0
            and table.lane >= 0
            and (lane is None or table.lane == lane)
            and table.station[0] < end
            and table.station[-1] > start
        ]

    def to_sumo(self, x: float, y: float) -> tuple[float, float]:
        """The map's coordinates to SUMO's."""
        return x + self.net.offset[0], y + self.net.offset[1]

    def _build(self, edges: tuple[str, ...], direction: int) -> None:
        near = 0.0 if direction > 0 else self.route.length
        for edge, after in zip(edges, (*edges[1:], None), strict=False):
            lanes = self.net.edge[edge].lanes
            tables = _even(self.route, [self._table(lane.id, near, direction) for lane in lanes])
            self.tables.update((table.id, table) for table in tables)
            near = float(tables[0].station[-1])
            links = self.net.links_of(edge)
            if after is not None and after not in {target for target, _ in links}:
                raise TrafficError(
                    f"the SUMO net has no connection from edge {edge!r} to {after!r}, "
                    "which the route follows"
                )
            for target, internal in links:
                # A long turn is split in two internal lanes.
                while target == after and internal and internal not in self.tables:
                    self._table(internal, near, direction)
                    internal = self.net.inside.get(internal, "")

    def _table(self, name: str, near: float, direction: int) -> LaneTable:
        lane = self.net.lanes[name]
        x, y = sample_shape(lane)
        x, y = x - self.net.offset[0], y - self.net.offset[1]
        station, offset = locate_along(self.route, x, y, near, direction)
        low, high = self._spans.get(lane.origin[0] if lane.origin else "", (-math.inf, math.inf))
        if not low - ASTRAY <= station[0] <= high + ASTRAY:
            # Where the route crosses itself, the nearest place may be on its other part.
            near = low if direction > 0 else high
            station, offset = locate_along(self.route, x, y, near, direction)
        number = self._route_lane(station, offset) if direction > 0 else -1
        spacing = lane.length / (len(station) - 1)
        pose = route_pose(self.route, station, offset, direction)
        self.tables[name] = LaneTable(
            *(name, lane.edge, lane.index, number, direction),
            *(lane.length, spacing, station, offset, pose),
        )
        return self.tables[name]

    def _table_off_route(self, name: str) -> LaneTable:
        lane = self.net.lanes[name]
        surface = self._surfaces.surface(name, sample_spacing(lane))
        length = float(surface.position[-1])
        station, offset = locate_each(self.route, surface.x, surface.y)
        spacing = length / (len(station) - 1)
        pose = surface_pose(surface)
        return LaneTable(name, lane.edge, lane.index, -1, 0, length, spacing, station, offset, pose)

    @cached_property
    def _spans(self) -> dict[str, tuple[float, float]]:
        """Stations of each road of the route, from where it is entered to where it is left."""
        starts = [part.station_start for part in self.route.segments]
        ends = [*starts[1:], self.route.length]
        roads = (part.road_id for part in self.route.segments)
        return dict(zip(roads, zip(starts, ends, strict=True), strict=True))

    @cached_property
    def _surfaces(self) -> LaneSurfaces:
        return LaneSurfaces(self.net, RoadFrames(self.route.road_map))

    def _route_lane(self, station: FloatArray, offset: FloatArray) -> int:
        """The driving lane under most of a SUMO lane, -1 for a shoulder."""
        picks = np.linspace(0, len(station) - 1, 7)[1:-1].astype(int)
        lanes = [self.route.lane_at(float(station[k]), float(offset[k])) for k in picks]
        return max(sorted(set(lanes)), key=lanes.count)


def _by_lane(tables: Iterable[LaneTable]) -> dict[int, tuple[list[float], list[LaneTable]]]:
    """First stations and tables by route lane, in the order of stations."""
    ordered: dict[int, tuple[list[float], list[LaneTable]]] = {}
    for table in sorted(tables, key=lambda table: (table.station[0], table.id)):
        starts, found = ordered.setdefault(table.lane, ([], []))
        starts.append(float(table.station[0]))
        found.append(table)
    return ordered


def _even(route: Route, tables: list[LaneTable]) -> list[LaneTable]:
    """Gives the lanes of an edge a common station at every position.

    SUMO keeps a vehicle's position when it changes lanes, but maps positions evenly onto each
    lane's own length. On an edge with bends and straights, equal positions of neighboring lanes
    would be up to some meters apart, and a vehicle that changes lanes would jump.
    """
    if len({len(table.station) for table in tables}) != 1:
        return tables
    station = np.mean([table.station for table in tables], axis=0)
    even = []
    for table in tables:
        order = slice(None) if table.direction > 0 else slice(None, None, -1)
        offset = np.asarray(np.interp(station, table.station[order], table.offset[order]))
        pose = route_pose(route, station, offset, table.direction)
        even.append(replace(table, station=station, offset=offset, pose=pose))
    return even


def upstream(lanes: RouteLanes, tables: Sequence[LaneTable], distance: float) -> list[LaneTable]:
    """The route's lanes from which a vehicle reaches given lanes without a lane change.

    Args:
      lanes: of the route.
      tables: the lanes to reach.
      distance: of the search before their beginnings [m].

    Returns:
      Lanes other than the given ones, the nearest first, with junction-internal lanes.
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
