"""Vehicles that are moved in SUMO from outside: the truck, its shadow, replayed vehicles."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from traffic_bridge.network.route_lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session

OVERLAP = 0.3  # [m]: with more overlap than this a vehicle is also in the second lane
EGO_TYPE = "ego"  # the type of all teleported vehicles; SUMO uses only their size
ALONG = "along.0"  # SUMO's route along the ego's route
# Keeps the exact pose in moveToXY; 0 and 1 would move the vehicle to the lane's center.
EXACT_POSE = 2
JUMP_SPEED = 60.0  # [m/s]: a faster vehicle is set to its place instead of driven there
ROLLBACK = 0.3  # [m] that a vehicle may roll back before it is set to its place
END = 1.0  # [m] before the end of the route: SUMO removes vehicles at the end
MATCH_RADIUS = 30.0  # [m] in which SUMO looks for the lane; SUMO's default of 100 costs more


class LaneOverlap:
    """Finds the lanes under a vehicle, and puts it there."""

    def __init__(self, lanes: RouteLanes) -> None:
        self._lanes = lanes
        open_lanes = {table.id for edge in lanes.oncoming_edges for table in lanes.of_edge(edge)}
        # First and last station, half the width [m], table.
        self._opposite = [
            (
                *(float(table.station[-1]), float(table.station[0])),
                *(0.5 * lanes.net.lanes[table.id].width, table),
            )
            for table in lanes.tables.values()
            if table.direction < 0 and (table.id in open_lanes or table.edge.startswith(":"))
        ]

    def edges(self, width: float, offsets: Iterable[float]) -> tuple[float, float]:
        """Offsets of the left and right side of a vehicle, less `OVERLAP` [m]."""
        half = 0.5 * width - OVERLAP
        known = tuple(offsets)
        return max(known) + half, min(known) - half

    def under(self, station: float, edges: Iterable[float]) -> list[int]:
        """Lanes of the route under the sides of a vehicle, -1 off its lanes; see `edges`."""
        lane_at = self._lanes.route.lane_at
        return [lane_at(station, edge) for edge in edges]

    def second(self, lane: int, station: float, under: Iterable[int]) -> int:
        """The other lane of the route that a vehicle reaches into, -1 for none.

        Args:
          lane: its own lane.
          station: of its front bumper [m].
          under: lanes under its sides.
        """
        for other in under:
            if other not in (-1, lane) and self.table(other, station) is not None:
                return other
        return -1

    def table(self, lane: int, station: float) -> LaneTable | None:
        """SUMO's lane of a lane of the route at a station, or None."""
        return self._lanes.covering(lane, station) or self._lanes.find(lane, station)

    def opposite(
        self, station: float, edges: Sequence[float], under: Sequence[int]
    ) -> LaneTable | None:
        """The oncoming lane that a vehicle reaches into, or None; see `second`."""
        for edge, lane in zip(edges, under, strict=True) if self._opposite else ():
            # Usually the side is in a lane of the route.
            if lane < 0 and (found := self._at(station, edge)):
                return found
        return None

    def put(
        self,
        vehicle: TeleportedVehicle,
        lane: int,
        station: float,
        offset: float,
        point: tuple[float, float],
        yaw: float,
        speed: float,
    ) -> None:
        """Moves a vehicle to its place at the end of the next step, on or off the lanes.

        Args:
          vehicle: to move.
          lane: of the route, -1 off its lanes.
          station: of its front bumper [m].
          offset: of its front bumper [m].
          point: x and y of its front bumper, map frame [m].
          yaw: of the vehicle [rad].
          speed: of the vehicle [m/s]; backwards counts as zero.
        """
        table = self.table(lane, station) if lane >= 0 else None
        if table is None:
            vehicle.move(*self._lanes.to_sumo(*point), yaw, max(speed, 0.0))
            return
        position = table.position_of(station)
        vehicle.put(table, position, offset - table.at(position)[1], max(speed, 0.0))

    def _at(self, station: float, offset: float) -> LaneTable | None:
        for low, high, half, table in self._opposite:
            if not low <= station <= high:
                continue
            if abs(offset - table.at(table.position_of(station))[1]) < half:
                return table
        return None


class TeleportedVehicle:
    """A vehicle in SUMO that is moved to a given place in every step.

    SUMO's search for the lane of a point costs more than the rest of a step, and is not exact in
    bends. So the vehicle drives along its lane, at the speed that takes it to its place in one
    step, and is moved where it changes lanes. Only off the lanes SUMO searches.

    Args:
      session: the running SUMO.
      lanes: of the route.
      name: of the vehicle.
      step: length of a traffic step [s].
      size: length and width [m]; None: those of the ego's type.
      way: name of its SUMO route.
    """

    def __init__(
        self,
        session: Session,
        lanes: RouteLanes,
        name: str,
        step: float,
        size: tuple[float, float] | None = None,
        way: str = ALONG,
    ) -> None:
        self.name = name
        self._cut = False
        self._api = session.api
        self._lanes = lanes
        self._step = step
        self._get_lane = session.function("vehicle", "getLaneID")
        self._get_position = session.function("vehicle", "getLanePosition")
        self._set_speed = session.function("vehicle", "setSpeed")
        self._set_side = session.function("vehicle", "setLateralLanePosition")
        vehicle = self._api.vehicle
        vehicle.add(name, way, typeID=EGO_TYPE, departSpeed="0")
        vehicle.setSpeedMode(name, 0)
        vehicle.setLaneChangeMode(name, 0)
        if size is not None:
            vehicle.setLength(name, size[0])
            vehicle.setWidth(name, size[1])

    def remove(self) -> None:
        """Removes it from SUMO."""
        self._api.vehicle.remove(self.name)

    def cut(self, length: float, hidden: float) -> None:
        """Shortens the vehicle by its front part beyond the end of the route.

        Args:
          length: of the whole vehicle [m].
          hidden: length of that part [m], 0 for none.
        """
        if hidden > 0.0 or self._cut:
            self._cut = hidden > 0.0
            self._api.vehicle.setLength(self.name, length - hidden)

    def put(self, table: LaneTable, position: float, side: float, speed: float) -> None:
        """Moves it to a position on a lane at the end of the next step.

        Args:
          table: the lane.
          position: along the lane [m].
          side: distance from the lane's center, positive to the left [m].
          speed: of the vehicle [m/s].
        """
        here = self._get_lane(self.name)
        way = None
        # A shortened vehicle does not advance in SUMO, but shows its speed to its followers.
        if here and not self._cut:
            way = self._lanes.distance(here, self._get_position(self.name), table, position)
        if way is None or not -ROLLBACK <= way <= JUMP_SPEED * self._step:
            way = min(speed * self._step, position)
            self._api.vehicle.moveTo(self.name, table.id, position - way)
            # Else a new vehicle stands for its followers during its first step.
            self._api.vehicle.setPreviousSpeed(self.name, speed)
        self._set_speed(self.name, max(way, 0.0) / self._step)
        self._set_side(self.name, side)

    def move(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Moves it to a point off the lanes, in SUMO's coordinates, at the end of the next step."""
        angle = 90.0 - math.degrees(yaw)
        vehicle = self._api.vehicle
        vehicle.moveToXY(self.name, "", -1, x, y, angle, EXACT_POSE, MATCH_RADIUS)
        vehicle.setSpeed(self.name, speed)
