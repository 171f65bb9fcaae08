"""One-way roads with equal lanes as map records, for plain routes, tests and measured roads."""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.core.checks import in_range
from iits_mj.road.elements import Lane, LaneSection, OpenDriveMap, Road, RoadMark, RoadType
from iits_mj.road.geometry import Geometry, Line
from iits_mj.road.polynomials import Cubic


@dataclass(frozen=True)
class Lanes:
    """Equal parallel lanes: number, width [m], speed limit [m/s], friction."""

    count: int = 2
    width: float = 4.0
    speed_limit: float = 25.0
    friction: float = 0.8


def one_way_road(
    name: str,
    length: float,
    geometries: tuple[Geometry, ...],
    elevations: tuple[Cubic, ...],
    lanes: Lanes,
) -> OpenDriveMap:
    """Returns a road with lanes along s only; its reference line is the rightmost lane's center."""
    right = tuple(
        Lane(
            id=-i,
            widths=(Cubic(0.0, lanes.width),),
            marks=(RoadMark(0.0, "broken" if i < lanes.count else "solid"),),
            speeds=((0.0, lanes.speed_limit),),
            frictions=((0.0, lanes.friction),),
        )
        for i in range(1, lanes.count + 1)
    )
    center = Lane(id=0, kind="none", marks=(RoadMark(0.0, "solid"),))
    road = Road(
        id="1",
        length=length,
        geometries=geometries,
        sections=(LaneSection(0.0, (center, *right)),),
        name=name,
        types=(RoadType(0.0, "motorway", lanes.speed_limit),),
        elevations=elevations,
        lane_offsets=(Cubic(0.0, (lanes.count - 0.5) * lanes.width),),
    )
    return OpenDriveMap(roads=(road,), name=name)


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
    return one_way_road("straight", length, (line,), (slope,), rows)
