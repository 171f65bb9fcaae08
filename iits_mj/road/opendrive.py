"""Parses OpenDRIVE (1.4 to 1.8) into the records of `elements`.

Element and attribute names follow ASAM OpenDRIVE 1.6. Content that affects neither the road's
place, nor driving, nor pictures (controllers, vendor data) is not read. Other unsupported content
is refused, or left out with a note.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from iits_mj.core.errors import MapError
from iits_mj.road.elements import (
    DRIVING_TYPES,
    Connection,
    Junction,
    Lane,
    LaneSection,
    LightProgram,
    Link,
    OpenDriveMap,
    Road,
    RoadMark,
    RoadType,
    Signal,
    Structure,
)
from iits_mj.road.geometry import Arc, Geometry, Line, ParamPoly3, Poly3, Spiral
from iits_mj.road.objects import read_objects
from iits_mj.road.polynomials import Cubic
from iits_mj.road.seams import (
    HEADING_STEP_LIMIT,
    HEIGHT_STEP_LIMIT,
    heading_step,
    height_step,
)
from iits_mj.road.xml_input import Reader, parse_xml

LENGTH_LIMIT = 1e6
# Some writers leave roads of less than a millimeter between others [m].
LENGTH_MIN = 1e-6
# Wet ice has 0.05; the tires' equations need some friction.
FRICTION_LEAST, FRICTION_LIMIT = 0.05, 2.0
CURVATURE_LIMIT = 10.0
# On a shorter record a larger curvature is a rounding error of the writer, and is reduced [m].
SHORTEST_BEND = 0.05
TURN_LIMIT = 200.0
PLAN_JUMP_LIMIT = 3.0
SIGNALS_MAX = 10_000
PHASE_LIMIT = 3600.0  # [s] of a traffic light
LIGHT_PROGRAM = "iits_mj:light_program"  # code of the header's userData with a light's program
_COEFFICIENTS = ("a", "b", "c", "d")
_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_UNLIMITED = ("no limit", "undefined")
_FOREIGN = ("userData", "include", "dataQuality")


def parse(content: bytes, source: str) -> OpenDriveMap:
    """Reads a map from the bytes of a file; `source` names it in errors.

    Raises:
      MapError: the map cannot be used; the message names the source, the road and the reason.
    """
    root = parse_xml(content, source)
    reader = Reader(source)
    if root.tag != "OpenDRIVE":
        reader.fail(f"is XML, but not OpenDRIVE: the root element is <{root.tag[:40]}>")
    header = root.find("header")
    version = 1 if header is None else reader.number(header, "revMajor", 1.0)
    if version != 1:
        reader.fail(f"is OpenDRIVE {version:g}.x; versions 1.4 to 1.8 are supported")
    signals = sum(1 for _ in root.iter("signal"))
    if signals > SIGNALS_MAX:
        reader.fail(f"has {signals} signals; at most {SIGNALS_MAX} are supported")
    notes: list[str] = []
    junctions = []
    for item in root.findall("junction"):
        try:
            junctions.append(_read_junction(reader, item, notes))
        except MapError as error:
            notes.append(f"left out: {reader.own(error)}")
    roads = []
    rules = [item.get("rule", "RHT") for item in root.findall("road")]
    left_hand = 2 * rules.count("LHT") > len(rules)
    if 0 < rules.count("LHT") < len(rules):
        side = "left" if left_hand else "right"
        notes.append(f"roads differ in their rule (RHT, LHT): all are driven on the {side}")
    seen: set[str] = set()
    fault: MapError | None = None
    for item in root.findall("road"):
        identity = reader.text(item, "id")
        if identity in seen:
            reader.fail(f"road {identity!r} is defined twice")
        seen.add(identity)
        try:
            roads.append(_read_road(reader, item, left_hand, notes))
        except MapError as error:
            # One road that cannot be used does not make the others useless.
            fault = fault or error
            notes.append(f"left out: {reader.own(error)}")
    if not roads:
        raise fault or MapError(f"{source}: the map has no <road>")
    reference = None if header is None else header.find("geoReference")
    offset = None if header is None else header.find("offset")
    return OpenDriveMap(
        roads=tuple(roads),
        junctions=tuple(junctions),
        name="" if header is None else header.get("name", ""),
        geo_reference="" if reference is None else (reference.text or "").strip(),
        offset=(0.0, 0.0)
        if offset is None
        else (reader.number(offset, "x", 0.0), reader.number(offset, "y", 0.0)),
        light_programs=() if header is None else _read_programs(reader, header, notes),
        notes=tuple(dict.fromkeys(notes)),
    )


def _read_programs(reader: Reader, header: Element, notes: list[str]) -> tuple[LightProgram, ...]:
    """The programs of traffic lights that `writer` has written; a note for one not usable."""
    found = []
    for item in header.findall("userData"):
        if item.get("code") != LIGHT_PROGRAM:
            continue
        light = item.get("light", "")
        try:
            parts = (part.partition(":") for part in item.get("value", "").split())
            phases = tuple((float(duration), state) for duration, _, state in parts)
            offset = reader.number(item, "offset", 0.0)
        except (ValueError, MapError):
            phases, offset = (), 0.0
        usable = all(0.0 < duration < PHASE_LIMIT for duration, _ in phases)
        if usable and len({len(state) for _, state in phases}) == 1 and phases[0][1]:
            found.append(LightProgram(light, offset, phases))
        else:
            notes.append(f"left out: the program of traffic light {light!r} is not usable")
    return tuple(found)


def _read_junction(reader: Reader, item: Element, notes: list[str]) -> Junction:
    identity = reader.text(item, "id")
    place = reader.within(f"junction {identity!r}")
    kind = item.get("type", "default")
    if kind not in ("default", "direct", "virtual", "crossing"):
        place.fail(
            f"has the type {kind!r}; supported are 'default', 'direct', 'virtual' and 'crossing'"
        )
    interrupts = kind in ("default", "direct")
    connecting_name = "linkedRoad" if kind == "direct" else "connectingRoad"
    connections = []
    for connection in item.findall("connection") if interrupts else ():
        links = tuple(
            (place.integer(link, "from"), place.integer(link, "to"))
            for link in connection.findall("laneLink")
        )
        contact = connection.get("contactPoint", "start")
        if contact not in ("start", "end"):
            place.fail(f"<connection contactPoint={contact!r}> must be 'start' or 'end'")
        incoming = place.text(connection, "incomingRoad")
        connecting = place.text(connection, connecting_name)
        connections.append(Connection(incoming, connecting, contact, links))
    if not interrupts:
        notes.append(f"junction {identity!r}: a {kind} junction does not interrupt a road, ignored")
    return Junction(identity, kind, tuple(connections))


def _read_road(reader: Reader, item: Element, left_hand: bool, notes: list[str]) -> Road:
    identity = reader.text(item, "id")
    place = reader.within(f"road {identity!r}")
    length = max(place.number(item, "length", low=0.0, high=LENGTH_LIMIT), LENGTH_MIN)
    geometries = _read_plan(place, item)
    lateral = item.find("lateralProfile")
    for name in ("shape", "crossfall"):
        if lateral is not None and lateral.find(name) is not None:
            notes.append(f"road {identity!r}: <lateralProfile><{name}> is not used")
    link = item.find("link")
    lanes = item.find("lanes")
    if lanes is None:
        place.fail("has no <lanes>")
    junction = item.get("junction", "-1").strip()
    road = Road(
        id=identity,
        length=length,
        geometries=geometries,
        sections=_read_lanes(place, lanes, length, notes),
        name=item.get("name", ""),
        junction=None if junction in ("", "-1") else junction,
        predecessor=_read_link(place, link, "predecessor", notes),
        successor=_read_link(place, link, "successor", notes),
        types=tuple(_read_type(place, record) for record in item.findall("type")),
        elevations=_read_cubics(place, item.find("elevationProfile"), "elevation"),
        superelevations=_read_cubics(place, lateral, "superelevation"),
        lane_offsets=_read_cubics(place, lanes, "laneOffset"),
        signals=_read_signals(place, item.find("signals"), notes),
        structures=_read_structures(place, item.find("objects")),
        objects=read_objects(place, item.find("objects"), notes),
        left_hand=left_hand,
    )
    _check_plan(place, road)
    return road


def _check_plan(place: Reader, road: Road) -> None:
    """Fails if the records leave a gap in the road that is too large to be blended."""
    ends = [*(geometry.s for geometry in road.geometries[1:]), road.length]
    for geometry, end in zip(road.geometries, ends, strict=True):
        missing = end - geometry.s - geometry.length
        if missing > PLAN_JUMP_LIMIT:
            place.fail(
                f"the geometry at s = {geometry.s:g} is {geometry.length:g} m long and ends "
                f"{missing:g} m before s = {end:g}, where the next one or the road's end is"
            )
    if road.geometries[0].s > PLAN_JUMP_LIMIT:
        place.fail(f"its first geometry starts at s = {road.geometries[0].s:g} instead of 0")
    for jump in road.plan.jumps():
        if math.hypot(jump.dx, jump.dy) > PLAN_JUMP_LIMIT:
            place.fail(
                f"the plan view jumps by {math.hypot(jump.dx, jump.dy):.1f} m at s = {jump.s:g}; "
                f"up to {PLAN_JUMP_LIMIT:g} m are blended"
            )
        if abs(jump.heading) > HEADING_STEP_LIMIT:
            place.fail(f"at s = {jump.s:g} {heading_step(abs(jump.heading))}")
    for s in road.elevation.breaks()[1:]:
        before, after = (float(road.elevation.evaluate(s, 0, side)) for side in (-1, 1))
        if abs(after - before) > HEIGHT_STEP_LIMIT and 0.0 < s < road.length:
            place.fail(f"at s = {s:g} {height_step(after - before)}")


def _read_plan(place: Reader, item: Element) -> tuple[Geometry, ...]:
    view = item.find("planView")
    records = [] if view is None else view.findall("geometry")
    if not records:
        place.fail("has no <geometry> in its <planView>")
    geometries = (_read_geometry(place, record) for record in records)
    return tuple(sorted(geometries, key=lambda geometry: geometry.s))


def _read_geometry(place: Reader, record: Element) -> Geometry:
    s = place.number(record, "s", low=0.0, high=LENGTH_LIMIT)
    where = place.within(f"geometry at s = {s:g}")
    x, y = where.number(record, "x"), where.number(record, "y")
    heading = where.number(record, "hdg", low=-1e4, high=1e4)
    length = where.number(record, "length", low=0.0, high=LENGTH_LIMIT)
    shape = next((child for child in record if child.tag not in _FOREIGN), None)
    if shape is None:
        where.fail("has no shape; one of line, arc, spiral, poly3, paramPoly3 is needed")
    tag = shape.tag
    if tag == "line" or length == 0.0:
        return Line(s, x, y, heading, length)

    def curvature(name: str) -> float:
        value = where.number(shape, name)
        if length < SHORTEST_BEND:
            return min(max(value, -CURVATURE_LIMIT), CURVATURE_LIMIT)
        value = where.number(shape, name, low=-CURVATURE_LIMIT, high=CURVATURE_LIMIT)
        if abs(value) * length > TURN_LIMIT:
            where.fail(f"<{tag} {name}={value:g}> turns by more than {TURN_LIMIT:g} rad")
        return value

    def cubic(suffix: str) -> tuple[float, float, float, float]:
        a, b, c, d = (where.number(shape, name + suffix) for name in _COEFFICIENTS)
        return a, b, c, d

    if tag == "arc":
        return Arc(s, x, y, heading, length, curvature("curvature"))
    if tag == "spiral":
        return Spiral(s, x, y, heading, length, curvature("curvStart"), curvature("curvEnd"))
    if tag == "poly3":
        return Poly3(s, x, y, heading, length, cubic(""))
    if tag == "paramPoly3":
        domain = shape.get("pRange", "normalized")
        if domain not in ("arcLength", "normalized"):
            where.fail(f"<paramPoly3 pRange={domain!r}> must be 'arcLength' or 'normalized'")
        u, v = cubic("U"), cubic("V")
        if math.hypot(u[1], v[1]) < 1e-9:
            where.fail("<paramPoly3> has no direction at its start: bU and bV are zero")
        return ParamPoly3(s, x, y, heading, length, u, v, domain == "normalized")
    return where.fail(f"<{tag}> is no OpenDRIVE geometry; line, arc, spiral, poly3, paramPoly3 are")


def _read_cubics(place: Reader, parent: Element | None, tag: str) -> tuple[Cubic, ...]:
    records = []
    for record in () if parent is None else parent.findall(tag):
        s = place.number(record, "s", low=0.0, high=LENGTH_LIMIT)
        where = place.within(f"{tag} at s = {s:g}")
        records.append(Cubic(s, *(where.number(record, name, 0.0) for name in _COEFFICIENTS)))
    return tuple(sorted(records, key=lambda cubic: cubic.start))


def _read_link(place: Reader, link: Element | None, name: str, notes: list[str]) -> Link | None:
    element = None if link is None else link.find(name)
    if element is None:
        return None
    kind = element.get("elementType", "road")
    if kind not in ("road", "junction"):
        place.fail(f"<{name} elementType={kind!r}> must be 'road' or 'junction'")
    contact = element.get("contactPoint")
    if kind == "road" and contact is None:
        contact = "start" if name == "successor" else "end"
        notes.append(f"{place.inside}: <{name}> has no contactPoint, {contact!r} is taken")
    if contact not in (None, "start", "end"):
        place.fail(f"<{name} contactPoint={contact!r}> must be 'start' or 'end'")
    return Link(kind, place.text(element, "elementId"), contact if kind == "road" else None)


def _read_type(place: Reader, record: Element) -> RoadType:
    speed = record.find("speed")
    return RoadType(
        s=place.number(record, "s", 0.0, low=0.0, high=LENGTH_LIMIT),
        kind=record.get("type", "unknown"),
        speed=None if speed is None else _read_speed(place, speed),
        country=record.get("country", ""),
    )


def _read_signals(place: Reader, signals: Element | None, notes: list[str]) -> tuple[Signal, ...]:
    """Signs and traffic lights in the order of the file; unreadable ones are left out."""
    result = []
    for item in () if signals is None else signals.findall("signal"):
        try:
            result.append(_read_signal(place, item))
        except MapError as error:
            notes.append(f"left out: {place.own(error)}")
    return tuple(result)


def _read_signal(place: Reader, item: Element) -> Signal:
    identity = place.text(item, "id")
    where = place.within(f"signal {identity!r}")
    value = item.get("value")
    return Signal(
        id=identity,
        s=where.number(item, "s", low=0.0),
        t=where.number(item, "t", 0.0),
        kind=item.get("type", ""),
        subtype=item.get("subtype", ""),
        country=item.get("country", ""),
        name=item.get("name", ""),
        dynamic=item.get("dynamic", "no") == "yes",
        orientation=item.get("orientation", "none"),
        value=where.number(item, "value") if value and value.strip() else None,
        unit=item.get("unit", ""),
        z_offset=where.number(item, "zOffset", 0.0),
        height=where.number(item, "height", 0.0),
        width=where.number(item, "width", 0.0),
        heading=where.number(item, "hOffset", 0.0),
    )


def _read_structures(place: Reader, objects: Element | None) -> tuple[Structure, ...]:
    """Tunnels and bridges in order of s."""
    result = []
    for item in () if objects is None else objects:
        if item.tag not in ("tunnel", "bridge"):
            continue
        identity = place.text(item, "id")
        where = place.within(f"{item.tag} {identity!r}")
        s, length = (where.number(item, name, low=0.0) for name in ("s", "length"))
        name, subtype = item.get("name", ""), item.get("type", "standard")
        result.append(Structure(item.tag, identity, s, length, name, subtype))
    return tuple(sorted(result, key=lambda structure: structure.s))


def _read_lanes(
    place: Reader, lanes: Element, road_length: float, notes: list[str]
) -> tuple[LaneSection, ...]:
    """Lane sections that begin on the road, in order of s."""
    found = (_read_section(place, item, notes) for item in lanes.findall("laneSection"))
    sections = tuple(
        section for section in sorted(found, key=lambda one: one.s) if section.s < road_length
    )
    if not sections:
        place.fail("has no <laneSection>")
    return sections


def _read_speed(place: Reader, record: Element) -> float:
    """A limit [m/s]; infinite for "no limit"."""
    if record.get("max", "").strip().lower() in _UNLIMITED:
        return math.inf
    unit = record.get("unit", "m/s")
    if unit not in _UNITS:
        place.fail(f"<speed unit={unit!r}> must be one of {', '.join(_UNITS)}")
    return place.number(record, "max", low=0.0, high=1000.0) * _UNITS[unit]


def _read_section(place: Reader, item: Element, notes: list[str]) -> LaneSection:
    s = place.number(item, "s", low=0.0)
    where = place.within(f"lane section at s = {s:g}")
    lanes: list[Lane] = []
    for side, sign in (("left", 1), ("center", 0), ("right", -1)):
        group = item.find(side)
        for element in () if group is None else group.findall("lane"):
            lane = _read_lane(where, element, notes)
            if (lane.id > 0) - (lane.id < 0) != sign:
                where.fail(f"lane {lane.id} is in <{side}>")
            if any(other.id == lane.id for other in lanes):
                where.fail(f"lane {lane.id} is defined twice")
            lanes.append(lane)
    lanes.sort(key=lambda lane: -lane.id)
    return LaneSection(s, tuple(lanes))


def _read_lane(place: Reader, element: Element, notes: list[str]) -> Lane:
    identity = place.integer(element, "id")
    where = place.within(f"lane {identity}")
    widths = _read_widths(where, element, "width")
    borders = _read_widths(where, element, "border")
    # Some writers give borders as distances; t is negative on the right.
    if identity < 0 and borders and all(record.a >= 0.0 for record in borders):
        borders = tuple(Cubic(r.start, -r.a, -r.b, -r.c, -r.d) for r in borders)
    if identity != 0 and not widths and not borders:
        if element.get("type", "none") in DRIVING_TYPES:
            where.fail("has neither <width> nor <border>")
        notes.append(f"{where.inside}: has neither <width> nor <border>, a width of 0 is taken")
        widths = (Cubic(0.0, 0.0),)
    return Lane(
        id=identity,
        kind=element.get("type", "none"),
        widths=widths if identity else (),
        borders=borders if identity and not widths else (),
        marks=tuple(_read_mark(where, mark) for mark in element.findall("roadMark")),
        speeds=tuple(
            (_offset(where, record), _read_speed(where, record))
            for record in element.findall("speed")
        ),
        frictions=tuple(
            (_offset(where, record), _read_friction(where, record, notes))
            for record in element.findall("material")
            if record.get("friction") is not None
        ),
        predecessor=_lane_link(where, element, "predecessor"),
        successor=_lane_link(where, element, "successor"),
    )


def _read_friction(place: Reader, record: Element, notes: list[str]) -> float:
    """A coefficient of friction, at least `FRICTION_LEAST` and at most `FRICTION_LIMIT`."""
    value = place.number(record, "friction", low=0.0)
    used = min(max(value, FRICTION_LEAST), FRICTION_LIMIT)
    if used != value:
        notes.append(f"{place.inside}: friction {value:g} is changed to {used:g}")
    return used


def _offset(place: Reader, record: Element) -> float:
    return place.number(record, "sOffset", 0.0, low=0.0)


def _read_widths(place: Reader, element: Element, tag: str) -> tuple[Cubic, ...]:
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
