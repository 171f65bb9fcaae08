"""Streets: roads of a map at their full width, with every lane, as lines that can be drawn.

A street is either the route of the truck or one other road of its map. `Footprints` tells which
places they cover.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.road import RoadPoint, Route
from iits_mj.road.chain import Piece
from iits_mj.road.elements import PAVED_TYPES, Lane, LaneSection, Road, lane_borders
from iits_mj.road.polynomials import PiecewiseCubic
from iits_mj.road.reference_line import ReferenceLine

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Lane types without a surface of their own: the ground is seen.
BARE = frozenset(("none", "median"))
SAMPLE = 1.0  # [m] between the rows of a footprint
LEVEL = 1.5  # [m] of height up to which two surfaces belong to one place


@dataclass(frozen=True)
class Span:
    """A stretch with one set of lanes, over [start, end) of station."""

    start: float
    end: float
    piece: Piece
    section: LaneSection

    @cached_property
    def borders(self) -> dict[int, PiecewiseCubic]:
        """The road's t of the outer border of every lane, by lane id; 0 is the center line."""
        road, section = self.piece.road, self.section
        return {**lane_borders(road, section, 1), **lane_borders(road, section, -1)}

    @property
    def in_junction(self) -> bool:
        """Whether the road leads through a junction."""
        return self.piece.road.junction is not None

    def inner(self, lane: Lane) -> int:
        """Returns the id of the neighbor of a lane towards the center line."""
        ids = [other.id for other in self.section.side(1 if lane.id < 0 else -1)]
        place = ids.index(lane.id)
        return ids[place - 1] if place else 0


class Street:
    """A route, or one road of a map, at its full width."""

    def __init__(self, spans: Sequence[Span], length: float, line: ReferenceLine | None) -> None:
        """Use `of_route` or `of_road`; stations are those of `line`, or the road's s."""
        self.spans = tuple(spans)
        self.length = length
        self._line = line
        self._starts = np.array([span.start for span in spans])

    @classmethod
    def of_route(cls, route: Route) -> Street:
        """Returns the street of a route, on its reference line."""
        spans = []
        for band in route.bands:
            start, end = (float(route.line.station(p)) for p in (band.p_start, band.p_end))
            spans.append(Span(start, end, band.piece, band.section))
        return cls(spans, route.length, route.line)

    @classmethod
    def of_road(cls, road: Road) -> Street:
        """Returns the street of a road, along its s."""
        piece = Piece(road, 1, 0.0, road.length, 0.0)
        spans = [Span(start, end, piece, section) for start, end, section in road.section_spans()]
        return cls(spans, road.length, None)

    def between(self, start: float, end: float) -> Iterator[tuple[Span, float, float]]:
        """Yields the spans in an interval, and the part of it in each; the ends extend beyond."""
        for i, span in enumerate(self.spans):
            low = -np.inf if i == 0 else span.start
            high = np.inf if i + 1 == len(self.spans) else span.end
            a, b = max(start, low), min(end, high)
            if b - a > 0.1:
                yield span, a, b

    def s(self, span: Span, station: FloatArray) -> FloatArray:
        """The road's s at stations of a span."""
        if self._line is None:
            return station
        return span.piece.s_at(self._line.parameter(np.clip(station, 0.0, self.length)))

    def station(self, span: Span, s: float) -> float:
        """The station at a road's s."""
        p = span.piece.p_at(s)
        return p if self._line is None else float(self._line.station(p))

    def evaluate(self, station: ArrayLike) -> RoadPoint:
        """Points of the reference line; see `Route.evaluate`."""
        station = np.asarray(station, dtype=float)
        if self._line is not None:
            return self._line.evaluate(station)
        value, rate, bend = self.spans[0].piece.state(station)
        speed = np.maximum(np.hypot(rate[0], rate[1]), 1e-9)
        curvature = (rate[0] * bend[1] - rate[1] * bend[0]) / speed**3
        heading = np.unwrap(np.arctan2(rate[1], rate[0]))
        x, y, z, roll = value
        return RoadPoint(x, y, z, heading, curvature, rate[2] / speed, roll)

    def offset(self, span: Span, lane_id: int, station: FloatArray) -> FloatArray:
        """Offset of a lane's outer border at stations of a span [m]."""
        piece = span.piece
        return piece.direction * span.borders[lane_id].evaluate(self.s(span, station)) - piece.shift

    def surface_edges(self, station: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Offsets of the right and left edge of everything that has a surface [m]."""
        return self._edges(station, lambda lane: lane.kind not in BARE)

    def paved_edges(self, station: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Offsets of the right and left edge of everything that vehicles use [m]."""
        return self._edges(station, lambda lane: lane.kind in PAVED_TYPES)

    def _edges(
        self, station: ArrayLike, counts: Callable[[Lane], bool]
    ) -> tuple[FloatArray, FloatArray]:
        station = np.asarray(station, dtype=float)
        right, left = np.zeros(station.shape), np.zeros(station.shape)
        index = np.maximum(np.searchsorted(self._starts, station, side="right") - 1, 0)
        for i in np.unique(index):
            span, chosen = self.spans[i], index == i
            lanes = [lane for lane in span.section.lanes if lane.id and counts(lane)]
            ids = {lane.id for lane in lanes} | {span.inner(lane) for lane in lanes}
            rows = [self.offset(span, one, station[chosen]) for one in ids or {0}]
            right[chosen], left[chosen] = np.min(rows, axis=0), np.max(rows, axis=0)
        return right, left


@dataclass(frozen=True)
class Rows:
    """Rows across one street: center, direction and half width of each, (n,)."""

    x: FloatArray
    y: FloatArray
    z: FloatArray
    heading: FloatArray
    tilt: FloatArray
    half: FloatArray

    @cached_property
    def tree(self) -> cKDTree:
        """For the search of the nearest row."""
        from scipy.spatial import cKDTree

        return cKDTree(np.stack([self.x, self.y], axis=-1))

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the space that they can cover [m]."""
        points = np.stack([self.x, self.y, self.z])
        reach = float(self.half.max(initial=0.0)) + SAMPLE
        rise = reach * float(np.abs(self.tilt).max(initial=0.0))
        margin = np.array([reach, reach, rise])
        return points.min(axis=1) - margin, points.max(axis=1) + margin

    def near(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Depth inside the surface (negative beside it), and the surface's height there [m]."""
        _, index = self.tree.query(points[:, :2])
        dx, dy = points[:, 0] - self.x[index], points[:, 1] - self.y[index]
        c, s = np.cos(self.heading[index]), np.sin(self.heading[index])
        along, aside = dx * c + dy * s, dy * c - dx * s
        depth = np.minimum(self.half[index] - np.abs(aside), SAMPLE - np.abs(along))
        return depth, self.z[index] + aside * self.tilt[index]


def rows_across(street: Street, start: float, end: float, *, paved: bool) -> Rows:
    """Returns the rows of a street between two stations, of its paved or of its full width."""
    station = np.linspace(start, end, max(int((end - start) / SAMPLE), 1) + 1)
    right, left = street.paved_edges(station) if paved else street.surface_edges(station)
    x, y, z, heading, _, _, roll = street.evaluate(station)
    middle, tilt = 0.5 * (right + left), np.tan(roll)
    return Rows(
        x - middle * np.sin(heading),
        y + middle * np.cos(heading),
        z + middle * tilt,
        heading,
        tilt,
        0.5 * (left - right),
    )


class Footprints:
    """The places that streets cover, by the name of the street."""

    def __init__(self, rows: dict[str, Rows]) -> None:
        self.rows = rows
        self._names = list(rows)
        self._low, self._high = (
            np.array([row.box[k] for row in rows.values()]).reshape(-1, 3) for k in (0, 1)
        )

    def covered(
        self, name: str, points: FloatArray, margin: float = 0.3, below: float | None = None
    ) -> NDArray[np.bool_]:
        """Whether points (n, 3) lie inside another street than `name`, by at least a margin [m].

        With `below`, only streets that are lower than the points by more than that count, without
        it only those of about their height.
        """
        found = np.zeros(len(points), dtype=bool)
        if not len(points):
            return found
        reach = max(-margin, 0.0)
        # No street is banked by more than 45 degrees: beside it, its height changes by less.
        lowest, highest = float(points[:, 2].min()) - reach, float(points[:, 2].max()) + reach
        if below is None:
            possible = (self._low[:, 2] < highest + LEVEL) & (self._high[:, 2] > lowest - LEVEL)
        else:
            possible = self._low[:, 2] < highest - below
        for other, near in self._others(points, reach, possible):
            if other == name:
                continue
            depth, height = self.rows[other].near(points[near])
            over = points[near, 2] - height
            level = np.abs(over) < LEVEL if below is None else over > below
            found[near[(depth > margin) & level]] = True
        return found

    def height(self, points: FloatArray, names: Iterable[str]) -> FloatArray:
        """Height of the nearest of some streets at points (n, 2) [m]."""
        best, found = np.full(len(points), -np.inf), np.zeros(len(points))
        for name in sorted(names):
            depth, height = self.rows[name].near(points)
            found = np.where(depth > best, height, found)
            best = np.maximum(depth, best)
        return found

    def _others(
        self, points: FloatArray, reach: float, possible: NDArray[np.bool_]
    ) -> Iterator[tuple[str, IndexArray]]:
        """Yields the possible streets that may cover some points, and the indices of those."""
        place = points[:, :2]
        low, high = place.min(axis=0) - reach, place.max(axis=0) + reach
        corners = self._low[:, :2], self._high[:, :2]
        close = possible & np.all((corners[0] < high) & (corners[1] > low), axis=1)
        for i in np.flatnonzero(close):
            inside = (place > corners[0][i] - reach) & (place < corners[1][i] + reach)
            near = np.flatnonzero(inside[:, 0] & inside[:, 1])
            if near.size:
                yield self._names[i], near
