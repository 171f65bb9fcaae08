"""Roads of a map one by one: from (station, lane, offset) to a point of the surface, and back.

`Route` joins a chain of roads end to end for the truck. Here every road is separate, because
traffic also drives on roads outside the chain. The geometry is the same: exact records, with the
steps inside a road blended (`iits_mj.road.seams`).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.road import RoadMap
from iits_mj.road.chain import join
from iits_mj.road.elements import LaneSection, Road, lane_borders
from iits_mj.road.polynomials import PiecewiseCubic, combine
from iits_mj.road.reference_line import ReferenceLine, RoadPoint
from iits_mj.road.route import SUPERELEVATION_LIMIT
from iits_mj.road.seams import ContinuousChain

HALF_STEP = 0.05  # [m], half of the distance over which heading and grade are differences
# netconvert displaces tapered lanes by up to 2 m; a whole lane is wider [m].
NAME_TOLERANCE = 2.5


class SurfacePoint(NamedTuple):
    """Points of the road surface, arrays of one shape.

    Attributes:
      x, y, z: map frame [m].
      heading: of travel [rad], counter-clockwise from x.
      grade: dz over horizontal distance, positive uphill in travel.
      bank: roll angle of the surface in travel [rad], positive where the left side is higher.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    heading: FloatArray
    grade: FloatArray
    bank: FloatArray


class RoadFrame:
    """One road: reference line, and its lanes' centers.

    Stations are meters along the reference line, as OpenDRIVE's s.

    Attributes:
      road: the road; length: [m].

    Raises:
      MapError: its records jump by more than can be blended.
    """

    def __init__(self, road_map: RoadMap, road: Road) -> None:
        """Scales cross slopes above `SUPERELEVATION_LIMIT` down, as a route does."""
        self.road = road
        source = road_map.name
        pieces = join(road_map.roads, [(road.id, 1)], source)
        steepest = pieces[0].steepest()
        scale = SUPERELEVATION_LIMIT / steepest if steepest > SUPERELEVATION_LIMIT else 1.0
        self.line = ReferenceLine(ContinuousChain(pieces, source, scale))
        self.length = road.length
        self._starts = [section.s for section in road.sections]
        self._ends = [*self._starts[1:], road.length]
        self._borders: list[dict[int, tuple[PiecewiseCubic, PiecewiseCubic]]] = [
            _lane_sides(road, section) for section in road.sections
        ]
        self._centers = [
            {lane: combine([(0.5, inner), (0.5, outer)]) for lane, (inner, outer) in sides.items()}
            for sides in self._borders
        ]

    def section(self, s: float) -> int:
        """Index of the lane section at a station."""
        return max(bisect_right(self._starts, s) - 1, 0)

    def lanes(self, s: float) -> list[tuple[int, float, float]]:
        """(lane id, t of its right-hand and left-hand border as s grows) at a station [m]."""
        found = []
        for lane, (inner, outer) in self._borders[self.section(s)].items():
            low, high = sorted((inner.at(s), outer.at(s)))
            found.append((lane, low, high))
        return found

    def kind(self, s: float, lane: int) -> str:
        """OpenDRIVE's type of a lane at a station; "" where there is no such lane."""
        record = self.road.sections[self.section(s)].lane(lane)
        return "" if record is None else record.kind

    def speed(self, s: float, lane: int) -> float:
        """Limit of a lane at a station [m/s]: its own, else the road's; infinite: no limit."""
        section = self.road.sections[self.section(s)]
        record = section.lane(lane)
        speeds = () if record is None else record.speeds
        begun = [value for start, value in speeds if section.s + start <= s + 1e-9]
        if begun:
            return begun[-1]
        return speeds[0][1] if speeds else self.road.speed_at(s)

    def center(self, lane: int, s: FloatArray, section: int) -> FloatArray:
        """T of a lane's center by one lane section, also beyond the section's ends [m]."""
        return self._centers[section][lane].evaluate(s)

    def center_at(self, lane: int, s: float) -> float:
        """T of a lane's center at one station [m]."""
        return self._centers[self.section(s)][lane].at(s)

    def span(self, section: int) -> tuple[float, float]:
        """Stations at which a lane section begins and ends [m]."""
        return self._starts[section], self._ends[section]

    def _sections_of(self, lanes: Mapping[int, int], s: FloatArray) -> NDArray[np.intp]:
        """Lane section for each station; the nearest of those in `lanes` where there is none."""
        known = sorted(lanes)
        if len(known) == 1:
            return np.full(s.shape, known[0], dtype=np.intp)
        gaps = np.array(
            [np.maximum(np.maximum(self._starts[i] - s, s - self._ends[i]), 0.0) for i in known]
        )
        # Where two sections meet, the one that begins there counts.
        latest = len(known) - 1 - np.argmin(gaps[::-1], axis=0)
        return np.asarray(known, dtype=np.intp)[latest]

    def evaluate(
        self, lanes: Mapping[int, int], s: ArrayLike, offset: ArrayLike = 0.0
    ) -> SurfacePoint:
        """Points beside a lane's center, in the lane's direction of travel.

        Args:
          lanes: by lane section, the OpenDRIVE id the lane has there: negative right, positive
            left of the center line.
          s: stations [m], shape (n,).
          offset: to the left of the lane's center, in travel [m], shape (n,) or a number.
        """
        s = np.atleast_1d(np.asarray(s, dtype=float))
        sense = float(self.road.travel(next(iter(lanes.values()))))
        shift = sense * np.broadcast_to(np.asarray(offset, dtype=float), s.shape)
        sections = self._sections_of(lanes, s)
        places = s + np.array([[-HALF_STEP], [0.0], [HALF_STEP]])
        t = np.empty_like(places)
        for i, lane in lanes.items():
            chosen = sections == i
            if chosen.all():
                t = self.center(lane, places, i)
                break
            t[:, chosen] = self.center(lane, places[:, chosen], i)
        point = self.surface(places, t + shift)
        dx, dy = sense * (point.x[2] - point.x[0]), sense * (point.y[2] - point.y[0])
        way = np.maximum(np.hypot(dx, dy), 1e-9)
        return SurfacePoint(
            point.x[1],
            point.y[1],
            point.z[1],
            np.arctan2(dy, dx),
            sense * (point.z[2] - point.z[0]) / way,
            sense * point.superelevation[1],
        )

    def nearest_lane(self, section: int, s: float, t: float, named: int) -> int:
        """The lane of a section that a point belongs to: the named one if the point is near it.

        Otherwise the nearest lane of the same side; driving lanes come first.
        """
        centers = self._centers[section]
        if named in centers and abs(centers[named].at(s) - t) <= NAME_TOLERANCE:
            return named
        side = [lane for lane in centers if lane * named > 0]
        record = self.road.sections[section]
        driving = [lane for lane in record.driving(1 if named < 0 else -1) if lane.id in side]
        choice = [lane.id for lane in driving] or side or list(centers)
        return min(choice, key=lambda lane: (abs(centers[lane].at(s) - t), abs(lane)))

    def surface(self, s: FloatArray, t: FloatArray) -> RoadPoint:
        """Points of the surface at (s, t) of the road."""
        inside = np.clip(s, 0.0, self.length)
        return self.line.evaluate(self.line.station(inside) + (s - inside), t)

    def locate(self, x: float, y: float, near: float | None = None) -> tuple[float, float]:
        """(s, t) of a point of the map."""
        station, t = self.line.locate(
            x, y, None if near is None else float(self.line.station(np.clip(near, 0, self.length)))
        )
        return self.line.parameter_at(station), t


class RoadFrames(dict[str, RoadFrame]):
    """The frames of a map's roads, made on first use."""

    def __init__(self, road_map: RoadMap) -> None:
        super().__init__()
        self.road_map = road_map

    def __missing__(self, road: str) -> RoadFrame:
        """Makes a road's frame; a KeyError names a road that is not of the map."""
        frame = self[road] = RoadFrame(self.road_map, self.road_map.roads[road])
        return frame


def _lane_sides(
    road: Road, section: LaneSection
) -> dict[int, tuple[PiecewiseCubic, PiecewiseCubic]]:
    """Inner and outer border of every lane of a section, as t over s [m]."""
    sides = {}
    for direction in (1, -1):
        borders = lane_borders(road, section, direction)
        inner = borders[0]
        for lane in section.side(direction):
            sides[lane.id] = (inner, borders[lane.id])
            inner = borders[lane.id]
    return sides
