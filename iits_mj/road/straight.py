"""Single roads with equal lanes as map records: plain routes and measured roads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from iits_mj.core.checks import in_range
from iits_mj.road.elements import Lane, LaneSection, OpenDriveMap, Road, RoadMark, RoadType
from iits_mj.road.geometry import Geometry, Line
from iits_mj.road.polynomials import Cubic


@dataclass(frozen=True)
class Lanes:
    """Equal parallel lanes: number, width [m], speed limit [m/s], friction, oncoming lanes."""

    count: int = 2
    width: float = 4.0
    speed_limit: float = 25.0
    friction: float = 0.8
    oncoming: int = 0


def plain_road(
    name: str,
    length: float,
    geometries: tuple[Geometry, ...],
    elevations: tuple[Cubic, ...],
    lanes: Sequence[tuple[float, Lanes]],
    superelevations: tuple[Cubic, ...] = (),
    centered: bool = False,
) -> OpenDriveMap:
    """Returns a map of one road.

    Args:
      name: of the map and the road.
      length: [m].
      geometries: of the reference line.
      elevations: of the reference line.
      lanes: (station from which they count, lanes), the first at 0; lanes open and close on the
        left of those that go on, at once.
      superelevations: cross slope.
      centered: the reference line is the center line; without it, it is the center of the rightmost
        lane.
    """
    bare = [LaneSection(start, _lanes(rows)) for start, rows in lanes]
    sections = [
        linked(section, bare[i - 1] if i else None, bare[i + 1] if i + 1 < len(bare) else None)
        for i, section in enumerate(bare)
    ]
    offsets = tuple(Cubic(start, (rows.count - 0.5) * rows.width) for start, rows in lanes)
    road = Road(
        id="1",
        length=length,
        geometries=geometries,
        sections=tuple(sections),
        name=name,
        types=(RoadType(0.0, "motorway", lanes[0][1].speed_limit),),
        elevations=elevations,
        superelevations=superelevations,
        lane_offsets=() if centered else offsets,
    )
    return OpenDriveMap(roads=(road,), name=name)


def _lanes(rows: Lanes) -> tuple[Lane, ...]:
    """The lanes of a section, from the left."""
    found = [Lane(id=0, kind="none", marks=(RoadMark(0.0, "solid"),))]
    for side, count in ((1, rows.oncoming), (-1, rows.count)):
        for i in range(1, count + 1):
            lane = Lane(
                id=side * i,
                widths=(Cubic(0.0, rows.width),),
                marks=(RoadMark(0.0, "broken" if i < count else "solid"),),
                speeds=((0.0, rows.speed_limit),),
                frictions=((0.0, rows.friction),),
            )
            found.insert(0 if side > 0 else len(found), lane)
    return tuple(found)


def linked(
    section: LaneSection, before: LaneSection | None, after: LaneSection | None
) -> LaneSection:
    """Returns a section whose lanes name their neighbors in the sections before and after.

    Right lanes are matched from the outside, because lanes open and close on the inside.
    """
    count = len(section.side(1))

    def partner(lane: Lane, other: LaneSection | None) -> int | None:
        if other is None or lane.id == 0:
            return None
        if lane.id > 0:
            return lane.id if other.lane(lane.id) else None
        shifted = lane.id - (len(other.side(1)) - count)
        return shifted if shifted < 0 else None

    return replace(
        section,
        lanes=tuple(
            replace(lane, predecessor=partner(lane, before), successor=partner(lane, after))
            for lane in section.lanes
        ),
    )


def straight_road(
    length: float, lanes: int, lane_width: float, speed_limit: float, grade: float, friction: float
) -> OpenDriveMap:
    """Returns a straight road of constant grade along x.

    Raises:
      InputError: a value is out of range.
    """
    length = in_range("length", length, 1.0, 1e6, "m")
    in_range("lanes", lanes, 1, 20)
    rows = Lanes(
        lanes,
        in_range("lane_width", lane_width, 1.0, 20.0, "m"),
        in_range("speed_limit", speed_limit, 0.1, 200.0, "m/s"),
        in_range("friction", friction, 0.0, 2.0),
    )
    slope = Cubic(0.0, 0.0, in_range("grade", grade, -0.5, 0.5))
    line = Line(0.0, 0.0, 0.0, 0.0, length)
    return plain_road("straight", length, (line,), (slope,), [(0.0, rows)])
