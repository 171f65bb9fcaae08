"""Sidewalks, walking areas and crossings of a net, made by netconvert at the map's junctions.

netconvert moves the lanes of roads on which it guesses sidewalks. The vehicles' lanes are put back,
so that vehicles drive where they do without pedestrians.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import MapError
from iits_mj.road.elements import CROSSING as PAINTED
from iits_mj.road.elements import Road
from traffic_bridge.network.net_file import ORIGIN, WALKER, NetFile, NetLane

# Sidewalks along all roads; only those that the map has are used, see `read_crossings`.
OPTIONS = ("--sidewalks.guess", "--sidewalks.guess.max-speed", "70", "--crossings.guess")
SIDEWALK = "sidewalk"  # OpenDRIVE's type of lane
SET_BACK = 1.5  # [m] behind the edge of the road at which persons wait: trailers cut corners
CURB = 0.5  # [m] between the road and its sidewalk: netconvert's sidewalks touch the road
SAME_ARM = 12.0  # [m] between a crossing of the map and one of the net at the same arm, at most
LINE_GAP = 0.5  # [m] from a stop line to the crossing behind it, at least


@dataclass(frozen=True)
class Sidewalk:
    """The end of a sidewalk at a walking area.

    Attributes:
      edge: SUMO's edge, to which it belongs; length: of it [m].
      at_end: it meets the walking area at the edge's end, else at its beginning.
    """

    edge: str
    length: float
    at_end: bool

    def place(self, distance: float) -> float:
        """Position at a distance from the walking area, at most a third of the edge [m]."""
        distance = min(distance, self.length / 3.0)
        return self.length - distance if self.at_end else distance


@dataclass(frozen=True)
class Crossing:
    """A crossing between two sidewalks.

    Attributes:
      id: SUMO's edge; edges: of the road that it crosses.
      roads: ids of the map's roads that it crosses.
      sides: the sidewalks that begin at either end.
      axis: from one end to the other, in SUMO's coordinates, shape (n, 2) [m].
      outline: corners, in SUMO's coordinates, shape (n, 2) [m].
    """

    id: str
    edges: tuple[str, ...]
    roads: frozenset[str]
    sides: tuple[tuple[Sidewalk, ...], tuple[Sidewalk, ...]]
    axis: FloatArray
    outline: FloatArray


def has_sidewalks(road: Road | None) -> bool:
    """Whether a road has a lane for pedestrians."""
    return road is not None and any(
        lane.kind == SIDEWALK for section in road.sections for lane in section.lanes
    )


def with_vehicle_lanes(text: str, base: str, name: str) -> str:
    """Returns a net with walkways whose vehicle lanes have the shapes of the net without them.

    Args:
      text: the net with walkways.
      base: the net of the same map without them.
      name: of the map, for errors.

    Raises:
      MapError: the two nets have other edges or lanes.
    """
    root, source = ElementTree.fromstring(text), ElementTree.fromstring(base)
    new, old = _lanes(root), _lanes(source)
    for edge, lanes in old.items():
        made = [lane for lane in new.get(edge, ()) if not _is_walkway(lane)]
        if not edge.startswith(":") and len(made) != len(lanes):
            raise MapError(
                f"{name}: netconvert gives edge {edge!r} {len(made)} lanes with sidewalks and "
                f"{len(lanes)} without them: this map cannot have pedestrians"
            )
        if not edge.startswith(":"):
            _take_shapes(made, lanes)
            for lane in new[edge][: len(new[edge]) - len(made)]:
                lane.set("shape", _moved_right(lane.attrib["shape"], CURB))
    ways = _ways(source, old)
    for link, made in _ways(root, new).items():
        # A way that is split for a crossing has the map's shape already.
        if len(ways.get(link, ())) == len(made):
            _take_shapes(made, ways[link])
    for lane in root.findall("edge[@function='crossing']/lane"):
        _set_back(lane)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def with_painted_crossings(text: str, roads: Mapping[str, Road]) -> str:
    """Returns a net whose crossings lie where the map paints them on the same arm of a junction.

    netconvert reads no crossings of an OpenDRIVE map. The sidewalks of the arm end at the crossing.

    Args:
      text: the net with walkways, at the map's place.
      roads: of the map, by id.
    """
    root = ElementTree.fromstring(text)
    lanes = _lanes(root)
    offset = [float(n) for n in root.findall("location")[0].attrib["netOffset"].split(",")]
    for edge in root.findall("edge[@function='crossing']"):
        crossed = [lanes[name] for name in edge.get("crossingEdges", "").split() if name in lanes]
        (lane,) = lanes[edge.attrib["id"]]
        axis = _points(lane.attrib["shape"])[:, :2]
        move = paint_of(axis - offset, {_road_of(one) for one in crossed}, roads)
        shortest = min(float(one[0].attrib["length"]) for one in crossed)
        if move is None or np.hypot(*move) > 0.5 * shortest:
            continue
        for key in ("shape", "outlineShape"):
            if key in lane.attrib:
                points = _points(lane.attrib[key])
                points[:, :2] += move
                lane.set(key, _text(points))
        for walk in (one[0] for one in crossed if _is_walkway(one[0])):
            points = _points(walk.attrib["shape"])
            # Its points in the order from the crossing.
            ends = np.hypot(*(points[[0, -1], :2] - axis.mean(axis=0)).T)
            order = slice(None, None, 1 if ends[0] < ends[1] else -1)
            along = (points[order][1] - points[order][0])[:2]
            walk.set("shape", _text(_cut(points[order], along @ move / np.hypot(*along))[order]))
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def paint_of(
    axis: FloatArray, names: Collection[str], roads: Mapping[str, Road]
) -> FloatArray | None:
    """Returns the way across a crossing to the one that the map paints there (2,) [m], or None.

    Args:
      axis: of the crossing, from one side of the road to the other, map frame, shape (n, 2) [m].
      names: of the roads that it crosses.
      roads: of the map, by id.
    """
    middle, along = axis.mean(axis=0), axis[-1] - axis[0]
    length = float(np.hypot(*along))
    across = np.array([-along[1], along[0]]) / length
    found: list[float] = []
    for road in (roads[name] for name in sorted(names) if name in roads):
        places = [(one.s, one.t) for one in road.signals if one.kind == PAINTED]
        places += [(one.s, one.t) for one in road.objects if one.is_crossing]
        for s, t in places:
            point = road.plan.evaluate(s)
            x, y, heading = float(point.x), float(point.y), float(point.heading)
            away = (x - t * math.sin(heading), y + t * math.cos(heading)) - middle
            if abs(away @ along) < 0.5 * length**2 and abs(away @ across) < SAME_ARM:
                found.append(float(away @ across))
    return min(found, key=abs) * across if found else None


def read_crossings(net: Path, roads: Mapping[str, Road]) -> tuple[Crossing, ...]:
    """Returns the crossings of roads on which the map has sidewalks, in the net's order.

    Args:
      net: file of a net with walkways.
      roads: of the map, by id.
    """
    root = ElementTree.parse(net).getroot()
    lanes = _lanes(root)
    walks = {
        edge: float(found[0].attrib["length"])
        for edge, found in lanes.items()
        if not edge.startswith(":") and _is_walkway(found[0])
    }
    ends: dict[str, list[Sidewalk]] = {}
    areas: dict[str, set[str]] = {}
    for link in root.findall("connection"):
        start, end = link.attrib["from"], link.attrib["to"]
        if start in walks and end.startswith(":"):
            ends.setdefault(end, []).append(Sidewalk(start, walks[start], at_end=True))
        elif end in walks and start.startswith(":"):
            ends.setdefault(start, []).append(Sidewalk(end, walks[end], at_end=False))
        elif start.startswith(":") and end.startswith(":"):
            areas.setdefault(start, set()).add(end)
            areas.setdefault(end, set()).add(start)
    found = []
    for edge in root.findall("edge[@function='crossing']"):
        name, crossed = edge.attrib["id"], tuple(edge.get("crossingEdges", "").split())
        sides = [tuple(ends.get(area, ())) for area in sorted(areas.get(name, ()))]
        owners = {_road_of(lanes[one]) for one in crossed if one in lanes}
        if (
            len(sides) != 2
            or not all(sides)
            or not all(has_sidewalks(roads.get(r)) for r in owners)
        ):
            continue
        (lane,) = lanes[name]
        axis = _points(lane.attrib["shape"])[:, :2]
        outline = _points(lane.get("outlineShape") or lane.attrib["shape"])[:, :2]
        ends_of = sides[0], sides[1]
        found.append(Crossing(name, crossed, frozenset(owners), ends_of, axis, outline))
    return tuple(found)


def lines_before(net: NetFile, crossings: tuple[Crossing, ...]) -> dict[str, float]:
    """Distances of stop lines before the ends of lanes that let vehicles wait at crossings [m]."""
    found: dict[str, float] = {}
    for crossing in crossings:
        for lane in (lane for edge in crossing.edges for lane in _of(net, edge)):
            (x, y), (before_x, before_y) = lane.shape[-1], lane.shape[-2]
            course = math.atan2(y - before_y, x - before_x)
            along = (crossing.outline - (x, y)) @ (math.cos(course), math.sin(course))
            # The crossing lies at the end of the edge that leads to it.
            near = np.abs(along) < 0.5 * lane.length
            if near.all():
                found[lane.id] = max(-float(along.min()) + LINE_GAP, 0.0)
    return found


def _of(net: NetFile, edge: str) -> tuple[NetLane, ...]:
    return net.edge[edge].lanes if edge in net.edge else ()


def _lanes(root: Element) -> dict[str, list[Element]]:
    """The lanes of each edge from the right; a sidewalk is the first."""
    return {
        edge.attrib["id"]: sorted(edge.findall("lane"), key=lambda lane: int(lane.attrib["index"]))
        for edge in root.findall("edge")
    }


def _cut(points: FloatArray, distance: float) -> FloatArray:
    """A polyline without its first part of a length [m]; unchanged for a negative one."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    along = np.concatenate([[0.0], steps.cumsum()])
    if not 0.0 < distance < along[-1]:
        return points
    first = [np.interp(distance, along, column) for column in points.T]
    return np.vstack([first, points[along > distance]])


def _moved_right(shape: str, distance: float) -> str:
    """A polyline moved to its right [m]."""
    points = _points(shape)
    course = np.gradient(points[:, :2], axis=0)
    course /= np.hypot(*course.T)[:, None]
    points[:, :2] += distance * np.column_stack([course[:, 1], -course[:, 0]])
    return _text(points)


def _points(shape: str) -> FloatArray:
    """The points of a shape, shape (n, 2) or (n, 3) [m]."""
    return np.array([[float(n) for n in point.split(",")] for point in shape.split()])


def _text(points: FloatArray) -> str:
    return " ".join(",".join(f"{n:.3f}" for n in point) for point in points)


def _set_back(crossing: Element) -> None:
    """Lengthens a crossing, so that persons wait behind the edges of the road."""
    points = _points(crossing.attrib["shape"])
    for end, inner in ((0, 1), (-1, -2)):
        outward = points[end] - points[inner]
        points[end] += SET_BACK / float(np.hypot(*outward[:2])) * outward
    crossing.set("shape", _text(points))
    crossing.set("length", f"{float(crossing.attrib['length']) + 2.0 * SET_BACK:.2f}")


def _take_shapes(lanes: list[Element], sources: list[Element]) -> None:
    for lane, source in zip(lanes, sources, strict=True):
        for key in ("shape", "length"):
            lane.set(key, source.attrib[key])


def _ways(
    root: Element, lanes: Mapping[str, list[Element]]
) -> dict[tuple[str, ...], list[Element]]:
    """The lanes inside a junction of each connection between vehicle lanes.

    A connection is named by its edges and by the places of its lanes from the left.
    """
    named = {lane.attrib["id"]: lane for edge in lanes.values() for lane in edge}
    links = root.findall("connection")
    inside = {f"{link.get('from')}_{link.get('fromLane')}": link.get("via") for link in links}
    found: dict[tuple[str, ...], list[Element]] = {}
    for link in links:
        start, end, via = link.attrib["from"], link.attrib["to"], link.get("via")
        if start.startswith(":") or end.startswith(":"):
            continue
        places = ((start, link.attrib["fromLane"]), (end, link.attrib["toLane"]))
        key = (start, end, *(str(len(lanes[edge]) - int(lane)) for edge, lane in places))
        way = []
        while via:
            way.append(named[via])
            via = inside.get(via)
        found[key] = way
    return found


def _is_walkway(lane: Element) -> bool:
    return lane.get("allow") == WALKER


def _road_of(lanes: list[Element]) -> str:
    for parameter in lanes[-1].findall("param"):
        if parameter.get("key") == ORIGIN:
            return parameter.get("value", "").split(" ")[0].rpartition("_")[0]
    return ""
