"""Reads a SUMO net file (`.net.xml`) into plain records, without starting SUMO.

SUMO's own reader (`sumolib.net`) is not used: it drops the lanes' OpenDRIVE type, which defines
where cars may drive, takes twice as long, and raises errors of other libraries on a damaged file.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import TrafficError
from iits_mj.road.elements import DRIVING_TYPES

WALKER = "pedestrian"  # SUMO's class; lanes for it alone are no lanes of vehicles
SIGNALS = "linkSignalID:"  # netconvert's parameter of a light: OpenDRIVE's signals of a link
YIELDS = tuple("msw")  # SUMO's states of connections that give way, or stop
ORIGIN = "origId"  # netconvert's name for "ROAD_LANE" of OpenDRIVE (--output.original-names)


@dataclass(frozen=True, eq=False)
class NetLane:
    """One lane of a net.

    Attributes:
      id: SUMO's; edge: its edge; index: from the right.
      length: in SUMO's measure of positions [m]; width: [m]; speed: limit [m/s].
      kind: OpenDRIVE's lane type; "" if the net does not name it.
      origin: (road id, lane id) in OpenDRIVE, or None for SUMO's own short joints.
      open: to passenger cars.
      stop_offset: distance of the stop line before the lane's end [m].
      shape: polyline of its center in SUMO's coordinates [m], shape (n, 2).
    """

    id: str
    edge: str
    index: int
    length: float
    width: float = 3.2
    speed: float = 13.89
    kind: str = ""
    origin: tuple[str, int] | None = None
    open: bool = True
    stop_offset: float = 0.0
    shape: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def internal(self) -> bool:
        """Whether the lane lies inside a SUMO junction, where vehicles do not change lanes."""
        return self.edge.startswith(":")

    @property
    def is_driving(self) -> bool:
        """Whether cars and trucks may drive on the lane."""
        return self.open and (self.kind in DRIVING_TYPES or not self.kind)

    def neighbor(self, side: int) -> str:
        """Id of the lane to the right (-1) or left (+1), whether it exists or not."""
        return f"{self.edge}_{self.index + side}"


@dataclass(frozen=True)
class NetEdge:
    """A stretch of road in one direction, with its lanes from the right."""

    id: str
    lanes: tuple[NetLane, ...]

    @property
    def internal(self) -> bool:
        """Whether the edge lies inside a SUMO junction."""
        return self.id.startswith(":")

    @property
    def length(self) -> float:
        """Length in SUMO's measure of positions [m]."""
        return self.lanes[0].length


@dataclass(frozen=True)
class NetConnection:
    """A connection from a lane to a lane.

    Attributes:
      start, end: SUMO lane ids.
      via: the first lane inside the junction, or "".
      turn: "s" straight, "l" left, "r" right, "L" and "R" half left and right, "t" back.
      light: the traffic light that controls it, or ""; link: its letter's index there, or -1.
      yields: whether its vehicles give way, at a junction without a light.
    """

    start: str
    end: str
    via: str
    turn: str
    light: str
    link: int
    yields: bool = False


@dataclass(frozen=True)
class NetJunction:
    """A node: `kind` is SUMO's ("priority", "traffic_light", "dead_end" ...); x, y of SUMO [m]."""

    id: str
    kind: str
    x: float
    y: float


@dataclass(frozen=True)
class NetLight:
    """A traffic light's program: (duration [s], one letter per link) for each phase.

    `signals` are the ids of OpenDRIVE's signals by the number of their link.
    """

    id: str
    program: str
    phases: tuple[tuple[float, str], ...]
    signals: dict[int, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class NetFile:
    """A SUMO net, reduced to the parts that this project uses: those of vehicles.

    Attributes:
      path: of the file.
      offset: SUMO's x and y minus the map's x and y [m].
    """

    path: Path
    offset: tuple[float, float]
    edges: tuple[NetEdge, ...]
    connections: tuple[NetConnection, ...]
    junctions: tuple[NetJunction, ...]
    lights: tuple[NetLight, ...]

    @classmethod
    def read(cls, path: Path) -> NetFile:
        """Reads a net file; an unchanged file is not read a second time.

        Raises:
          TrafficError: the file is missing, no SUMO net, or written without original names.
        """
        try:
            status = path.stat()
            return _read(path, status.st_mtime_ns, status.st_size)
        except (OSError, ElementTree.ParseError, ValueError, KeyError) as error:
            raise TrafficError(f"{path}: not a SUMO network: {error}") from error

    @cached_property
    def edge(self) -> dict[str, NetEdge]:
        """The edges by id."""
        return {edge.id: edge for edge in self.edges}

    @cached_property
    def lanes(self) -> dict[str, NetLane]:
        """The lanes of all edges by id."""
        return {lane.id: lane for edge in self.edges for lane in edge.lanes}

    @cached_property
    def links(self) -> dict[str, tuple[tuple[str, str], ...]]:
        """(lane that begins at its end, edge to which it leads) of each connected lane."""
        found: dict[str, tuple[tuple[str, str], ...]] = {}
        for link in self.connections:
            onward = (link.via or link.end, link.end.rpartition("_")[0])
            found[link.start] = (*found.get(link.start, ()), onward)
        return found

    @cached_property
    def inside(self) -> dict[str, str]:
        """The lane that follows each lane inside a junction; "" at the junction's end."""
        return {link.start: link.via for link in self.connections if link.start.startswith(":")}

    def links_of(self, edge: str) -> list[tuple[str, str]]:
        """(edge, internal lane or "") of every connection from an edge, from the right lane on."""
        lanes = {lane.id: k for k, lane in enumerate(self.edge[edge].lanes)}
        links = [link for link in self.connections if link.start in lanes]
        links.sort(key=lambda link: lanes[link.start])
        return [(link.end.rpartition("_")[0], link.via) for link in links]


def distances_along(points: FloatArray) -> FloatArray:
    """Distance of every point of a polyline (n, 2) from its first point along it, shape (n,)."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))


@lru_cache(maxsize=8)
def _read(path: Path, _changed: int, _size: int) -> NetFile:
    root = ElementTree.parse(path).getroot()
    location = root.find("location")
    if root.tag != "net" or location is None:
        raise ValueError("it has no <net> with a <location>")
    x, y = (float(value) for value in location.get("netOffset", "").split(","))
    edges = tuple(edge for item in root.findall("edge") if (edge := _edge(item)).lanes)
    there = {lane.id for edge in edges for lane in edge.lanes}
    links = (_connection(item) for item in root.findall("connection"))
    found = NetFile(
        path=path,
        offset=(x, y),
        edges=edges,
        connections=tuple(link for link in links if {link.start, link.end} <= there),
        junctions=tuple(
            _junction(item) for item in root.findall("junction") if item.get("type") != "internal"
        ),
        lights=tuple(_light(item) for item in root.findall("tlLogic")),
    )
    for edge in found.edges:
        if not edge.internal and any(lane.origin is None for lane in edge.lanes):
            raise TrafficError(
                f"{path}: edge {edge.id!r} does not name its OpenDRIVE lanes; "
                "make the net with netconvert's --output.original-names"
            )
    return found


def _edge(item: Element) -> NetEdge:
    identity = item.attrib["id"]
    lanes = (_lane(lane, identity) for lane in item.findall("lane") if lane.get("allow") != WALKER)
    return NetEdge(identity, tuple(sorted(lanes, key=lambda lane: lane.index)))


def _lane(item: Element, edge: str) -> NetLane:
    points = [point.split(",") for point in item.attrib["shape"].split()]
    origin = None
    for parameter in item.findall("param"):
        if parameter.get("key") == ORIGIN:
            # Several names belong to joined lanes; the lane begins with the first one.
            name = re.match(r"(.+?)_(-?\d+)(?: |$)", parameter.get("value", ""))
            origin = (name[1], int(name[2])) if name else None
    stop = item.find("stopOffset")
    return NetLane(
        id=item.attrib["id"],
        edge=edge,
        index=int(item.attrib["index"]),
        length=float(item.attrib["length"]),
        width=float(item.get("width", "3.2")),
        speed=float(item.attrib["speed"]),
        kind=item.get("type", ""),
        origin=origin,
        open=_is_open(item.get("allow"), item.get("disallow", "")),
        stop_offset=float(stop.get("value", "0")) if stop is not None else 0.0,
        shape=np.array([[float(point[0]), float(point[1])] for point in points]),
    )


def _is_open(allowed: str | None, forbidden: str) -> bool:
    """Whether cars may drive, by SUMO's lists of vehicle classes."""
    if allowed is not None:
        return "passenger" in allowed.split() or allowed == "all"
    return not {"passenger", "all"} & set(forbidden.split())


def _connection(item: Element) -> NetConnection:
    given = item.attrib
    return NetConnection(
        start=f"{given['from']}_{given['fromLane']}",
        end=f"{given['to']}_{given['toLane']}",
        via=given.get("via", ""),
        turn=given.get("dir", "s"),
        light=given.get("tl", ""),
        link=int(given.get("linkIndex", "-1")),
        yields=given.get("state", "") in YIELDS,
    )


def _junction(item: Element) -> NetJunction:
    given = item.attrib
    return NetJunction(given["id"], given.get("type", ""), float(given["x"]), float(given["y"]))


def _light(item: Element) -> NetLight:
    phases = tuple((float(p.attrib["duration"]), p.attrib["state"]) for p in item.findall("phase"))
    return NetLight(item.attrib["id"], item.get("programID", "0"), phases, signals_of(item))


def signals_of(item: Element) -> dict[int, tuple[str, ...]]:
    """Ids of OpenDRIVE's signals for each link of a light's program in a net."""
    return {
        int(key.removeprefix(SIGNALS)): tuple(parameter.get("value", "").split())
        for parameter in item.findall("param")
        if (key := parameter.get("key", "")).startswith(SIGNALS)
    }
