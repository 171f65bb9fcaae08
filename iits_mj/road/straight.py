"""A straight road as OpenDRIVE records: the road of every test and of the plain model."""

from __future__ import annotations

import math

from iits_mj.core.errors import InputError
from iits_mj.road.elements import Lane, LaneSection, OpenDriveMap, Road, RoadMark, RoadType
from iits_mj.road.geometry import Line
from iits_mj.road.polynomials import Cubic


def straight_road(
    length: float, lanes: int, lane_width: float, speed_limit: float, grade: float, friction: float
) -> OpenDriveMap:
    """One road along x with `lanes` lanes in the direction of x and none against it.

    The reference line is the centre of the rightmost lane, so that offset 0 is a place to drive.

    Raises:
      InputError: a value is out of range.
    """
    bounds = {
        "length": (length, 1.0, 1e6),
        "lanes": (lanes, 1, 20),
        "lane_width": (lane_width, 1.0, 20.0),
        "speed_limit": (speed_limit, 0.1, 200.0),
        "grade": (grade, -0.5, 0.5),
        "friction": (friction, 0.0, 2.0),
    }
    for name, (value, low, high) in bounds.items():
        if not (math.isfinite(value) and low <= value <= high):
            raise InputError(f"{name} must be within [{low:g}, {high:g}], not {value}")
    right = tuple(
        Lane(
            id=-i,
            widths=(Cubic(0.0, float(lane_width)),),
            marks=(RoadMark(0.0, "broken" if i < lanes else "solid"),),
            speeds=((0.0, float(speed_limit)),),
            frictions=((0.0, float(friction)),),
        )
        for i in range(1, lanes + 1)
    )
    center = Lane(id=0, kind="none", marks=(RoadMark(0.0, "solid"),))
    road = Road(
        id="1",
        length=float(length),
        geometries=(Line(0.0, 0.0, 0.0, 0.0, float(length)),),
        sections=(LaneSection(0.0, (center, *right)),),
        name="straight",
        types=(RoadType(0.0, "motorway", float(speed_limit)),),
        elevations=(Cubic(0.0, 0.0, float(grade)),),
        lane_offsets=(Cubic(0.0, (lanes - 0.5) * lane_width),),
    )
    return OpenDriveMap(roads=(road,), name="straight")
