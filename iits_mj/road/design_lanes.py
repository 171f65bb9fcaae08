"""Lane sections of a designed road: further lanes that open and close, limits, paint, links."""

from __future__ import annotations

from dataclasses import replace

from iits_mj.road.design import Design
from iits_mj.road.elements import Lane, LaneSection, RoadMark
from iits_mj.road.polynomials import Cubic, PiecewiseCubic

# A section is judged a micrometre after its start.
_JUST_AFTER = 1e-6


def ramp(start: float, length: float, low: float, high: float) -> Cubic:
    """A cubic from `low` to `high` that begins and ends level."""
    rise = high - low
    return Cubic(start, low, 0.0, 3.0 * rise / length**2, -2.0 * rise / length**3)


def limit_at(design: Design, station: float) -> float:
    """Speed limit at a station [m/s]."""
    slower = [speed for start, end, speed in design.limits if start <= station < end]
    return min([design.speed_limit, *slower])


def lane_sections(design: Design, tapered: bool) -> list[LaneSection]:
    """Lane sections over the whole length, with lane links; s is the station."""
    places = {0.0, *design.road_ends}
    for start, end, _ in design.limits:
        places |= {start, end}
    for extra in design.extra_lanes:
        places |= {extra.start + extra.taper, extra.end - extra.taper}
        places |= {extra.start, extra.end} if tapered else set()
    ordered = sorted(places)
    make = _section if tapered else _level_section
    bare = [make(design, start) for start in ordered]
    return [
        _link(section, bare[i - 1] if i else None, bare[i + 1] if i + 1 < len(bare) else None)
        for i, section in enumerate(bare)
    ]


def _section(design: Design, start: float) -> LaneSection:
    middle = start + _JUST_AFTER
    width = design.lane_width
    extra = next((e for e in design.extra_lanes if e.start <= middle < e.end), None)
    count = design.lanes + (extra is not None)
    speeds = ((0.0, limit_at(design, middle)),)
    right = []
    for i in range(1, count + 1):
        shape = Cubic(0.0, width)
        if extra is not None and i == 1:
            if middle < extra.start + extra.taper:
                shape = ramp(extra.start - start, extra.taper, 0.0, width)
            elif middle >= extra.end - extra.taper:
                shape = ramp(extra.end - extra.taper - start, extra.taper, width, 0.0)
        if abs(shape.start) > _JUST_AFTER:
            # A section that begins inside a taper takes the taper's remaining cubic.
            shape = PiecewiseCubic([shape]).expanded_at(0.0)
        mark = RoadMark(0.0, "broken", 0.15) if i < count else RoadMark(0.0, "solid", 0.3)
        right.append(Lane(-i, "driving", (shape,), marks=(mark,), speeds=speeds))
    return _with_shoulders(design, start, right)


def _level_section(design: Design, start: float) -> LaneSection:
    """Lanes of one width only; the innermost is closed unless a further lane is fully open."""
    middle = start + _JUST_AFTER
    is_open = any(e.start + e.taper <= middle < e.end - e.taper for e in design.extra_lanes)
    speeds = ((0.0, limit_at(design, middle)),)
    width = (Cubic(0.0, design.lane_width),)
    inner = Lane(-1, "driving" if is_open else "none", width, speeds=speeds)
    right = [Lane(-i, "driving", width, speeds=speeds) for i in range(2, design.lanes + 2)]
    return _with_shoulders(design, start, [inner, *right])


def _with_shoulders(design: Design, start: float, right: list[Lane]) -> LaneSection:
    return LaneSection(
        start,
        (
            Lane(1, "shoulder", (Cubic(0.0, design.left_shoulder),)),
            Lane(0, "none", marks=(RoadMark(0.0, "solid", 0.3),)),
            *right,
            Lane(-len(right) - 1, "shoulder", (Cubic(0.0, design.right_shoulder),)),
        ),
    )


def _link(
    section: LaneSection, before: LaneSection | None, after: LaneSection | None
) -> LaneSection:
    """Right lanes are matched from the outside, because lanes open and close on the inside."""
    count = len(section.side(1))

    def partner(lane: Lane, other: LaneSection | None) -> int | None:
        if other is None or lane.id == 0:
            return None
        if lane.id > 0:
            return lane.id
        shifted = lane.id - (len(other.side(1)) - count)
        return shifted if shifted < 0 else None

    return replace(
        section,
        lanes=tuple(
            replace(lane, predecessor=partner(lane, before), successor=partner(lane, after))
            for lane in section.lanes
        ),
    )
