"""The truck's neighbors: the traffic as columns, with a query for each meaning of "ahead"."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from iits_mj.core.arrays import BoolArray, FloatArray, IndexArray
from iits_mj.core.errors import InputError
from iits_mj.core.vehicles import TrackedVehicle, VehicleFrame

if TYPE_CHECKING:
    from iits_mj.core.messages import EgoFootprint, EgoState

# Attributes of a vehicle that `Neighbors` reads.
_FIGURES = (
    *("station", "offset", "speed", "lateral_speed", "length", "width"),
    *("acceleration", "yaw", "yaw_rate", "x", "y", "z"),
)
_figures_of = operator.attrgetter(*_FIGURES)
# A body is in a lane when it reaches at least this far into it [m].
INTRUSION = 0.3
# A vehicle that moves slower than this across the lane is weaving, not changing lanes [m/s].
_WEAVING = 0.3
# A vehicle also counts as in the lanes in which it will be after this time [s].
_ANTICIPATION = 1.0
# Reach of the queries by lane index, from the truck's front bumper [m].
_LANE_REACH = 250.0
# A vehicle this far above or below the road at its own station is on another road: a bridge leaves
# 4.5 m and more, and road heights are exact to some centimeters [m].
LEVEL_OVER_ROAD = 3.0
# The same relative to the truck, where the vehicle's own road is unknown: up to 80 m away that
# road may climb by some meters, so only the bridge's full clearance decides [m].
LEVEL_OVER_TRUCK = 4.5


class RoadSurface(Protocol):
    """Height of a road over station; `controllers.planning.road_preview.RoadPreview` is one."""

    station: FloatArray
    height: FloatArray
    superelevation: FloatArray


class LaneAlong(Protocol):
    """A lane followed along the road; `controllers.planning.road_preview.LanePath` is one."""

    @property
    def station(self) -> FloatArray:
        """Stations [m], rising."""

    @property
    def offset(self) -> FloatArray:
        """Offset of the lane's middle at the stations [m]."""

    @property
    def half_width(self) -> float:
        """[m]."""

    @property
    def end(self) -> float:
        """Station of the lane's end [m]."""

    @property
    def road(self) -> RoadSurface | None:
        """The road's surface, None to count vehicles of every level."""


class Lanes(Protocol):
    """Lanes by index; `iits_mj.road.Route` is one."""

    def lane_offset(self, lane: int, station: Any) -> Any:
        """Offset of a lane's middle [m]."""

    def lane_width(self, lane: int, station: Any) -> Any:
        """Width of a lane [m]."""


@dataclass(frozen=True, slots=True)
class Neighbor:
    """A vehicle near the truck.

    Attributes:
      id: its name; gap: between the bumpers [m], negative where it overlaps the truck's length.
      station, offset: of its center [m]; speed: [m/s]; acceleration: [m/s2].
      length, width: [m].
    """

    id: str
    gap: float
    station: float
    offset: float
    speed: float
    acceleration: float
    length: float
    width: float


class Neighbors:
    """The traffic around the truck as columns of shape (n,), in the scene's order.

    `Scene.neighbors` makes it once for a scene. Each meaning of "ahead" has its own query:

    | query               | a vehicle counts when                             | ahead when its     |
    |---------------------|---------------------------------------------------|--------------------|
    | `leader_along_path` | its body is in the followed lane now or in 1 s,   | center is ahead of |
    |                     | and it is on the lane's level                     | the front bumper   |
    | `leader_in_lane`    | its body is in the lane of an index now, within   | center is ahead of |
    |                     | 250 m, and it is on a lane of the route           | the front bumper   |
    | `corridor_gaps`     | its body reaches into the truck's own width, or   | center is ahead of |
    |                     | it is listed in the truck's lane                  | the truck's center |
    | `nearest_by_front`  | it is on any lane of the route                    | front bumper is    |
    |                     |                                                   | ahead of the       |
    |                     |                                                   | truck's            |

    A body is in a lane when it reaches 0.3 m or more into it.

    Args:
      ego: the truck.
      vehicles: the traffic.
      footprint: of the truck.

    Attributes:
      ids: names of the vehicles.
      lane: index on the route, -1 off it.
      station, offset, speed, lateral_speed, length, width, acceleration, yaw, yaw_rate, x, y, z:
        see `TrackedVehicle`.
      gap: between the bumpers along the route, negative where it overlaps the truck's length [m].
      front_distance: from the truck's front bumper to the vehicle's, positive ahead [m].
      posed: whether the vehicle has a pose, see `TrackedVehicle`.
      front, rear: stations of the truck's front bumper and of the trailer's rear [m].

    Raises:
      InputError: a number of a vehicle is not finite; the message names vehicle and number.
    """

    def __init__(
        self, ego: EgoState, vehicles: Sequence[TrackedVehicle], footprint: EgoFootprint
    ) -> None:
        self.front = ego.station + footprint.front_overhang
        self.rear = self.front - footprint.length
        self._ego, self._footprint = ego, footprint
        if isinstance(vehicles, VehicleFrame):
            self.ids, self.lane = vehicles.ids, vehicles.lanes
            table = vehicles.columns(*_FIGURES)
        else:
            self.ids = tuple(vehicle.id for vehicle in vehicles)
            self.lane = np.array([vehicle.lane for vehicle in vehicles], dtype=np.intp)
            rows = np.array(list(map(_figures_of, vehicles)), dtype=float)
            table = np.ascontiguousarray(rows.reshape(-1, len(_FIGURES)).T)
        finite = np.isfinite(table)
        if not finite.all():
            index, figure = np.argwhere(~finite.T)[0]
            raise InputError(
                f"vehicle {self.ids[index]!r}: {_FIGURES[figure]} is {table[figure, index]}: "
                "not finite"
            )
        self.station, self.offset, self.speed, self.lateral_speed, self.length, self.width = table[
            :6
        ]
        self.acceleration, self.yaw, self.yaw_rate, self.x, self.y, self.z = table[6:]
        half = 0.5 * self.length
        self.gap = np.maximum(self.station - half - self.front, self.rear - self.station - half)
        self.front_distance = self.station + half - self.front
        self.posed = (self.x != 0.0) | (self.y != 0.0) | (self.z != 0.0)
        self._level: tuple[RoadSurface, BoolArray] | None = None
        self._along: dict[int, tuple[LaneAlong, BoolArray]] = {}
        self._leaders: dict[int, tuple[LaneAlong, Neighbor | None]] = {}

    def neighbor(self, index: int) -> Neighbor:
        """Returns the vehicle of an index."""
        columns = self.gap, self.station, self.offset, self.speed, self.acceleration
        sizes = self.length, self.width
        return Neighbor(self.ids[index], *(float(column[index]) for column in columns + sizes))

    def on_level(self, road: RoadSurface) -> BoolArray:
        """Which vehicles drive on the road, not on a bridge above or a road below, shape (n,).

        A vehicle without a pose counts as on the road.
        """
        if self._level is None or self._level[0] is not road:
            bank = np.interp(self.station, road.station, road.superelevation)
            height = np.interp(self.station, road.station, road.height)
            above = self.z - (height + self.offset * np.tan(bank))
            self._level = road, np.asarray(~self.posed | (np.abs(above) < LEVEL_OVER_ROAD))
        return self._level[1]

    def along_path(self, path: LaneAlong, entering: float = 0.0) -> BoolArray:
        """Which vehicles are in a lane that is followed along the road, shape (n,).

        A vehicle counts when its body is in the lane now or will be in 1 s at its lateral speed: a
        vehicle that changes lanes is in both.

        Args:
          path: of the lane.
          entering: also counts vehicles that cross into the lane within this time [s].
        """
        known = self._along.get(id(path))
        if entering == 0.0 and known is not None:
            return known[1]
        middle = np.interp(self.station, path.station, path.offset)
        reach = path.half_width + 0.5 * self.width - INTRUSION
        soon = self.offset + _ANTICIPATION * self.lateral_speed
        inside = (np.abs(self.offset - middle) < reach) | (np.abs(soon - middle) < reach)
        if entering > 0.0:
            crossing = np.abs(self.lateral_speed) > _WEAVING
            later = self.offset + entering * self.lateral_speed
            # A vehicle that will have crossed the whole lane by then has been in it.
            through = (self.offset - middle) * (later - middle) < 0.0
            inside |= crossing & ((np.abs(later - middle) < reach) | through)
        inside &= (self.station >= path.station[0]) & (self.station <= path.station[-1])
        # A lane holds no vehicle beyond its end.
        inside &= self.station <= path.end
        if path.road is not None:
            inside &= self.on_level(path.road)
        if entering == 0.0:
            self._along[id(path)] = path, inside
        return inside

    def leader_along_path(self, path: LaneAlong) -> Neighbor | None:
        """The nearest vehicle of the followed lane whose center is ahead of the front bumper."""
        found = self._leaders.get(id(path))
        if found is None:
            leader = self._nearest(self.along_path(path) & (self.station > self.front))
            found = self._leaders[id(path)] = path, leader
        return found[1]

    def is_beside(self, path: LaneAlong) -> bool:
        """Whether the center of a vehicle of the followed lane is beside the truck."""
        beside = (self.station <= self.front) & (self.station >= self.rear)
        return bool((self.along_path(path) & beside).any())

    def in_lane(self, lanes: Lanes, lane: int) -> BoolArray:
        """Which vehicles are in the lane of an index, at the vehicles' own stations, shape (n,).

        A vehicle counts when its body is in the lane now, it is on a lane of the route and within
        250 m of the front bumper.
        """
        middle = lanes.lane_offset(lane, self.station)
        half = 0.5 * lanes.lane_width(lane, self.station)
        inside = np.abs(self.offset - middle) < half + 0.5 * self.width - INTRUSION
        near = np.abs(self.station - self.front) <= _LANE_REACH
        return np.asarray(inside & near & (self.lane >= 0))

    def leader_in_lane(self, lanes: Lanes, lane: int) -> Neighbor | None:
        """The nearest vehicle of a lane whose center is ahead of the front bumper."""
        return self._nearest(self.in_lane(lanes, lane) & (self.station > self.front))

    def follower_in_lane(self, lanes: Lanes, lane: int) -> Neighbor | None:
        """The nearest vehicle of a lane behind the front bumper, or beside the truck."""
        return self._nearest(self.in_lane(lanes, lane) & (self.station <= self.front))

    def is_lane_free(self, lanes: Lanes, lane: int, distance: float) -> bool:
        """Whether every bumper gap of a lane, ahead, beside and behind, is at least this [m]."""
        return bool((self.gap[self.in_lane(lanes, lane)] >= distance).all())

    def corridor_gaps(self, lane: int) -> tuple[float, float]:
        """Bumper gaps to the vehicles ahead of and behind the truck's own corridor [m].

        A vehicle counts when its body reaches into the truck's width, in any lane, which includes a
        vehicle that cuts in; or when it is listed in the truck's lane. The truck's center divides
        ahead from behind. A gap is inf without a vehicle, and negative for an overlap.

        Args:
          lane: index of the truck's lane, -1 off the road.
        """
        ego, reach = self._ego, 0.5 * (self.width + self._footprint.width)
        inside = np.abs(self.offset - ego.offset) < reach
        if lane >= 0:
            inside |= self.lane == lane
        inside &= (self.lane >= 0) | (np.abs(self.z - ego.z) < LEVEL_OVER_TRUCK)
        before = self.station >= 0.5 * (self.front + self.rear)
        ahead = float(np.min(self.gap[inside & before], initial=np.inf))
        return ahead, float(np.min(self.gap[inside & ~before], initial=np.inf))

    def nearest_by_front(self, ahead: float, behind: float) -> tuple[IndexArray, IndexArray]:
        """Indices of the vehicles on any lane of the route, ahead and behind, nearest first.

        Front bumpers are compared, so that a vehicle beside the trailer is behind.

        Args:
          ahead: reach ahead of the truck's front bumper [m].
          behind: reach behind the trailer's rear [m].
        """
        distance, on_route = self.front_distance, self.lane >= 0
        before = (on_route & (distance > 0.0) & (distance <= ahead)).nonzero()[0]
        least = -behind - self._footprint.length
        after = (on_route & (distance <= 0.0) & (distance >= least)).nonzero()[0]
        return (
            before[np.argsort(distance[before], kind="stable")],
            after[np.argsort(-distance[after], kind="stable")],
        )

    def _nearest(self, chosen: BoolArray) -> Neighbor | None:
        candidates = chosen.nonzero()[0]
        if not candidates.size:
            return None
        return self.neighbor(int(candidates[self.gap[candidates].argmin()]))
