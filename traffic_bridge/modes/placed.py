"""A vehicle of SUMO that somebody else drives: the truck, its shadow, a replayed vehicle."""

from __future__ import annotations

import math

from traffic_bridge.network.lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session

EGO_TYPE = "ego"  # the type of all of them; SUMO needs their size only
# moveToXY: 2 keeps the exact pose, 0 and 1 would snap it to the lane's centre.
EXACT_POSE = 2
FASTEST = 60.0  # [m/s]: one that is farther away has been moved, not driven
ROLLBACK = 0.3  # [m] that one may roll back before it is moved
END = 1.0  # [m] before the end of the route: SUMO would let a vehicle arrive and forget it
MATCH_RADIUS = 30.0  # [m] in which SUMO looks for its lane; SUMO's default of 100 costs more


class PlacedVehicle:
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
            way = self._lanes.way(here, self._get_position(self.name), table, position)
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
