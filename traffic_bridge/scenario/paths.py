"""Paths of straight pieces through points of the map, on which road users move."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.road import Route
from iits_mj.road.reference_line import RoadPoint

CLOSEST = 1e-3  # [m] between two points of a path
SPACING = 2.0  # [m] between points of a path that follows the route
EQUAL = 0.5  # [m]: of places that are so equally near, the first one on the path counts


class Path:
    """A path through points of the map; beyond its ends it extends straight.

    A body's heading is that of the chord between its ends, which are both on the path, so that it
    does not jump at a corner.

    Args:
      points: x, y and, if all have it, z [m], at least two, shape (n, 2 or 3).
      span: length of the body [m].
      route: whose surface gives the height where the points have none.

    Attributes:
      stations: of the points along the path [m]; length: of the path [m].
    """

    def __init__(self, points: Sequence[Sequence[float]], span: float, route: Route) -> None:
        table = np.array([tuple(point) for point in points], dtype=float)
        steps = np.hypot(*np.diff(table[:, :2], axis=0).T)
        if len(steps) == 0 or steps.min() < CLOSEST:
            raise InputError(
                f"points: a path needs two or more, each {CLOSEST:g} m or more from the next"
            )
        self.stations: FloatArray = np.concatenate(([0.0], np.cumsum(steps)))
        self.length = float(self.stations[-1])
        self._points, self._span, self._route = table, span, route

    def evaluate(self, station: float, offset: float = 0.0) -> RoadPoint:
        """Returns the point at a station, an offset to the left of the path; see `Route`."""
        x, y, z = self._at(station)
        half = 0.5 * self._span
        behind, ahead = self._at(station - half), self._at(station + half)
        dx, dy = ahead[0] - behind[0], ahead[1] - behind[1]
        way = math.hypot(dx, dy)
        if way < 0.1 * self._span:  # the path turns back within the body's length
            k = self._piece(station)
            dx, dy = self._points[k + 1, :2] - self._points[k, :2]
        heading = math.atan2(dy, dx)
        x, y = x - offset * math.sin(heading), y + offset * math.cos(heading)
        grade, bank = (ahead[2] - behind[2]) / max(way, self._span), 0.0
        if math.isnan(z):
            surface = self._route.evaluate(*self._route.locate(x, y))
            turn = heading - float(surface.heading)
            rise, slope = float(surface.grade), math.tan(float(surface.superelevation))
            z = float(surface.z)
            grade = math.cos(turn) * rise + math.sin(turn) * slope
            bank = math.atan(math.cos(turn) * slope - math.sin(turn) * rise)
        return RoadPoint(x, y, z, heading, 0.0, grade, bank)  # type: ignore[arg-type]

    def locate(self, x: float, y: float, near_station: float | None = None) -> tuple[float, float]:
        """Returns station and offset of the nearest place, the first one of equally near ones."""
        del near_station
        start = self._points[:-1, :2]
        pieces = np.diff(self._points[:, :2], axis=0)
        lengths = np.diff(self.stations)
        along = ((np.array([x, y]) - start) * pieces).sum(axis=1) / lengths
        low, high = np.zeros(len(lengths)), lengths.copy()
        # The ends extend straight.
        low[0], high[-1] = -math.inf, math.inf
        along = np.clip(along, low, high)
        foot = start + pieces * (along / lengths)[:, None]
        distance = np.hypot(x - foot[:, 0], y - foot[:, 1])
        k = int(np.argmax(distance <= distance.min() + EQUAL))
        side = pieces[k, 0] * (y - foot[k, 1]) - pieces[k, 1] * (x - foot[k, 0])
        return float(self.stations[k] + along[k]), math.copysign(float(distance[k]), float(side))

    def lane_offset(self, lane: int, station: float) -> float:
        """Returns the offset of the path itself [m]: 0."""
        del lane, station
        return 0.0

    def _piece(self, station: float) -> int:
        k = int(np.searchsorted(self.stations, station, side="right")) - 1
        return min(max(k, 0), len(self.stations) - 2)

    def _at(self, station: float) -> tuple[float, float, float]:
        """X, y and z on the path [m]; z is NaN where the points have none."""
        k = self._piece(station)
        part = (station - self.stations[k]) / (self.stations[k + 1] - self.stations[k])
        place = (self._points[k] + part * (self._points[k + 1] - self._points[k])).tolist()
        return place[0], place[1], place[2] if len(place) > 2 else math.nan


def points_on_route(
    route: Route, places: Sequence[Sequence[float]]
) -> tuple[list[tuple[float, ...]], list[int]]:
    """Points of the map on the way over (station, offset) places of a route.

    Returns:
      The points [m], 2 m or less apart, and the numbers of those that are the places.
    """
    points, numbers = [route.evaluate(*places[0])], [0]
    for (s0, t0), (s1, t1) in itertools.pairwise(places):
        count = max(math.ceil(math.hypot(s1 - s0, t1 - t0) / SPACING), 1)
        for k in range(1, count + 1):
            part = k / count
            points.append(route.evaluate(s0 + part * (s1 - s0), t0 + part * (t1 - t0)))
        numbers.append(len(points) - 1)
    return [(float(p.x), float(p.y), float(p.z)) for p in points], numbers
