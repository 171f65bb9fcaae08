"""Builds map records of a road design: alignment, heights, cross slopes, structures and signs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from iits_mj.core.errors import InputError
from iits_mj.road.design import Design, lane_sections, limit_at, ramp
from iits_mj.road.elements import Link, OpenDriveMap, Road, RoadType, Signal, Structure
from iits_mj.road.geometry import Arc, Geometry, Line, Spiral
from iits_mj.road.polynomials import Cubic, PiecewiseCubic, constant

# Coordinates are rounded to a nanometre, so that every machine writes the same file.
_DIGITS = 9


def build(design: Design, tapered: bool = True) -> OpenDriveMap:
    """Map records of a design: one road after the other, linked lane by lane.

    SUMO's lanes have one width each, and netconvert lays a tapered lane's neighbours up to 2 m
    beside their place. Without `tapered` the innermost lane is always there and fully wide, and
    open to traffic only where the further lane is fully open: netconvert then keeps all in place.
    """
    ends = [*design.road_ends, design.length]
    starts = [0.0, *design.road_ends]
    plan = _plan(design)
    elevation = _elevation(design)
    roll = _superelevation(design)
    offset = _lane_offset(design) if tapered else constant(design.lane_width * (design.lanes + 0.5))
    sections = lane_sections(design, tapered)
    roads = []
    for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
        inside = [section for section in sections if start <= section.s < end]
        roads.append(
            Road(
                id=str(i + 1),
                name=design.name,
                length=_round(end - start),
                predecessor=Link("road", str(i), "end") if i else None,
                successor=Link("road", str(i + 2), "start") if i + 1 < len(ends) else None,
                types=(RoadType(0.0, "motorway", design.speed_limit),),
                geometries=tuple(_cut(plan, start, end)),
                elevations=_records(elevation, start, end),
                superelevations=_records(roll, start, end),
                lane_offsets=_records(offset, start, end),
                sections=tuple(replace(item, s=_round(item.s - start)) for item in inside),
                structures=tuple(_structures(design, start, end)),
                signals=tuple(_signs(design, start, end)),
            )
        )
    return OpenDriveMap(roads=tuple(roads), name=design.name)


def _round(value: float) -> float:
    return round(value, _DIGITS) + 0.0


def _records(profile: PiecewiseCubic, start: float, end: float) -> tuple[Cubic, ...]:
    # Coefficients keep 12 significant digits: 1 nm over the longest record.
    return tuple(
        Cubic(_round(r.start), *(float(f"{value:.12g}") for value in r[1:]))
        for r in profile.along(start, end, 1, 0.0).records
    )


def _plan(design: Design) -> list[Geometry]:
    x, y, _, heading = design.start
    s = 0.0
    records: list[Geometry] = []
    for length, bend, bend_end, _, _ in design.alignment:
        place = (s, x, y, heading, length)
        if bend != bend_end:
            records.append(Spiral(*place, bend, bend_end))
        else:
            records.append(Arc(*place, bend) if bend else Line(*place))
        end = records[-1].evaluate(length)
        x, y, heading = (_round(float(v)) for v in (end.x, end.y, end.heading))
        s = _round(s + length)
    return records


def _cut(records: list[Geometry], start: float, end: float) -> Iterator[Geometry]:
    for record in records:
        low, high = max(record.s, start), min(record.s + record.length, end)
        if high - low < 1e-6:
            continue
        ds, length = low - record.s, _round(high - low)
        at = record.evaluate(ds)
        x, y, heading = (_round(float(v)) for v in (at.x, at.y, at.heading))
        place = (_round(low - start), x, y, heading, length)
        if isinstance(record, Spiral):
            rate = (record.curvature_end - record.curvature_start) / record.length
            bend = record.curvature_start + rate * ds
            yield Spiral(*place, bend, bend + rate * length)
        else:
            yield Arc(*place, record.curvature) if isinstance(record, Arc) else Line(*place)


def _elevation(design: Design) -> PiecewiseCubic:
    """Tangents joined by parabolas: z'' = (g2 - g1)/L over a curve of length L."""
    height, grade, station = design.start[2], design.initial_grade, 0.0
    records = [Cubic(0.0, height, grade)]
    for center, following, length in design.grades:
        begin, end = center - 0.5 * length, center + 0.5 * length
        if begin < station:
            raise InputError(f"the vertical curves about {center:g} m overlap; lower its K")
        height += grade * (begin - station)
        records.append(Cubic(begin, height, grade, 0.5 * (following - grade) / length))
        height += 0.5 * (grade + following) * length
        grade, station = following, end
        records.append(Cubic(end, height, grade))
    return PiecewiseCubic(records)


def _superelevation(design: Design) -> PiecewiseCubic:
    records, s = [], 0.0
    for length, _, _, roll, roll_end in design.alignment:
        records.append(ramp(s, length, roll, roll_end))
        s += length
    return PiecewiseCubic(records)


def _lane_offset(design: Design) -> PiecewiseCubic:
    """Offset 0 is the centre of the rightmost lane; further lanes open on the left."""
    width = design.lane_width
    base = (design.lanes - 0.5) * width
    records = [Cubic(0.0, base)]
    for extra in design.extra_lanes:
        records.append(ramp(extra.start, extra.taper, base, base + width))
        records.append(Cubic(extra.start + extra.taper, base + width))
        records.append(ramp(extra.end - extra.taper, extra.taper, base + width, base))
        records.append(Cubic(extra.end, base))
    return PiecewiseCubic(records)


def _structures(design: Design, start: float, end: float) -> Iterator[Structure]:
    for i, (kind, name, begin, finish) in enumerate(design.structures):
        low, high = max(begin, start), min(finish, end)
        if high > low:
            length = _round(high - low)
            yield Structure(kind, str(i + 1), _round(low - start), length, name)


def _signs(design: Design, start: float, end: float) -> Iterator[Signal]:
    """A speed sign (274 of the German catalogue) beside the right shoulder at every change."""
    places = sorted({0.0, *(p for low, high, _ in design.limits for p in (low, high))})
    t = -(0.5 * design.lane_width + design.right_shoulder + 0.75)
    for number, station in enumerate(places, 1):
        if start <= station < end:
            limit = float(round(limit_at(design, station) * 3.6))
            yield Signal(
                id=str(number), s=_round(station - start), t=t, kind="274", country="DE",
                name=f"limit {limit:.0f} km/h", orientation="+", value=limit, unit="km/h",
                z_offset=2.2, height=0.9, width=0.9,
            )  # fmt: skip
