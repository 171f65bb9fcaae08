"""Lanes, structures and signals along a route.

Lanes have borders, limits, paint and friction over the route's chain parameter.

They are counted from the outside, 0 being the outermost driving lane: the rightmost one, in
left-hand traffic the leftmost one. Offsets are positive to the left of the route's reference line.
Widths are horizontal, as in SUMO's network (a cross slope of 0.1 rad changes them by 0.5 %).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from iits_mj.road.chain import Piece
from iits_mj.road.elements import (
    DEFAULT_FRICTION,
    PAVED_TYPES,
    Lane,
    LaneSection,
    RoadMark,
    Signal,
    lane_borders,
)
from iits_mj.road.polynomials import PiecewiseCubic, combine
from iits_mj.road.reference_line import ReferenceLine

T = TypeVar("T")


class Steps(Generic[T]):
    """A value that changes stepwise along the chain parameter."""

    def __init__(self, starts: Sequence[float], values: Sequence[T]) -> None:
        self._starts = list(starts)
        self.values = list(values)

    def at(self, p: float) -> T:
        """Value at a place."""
        return self.values[max(bisect_right(self._starts, p) - 1, 0)]


@dataclass(frozen=True)
class RouteLane:
    """One driving lane of a band: borders as offsets [m], limits [m/s] and friction."""

    lane: Lane
    right: PiecewiseCubic
    left: PiecewiseCubic
    speed: Steps[float]
    friction: Steps[float]


@dataclass(frozen=True)
class LaneBand:
    """A stretch of route with one set of lanes, over [p_start, p_end) of the chain parameter.

    Attributes:
      lanes: driving lanes from the outside.
      marks: paint on the boundaries from the outside, one more than lanes.
      right_edge, left_edge: offsets of the paved surface's edges [m].
    """

    p_start: float
    p_end: float
    piece: Piece
    section: LaneSection
    lanes: tuple[RouteLane, ...]
    marks: tuple[Steps[RoadMark], ...]
    right_edge: PiecewiseCubic
    left_edge: PiecewiseCubic

    def boundary(self, i: int) -> PiecewiseCubic:
        """Returns the offset of boundary i from the outside, 0 to the number of lanes."""
        i = min(max(i, 0), len(self.lanes))
        lane, outer = self.lanes[max(i - 1, 0)], i == 0
        return lane.right if outer is not self.piece.road.left_hand else lane.left


def lane_bands(piece: Piece) -> list[LaneBand]:
    """Returns the bands of one piece of a chain, in the order of travel."""
    low, high = sorted((piece.s_start, piece.s_end))
    spans = []
    for start, end, section in piece.road.section_spans():
        # The outer sections also cover the bridged gaps.
        start = min(start, low) if section is piece.road.sections[0] else start
        end = max(end, high) if section is piece.road.sections[-1] else end
        start, end = max(start, low), min(end, high)
        if end - start > 1e-9:
            spans.append((start, end, section))
    if piece.direction < 0:
        spans = [(end, start, section) for start, end, section in reversed(spans)]
    return [_band(piece, start, end, section) for start, end, section in spans]


def _band(piece: Piece, s_start: float, s_end: float, section: LaneSection) -> LaneBand:
    direction = piece.direction
    origin = piece.p_at(s_start)
    low, high = sorted((s_start, s_end))
    own = piece.road.side(direction)
    borders = lane_borders(piece.road, section, own)
    opposite = lane_borders(piece.road, section, -own)

    def offset(border: PiecewiseCubic) -> PiecewiseCubic:
        traveled = border.along(s_start, s_end, direction, origin)
        return combine([(float(direction), traveled)], -piece.shift)

    def steps(records: Sequence[tuple[float, T]], default: T) -> Steps[T]:
        places = [(section.s + start, value) for start, value in records]
        inner = [(s, v) for s, v in places if low < s < high]
        before = [value for s, value in places if s <= low]
        first = before[-1] if before else (places[0][1] if places else default)
        values = [first, *(value for _, value in inner)]
        starts = [low, *(s for s, _ in inner)]
        if direction > 0:
            return Steps([piece.p_at(s) for s in starts], values)
        ends = [*starts[1:], high]
        return Steps([piece.p_at(s) for s in reversed(ends)], list(reversed(values)))

    side = section.side(own)
    inner_id = {lane.id: (side[i - 1].id if i else 0) for i, lane in enumerate(side)}
    road_speed = [
        (record.s - section.s, piece.road.speed_at(record.s)) for record in piece.road.types
    ]
    default_speed = piece.road.speed_at(low)
    left_hand = piece.road.left_hand
    sides = {
        lane.id: (offset(borders[lane.id]), offset(borders[inner_id[lane.id]]))
        for lane in section.driving(own)
    }
    lanes = [
        RouteLane(
            lane=lane,
            right=sides[lane.id][left_hand],
            left=sides[lane.id][not left_hand],
            speed=steps(lane.speeds or road_speed, default_speed),
            friction=steps(lane.frictions, DEFAULT_FRICTION),
        )
        for lane in section.driving(own)
    ]
    no_mark = RoadMark(0.0)
    painted = [route_lane.lane.id for route_lane in lanes]
    marks = []
    for identity in (*painted, inner_id[painted[-1]]):
        owner = section.lane(identity)
        records = [(mark.start, mark) for mark in owner.marks] if owner else []
        marks.append(steps(records, no_mark))
    edges = (
        offset(borders[_paved_edge(section, own, lanes[0].lane.id)]),
        offset(opposite[_paved_edge(section, -own, 0)]),
    )
    return LaneBand(
        p_start=origin,
        p_end=piece.p_at(s_end),
        piece=piece,
        section=section,
        lanes=tuple(lanes),
        marks=tuple(marks),
        right_edge=edges[left_hand],
        left_edge=edges[not left_hand],
    )


def _paved_edge(section: LaneSection, side: int, start: int) -> int:
    """Outermost lane that is paved without a gap, beginning at lane `start`."""
    edge = start
    for lane in section.side(side):
        if abs(lane.id) <= abs(start):
            continue
        if lane.kind not in PAVED_TYPES:
            break
        edge = lane.id
    return edge


@dataclass(frozen=True)
class RouteSegment:
    """A road of the route: driven from `s_start` to `s_end`, entered at `station_start`."""

    road_id: str
    direction: int
    s_start: float
    s_end: float
    station_start: float


@dataclass(frozen=True)
class RouteSignal:
    """A sign or light that faces the route's traffic."""

    station: float
    offset: float
    signal: Signal


@dataclass(frozen=True)
class FrictionPatch:
    """Friction over [start, end) of station: `left` of the offset `split`, and `right` of it."""

    start: float
    end: float
    left: float
    right: float
    split: float = 0.0


def structure_spans(
    pieces: Sequence[Piece], line: ReferenceLine, kind: str
) -> tuple[tuple[float, float], ...]:
    """Returns (start, end) stations of each "tunnel" or "bridge"; those that touch are merged."""
    spans: list[tuple[float, float]] = []
    for piece in pieces:
        low, high = sorted((piece.s_start, piece.s_end))
        for item in piece.road.structures:
            start, end = max(item.s, low), min(item.s + item.length, high)
            if item.kind == kind and end > start:
                ends = sorted(float(line.station(piece.p_at(s))) for s in (start, end))
                spans.append((ends[0], ends[1]))
    merged: list[tuple[float, float]] = []
    for begin, end in sorted(spans):
        if merged and begin - merged[-1][1] < 1.0:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((begin, end))
    return tuple(merged)


def facing_signals(pieces: Sequence[Piece], line: ReferenceLine) -> tuple[RouteSignal, ...]:
    """Returns the signals that face the route's direction, in order of station."""
    found = []
    for piece in pieces:
        low, high = sorted((piece.s_start, piece.s_end))
        facing = ("+", "none") if piece.direction > 0 else ("-", "none")
        for signal in piece.road.signals:
            if low <= signal.s <= high and signal.orientation in facing:
                station = float(line.station(piece.p_at(signal.s)))
                offset = piece.direction * signal.t - piece.shift
                found.append(RouteSignal(station, offset, signal))
    return tuple(sorted(found, key=lambda item: item.station))
