"""What lies along a route: its segments, tunnels and bridges, signals, patches of friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from iits_mj.road.chain import Piece
from iits_mj.road.elements import Signal
from iits_mj.road.reference_line import ReferenceLine


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
    """Stations from where to where a "tunnel" or "bridge" runs; those that touch are one."""
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
    """Signals for the route's direction, in order of station."""
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
