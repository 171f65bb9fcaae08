"""The map as OpenDRIVE text that netconvert interprets as `RoadMap` does."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from iits_mj.core.errors import MapError
from iits_mj.road import RoadMap
from iits_mj.road.elements import (
    CROSSING,
    Connection,
    Junction,
    Lane,
    LaneSection,
    Road,
    lane_borders,
)
from iits_mj.road.opendrive import LENGTH_MIN
from iits_mj.road.writer import to_xml
from iits_mj.road.xml_input import content_hash, parse_xml, read_file

UNLIMITED = 70.0  # [m/s], the limit in the net for a road without one
BRIDGE = "direct_junction_"  # beginning of the ids of roads that this module adds
SIGNAL_DEFAULTS = {"type": "-1", "subtype": "-1", "orientation": "none", "dynamic": "no"}
FLAT_SPIRAL = 0.005  # [m]
STRAIGHT_TURN = 1e-6  # [rad]
# Attributes that change their sign in a mirror at the x axis.
_MIRRORED = {
    "geometry": ("y", "hdg"),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": tuple("abcd"),
    "paramPoly3": ("aV", "bV", "cV", "dV"),
    "superelevation": tuple("abcd"),
    "laneOffset": tuple("abcd"),
    "signal": ("t",),
    "validity": ("fromLane", "toLane"),
    "laneLink": ("from", "to"),
}
BRIDGE_LENGTH = 0.1  # [m] of those roads: the shortest lane of a net


def opendrive_for_netconvert(road_map: RoadMap, only: Collection[str] | None = None) -> bytes:
    """The map, or `only` the roads of some ids, as text that netconvert reads as `RoadMap` does.

    netconvert reads speed limits of lanes but not of roads, reads an empty `junction` as a number,
    ignores "no limit", and refuses direct junctions, links to roads that do not exist and signals
    without a type. The geometry is unchanged. A map without a file is written from memory.

    Raises:
      MapError: the file cannot be read, or has changed since the map was read.
    """
    if road_map.path.is_file():
        content = read_file(road_map.path)
        if content_hash(content) != road_map.content_hash:
            raise MapError(
                f"{road_map.path}: the file has changed since the map was read; read it again"
            )
    else:
        content = to_xml(road_map.content).encode()
    root = parse_xml(content, str(road_map.path))
    # netconvert subtracts the offset from the net's coordinates, but not from its shapes.
    for header in root.findall("header"):
        for offset in header.findall("offset"):
            header.remove(offset)
    roads = {name: r for name, r in road_map.roads.items() if only is None or name in only}
    for item in root.findall("road"):
        road = roads.get(item.get("id", ""))
        if road is None:
            root.remove(item)
            continue
        if not item.get("junction", "").strip():
            item.set("junction", "-1")
        _drop_lost_links(item, roads)
        if road.length <= LENGTH_MIN:
            item.set("length", repr(road.length))
        for record in item.iter("geometry"):
            _replace_flat_spiral(record)
            if road.length <= LENGTH_MIN:
                record.set("length", repr(road.length))
        _set_signals(item)
        _set_speeds(item, road)
    junctions = {junction.id: junction for junction in road_map.content.junctions}
    for item in root.findall("junction"):
        junction = junctions.get(item.get("id", ""))
        if junction is not None and junction.kind == "direct":
            _bridge(root, item, junction, roads)
        for connection in item.findall("connection"):
            named = (connection.get("incomingRoad"), connection.get("connectingRoad"))
            if not all(name in roads or str(name).startswith(BRIDGE) for name in named):
                item.remove(connection)
    if road_map.left_hand:
        _mirror(root)
    for section in root.iter("laneSection"):
        for group in section:
            # netconvert numbers the lanes in the order of the file, which must be left to right.
            group[:] = sorted(group, key=lambda lane: -float(lane.get("id", "0")))
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _set_speeds(item: Element, road: Road) -> None:
    """Writes the limit of every driving lane into the lane itself, in m/s."""
    sections = sorted(item.iter("laneSection"), key=lambda section: float(section.get("s", "0")))
    # The file may contain sections that begin beyond the road's end.
    for element, (start, end, section) in zip(sections, road.section_spans(), strict=False):
        for lane_item in element.iter("lane"):
            lane = section.lane(int(lane_item.get("id", "0")))
            if lane is None or not lane.is_driving or lane.id == 0:
                continue
            speeds = _speeds(road, section, lane, start, end)
            if not speeds:
                continue
            for old in lane_item.findall("speed"):
                lane_item.remove(old)
            for offset, limit in speeds:
                value = f"{UNLIMITED if math.isinf(limit) else min(limit, UNLIMITED):.6g}"
                ElementTree.SubElement(
                    lane_item, "speed", {"sOffset": repr(offset), "max": value, "unit": "m/s"}
                )


def _speeds(
    road: Road, section: LaneSection, lane: Lane, start: float, end: float
) -> list[tuple[float, float]]:
    """(distance from the section's start [m], limit [m/s]): the lane's own, else the road's.

    A road inside a junction without limits gets none: netconvert uses the limits of the roads
    before and after it and the speed that its bend allows.
    """
    if lane.speeds:
        return list(lane.speeds)
    if not road.types and road.junction is not None:
        return []
    inner = [record.s for record in road.types if start < record.s < end]
    return [(s - section.s, road.speed_at(s)) for s in (start, *inner)]


def _drop_lost_links(item: Element, roads: Mapping[str, Road]) -> None:
    """Removes links to roads that the net does not get."""
    for link in item.findall("link"):
        for name in ("predecessor", "successor"):
            for element in link.findall(name):
                if element.get("elementType", "road") != "road":
                    continue
                if element.get("elementId") not in roads:
                    link.remove(element)


def _replace_flat_spiral(record: Element) -> None:
    """Makes a spiral of nearly constant curvature an arc or a line.

    netconvert divides by the change of curvature and then needs all memory of the machine.
    """
    spiral = record.find("spiral")
    if spiral is None:
        return
    start, end = (float(spiral.get(name, "0")) for name in ("curvStart", "curvEnd"))
    length = float(record.get("length", "0"))
    # Ends of an arc and a spiral of the same mean curvature are apart by less than this.
    if abs(end - start) * length**2 > FLAT_SPIRAL:
        return
    record.remove(spiral)
    mean = 0.5 * (start + end)
    if abs(mean) * length < STRAIGHT_TURN:
        SubElement(record, "line")
    else:
        SubElement(record, "arc", curvature=repr(mean))


def _set_signals(item: Element) -> None:
    """Completes signals, and drops painted crossings, where netconvert would set lights.

    OpenDRIVE's value for "no type" is -1.
    """
    for signals in item.findall("signals"):
        for signal in signals.findall("signal"):
            if signal.get("type") == CROSSING and signal.get("dynamic") != "yes":
                signals.remove(signal)
    for number, signal in enumerate(item.iter("signal")):
        nameless = {"id": f"{item.get('id')}_signal_{number}"}
        for name, value in (SIGNAL_DEFAULTS | nameless).items():
            if not signal.get(name, "").strip():
                signal.set(name, value)


def _bridge(root: Element, item: Element, junction: Junction, roads: Mapping[str, Road]) -> None:
    """Makes a direct junction one with connecting roads, one for each pair of lanes."""
    for old in item.findall("connection"):
        item.remove(old)
    item.attrib.pop("type", None)
    count = 0
    for connection in junction.connections:
        for before, after in _lane_pairs(connection, junction, roads):
            identity = f"{BRIDGE}{junction.id}_{count}"
            count += 1
            _add_bridge(root, identity, junction.id, before, after)
            made = SubElement(
                item,
                "connection",
                id=str(count),
                incomingRoad=before[0].id,
                connectingRoad=identity,
                contactPoint="start",
            )
            to = "1" if before[0].left_hand else "-1"
            SubElement(made, "laneLink", {"from": str(before[2]), "to": to})


_LaneEnd = tuple[Road, int, int]  # road, direction of travel, lane id


def _lane_pairs(
    connection: Connection, junction: Junction, roads: Mapping[str, Road]
) -> Iterator[tuple[_LaneEnd, _LaneEnd]]:
    """The lanes that a connection of a direct junction joins, in their directions of travel."""
    incoming = roads.get(connection.incoming)
    linked = roads.get(connection.connecting)
    if incoming is None or linked is None:
        return
    onward = 1 if connection.contact == "start" else -1
    ends_here = [
        direction
        for direction in (1, -1)
        if (link := incoming.link(direction)) is not None and link.id == junction.id
    ]
    for first, second in connection.lane_links:
        for direction in ends_here[:1]:
            into = incoming.travel(first) == direction
            if into != (linked.travel(second) == onward):
                continue  # the lanes lead in opposite directions
            if into:
                yield (incoming, direction, first), (linked, onward, second)
            else:
                yield (linked, -onward, second), (incoming, -direction, first)


def _add_bridge(
    root: Element, identity: str, junction: str, before: _LaneEnd, after: _LaneEnd
) -> None:
    """Adds a connecting road of one lane where the lane before it ends."""
    road, direction, lane = before
    s = road.length if direction > 0 else 0.0
    section = road.sections[-1 if direction > 0 else 0]
    borders = lane_borders(road, section, road.side(direction))
    inside = lane - 1 if lane > 0 else lane + 1
    if lane not in borders or inside not in borders:
        return
    end = road.plan.evaluate(s, -direction)
    heading = float(end.heading) + (0.0 if direction > 0 else math.pi)
    # Seen in travel, t changes its sign on a road that is driven against its s.
    inner, outer = (direction * borders[each].at(s) for each in (inside, lane))
    side, made_lane = ("left", "1") if road.left_hand else ("right", "-1")
    item = SubElement(
        root, "road", name="", length=repr(BRIDGE_LENGTH), id=identity, junction=junction
    )
    link = SubElement(item, "link")
    for name, (other, way, _), contacts in (
        ("predecessor", before, ("end", "start")),
        ("successor", after, ("start", "end")),
    ):
        contact = contacts[0 if way > 0 else 1]
        SubElement(link, name, elementType="road", elementId=other.id, contactPoint=contact)
    place = {"s": "0", "x": repr(float(end.x)), "y": repr(float(end.y)), "hdg": repr(heading)}
    view = SubElement(item, "planView")
    SubElement(SubElement(view, "geometry", place, length=repr(BRIDGE_LENGTH)), "line")
    height = float(road.elevation.evaluate(s, 0, -direction))
    profile = SubElement(item, "elevationProfile")
    SubElement(profile, "elevation", s="0", a=repr(height), b="0", c="0", d="0")
    lanes = SubElement(item, "lanes")
    SubElement(lanes, "laneOffset", s="0", a=repr(inner), b="0", c="0", d="0")
    made = SubElement(lanes, "laneSection", s="0")
    SubElement(SubElement(made, "center"), "lane", id="0", type="none", level="false")
    element = SubElement(
        SubElement(made, side), "lane", id=made_lane, type="driving", level="false"
    )
    lane_link = SubElement(element, "link")
    SubElement(lane_link, "predecessor", id=str(lane))
    SubElement(lane_link, "successor", id=str(after[2]))
    SubElement(element, "width", sOffset="0", a=repr(abs(inner - outer)), b="0", c="0", d="0")


def _mirror(root: Element) -> None:
    """Mirrors the map in the x axis, which makes left-hand traffic right-hand traffic."""
    for section in root.iter("laneSection"):
        for group in section:
            group.tag = {"left": "right", "right": "left"}.get(group.tag, group.tag)
            for lane in group.findall("lane"):
                for element in (lane, *lane.findall("link/*")):
                    _negate(element, "id")
                for border in lane.findall("border"):
                    _negate(border, *"abcd")
    for tag, names in _MIRRORED.items():
        for element in root.iter(tag):
            _negate(element, *names)


def _negate(element: Element, *names: str) -> None:
    for name in names:
        value = element.get(name, "").strip()
        if value and float(value):
            element.set(name, value[1:] if value.startswith("-") else f"-{value.lstrip('+')}")
