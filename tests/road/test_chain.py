from __future__ import annotations

import pytest

from iits_mj.core.errors import MapError
from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from tests.road.opendrive_text import LANES, document, line, road, successor


def road_map(*roads: str, extra: str = "") -> RoadMap:
    return RoadMap(parse(document(*roads, extra=extra).encode(), "test"), "test")


def names(route) -> list[tuple[str, int]]:
    return [(segment.road_id, segment.direction) for segment in route.segments]


def test_longest_chain_follows_links_through_roads():
    route = road_map(
        road("3", geometry=line(200.0)),
        road("1", link=successor("2")),
        road("2", geometry=line(100.0), link=successor("3")),
    ).route()
    assert names(route) == [("1", 1), ("2", 1), ("3", 1)]
    assert route.length == pytest.approx(300.0)


def test_chain_can_start_at_a_named_road():
    content = road_map(road("1", link=successor("2")), road("2", geometry=line(100.0)))
    assert names(content.route("2")) == [("2", 1)]
    with pytest.raises(MapError, match="there are 1:\\+1, 2:\\+1"):
        content.route("nowhere")


def test_roads_are_driven_backwards_on_their_left_lanes():
    left = LANES.replace("right>", "left>").replace('id="-1"', 'id="1"')
    back = '<successor elementType="road" elementId="2" contactPoint="end"/>'
    route = road_map(
        road("1", link=back), road("2", geometry=line(200.0, heading=3.141592653589793), lanes=left)
    ).route()
    assert names(route) == [("1", 1), ("2", -1)]
    point = route.evaluate(150.0)
    assert (point.x, point.y) == pytest.approx((150.0, 0.0), abs=1e-6)
    assert point.heading == pytest.approx(0.0, abs=1e-9)
    assert route.lane_offset(0, 150.0) == pytest.approx(-1.75)


def test_closed_loop_gives_one_lap():
    link = successor("1") + '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
    arc = '<arc curvature="0.06283185307179587"/>'
    circle = f'<geometry s="0" x="0" y="0" hdg="0" length="100">{arc}</geometry>'
    route = road_map(road("1", geometry=circle, link=link)).route()
    assert names(route) == [("1", 1)]
    assert route.length == pytest.approx(100.0)


def test_chain_through_a_cycle_drives_every_road_once():
    a, b = road("1", link=successor("2")), road("2", geometry=line(100.0), link=successor("1"))
    assert names(road_map(a, b).route()) == [("1", 1), ("2", 1)]


def test_link_to_a_missing_road_ends_the_chain():
    assert names(road_map(road("1", link=successor("99"))).route()) == [("1", 1)]


def test_chain_passes_a_junction_where_lanes_are_linked():
    into = '<successor elementType="junction" elementId="9"/>'
    before = '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
    junction = """<junction id="9"><connection id="0" incomingRoad="1" connectingRoad="5"
      contactPoint="start"><laneLink from="-1" to="-1"/></connection>
      <connection id="1" incomingRoad="1" connectingRoad="6" contactPoint="start">
      <laneLink from="-7" to="-1"/></connection></junction>"""
    route = road_map(
        road("1", link=into),
        road("5", geometry=line(100.0), link=before + successor("2"), attributes='junction="9"'),
        road("6", geometry=line(100.0), link=before, attributes='junction="9"'),
        road("2", geometry=line(200.0)),
        extra=junction,
    ).route()
    assert names(route) == [("1", 1), ("5", 1), ("2", 1)]


def test_a_large_grid_of_roads_is_searched_to_its_end():
    size = 12
    roads, junctions = [], []
    for i in range(size):
        into = f'<successor elementType="junction" elementId="j{i}"/>'
        roads.append(road(f"m{i}", geometry=line(200.0 * i), link=into))
        connections = ""
        for k in range(6):
            before = f'<predecessor elementType="road" elementId="m{i}" contactPoint="end"/>'
            name = f"c{i}_{k}"
            onward = before + successor(f"m{i + 1}")
            roads.append(road(name, geometry=line(200.0 * i + 100.0), link=onward))
            connections += (
                f'<connection id="{k}" incomingRoad="m{i}" connectingRoad="{name}" '
                'contactPoint="start"><laneLink from="-1" to="-1"/></connection>'
            )
        junctions.append(f'<junction id="j{i}">{connections}</junction>')
    route = road_map(*roads, extra="".join(junctions)).route()
    assert route.length == pytest.approx(200.0 * size)
