"""Paint on roads: lane markings by OpenDRIVE type and color, and potholes."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.corridor import Corridor
from iits_mj.model.scenery.streets import Span, Street
from iits_mj.model.visuals.shapes import Shape, merge
from iits_mj.road import Route
from iits_mj.road.elements import Lane, RoadMark
from iits_mj.road.unevenness import LENGTH, WIDTH

MARKING_LIFT = 0.02
MARKING_WIDTH = 0.12  # [m] at least
DASH_LENGTH, DASH_PERIOD = 6.0, 15.0
# A pothole lies between the asphalt and its paint [m]; corners of its outline, and their share of
# the radius: broken edges are no circle.
POTHOLE_LIFT = 0.012
POTHOLE_EDGE = 1.0 + 0.12 * np.array([1, -1, 0, 1, 0, -1, 1, 0, -1, 0.5, -0.5, 0])
COLORS = ("yellow", "red", "blue", "green", "orange")

Hidden = Callable[[FloatArray, FloatArray], NDArray[np.bool_]]
"""Whether paint at stations (n,) and their points (n, 3) is left out, (n,)."""


def markings(
    street: Street, corridor: Corridor, start: float, end: float, hidden: Hidden | None = None
) -> dict[str, Shape]:
    """Returns the lane markings between two stations as one mesh per material.

    Args:
      street: with the lanes.
      corridor: with its drawing stations.
      start: first station [m].
      end: last station [m].
      hidden: which places get no paint, as where roads cross.
    """
    found: dict[str, list[Shape]] = defaultdict(list)
    for span, a, b in street.between(start, end):
        for lane in span.section.lanes:
            for mark, begin, last in _records(street, span, lane, a, b):
                color = f"_{mark.color}" if mark.color in COLORS else ""
                width = max(mark.width, MARKING_WIDTH)
                for broken, aside in _lines(mark, lane.id, width):
                    shift = span.piece.direction * aside
                    line = _Line(street, span, lane.id, shift, width)
                    draw = line.dashes if broken else line.solid
                    found[f"road_marking{color}"] += draw(corridor, begin, last, hidden)
        if _lacks_edge_line(span):
            part = corridor.between(a, b - 1e-3)
            _, left = street.paved_edges(part.station)
            if np.all(left > street.offset(span, 0, part.station) + 2.0):
                outer, inner = left - 0.075, left - 0.225
                found["road_marking"].append(part.strip(outer, inner, MARKING_LIFT))
    return {material: merge(shapes) for material, shapes in found.items() if shapes}


def potholes(route: Route, start: float, end: float) -> Shape | None:
    """Returns the potholes of a route between two stations as flat dark patches; None for none."""
    uneven = route.unevenness
    first, last = max(start, 0.0), min(end, route.length)
    if not uneven.potholes or last <= first:
        return None
    # The surface repeats along and across the road.
    station, offset, diameter, _ = uneven.pothole_places().T
    rows = np.arange(math.floor(first / LENGTH), math.ceil(last / LENGTH))
    right, left = route.surface_edges(np.linspace(first, last, 16))
    columns = np.arange(math.floor(np.min(right) / WIDTH), math.ceil(np.max(left) / WIDTH))
    shape = (len(rows), len(columns), len(station))
    station = np.broadcast_to(station + LENGTH * rows[:, None, None], shape).ravel()
    offset = np.broadcast_to(offset + WIDTH * columns[:, None], shape).ravel()
    radius = 0.5 * np.broadcast_to(diameter, shape).ravel()
    right, left = route.surface_edges(station)
    kept = (station >= first) & (station < last)
    kept &= (offset - radius > right) & (offset + radius < left)
    if not kept.any():
        return None
    station, offset, radius = station[kept], offset[kept], radius[kept]
    count, corners = len(station), len(POTHOLE_EDGE)
    angle = 2.0 * np.pi * np.arange(corners) / corners
    edge = radius[:, None] * POTHOLE_EDGE
    along = (station[:, None] + edge * np.cos(angle)).ravel()
    row = Corridor.sample(route, along)
    points = row.across((offset[:, None] + edge * np.sin(angle)).ravel(), POTHOLE_LIFT)
    base = corners * np.arange(count)[:, None, None]
    fan = np.array([(0, k, k + 1) for k in range(1, corners - 1)])
    faces = (base + fan).reshape(-1, 3).astype(np.int32)
    return Shape(points, faces, None, row.up(1)[:, 0])


def _records(
    street: Street, span: Span, lane: Lane, start: float, end: float
) -> Iterator[tuple[RoadMark, float, float]]:
    """Yields the painted records of a lane's outer border, and the interval of each."""
    marks = sorted(lane.marks, key=lambda mark: mark.start) or [RoadMark(0.0)]
    ends = [street.station(span, span.section.s + mark.start) for mark in marks[1:]]
    forward = span.piece.direction > 0
    first, last = (-np.inf, np.inf) if forward else (np.inf, -np.inf)
    for mark, one, other in zip(marks, [first, *ends], [*ends, last], strict=True):
        a, b = max(start, min(one, other)), min(end, max(one, other))
        if b - a > 0.1 and {*mark.kind.split()} & {"solid", "broken", "botts"}:
            yield mark, a, b


def _lines(mark: RoadMark, lane_id: int, width: float) -> list[tuple[bool, float]]:
    """Returns (broken, shift of t [m]) of the one or two lines of a marking.

    Double lines are named from the inside to the outside, those of the center lane from left to
    right (ASAM OpenDRIVE 1.6, attributes of road markings).
    """
    words = [word for word in mark.kind.split() if word in ("solid", "broken", "botts")]
    if len(words) == 1:
        return [(words[0] != "solid", 0.0)]
    inner = width if lane_id <= 0 else -width
    return [(words[0] != "solid", inner), (words[1] != "solid", -inner)]


def _lacks_edge_line(span: Span) -> bool:
    """Whether the side of oncoming traffic has no paint at all, while the own side has."""

    def painted(direction: int) -> bool:
        lanes = span.section.side(direction)
        return any(mark.kind != "none" for lane in lanes for mark in lane.marks)

    own = span.piece.direction
    return painted(own) and not painted(-own)


class _Line:
    """One line of paint along the outer border of a lane."""

    def __init__(
        self, street: Street, span: Span, lane_id: int, shift: float, width: float
    ) -> None:
        self._place = (street, span, lane_id)
        self._shift, self._half = shift, 0.5 * width

    def _middle(self, station: FloatArray) -> FloatArray:
        street, span, lane_id = self._place
        return street.offset(span, lane_id, station) + self._shift

    def solid(
        self, corridor: Corridor, start: float, end: float, hidden: Hidden | None
    ) -> list[Shape]:
        """Returns the parts of an unbroken line."""
        part = corridor.between(start, end - 1e-3)
        parts = [part]
        if hidden is not None:
            points = part.across(self._middle(part.station))
            parts = [*part.runs(~hidden(part.station, points))]
        found = []
        for row in parts:
            middle = self._middle(row.station)
            found.append(row.strip(middle + self._half, middle - self._half, MARKING_LIFT))
        return found

    def dashes(self, _: Corridor, start: float, end: float, hidden: Hidden | None) -> list[Shape]:
        """Returns dashes of `DASH_LENGTH` at multiples of `DASH_PERIOD`."""
        street = self._place[0]
        first = np.ceil(start / DASH_PERIOD) * DASH_PERIOD
        begin = np.arange(first, end - DASH_LENGTH, DASH_PERIOD)
        if hidden is not None and begin.size:
            center = begin + 0.5 * DASH_LENGTH
            row = Corridor.sample(street, center)
            begin = begin[~hidden(center, row.across(self._middle(center)))]
        if not begin.size:
            return []
        ends = np.stack([begin, begin + DASH_LENGTH], axis=1).ravel()
        row = Corridor.sample(street, ends)
        middle = self._middle(ends)
        offsets = np.stack([middle + self._half, middle - self._half], axis=1)
        points = row.across(offsets, MARKING_LIFT).reshape(-1, 3)
        # Four points a dash: left and right at its start, left and right at its end.
        base = 4 * np.arange(begin.size)[:, None]
        faces = np.concatenate([base + np.array(t) for t in ((0, 1, 3), (0, 3, 2))])
        normals = np.repeat(row.up(1)[:, 0], 2, axis=0)
        return [Shape(points, faces.astype(np.int32), None, normals)]
