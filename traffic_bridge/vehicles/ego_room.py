"""The space that is kept free around the truck when the road is populated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoFootprint
from traffic_bridge.network.route_lanes import LaneTable

# Free road kept around the ego in its own lane: at least a distance [m] and a time [s].
EGO_GAP = 30.0
EGO_HEADWAY = 3.0
LEVEL_HEADWAY = 1.2  # [s] in traffic of a level of service
NEXT_LANE_GAP = 15.0
SIDE_GAP = 0.2  # [m] beside the truck for vehicles on lanes of another direction
POINT_SPACING = 1.0  # [m] along the path of such a vehicle


@dataclass(frozen=True, eq=False)
class EgoRoom:
    """The truck's place when the road is populated.

    Attributes:
      station: of the front bumper [m].
      lane: of the route, -1 off its lanes.
      speed: [m/s].
      axis: points along the middle of the combination, map frame, shape (n, 2) [m].
      footprint: size of the combination.
      traffic_speed: typical speed of the other vehicles [m/s].
      headway: time kept free before and behind the truck in its lane [s].
      beside: whether vehicles may begin beside the truck, in the next lane.
    """

    station: float
    lane: int
    speed: float
    axis: FloatArray
    footprint: EgoFootprint
    traffic_speed: float
    headway: float = EGO_HEADWAY
    beside: bool = False

    def takes(self, station: float, length: float, lane: int) -> bool:
        """Whether a place on a lane of the route is too close to the truck.

        Args:
          station: of a vehicle's front bumper [m].
          length: of the vehicle [m].
          lane: of the route.
        """
        clear = NEXT_LANE_GAP
        if lane != self.lane and self.lane >= 0 and self.beside:
            return False
        if lane == self.lane or self.lane < 0:
            clear = max(EGO_GAP, self.headway * max(self.speed, self.traffic_speed))
        rear = self.station - self.footprint.length
        return station > rear - clear and station - length < self.station + clear

    def blocks(self, table: LaneTable, position: float, length: float, width: float) -> bool:
        """Whether the truck blocks the path of a vehicle of another direction or road.

        Args:
          table: the vehicle's lane.
          position: of its front bumper along it [m].
          length: of the vehicle [m].
          width: of the vehicle [m].
        """
        closing = max(self.speed, 0.0) + self.traffic_speed
        clear = max(EGO_GAP, EGO_HEADWAY * closing)
        x, y, heading = table.pose[0], table.pose[1], table.pose[3]
        grid = np.arange(len(x)) * table.spacing
        places = np.arange(position - length, position + clear, POINT_SPACING)
        # Beyond the lane's ends the path continues straight.
        beyond = places - np.clip(places, 0.0, grid[-1])
        toward = np.interp(places, grid, heading)
        way_x = np.interp(places, grid, x) + beyond * np.cos(toward)
        way_y = np.interp(places, grid, y) + beyond * np.sin(toward)
        middle = self.axis[len(self.axis) // 2]
        if math.hypot(way_x[0] - middle[0], way_y[0] - middle[1]) > (
            2.0 * clear + length + self.footprint.length
        ):
            return False
        apart = np.hypot(way_x[:, None] - self.axis[:, 0], way_y[:, None] - self.axis[:, 1])
        return bool(apart.min() < 0.5 * (self.footprint.width + width) + SIDE_GAP)
