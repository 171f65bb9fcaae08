"""Parses the <lanes> of an OpenDRIVE road: sections, widths or borders, paint, limits, friction."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from iits_mj.road.elements import Lane, LaneSection, RoadMark
from iits_mj.road.polynomials import Cubic
from iits_mj.road.xml_input import Reader

_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_UNLIMITED = ("no limit", "undefined")


def read_lanes(place: Reader, lanes: Element, road_length: float) -> tuple[LaneSection, ...]:
    """Lane sections of a road in order of s.

    Raises:
      MapError: there is none, or one is wrong.
    """
    sections = [_read_section(place, item) for item in lanes.findall("laneSection")]
    sections.sort(key=lambda section: section.s)
    sections = [section for section in sections if section.s < road_length]
    if not sections:
        place.fail("has no <laneSection>")
    return tuple(sections)


def read_speed(place: Reader, record: Element) -> float:
    """A limit [m/s]; infinite for "no limit"."""
    if record.get("max", "").strip().lower() in _UNLIMITED:
        return math.inf
    unit = record.get("unit", "m/s")
    if unit not in _UNITS:
        place.fail(f"<speed unit={unit!r}> must be one of {', '.join(_UNITS)}")
    return place.number(record, "max", low=0.0, high=1000.0) * _UNITS[unit]


def _read_section(place: Reader, item: Element) -> LaneSection:
    s = place.number(item, "s", low=0.0)
    where = place.within(f"lane section at s = {s:g}")
    lanes: list[Lane] = []
    for side, sign in (("left", 1), ("center", 0), ("right", -1)):
        group = item.find(side)
        for element in () if group is None else group.findall("lane"):
            lane = _read_lane(where, element)
            if (lane.id > 0) - (lane.id < 0) != sign:
                where.fail(f"lane {lane.id} stands in <{side}>")
            if any(other.id == lane.id for other in lanes):
                where.fail(f"lane {lane.id} is defined twice")
            lanes.append(lane)
    lanes.sort(key=lambda lane: -lane.id)
    return LaneSection(s, tuple(lanes))


def _read_lane(place: Reader, element: Element) -> Lane:
    identity = place.integer(element, "id")
    where = place.within(f"lane {identity}")
    widths = _read_cubics(where, element, "width")
    borders = _read_cubics(where, element, "border")
    # Some writers give borders as distances; t is negative on the right.
    if identity < 0 and borders and all(record.a >= 0.0 for record in borders):
        borders = tuple(Cubic(r.start, -r.a, -r.b, -r.c, -r.d) for r in borders)
    if identity != 0 and not widths and not borders:
        where.fail("has neither <width> nor <border>")
    return Lane(
        id=identity,
        kind=element.get("type", "none"),
        widths=widths if identity else (),
        borders=borders if identity and not widths else (),
        marks=tuple(_read_mark(where, mark) for mark in element.findall("roadMark")),
        speeds=tuple(
            (_offset(where, record), read_speed(where, record))
            for record in element.findall("speed")
        ),
        frictions=tuple(
            (_offset(where, record), where.number(record, "friction", low=0.0, high=2.0))
            for record in element.findall("material")
            if record.get("friction") is not None
        ),
        predecessor=_lane_link(where, element, "predecessor"),
        successor=_lane_link(where, element, "successor"),
    )


def _offset(place: Reader, record: Element) -> float:
    return place.number(record, "sOffset", 0.0, low=0.0)


def _read_cubics(place: Reader, element: Element, tag: str) -> tuple[Cubic, ...]:
    records = (
        Cubic(
            _offset(place, record),
            place.number(record, "a"),
            *(place.number(record, name, 0.0) for name in ("b", "c", "d")),
        )
        for record in element.findall(tag)
    )
    return tuple(sorted(records, key=lambda cubic: cubic.start))


def _read_mark(place: Reader, mark: Element) -> RoadMark:
    return RoadMark(
        start=_offset(place, mark),
        kind=mark.get("type", "none"),
        width=place.number(mark, "width", 0.12, low=0.0, high=10.0),
        color=mark.get("color", "standard"),
    )


def _lane_link(place: Reader, element: Element, name: str) -> int | None:
    link = element.find("link")
    target = None if link is None else link.find(name)
    return None if target is None else place.integer(target, "id")
