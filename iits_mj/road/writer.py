"""Writes map records as an OpenDRIVE 1.6 file; reading it back gives equal records."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from iits_mj.core.errors import MapError
from iits_mj.road.elements import Junction, Lane, LaneSection, Link, OpenDriveMap, Road
from iits_mj.road.geometry import Arc, Geometry, Line, ParamPoly3, Poly3, Spiral
from iits_mj.road.opendrive import LIGHT_PROGRAM
from iits_mj.road.polynomials import Cubic

_COEFFICIENTS = ("a", "b", "c", "d")


def to_xml(content: OpenDriveMap) -> str:
    """The text of an OpenDRIVE file; numbers keep all their digits."""
    root = Element("OpenDRIVE")
    header = SubElement(root, "header", revMajor="1", revMinor="6", name=content.name)
    if content.geo_reference:
        SubElement(header, "geoReference").text = content.geo_reference
    if content.offset != (0.0, 0.0):
        _add(header, "offset", x=content.offset[0], y=content.offset[1], z=0.0, hdg=0.0)
    for program in content.light_programs:
        text = " ".join(f"{_number(duration)}:{state}" for duration, state in program.phases)
        key = {"code": LIGHT_PROGRAM, "light": program.id, "value": text}
        SubElement(header, "userData", key | {"offset": _number(program.offset)})
    for road in content.roads:
        _write_road(root, road)
    for junction in content.junctions:
        _write_junction(root, junction)
    indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def write(content: OpenDriveMap, path: str | Path) -> Path:
    """Writes a file and returns its path.

    Raises:
      MapError: it cannot be written.
    """
    path = Path(path)
    try:
        path.write_text(to_xml(content), encoding="utf-8")
    except OSError as error:
        raise MapError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def _add(parent: Element, tag: str, **values: float | str | None) -> Element:
    """Adds an element; None leaves an attribute out, numbers are written in full."""
    attributes = {
        name: value if isinstance(value, str) else _number(value)
        for name, value in values.items()
        if value is not None
    }
    return SubElement(parent, tag, attributes)


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else repr(float(value))


def _add_cubics(
    parent: Element, tag: str, records: tuple[Cubic, ...], start_name: str = "s"
) -> None:
    for record in records:
        values = dict(zip((start_name, *_COEFFICIENTS), record, strict=True))
        _add(parent, tag, **values)


def _write_road(root: Element, road: Road) -> None:
    item = _add(
        root, "road", rule="LHT" if road.left_hand else "RHT", name=road.name,
        length=road.length, id=road.id, junction="-1" if road.junction is None else road.junction,
    )  # fmt: skip
    link = SubElement(item, "link")
    _write_link(link, "predecessor", road.predecessor)
    _write_link(link, "successor", road.successor)
    for record in road.types:
        kind = _add(item, "type", s=record.s, type=record.kind, country=record.country or None)
        if record.speed is not None:
            _add(kind, "speed", max=_limit(record.speed), unit="m/s")
    view = SubElement(item, "planView")
    for geometry in road.geometries:
        _write_geometry(view, geometry)
    _add_cubics(SubElement(item, "elevationProfile"), "elevation", road.elevations)
    _add_cubics(SubElement(item, "lateralProfile"), "superelevation", road.superelevations)
    lanes = SubElement(item, "lanes")
    _add_cubics(lanes, "laneOffset", road.lane_offsets)
    for section in road.sections:
        _write_section(lanes, section)
    if road.structures:
        objects = SubElement(item, "objects")
        for structure in road.structures:
            _add(
                objects, structure.kind, s=structure.s, length=structure.length,
                id=structure.id, name=structure.name, type=structure.subtype,
            )  # fmt: skip
    if road.signals:
        signals = SubElement(item, "signals")
        for signal in road.signals:
            _add(
                signals, "signal", s=signal.s, t=signal.t, id=signal.id, name=signal.name,
                dynamic="yes" if signal.dynamic else "no", orientation=signal.orientation,
                zOffset=signal.z_offset, type=signal.kind, subtype=signal.subtype,
                country=signal.country, value=signal.value, unit=signal.unit or None,
                height=signal.height, width=signal.width,
            )  # fmt: skip


def _write_link(parent: Element, name: str, link: Link | None) -> None:
    if link is not None:
        _add(
            parent, name, elementType=link.element, elementId=link.id, contactPoint=link.contact
        )  # fmt: skip


def _write_geometry(view: Element, geometry: Geometry) -> None:
    item = _add(
        view, "geometry", s=geometry.s, x=geometry.x, y=geometry.y, hdg=geometry.heading,
        length=geometry.length,
    )  # fmt: skip
    match geometry:
        case Arc():
            _add(item, "arc", curvature=geometry.curvature)
        case Spiral():
            _add(
                item, "spiral", curvStart=geometry.curvature_start, curvEnd=geometry.curvature_end
            )  # fmt: skip
        case Poly3():
            _add(item, "poly3", **dict(zip(_COEFFICIENTS, geometry.coefficients, strict=True)))
        case ParamPoly3():
            domain = "normalized" if geometry.normalized else "arcLength"
            values: dict[str, float | str | None] = {"pRange": domain}
            for name, u, v in zip(
                _COEFFICIENTS, geometry.u_coefficients, geometry.v_coefficients, strict=True
            ):
                values[name + "U"], values[name + "V"] = u, v
            _add(item, "paramPoly3", **values)
        case Line():
            SubElement(item, "line")
        case _:
            raise MapError(f"a {type(geometry).__name__} cannot be written as OpenDRIVE")


def _write_section(parent: Element, section: LaneSection) -> None:
    item = _add(parent, "laneSection", s=section.s)
    for side, sign in (("left", 1), ("center", 0), ("right", -1)):
        chosen = [lane for lane in section.lanes if (lane.id > 0) - (lane.id < 0) == sign]
        if chosen:
            group = SubElement(item, side)
            for lane in chosen:
                _write_lane(group, lane)


def _write_lane(group: Element, lane: Lane) -> None:
    item = _add(group, "lane", id=lane.id, type=lane.kind, level="false")
    link = SubElement(item, "link")
    if lane.predecessor is not None:
        _add(link, "predecessor", id=lane.predecessor)
    if lane.successor is not None:
        _add(link, "successor", id=lane.successor)
    _add_cubics(item, "width", lane.widths, "sOffset")
    _add_cubics(item, "border", lane.borders, "sOffset")
    for mark in lane.marks:
        _add(
            item, "roadMark", sOffset=mark.start, type=mark.kind, weight="standard",
            color=mark.color, width=mark.width,
        )  # fmt: skip
    for start, friction in lane.frictions:
        _add(item, "material", sOffset=start, friction=friction)
    for start, speed in lane.speeds:
        _add(item, "speed", sOffset=start, max=_limit(speed), unit="m/s")


def _limit(speed: float) -> str:
    return "no limit" if math.isinf(speed) else _number(speed)


def _write_junction(root: Element, junction: Junction) -> None:
    kind = None if junction.kind == "default" else junction.kind
    item = _add(root, "junction", id=junction.id, name="", type=kind)
    for number, connection in enumerate(junction.connections):
        name = "linkedRoad" if junction.kind == "direct" else "connectingRoad"
        element = _add(
            item, "connection", id=number, incomingRoad=connection.incoming,
            contactPoint=connection.contact, **{name: connection.connecting},
        )  # fmt: skip
        for origin, target in connection.lane_links:
            _add(element, "laneLink", **{"from": origin, "to": target})
