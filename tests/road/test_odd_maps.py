"""Maps that peers drive although a part of them is odd: what is repaired, and what is left out."""

from __future__ import annotations

import re

import numpy as np
import pytest

from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from iits_mj.road.writer import to_xml
from tests.road.opendrive_text import LANES, LINE, document, line, road, successor
from tests.road.test_route import PROFILES, WIDE

STEP = '<elevation s="0" a="{}" b="0" c="0" d="0"/>'
PAIR = (road("1", link=successor("2")), road("2", geometry=line(100.0)))
ODD = {
    "kink": road(
        "9", line(0.0, 50.0) + line(100.0, 50.0, 1.0).replace('s="0"', 's="100"'), length=200
    ),
    "tight arc": road("9", line(0.0, 50.0).replace("<line/>", '<arc curvature="20"/>')),
    "no lanes": road("9", line(0.0, 50.0), lanes=""),
    "not a number": road("9", line(float("nan"))),
    "unknown unit": road(
        "9", line(0.0, 50.0), extra='<type s="0" type="town"><speed max="3" unit="knots"/></type>'
    ),
}


def read(text: str) -> RoadMap:
    return RoadMap(parse(text.encode(), "odd"), "odd")


def junction(*connections: str) -> str:
    return f'<junction id="8" type="direct">{"".join(connections)}</junction>'


def connection(incoming: str, linked: str, contact: str, *lanes: tuple[int, int]) -> str:
    links = "".join(f'<laneLink from="{a}" to="{b}"/>' for a, b in lanes)
    return (
        f'<connection id="0" incomingRoad="{incoming}" linkedRoad="{linked}" '
        f'contactPoint="{contact}">{links}</connection>'
    )


def at_junction(which: str) -> str:
    return f'<{which} elementType="junction" elementId="8"/>'


def lanes(right: int, left: int = 0) -> str:
    """Lanes of 3.5 m on both sides."""
    width = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
    sides = [
        f"<{side}>"
        + "".join(f'<lane id="{sign * i}" type="driving">{width}</lane>' for i in ids)
        + f"</{side}>"
        for side, sign, ids in (
            ("left", 1, range(left, 0, -1)),
            ("right", -1, range(1, right + 1)),
        )
        if ids
    ]
    center = '<center><lane id="0" type="none"/></center>'
    return f'<lanes><laneSection s="0">{center}{"".join(sides)}</laneSection></lanes>'


@pytest.mark.parametrize(
    "junction", ['<junction id="8" type="round"/>', '<junction id="8"><connection/></junction>']
)
def test_a_junction_that_cannot_be_read_is_left_out(junction):
    road_map = read(document(*PAIR, extra=junction))
    assert [note for note in road_map.notes if note.startswith("left out: junction '8'")]
    assert road_map.route().length == pytest.approx(200.0)


def test_a_sidewalk_without_a_width_has_none():
    bare = LANES.replace("</right>", '<lane id="-2" type="sidewalk"/></right>')
    road_map = read(document(road(lanes=bare)))
    assert "a width of 0 is taken" in road_map.notes[0]
    assert road_map.route().lane_width(0, 50.0) == pytest.approx(3.5)


def test_data_of_other_programs_in_a_geometry_is_not_its_shape():
    road_map = read(document(road(geometry=LINE.replace("<line/>", "<userData/><line/>"))))
    assert road_map.route().length == pytest.approx(100.0)


@pytest.mark.parametrize("name", ODD)
def test_an_odd_road_off_the_route_is_left_out_with_the_reason(name):
    road_map = read(document(*PAIR, ODD[name]))
    assert list(road_map.roads) == ["1", "2"]
    assert [note for note in road_map.notes if note.startswith("left out: road '9'")]
    assert road_map.route().length == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (road("2", geometry=line(130.0)), "30.0 m apart"),
        (road("2", geometry=line(100.0), elevation=STEP.format(9.0)), "height steps by 9.00 m"),
        (road("2", geometry=line(100.0, heading=1.0)), "heading steps by 57 degrees"),
    ],
    ids=["gap", "height", "kink"],
)
def test_a_link_that_no_vehicle_can_drive_is_not_driven(second, reason):
    road_map = read(document(road("1", link=successor("2")), second))
    assert [segment.road_id for segment in road_map.route().segments] == ["1"]
    assert any(note.startswith("not driven") and reason in note for note in road_map.notes)


@pytest.mark.parametrize("length", [0.0, 1e-7, 1e-5, 5e-4, 0.05])
def test_a_tiny_road_does_not_interrupt_the_route(length):
    route = read(
        document(
            road("1", link=successor("2")),
            road("2", line(100.0, length=length), length, successor("3")),
            road("3", line(100.0 + length)),
        )
    ).route()
    assert route.length == pytest.approx(200.0 + length, abs=1e-5)
    assert [segment.road_id for segment in route.segments][::2][:1] == ["1"]
    assert route.segments[-1].road_id == "3"
    assert float(route.evaluate(150.0).x) == pytest.approx(150.0, abs=1e-5)


@pytest.mark.parametrize(("given", "used"), [(5, 2.0), (0, 0.05)])
def test_friction_beyond_its_bounds_is_changed_with_a_note(given, used):
    material = f'<material sOffset="0" friction="{given}"/>'
    road_map = read(
        document(road(lanes=LANES.replace("</lane>\n</right>", f"{material}</lane></right>")))
    )
    assert road_map.route().friction(50.0, -1.0) == used
    assert any(f"friction {given} is changed to {used:g}" in note for note in road_map.notes)


def test_a_direct_junction_leads_from_lane_to_lane():
    road_map = read(
        document(
            road("1", link=at_junction("successor"), lanes=lanes(3)),
            road("2", line(100.0), link=at_junction("predecessor"), lanes=lanes(2)),
            road("3", line(100.0, -7.0, length=90.0), 90, at_junction("predecessor")),
            extra=junction(
                connection("1", "2", "start", (-1, -1), (-2, -2)),
                connection("1", "3", "start", (-3, -1)),
            ),
        )
    )
    assert [segment.road_id for segment in road_map.route().segments] == ["1", "2"]
    followers = road_map._graph.followers(("1", 1))
    assert followers == [("2", 1), ("3", 1)]


def test_a_direct_junction_is_driven_against_its_records():
    """A merge whose connections begin at the road after it."""
    road_map = read(
        document(
            road("1", link=at_junction("successor"), lanes=lanes(2)),
            road("2", line(100.0), link=at_junction("predecessor"), lanes=lanes(3)),
            road("3", line(10.0, -7.0, length=90.0), 90, at_junction("successor")),
            extra=junction(
                connection("2", "1", "end", (-1, -1), (-2, -2)),
                connection("2", "3", "end", (-3, -1)),
            ),
        )
    )
    assert [segment.road_id for segment in road_map.route("1").segments] == ["1", "2"]
    ramp = road_map.route("3")
    assert [segment.road_id for segment in ramp.segments] == ["3", "2"]
    # The ramp's lane is the outermost one of the road behind the merge.
    assert float(ramp.lane_offset(0, 80.0)) == pytest.approx(float(ramp.lane_offset(0, 100.0)))


def test_a_map_with_direct_junctions_survives_writing():
    text = document(
        road("1", link=at_junction("successor")),
        road("2", line(100.0), link=at_junction("predecessor")),
        extra=junction(connection("1", "2", "start", (-1, -1))),
    )
    content = parse(text.encode(), "odd")
    assert parse(to_xml(content).encode(), "odd") == content


def mirrored(text: str) -> str:
    """The same roads with left-hand traffic, seen in a mirror along the x axis."""

    def negated(match: re.Match[str]) -> str:
        return f'{match[1]}="{-float(match[2])!r}"'

    text = re.sub(r'\b(y|hdg|curvStart|curvEnd|curvature)="([^"]*)"', negated, text)
    text = re.sub(r'<lane id="(-?\d+)"', lambda m: f'<lane id="{-int(m[1])}"', text)
    text = re.sub(r"<(/?)(left|right)>", lambda m: f"<{m[1]}{_OTHER[m[2]]}>", text)
    for name in "abcd":
        text = re.sub(rf'(<(?:superelevation|laneOffset) [^>]*\b{name})="([^"]*)"', negated, text)
    return text.replace("<road ", '<road rule="LHT" ')


_OTHER = {"left": "right", "right": "left"}


def test_left_hand_traffic_is_the_mirror_image_of_right_hand_traffic():
    text = document(
        road(lanes=WIDE, **PROFILES), road("2", line(0.0, 99.0, 0.3), lanes=lanes(2, 1))
    )
    for start in ("1", "2", "2:-1"):
        right, left = read(text).route(start), read(mirrored(text)).route(start)
        assert left.road_map.left_hand
        assert not right.road_map.left_hand
        s = np.linspace(1.0, 99.0, 25)
        here, there = right.evaluate(s, 0.0), left.evaluate(s, 0.0)
        np.testing.assert_allclose(there.x, here.x, atol=1e-9)
        np.testing.assert_allclose(there.y, -here.y, atol=1e-9)
        for station in s.tolist():
            count = right.lane_count(station)
            assert left.lane_count(station) == count
            for lane in range(count):
                offset = float(right.lane_offset(lane, station))
                assert float(left.lane_offset(lane, station)) == pytest.approx(-offset)
                assert left.lane_at(station, -offset) == lane
                assert left.lane_width(lane, station) == pytest.approx(
                    right.lane_width(lane, station)
                )
            edges = right.surface_edges(station)
            mirror = left.surface_edges(station)
            assert (float(-mirror[1]), float(-mirror[0])) == pytest.approx(tuple(map(float, edges)))


def test_roads_that_differ_in_their_rule_are_driven_on_the_side_of_most():
    text = document(
        road("1", attributes='rule="LHT"'),
        road("2", line(0.0, 50.0), attributes='rule="LHT"'),
        road("3", line(0.0, 99.0)),
    )
    road_map = read(text)
    assert road_map.left_hand
    assert any("differ in their rule" in note for note in road_map.notes)


@pytest.mark.parametrize(
    ("branch", "reason"),
    [
        (road("2", line(100.0).replace("<line/>", '<arc curvature="-0.2"/>')), "radius of"),
        (road("2", line(100.0), elevation='<elevation s="0" a="0" b="0.4" c="0" d="0"/>'), "40 %"),
    ],
    ids=["tight", "steep"],
)
def test_the_route_avoids_roads_that_a_truck_cannot_drive(branch, reason):
    """The longest chain leads over road 2 and 4; the truck takes the shorter one over road 3."""
    junction_9 = (
        '<junction id="9"><connection id="0" incomingRoad="1" connectingRoad="2" '
        'contactPoint="start"/><connection id="1" incomingRoad="1" connectingRoad="3" '
        'contactPoint="start"/></junction>'
    )
    into = '<successor elementType="junction" elementId="9"/>'
    text = document(
        road("1", link=into), branch, road("3", line(100.0, length=60.0), 60), extra=junction_9
    )
    road_map = read(text)
    assert [segment.road_id for segment in road_map.route().segments] == ["1", "3"]
    assert any(reason in note for note in road_map.notes)
    # It has no choice where the other roads are too short, or the user asks for it.
    alone = read(document(branch, road("3", line(0.0, 90.0, length=40.0), 40)))
    assert [segment.road_id for segment in alone.route().segments] == ["2"]
    assert [segment.road_id for segment in road_map.route("2").segments] == ["2"]
