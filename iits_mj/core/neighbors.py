"""The truck's neighbors: the traffic as columns, with a query for each meaning of "ahead"."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from iits_mj import kernels
from iits_mj.core.arrays import BoolArray, FloatArray, IndexArray
from iits_mj.core.errors import InputError
from iits_mj.core.vehicles import COLUMNS, TrackedVehicle, VehicleFrame
from iits_mj.kernels import Address, Integer, Real, Table

if TYPE_CHECKING:
    from iits_mj.core.messages import EgoFootprint, EgoState

# Columns of a vehicle that must be finite, in the order of the check.
_FIGURES = (
    *("station", "offset", "speed", "lateral_speed", "length", "width"),
    *("acceleration", "yaw", "yaw_rate", "x", "y", "z"),
)
_columns_of = operator.attrgetter(*COLUMNS)
_ROWS = {name: row for row, name in enumerate((*COLUMNS, "gap", "front_distance"))}
_neighbor_of = operator.itemgetter(
    *(_ROWS[n] for n in ("gap", "station", "offset", "speed", "acceleration", "length", "width"))
)
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
# Within this angle of the road's direction, either way, a vehicle drives along it [rad].
ALONG = 0.35
# First row of the surface in a road's table.
_SURFACE = 3

_neighbors = kernels.function("iits_neighbors", Integer, Address, Integer, Real, Real)
_on_road = kernels.function(
    "iits_on_road",
    Integer,
    *(Address, Integer),  # vehicles
    *(Address, Integer, Integer, Real),  # road
    *(Real, Real, Address, Address),  # limits and results
)
_along_path = kernels.function(
    "iits_along_path",
    Integer,
    *(Address, Integer),  # vehicles
    *(Address, Integer, Integer, Real, Real),  # path
    *(Real, Real, Real, Real),  # limits
    *(Address, Real, Address),  # level, front and result
)
_corridor_gaps = kernels.function(
    "iits_corridor_gaps",
    None,
    *(Address, Integer, Address),  # vehicles
    *(Integer, Real, Real, Real, Real),  # truck
    *(Real, Address),  # limit and result
)
_Gaps = Real * 2


class RoadSurface(Protocol):
    """Surface of a road over station; `controllers.planning.road_preview.RoadPreview` is one.

    Attributes:
      step: between the stations of the table [m].
      table: rows of stations [m], two rows that are not used here, height [m], superelevation
        [rad], heading [rad] and the bound on its change within half a step [rad].
    """

    step: float
    table: Table


class LaneAlong(Protocol):
    """A lane followed along the road; `controllers.planning.road_preview.LanePath` is one."""

    @property
    def table(self) -> Table:
        """Rising stations [m] in the first row, offset of the lane's middle [m] in the last."""

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
      ids: names of the vehicles; kinds: of each, see `TrackedVehicle`.
      lane: index on the route, -1 off it.
      station, offset, speed, lateral_speed, length, width, acceleration, yaw, yaw_rate, x, y, z:
        see `TrackedVehicle`.
      gap: between the bumpers along the route, negative where it overlaps the truck's length [m].
      front_distance: from the truck's front bumper to the vehicle's, positive ahead [m].
      front, rear: stations of the truck's front bumper and of the trailer's rear [m].

    Raises:
      InputError: a number of a vehicle is not finite; the message names vehicle and number.
    """

    station: FloatArray
    offset: FloatArray
    speed: FloatArray
    lateral_speed: FloatArray
    length: FloatArray
    width: FloatArray
    acceleration: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    gap: FloatArray
    front_distance: FloatArray

    def __init__(
        self, ego: EgoState, vehicles: Sequence[TrackedVehicle], footprint: EgoFootprint
    ) -> None:
        self.front = ego.station + footprint.front_overhang
        self.rear = self.front - footprint.length
        self._ego, self._footprint = ego, footprint
        table = np.empty((len(_ROWS), len(vehicles)))
        if isinstance(vehicles, VehicleFrame):
            self.ids, self.kinds, self.lane = vehicles.ids, vehicles.kinds, vehicles.lanes
            table[: len(COLUMNS)] = vehicles.values.T
        else:
            self.ids = tuple(vehicle.id for vehicle in vehicles)
            self.kinds = tuple(vehicle.kind for vehicle in vehicles)
            self.lane = np.array([vehicle.lane for vehicle in vehicles], dtype=np.intp)
            for index, vehicle in enumerate(vehicles):
                table[: len(COLUMNS), index] = _columns_of(vehicle)
        self._table = Table(table)
        if not _neighbors(*self._vehicles, self.front, self.rear):
            self._require_finite()
        self._road: tuple[RoadSurface, BoolArray, BoolArray, int] | None = None
        self._along: dict[int, tuple[LaneAlong, BoolArray, int]] = {}
        self._made: dict[int, Neighbor] = {}

    def __getattr__(self, name: str) -> FloatArray:
        """A column, made on first use."""
        if name not in _ROWS:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        column = self._table.numbers[_ROWS[name]]
        setattr(self, name, column)
        return column

    @functools.cached_property
    def posed(self) -> BoolArray:
        """Whether each vehicle has a pose, see `TrackedVehicle`, shape (n,)."""
        return (self.x != 0.0) | (self.y != 0.0) | (self.z != 0.0)

    def neighbor(self, index: int) -> Neighbor:
        """Returns the vehicle of an index."""
        found = self._made.get(index)
        if found is None:
            numbers = _neighbor_of(self._table.numbers[:, index].tolist())
            found = self._made[index] = Neighbor(self.ids[index], *numbers)
        return found

    def on_level(self, road: RoadSurface) -> BoolArray:
        """Which vehicles drive on the road, not on a bridge above or a road below, shape (n,).

        A vehicle without a pose counts as on the road.
        """
        return self._on_road(road)[1]

    def surely_along(self, road: RoadSurface) -> BoolArray:
        """Which vehicles surely drive along the road, by a coarse heading of it, shape (n,)."""
        return self._on_road(road)[2]

    def all_along(self, road: RoadSurface) -> bool:
        """Whether all vehicles on the road's level drive along it for certain."""
        return self._on_road(road)[3] == 0

    def along_path(self, path: LaneAlong, entering: float = 0.0) -> BoolArray:
        """Which vehicles are in a lane that is followed along the road, shape (n,).

        A vehicle counts when its body is in the lane now or will be in 1 s at its lateral speed: a
        vehicle that changes lanes is in both. A lane holds no vehicle beyond its end.

        Args:
          path: of the lane.
          entering: also counts vehicles that cross into the lane within this time [s].
        """
        return self._in_path(path, entering)[1]

    def leader_along_path(self, path: LaneAlong) -> Neighbor | None:
        """The nearest vehicle of the followed lane whose center is ahead of the front bumper."""
        leader = self._in_path(path)[2]
        return None if leader < 0 else self.neighbor(leader)

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

    def least_gap(self, lanes: Lanes, lane: int) -> float:
        """The least bumper gap of a lane, ahead, beside or behind [m]; inf in an empty lane."""
        return float(self.gap[self.in_lane(lanes, lane)].min(initial=math.inf))

    def corridor_gaps(self, lane: int) -> tuple[float, float]:
        """Bumper gaps to the vehicles ahead of and behind the truck's own corridor [m].

        A vehicle counts when its body reaches into the truck's width, in any lane, which includes a
        vehicle that cuts in; or when it is listed in the truck's lane. The truck's center divides
        ahead from behind. A gap is inf without a vehicle, and negative for an overlap.

        Args:
          lane: index of the truck's lane, -1 off the road.
        """
        ego, gaps = self._ego, _Gaps()
        _corridor_gaps(
            *(*self._vehicles, kernels.address(self.lane)),
            *(lane, ego.offset, self._footprint.width, ego.z, 0.5 * (self.front + self.rear)),
            *(LEVEL_OVER_TRUCK, gaps),
        )
        return gaps[0], gaps[1]

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

    @property
    def _vehicles(self) -> tuple[int, int]:
        """Address of the columns, and the number of vehicles."""
        return self._table.address, len(self.ids)

    def _on_road(self, road: RoadSurface) -> tuple[RoadSurface, BoolArray, BoolArray, int]:
        """The road, `on_level`, `surely_along`, and how many are on the level and not along."""
        if self._road is None or self._road[0] is not road:
            level, along = np.empty((2, len(self.ids)), dtype=bool)
            others = _on_road(
                *self._vehicles,
                *(road.table.address, road.table.numbers.shape[1], _SURFACE, road.step),
                *(LEVEL_OVER_ROAD, ALONG, kernels.address(level), kernels.address(along)),
            )
            self._road = road, level, along, others
        return self._road

    def _in_path(self, path: LaneAlong, entering: float = 0.0) -> tuple[LaneAlong, BoolArray, int]:
        """The path, `along_path`, and the index of the leader, -1 for none."""
        known = self._along.get(id(path))
        if entering == 0.0 and known is not None:
            return known
        inside = np.empty(len(self.ids), dtype=bool)
        level = None if path.road is None else kernels.address(self.on_level(path.road))
        leader = _along_path(
            *self._vehicles,
            *(path.table.address, *path.table.numbers.shape, path.half_width, path.end),
            *(INTRUSION, _ANTICIPATION, entering, _WEAVING),
            *(level, self.front, kernels.address(inside)),
        )
        found = path, inside, leader
        if entering == 0.0:
            self._along[id(path)] = found
        return found

    def _require_finite(self) -> None:
        """Raises InputError for the first vehicle with a figure that is not finite."""
        finite = np.isfinite([getattr(self, name) for name in _FIGURES])
        if not finite.all():
            index, figure = np.argwhere(~finite.T)[0]
            name = _FIGURES[figure]
            raise InputError(
                f"vehicle {self.ids[index]!r}: {name} is {getattr(self, name)[index]}: not finite"
            )
