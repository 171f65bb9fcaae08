"""What of a map has to be said otherwise before netconvert reads it as we do.

netconvert reads limits of lanes only, not of roads; takes an empty `junction` for a number; ignores
a limit that is none; and dies on direct junctions. The geometry stays as it is.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from xml.etree.ElementTree import Element

from iits_mj.errors import MapError
from iits_mj.road import RoadMap
from iits_mj.road.elements import Lane, LaneSection, Road
from iits_mj.road.writer import to_xml
from iits_mj.road.xml_input import content_hash, parse_xml, read_file

UNLIMITED = 70.0  # [m/s], what SUMO is told where a road has no limit


def opendrive_for_netconvert(road_map: RoadMap) -> bytes:
    """The map as OpenDRIVE that netconvert reads rightly; made from memory where it has no file.

    Raises:
      MapError: the file cannot be read any more, or has changed since the map was read, or has
        direct junctions.
    """
    if road_map.path.is_file():
        content = read_file(road_map.path)
        _check_unchanged(road_map, content)
    else:
        content = to_xml(road_map.content).encode()
    root = parse_xml(content, str(road_map.path))
    for junction in root.findall("junction"):
        if junction.get("type") == "direct":
            raise MapError(
                f"{road_map.path}: the map has direct junctions (OpenDRIVE 1.7), "
                "which SUMO's netconvert cannot read; drive it without traffic or use another map"
            )
    for item in root.findall("road"):
        # An empty attribute means "in no junction", but netconvert wants the number.
        if not item.get("junction", "").strip():
            item.set("junction", "-1")
        road = road_map.roads.get(item.get("id", ""))
        if road is not None:
            _set_speeds(item, road)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _check_unchanged(road_map: RoadMap, content: bytes) -> None:
    if content_hash(content) != road_map.content_hash:
        raise MapError(
            f"{road_map.path}: the file has changed since the map was read; read it anew"
        )


def _set_speeds(item: Element, road: Road) -> None:
    """Writes the limit of every driving lane into the lane itself, in m/s."""
    sections = sorted(item.iter("laneSection"), key=lambda section: float(section.get("s", "0")))
    # A section that begins beyond the road's end is in the file only.
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

    A road inside a junction that says nothing is left alone: netconvert takes the limits of the
    roads before and after it, and what its bend allows.
    """
    if lane.speeds:
        return list(lane.speeds)
    if not road.types and road.junction is not None:
        return []
    inner = [record.s for record in road.types if start < record.s < end]
    return [(s - section.s, road.speed_at(s)) for s in (start, *inner)]
