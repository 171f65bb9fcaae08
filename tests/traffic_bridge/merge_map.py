"""Maps made for tests: a highway with an on-ramp and ending lanes, a two-way road, and others."""

from __future__ import annotations

import math

from iits_mj.road import RoadMap
from iits_mj.road.elements import (
    Connection,
    Junction,
    Lane,
    LaneSection,
    Link,
    OpenDriveMap,
    Road,
    RoadType,
)
from iits_mj.road.geometry import Arc, Line
from iits_mj.road.polynomials import Cubic
from iits_mj.road.writer import write

WIDTH = 3.75
GRADE = 0.02
BANK = 0.02
LIMIT, RAMP_LIMIT = 25.0, 16.0
MEETING = 600.0  # x where the ramp meets the highway [m]
JOINING = 20.0  # length of the junction's roads [m]
SIDE = -3.0 * WIDTH  # y of the ramp's reference line where it meets the highway
TURN, BEND, STRAIGHT = 0.15, 100.0, 200.0  # of the ramp [rad], [m], [m]


def write_merge_map(path):
    """Writes the map and reads it back."""
    return RoadMap.from_opendrive(write(merge_map(), path))


def merge_map():
    """Road 1 (3 lanes) and ramp 5 meet in junction 100; road 2 has 4, then 3, then 2 lanes."""
    lift = (SIDE * math.tan(BANK), 0.0)
    return OpenDriveMap(
        roads=(
            road("1", MEETING, 0.0, (section(0.0, 3, ahead=3),), successor=Link("junction", "100")),
            road(
                "10", JOINING, MEETING, (section(0.0, 3, behind=3, ahead=3),), junction="100",
                predecessor=Link("road", "1", "end"), successor=Link("road", "2", "start"),
            ),
            road(
                "2", 1400.0, MEETING + JOINING,
                (
                    section(0.0, 4, behind=4, ahead=4),
                    section(250.0, 4, behind=4, ahead=3, closing=100.0),
                    section(350.0, 3, behind=3, ahead=2),
                    section(900.0, 2, behind=2),
                ),
                predecessor=Link("junction", "100"),
            ),
            ramp(),
            road(
                "11", JOINING, MEETING, (section(0.0, 1, behind=1, ahead=4, shift=3),), y=SIDE,
                junction="100", lift=lift, limit=RAMP_LIMIT,
                predecessor=Link("road", "5", "end"), successor=Link("road", "2", "start"),
            ),
        ),
        junctions=(
            Junction(
                "100",
                connections=(
                    Connection("1", "10", "start", ((-1, -1), (-2, -2), (-3, -3))),
                    Connection("5", "11", "start", ((-1, -1),)),
                ),
            ),
        ),
        name="merge",
    )  # fmt: skip


def ramp():
    """A road with one lane that joins the highway from the right."""
    radius = BEND / TURN
    x = MEETING - radius * math.sin(TURN)
    y = SIDE - radius * (1.0 - math.cos(TURN))
    x0, y0 = x - STRAIGHT * math.cos(TURN), y - STRAIGHT * math.sin(TURN)
    length = STRAIGHT + BEND
    height = GRADE * MEETING + SIDE * math.tan(BANK)
    return Road(
        id="5",
        length=length,
        geometries=(
            Line(0.0, x0, y0, TURN, STRAIGHT),
            Arc(STRAIGHT, x, y, TURN, BEND, -TURN / BEND),
        ),
        sections=(section(0.0, 1, ahead=1),),
        successor=Link("junction", "100"),
        types=(RoadType(0.0, "motorway", RAMP_LIMIT),),
        elevations=(Cubic(0.0, height - GRADE * length, GRADE),),
        superelevations=(Cubic(0.0, BANK),),
    )


def road(identity, length, x, sections, y=0.0, lift=(0.0, 0.0), limit=LIMIT, **more):
    """A straight road along x, uphill and banked; its type holds the limit, not its lanes."""
    return Road(
        id=identity,
        length=length,
        geometries=(Line(0.0, x, y, 0.0, length),),
        sections=sections,
        types=(RoadType(0.0, "motorway", limit),),
        elevations=(Cubic(0.0, GRADE * x + lift[0], GRADE),),
        superelevations=(Cubic(0.0, BANK),),
        **more,
    )


def section(s, count, behind=0, ahead=0, closing=0.0, shift=0):
    """Right lanes, linked by number to `behind` preceding and `ahead` following lanes."""
    lanes = [Lane(0, "none")]
    for number in range(1, count + 1):
        width = Cubic(0.0, WIDTH)
        if closing and number == count:
            width = Cubic(0.0, WIDTH, -WIDTH / closing)
        lanes.append(
            Lane(
                -number,
                "driving",
                (width,),
                predecessor=-number if number <= behind else None,
                successor=-number - shift if number + shift <= ahead else None,
            )
        )
    return LaneSection(s, tuple(lanes))


def dirty_map():
    """Three consecutive roads; the second overlaps the first and is shifted, raised and rotated."""
    first = road("1", 300.0, 0.0, (section(0.0, 2, ahead=2),), successor=Link("road", "2", "start"))
    second = Road(
        id="2",
        length=200.0,
        geometries=(Line(0.0, 299.5, 0.2, 0.01, 200.0),),
        sections=(section(0.0, 2, behind=2, ahead=2),),
        predecessor=Link("road", "1", "end"),
        successor=Link("road", "3", "start"),
        types=(RoadType(0.0, "motorway", LIMIT),),
        elevations=(Cubic(0.0, GRADE * 300.0 + 0.15),),
        superelevations=(Cubic(0.0, BANK),),
    )
    x, y = 299.5 + 200.0 * math.cos(0.01), 0.2 + 200.0 * math.sin(0.01)
    third = Road(
        id="3",
        length=300.0,
        geometries=(Line(0.0, x, y, 0.01, 300.0),),
        sections=(section(0.0, 2, behind=2),),
        predecessor=Link("road", "2", "end"),
        types=(RoadType(0.0, "motorway", LIMIT),),
        elevations=(Cubic(0.0, GRADE * 300.0 + 0.15, 0.03),),
    )
    return OpenDriveMap(roads=(first, second, third), name="dirty")


def two_way_road(length=400.0, limit=LIMIT):
    """A straight road with one lane in each direction."""
    width = (Cubic(0.0, 3.2),)
    lanes = (Lane(1, "driving", width), Lane(0, "none"), Lane(-1, "driving", width))
    return OpenDriveMap(
        roads=(
            Road(
                id="1",
                length=length,
                geometries=(Line(0.0, 0.0, 0.0, 0.0, length),),
                sections=(LaneSection(0.0, lanes),),
                types=(RoadType(0.0, "rural", limit),),
            ),
        ),
        name="two-way",
    )
