"""A vehicle of SUMO that somebody else drives: the truck, its shadow, a replayed vehicle."""

from __future__ import annotations

import math
from collections.abc import Iterable

from iits_mj.road import Route
from traffic_bridge.network.route_lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session

# --- Which lanes a vehicle reaches into beside its own: SUMO knows one lane a vehicle ---

# A vehicle counts as being in a second lane as well from this overlap on [m].
OVERLAP = 0.3


class LaneOverlap:
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


# --- A vehicle of SUMO that somebody else drives: the truck, its shadow, a replayed vehicle ---

EGO_TYPE = "ego"  # the type of all of them; SUMO needs their size only
# moveToXY: 2 keeps the exact pose, 0 and 1 would snap it to the lane's centre.
EXACT_POSE = 2
FASTEST = 60.0  # [m/s]: one that is farther away has been moved, not driven
ROLLBACK = 0.3  # [m] that one may roll back before it is moved
END = 1.0  # [m] before the end of the route: SUMO would let a vehicle arrive and forget it
MATCH_RADIUS = 30.0  # [m] in which SUMO looks for its lane; SUMO's default of 100 costs more


class TeleportedVehicle:
    """A vehicle of SUMO that is where it is told to be.

    SUMO's search for the place of a point of the map costs more than all else in a step, and is not
    exact in bends. So the vehicle is driven along its lane, at the speed that takes it to its place
    in one step, and set over where it changes lanes. Only beside the lanes a point is searched.

    Args:
      session: the running SUMO.
      lanes: of the route.
      name: of the vehicle.
      step: length of a step [s].
      size: length and width [m]; default: those of the ego's type.
      way: name of the SUMO route that it is on.
    """

    def __init__(
        self,
        session: Session,
        lanes: RouteLanes,
        name: str,
        step: float,
        size: tuple[float, float] | None = None,
        way: str = "along.0",
    ) -> None:
        self.name = name
        self._cut = False
        self._api = session.api
        self._lanes = lanes
        self._step = step
        self._get_lane = session.getter("vehicle", "getLaneID")
        self._get_position = session.getter("vehicle", "getLanePosition")
        vehicle = self._api.vehicle
        vehicle.add(name, way, typeID=EGO_TYPE, departSpeed="0")
        vehicle.setSpeedMode(name, 0)
        vehicle.setLaneChangeMode(name, 0)
        if size is not None:
            vehicle.setLength(name, size[0])
            vehicle.setWidth(name, size[1])

    def remove(self) -> None:
        """Takes it out of the traffic."""
        self._api.vehicle.remove(self.name)

    def cut(self, length: float, hidden: float) -> None:
        """Leaves out the front part of it, which is beyond the end of the route.

        Args:
          length: of the whole vehicle [m].
          hidden: length of that part [m], 0 for none.
        """
        if hidden > 0.0 or self._cut:
            self._cut = hidden > 0.0
            self._api.vehicle.setLength(self.name, length - hidden)

    def put(self, table: LaneTable, position: float, side: float, speed: float) -> None:
        """Has it at a place on a lane after the coming step.

        Args:
          table: the lane.
          position: along it [m].
          side: distance from the lane's centre, positive to the left [m].
          speed: its own [m/s].
        """
        vehicle = self._api.vehicle
        here = self._get_lane(self.name)
        way = None
        # What is cut does not advance in SUMO, but has its speed for those behind.
        if here and not self._cut:
            way = self._lanes.distance(here, self._get_position(self.name), table, position)
        if way is None or not -ROLLBACK <= way <= FASTEST * self._step:
            way = min(speed * self._step, position)
            vehicle.moveTo(self.name, table.id, position - way)
        vehicle.setSpeed(self.name, max(way, 0.0) / self._step)
        vehicle.setLateralLanePosition(self.name, side)

    def move(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Has it at a point beside the lanes after the coming step, in SUMO's coordinates."""
        angle = 90.0 - math.degrees(yaw)
        vehicle = self._api.vehicle
        vehicle.moveToXY(self.name, "", -1, x, y, angle, EXACT_POSE, MATCH_RADIUS)
        vehicle.setSpeed(self.name, speed)
