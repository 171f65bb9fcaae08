"""Records of an OpenDRIVE file: roads, lanes, links, signals, structures.

Records compare by value, so two files with the same content give equal maps. Coordinates are
the road's own: s along the reference line, t to the left of it; SI units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

from iits_mj.road.geometry import Geometry, PlanView
from iits_mj.road.objects import MapObject
from iits_mj.road.polynomials import Cubic, PiecewiseCubic, combine

DRIVING_TYPES = frozenset(
    ("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane")
) | {"mwyEntry", "mwyExit"}
PAVED_TYPES = DRIVING_TYPES | {"shoulder", "stop", "parking", "biking", "bidirectional", "special1"}

# Limits where a map gives none: the road types of OpenDRIVE 1.6, table 26 [m/s].
DEFAULT_SPEED_LIMITS = {"town": 13.89, "lowSpeed": 8.33, "pedestrian": 2.78, "bicycle": 8.33}
DEFAULT_SPEED_LIMIT = 25.0
DEFAULT_FRICTION = 0.8


@dataclass(frozen=True)
class RoadMark:
    """Paint on a lane's outer border from `start` (within the lane section) on."""

    start: float
    kind: str = "none"
    width: float = 0.12
    color: str = "standard"


@dataclass(frozen=True)
class Lane:
    """One lane of a section.

    Attributes:
      id: negative right, positive left of the center lane 0.
      kind: OpenDRIVE lane type.
      widths: cubic records by distance from the section's start [m]; empty when borders are given.
      borders: outer border as t [m], the alternative to widths.
      marks: paint on the outer border (of lane 0: on the center line).
      speeds: (distance from the section's start [m], limit [m/s]), infinite where unlimited.
      frictions: (distance from the section's start [m], coefficient).
      predecessor, successor: lane ids in the neighboring sections or roads.
    """

    id: int
    kind: str = "driving"
    widths: tuple[Cubic, ...] = ()
    borders: tuple[Cubic, ...] = ()
    marks: tuple[RoadMark, ...] = ()
    speeds: tuple[tuple[float, float], ...] = ()
    frictions: tuple[tuple[float, float], ...] = ()
    predecessor: int | None = None
    successor: int | None = None

    @property
    def is_driving(self) -> bool:
        """Whether motor traffic uses the lane."""
        return self.kind in DRIVING_TYPES


@dataclass(frozen=True)
class LaneSection:
    """A stretch of road with an unchanging set of lanes, from `s` to the next section."""

    s: float
    lanes: tuple[Lane, ...]

    def side(self, side: int) -> list[Lane]:
        """Returns the lanes of a side (+1 right, -1 left of the center line), inner to outer."""
        chosen = [lane for lane in self.lanes if lane.id * side < 0]
        return sorted(chosen, key=lambda lane: abs(lane.id))

    def lane(self, lane_id: int) -> Lane | None:
        """Returns the lane of an id, or None."""
        return next((lane for lane in self.lanes if lane.id == lane_id), None)

    def driving(self, side: int) -> list[Lane]:
        """Returns the driving lanes of a side, from the outermost to the innermost."""
        return [lane for lane in reversed(self.side(side)) if lane.is_driving]


@dataclass(frozen=True)
class Link:
    """Successor of a road's end: a road (at its "start" or "end") or a junction."""

    element: str
    id: str
    contact: str | None = None


@dataclass(frozen=True)
class RoadType:
    """Kind of road from `s` on, with its speed limit [m/s] and country if they are given."""

    s: float
    kind: str = "unknown"
    speed: float | None = None
    country: str = ""


# Types of signals: light for pedestrians, painted crossing, and stop line (German catalog of signs,
# from which OpenDRIVE's own is derived).
PEDESTRIAN_LIGHT, CROSSING, STOP_LINE = "1000002", "1000003", "294"


@dataclass(frozen=True)
class Signal:
    """A sign or traffic light; `value` with `unit` is the limit of a speed sign.

    `heading` is that of its face against its orientation [rad], for pictures.
    """

    id: str
    s: float
    t: float
    kind: str = ""
    subtype: str = ""
    country: str = ""
    name: str = ""
    dynamic: bool = False
    orientation: str = "none"
    value: float | None = None
    unit: str = ""
    z_offset: float = 0.0
    height: float = 0.0
    width: float = 0.0
    heading: float = field(default=0.0, repr=False, compare=False)

    @property
    def is_traffic_light(self) -> bool:
        """Whether the signal changes its state: OpenDRIVE's own light types, or any dynamic one."""
        return self.dynamic or self.kind.startswith("10000")


@dataclass(frozen=True)
class Structure:
    """A tunnel or a bridge over [s, s + length]."""

    kind: str
    id: str
    s: float
    length: float
    name: str = ""
    subtype: str = "standard"


@dataclass(frozen=True)
class Road:
    """A road: reference line, profiles, lanes, links, signals and structures.

    With left-hand traffic (`left_hand`) the left lanes, whose ids are positive, are driven along s.
    `objects` are for pictures; maps that differ in nothing else are equal, with equal hashes.
    """

    id: str
    length: float
    geometries: tuple[Geometry, ...]
    sections: tuple[LaneSection, ...]
    name: str = ""
    junction: str | None = None
    predecessor: Link | None = None
    successor: Link | None = None
    types: tuple[RoadType, ...] = ()
    elevations: tuple[Cubic, ...] = ()
    superelevations: tuple[Cubic, ...] = ()
    lane_offsets: tuple[Cubic, ...] = ()
    signals: tuple[Signal, ...] = ()
    structures: tuple[Structure, ...] = ()
    objects: tuple[MapObject, ...] = field(default=(), repr=False, compare=False)
    left_hand: bool = False

    def __getstate__(self) -> dict[str, Any]:
        """The fields, without the profiles that are made of them."""
        return {each.name: self.__dict__[each.name] for each in fields(self)}

    @cached_property
    def plan(self) -> PlanView:
        """Reference line in the plane."""
        return PlanView(self.geometries)

    @cached_property
    def elevation(self) -> PiecewiseCubic:
        """Height of the reference line [m]."""
        return PiecewiseCubic(self.elevations)

    @cached_property
    def superelevation(self) -> PiecewiseCubic:
        """Cross slope [rad], positive where the left side (larger t) is higher."""
        return PiecewiseCubic(self.superelevations)

    @cached_property
    def lane_offset(self) -> PiecewiseCubic:
        """T of the center lane [m]."""
        return PiecewiseCubic(self.lane_offsets)

    def section_spans(self) -> Iterator[tuple[float, float, LaneSection]]:
        """Yields every lane section with its start and end."""
        ends = [section.s for section in self.sections[1:]] + [self.length]
        for section, end in zip(self.sections, ends, strict=True):
            yield section.s, end, section

    def side(self, direction: int) -> int:
        """Returns the side of the lanes of a direction of travel: +1 right, -1 left."""
        return -direction if self.left_hand else direction

    def travel(self, lane: int) -> int:
        """Returns the direction in which the lane with an id is driven: +1 along s, -1 against."""
        return self.side(1 if lane < 0 else -1)

    def has_lanes(self, direction: int) -> bool:
        """Returns whether driving lanes of a direction run along the whole road."""
        return all(section.driving(self.side(direction)) for section in self.sections)

    def link(self, direction: int) -> Link | None:
        """Returns the link of the road's end in a direction of travel."""
        return self.successor if direction > 0 else self.predecessor

    def speed_at(self, s: float) -> float:
        """Returns the road's own limit [m/s], for lanes without one."""
        kind, speed = "unknown", None
        for record in self.types:
            if record.s <= s or record is self.types[0]:
                kind, speed = record.kind, record.speed
        return DEFAULT_SPEED_LIMITS.get(kind, DEFAULT_SPEED_LIMIT) if speed is None else speed


@dataclass(frozen=True)
class Connection:
    """A way through a junction: from an incoming road onto a connecting road."""

    incoming: str
    connecting: str
    contact: str
    lane_links: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Junction:
    """A junction with its connections."""

    id: str
    kind: str = "default"
    connections: tuple[Connection, ...] = ()


@dataclass(frozen=True)
class LightProgram:
    """Phases of a traffic light of the SUMO net of which a map was made.

    Attributes:
      id: of the light in the net; offset: of the program's beginning [s].
      phases: duration [s], and a letter of SUMO for each link of the light.
    """

    id: str
    offset: float
    phases: tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class OpenDriveMap:
    """Content of a file that this project uses; `notes` lists the parts left out.

    `offset` is the place of the origin in the projection of `geo_reference`: x, y [m].
    `light_programs` are those of the SUMO net of which the map was made.
    """

    roads: tuple[Road, ...]
    junctions: tuple[Junction, ...] = ()
    name: str = ""
    geo_reference: str = ""
    offset: tuple[float, float] = (0.0, 0.0)
    notes: tuple[str, ...] = field(default=(), compare=False)
    light_programs: tuple[LightProgram, ...] = ()


def lane_borders(road: Road, section: LaneSection, side: int) -> dict[int, PiecewiseCubic]:
    """Returns t of the outer border of every lane of a side (+1 right), as profiles over s [m].

    Lane 0 is the center line, whose border is the lane offset.
    """
    sign = -1.0 if side > 0 else 1.0
    border = road.lane_offset
    result = {0: border}
    for lane in section.side(side):
        if lane.widths:
            width = _shifted(lane.widths, section.s)
            border = combine([(1.0, border), (sign, width)])
        elif lane.borders:
            border = combine([(1.0, road.lane_offset), (1.0, _shifted(lane.borders, section.s))])
        result[lane.id] = border
    return result


def _shifted(records: tuple[Cubic, ...], s: float) -> PiecewiseCubic:
    return PiecewiseCubic(record._replace(start=record.start + s) for record in records)
