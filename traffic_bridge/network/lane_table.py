"""One SUMO lane as a table: its center on the road's surface and on the route.

`LaneTable` is one lane; `LanePoses` evaluates many lanes at once.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.road import Route
from traffic_bridge.network.lane_surface import LaneSurface
from traffic_bridge.network.net_file import NetLane, distances_along

SAMPLE_SPACING = 5.0  # [m] of cubic pieces: exact to millimeters in a motorway's bends
JUNCTION_SPACING = 1.0  # [m] where a truck's turn has a radius of some meters
NEWTON_STEPS = 12
SETTLED = 1e-6  # [m]
FARTHEST_STEP = 30.0  # [m] of Newton's method
# Columns of a stack of lanes: four coefficients of x, y and z, then two of each other row.
_CUBIC = 3
_LINEAR = 6
_WIDTH = 4 * _CUBIC + 2 * _LINEAR

IntArray = NDArray[np.intp]

_vehicles_on_lanes = kernels.function(
    "iits_vehicles_on_lanes",
    kernels.Integer,
    *(kernels.Integer, *4 * [kernels.Address], kernels.Integer, kernels.Real, kernels.Address),
)


@dataclass(frozen=True, eq=False)
class LaneTable:
    """One SUMO lane.

    Attributes:
      id: SUMO's lane id; edge: its edge; index: SUMO's index from the right.
      lane: index from the right among the route's driving lanes; -1 for other lanes.
      direction: +1 in the route's direction of travel, -1 for the route's oncoming lanes, 0 for
        lanes of other roads.
      length: in SUMO's measure of positions [m].
      spacing: between samples, in the same measure [m].
      station, offset: of the lane's center at the samples, on the route [m], shape (n,).
      pose: x, y, z, heading, pitch, roll, curvature of the lane's center on the road's surface in
        its own direction, in the map frame, heading continuous, shape (7, n).
    """

    id: str
    edge: str
    index: int
    lane: int
    direction: int
    length: float
    spacing: float
    station: FloatArray
    offset: FloatArray
    pose: FloatArray

    @cached_property
    def _plain(self) -> tuple[list[float], list[float]]:
        """Stations in increasing order, and offsets in the order of the samples, as floats."""
        stations = self.station if self.direction >= 0 else self.station[::-1]
        return stations.tolist(), self.offset.tolist()

    def at(self, position: float) -> tuple[float, float]:
        """Station and offset at a position along the lane, extrapolated beyond its ends.

        Beyond the ends a meter along the lane is a meter of station, because the slope of an
        internal lane of some centimeters is not meaningful.
        """
        s, d = self._plain
        last = len(d) - 1
        inside = min(max(position, 0.0), self.length)
        place = inside / self.spacing
        i = min(int(place), last - 1)
        part = place - i
        if self.direction >= 0:
            low, high = s[i], s[i + 1]
        else:
            low, high = s[last - i], s[last - i - 1]
        return (
            low + part * (high - low) + self.direction * (position - inside),
            d[i] + part * (d[i + 1] - d[i]),
        )

    def position_of(self, station: float) -> float:
        """Position along the lane of a station, clipped to the lane [m]."""
        s, _ = self._plain
        i = bisect_right(s, station) - 1
        last = len(s) - 1
        if i < 0 or i >= last:
            place = 0.0 if i < 0 else float(last)
        else:
            place = i + (station - s[i]) / (s[i + 1] - s[i])
        if self.direction < 0:
            place = last - place
        return place * self.spacing


def sample_spacing(lane: NetLane) -> float:
    """Distance between the samples of a lane, at most [m]."""
    return JUNCTION_SPACING if lane.internal else SAMPLE_SPACING


def sample_shape(lane: NetLane) -> tuple[FloatArray, FloatArray]:
    """Points at even positions of a SUMO lane's polyline, in its coordinates: x, y, shape (n,)."""
    along = distances_along(lane.shape)
    count = max(math.ceil(lane.length / sample_spacing(lane) - 1e-9), 2) + 1
    places = np.linspace(0.0, along[-1], count)
    return np.interp(places, along, lane.shape[:, 0]), np.interp(places, along, lane.shape[:, 1])


def locate_along(
    route: Route, x: FloatArray, y: FloatArray, near: float, direction: int
) -> tuple[FloatArray, FloatArray]:
    """Stations and offsets of the points of a route's lane, all at once by Newton's method.

    Args:
      route: the ego's road.
      x: of the points, in the order of the lane, map frame [m], shape (n,).
      y: likewise.
      near: station near the first point [m].
      direction: +1 where stations increase along the lane, -1 where they decrease.
    """
    first, _ = route.locate(float(x[0]), float(y[0]), near)
    station = first + direction * distances_along(np.column_stack((x, y)))
    for _ in range(NEWTON_STEPS):
        foot = route.evaluate(station)
        dx, dy = x - foot.x, y - foot.y
        sine, cosine = np.sin(foot.heading), np.cos(foot.heading)
        offset = dy * cosine - dx * sine
        step = (dx * cosine + dy * sine) / np.maximum(1.0 - foot.curvature * offset, 0.2)
        if float(np.abs(step).max()) < SETTLED:
            return station, offset
        station = station + np.clip(step, -FARTHEST_STEP, FARTHEST_STEP)
    return locate_each(route, x, y, near)


def locate_each(
    route: Route, x: FloatArray, y: FloatArray, near: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Nearest stations and offsets of points, located one by one; shape (n,) each."""
    station, offset = np.empty(len(x)), np.empty(len(x))
    for k in range(len(x)):
        station[k], offset[k] = route.locate(float(x[k]), float(y[k]), near)
        near = float(station[k])
    return station, offset


def route_pose(route: Route, station: FloatArray, offset: FloatArray, direction: int) -> FloatArray:
    """Pose of a lane's center from the route's geometry, shape (7, n); see `LaneTable`."""
    point = route.evaluate(station, offset)
    stretch = np.maximum(1.0 - point.curvature * offset, 0.2)
    way = per_sample(station) * stretch
    # Some internal lanes have no length; their direction is the road's.
    aside = np.divide(per_sample(offset), way, out=np.zeros_like(way), where=np.abs(way) > 1e-6)
    heading = np.unwrap(point.heading + np.arctan(aside) + (math.pi if direction < 0 else 0.0))
    sense = float(direction)
    pitch, roll = -sense * np.arctan(point.grade), sense * point.superelevation
    return with_curvature(point.x, point.y, point.z, heading, pitch, roll)


def surface_pose(surface: LaneSurface) -> FloatArray:
    """Pose of a lane's center from its road's surface, shape (7, n); see `LaneTable`."""
    heading, pitch = np.unwrap(surface.heading), -np.arctan(surface.grade)
    return with_curvature(surface.x, surface.y, surface.z, heading, pitch, surface.bank)


def with_curvature(*rows: FloatArray) -> FloatArray:
    """Stacks x, y, z, heading, pitch and roll and adds the curvature, shape (7, n).

    The curvature is the change of heading over the distance.
    """
    pose = np.stack(rows)
    reach = np.hypot(per_sample(pose[0]), per_sample(pose[1]))
    curvature = np.divide(per_sample(pose[3]), reach, out=np.zeros_like(reach), where=reach > 1e-6)
    return np.concatenate((pose, curvature[None]))


def per_sample(values: FloatArray) -> FloatArray:
    """Change per sample; at the ends of second order too if there are three samples."""
    return np.gradient(values, edge_order=2) if len(values) > 2 else np.gradient(values)


class VehicleLanes(NamedTuple):
    """The lanes on which n vehicles are.

    Attributes:
      numbers: of the lanes in `LanePoses`, shape (n,).
      route_lanes: their indices on the route, -1 off it, shape (n,).
      directions: on the route, see `LaneTable`, shape (n,).
      table: for the compiled function.
    """

    numbers: IntArray
    route_lanes: IntArray
    directions: FloatArray
    table: kernels.Table


class LanePoses:
    """Poses of many vehicles at once, from the stacked tables of their lanes.

    Args:
      make: makes the table of a SUMO lane by id; called once for each lane.

    Attributes:
      tables: of every lane with a number; the number is the index in this list.
    """

    def __init__(self, make: Callable[[str], LaneTable]) -> None:
        self._make = make
        self.tables: list[LaneTable] = []
        self._numbers: dict[str, int] = {}
        self._pieces = kernels.Table(np.zeros((0, _WIDTH)))
        # Of each lane: first piece, last piece, direction on the route, pieces per meter.
        self._of_lane: FloatArray = np.zeros((4, 0))
        self._route_lanes: IntArray = np.zeros(0, dtype=np.intp)

    def numbers(self, lanes: Sequence[str]) -> IntArray:
        """Numbers of n lanes, shape (n,); makes the tables of new lanes."""
        try:
            found = [*map(self._numbers.__getitem__, lanes)]
        except KeyError:
            self._add([self._make(lane) for lane in sorted(set(lanes) - self._numbers.keys())])
            return self.numbers(lanes)
        return np.array(found, dtype=np.intp)

    def lanes(self, numbers: IntArray) -> VehicleLanes:
        """The lanes of n vehicles for `evaluate`, by their numbers; shape (n,)."""
        rows = self._of_lane.take(numbers, axis=1)
        return VehicleLanes(numbers, self._route_lanes.take(numbers), rows[2], kernels.Table(rows))

    def evaluate(
        self,
        lanes: VehicleLanes,
        given: kernels.Table,
        centers: kernels.Table,
        columns: kernels.Table,
        *,
        placed: bool = False,
        elapsed: float = 0.0,
    ) -> int:
        """Computes the columns of vehicles on their lanes' centers, extrapolated beyond the ends.

        Args:
          lanes: of the n vehicles.
          given: speed [m/s] and position of the front bumper in SUMO's measure [m], shape (2, n).
          centers: positions of the vehicles' centers in the same measure [m], shape (n,); written
            unless `placed`.
          columns: of a `VehicleFrame`, shape (len(COLUMNS), n); the sizes are given.
          placed: the centers are given.
          elapsed: time since the speeds in the columns, which gives the acceleration [s]; 0: the
            accelerations are given.

        Returns:
          The number of vehicles whose center lies before the beginning of their lane. If it is not
          zero, nothing but the centers is computed.
        """
        return int(
            _vehicles_on_lanes(
                len(lanes.numbers),
                *(lanes.table.address, self._pieces.address, given.address, centers.address),
                *(placed, elapsed, columns.address),
            )
        )

    def _add(self, tables: list[LaneTable]) -> None:
        pieces = [_pieces(table) for table in tables]
        counts = np.array([len(rows) for rows in pieces])
        first = len(self._pieces.numbers) + np.cumsum(counts) - counts
        directions, spacings = zip(*((t.direction, t.spacing) for t in tables), strict=True)
        rows = np.array([first, counts - 1, directions, 1.0 / np.array(spacings)])
        self._pieces = kernels.Table(np.concatenate((self._pieces.numbers, *pieces)))
        self._of_lane = np.concatenate((self._of_lane, rows), axis=1)
        new = np.array([table.lane for table in tables], dtype=np.intp)
        self._route_lanes = np.concatenate((self._route_lanes, new))
        self._numbers.update((table.id, len(self.tables) + k) for k, table in enumerate(tables))
        self.tables += tables


def _pieces(table: LaneTable) -> FloatArray:
    """Polynomials between the samples of a lane: cubic Hermite for x, y and z, else linear.

    Returns:
      Shape (samples - 1, _WIDTH); the variable runs from 0 to 1 in each piece.
    """
    x, y, z, heading, pitch, roll, curvature = table.pose
    # The tangent comes from the heading, which is exact; the samples' differences are not.
    reach = np.hypot(per_sample(x), per_sample(y))
    place = np.stack((x, y, z))
    slope = np.stack((reach * np.cos(heading), reach * np.sin(heading), per_sample(z)))
    rise, u, v = np.diff(place), slope[:, :-1], slope[:, 1:]
    rest = np.stack((table.station, table.offset, heading, pitch, roll, curvature))
    return np.ascontiguousarray(
        np.concatenate(
            (
                place[:, :-1],
                u,
                3.0 * rise - 2.0 * u - v,
                u + v - 2.0 * rise,
                rest[:, :-1],
                np.diff(rest),
            )
        ).T
    )
