"""Stop lines and crossings of a net are painted where vehicles stop and persons walk."""

from xml.etree import ElementTree

import numpy as np
import pytest

from iits_mj.road import RoadMap
from tests.model.crossing import HALF, crossing
from tests.paths import outside
from tests.traffic_bridge.esmini_maps import esmini
from traffic_bridge.network.markings import WIDTH, Markings, net_markings
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.stop_lines import lines_of_map
from traffic_bridge.network.walkways import read_crossings


@pytest.fixture(scope="module")
def village(tmp_path_factory):
    path = tmp_path_factory.mktemp("crossing") / "crossing.xodr"
    path.write_text(crossing())
    return RoadMap.from_opendrive(path).route()


def test_a_line_lies_across_its_lane_where_vehicles_stop():
    route = esmini("fabriksgatan_traffic_lights").route()
    net, found = build_network(route), net_markings(route)
    assert len(found.stop_lines) == 4
    assert not found.yield_lines
    lane = next(lane for lane in net.lanes.values() if lane.id == "-2_0")
    share = (lane.length - lane.stop_offset) / lane.length
    along = np.hypot(*np.diff(lane.shape, axis=0).T).cumsum()
    place = [np.interp(share * along[-1], [0.0, *along], lane.shape[:, k]) for k in (0, 1)]
    near = min(
        found.stop_lines,
        key=lambda corners: np.hypot(*(corners[:, :2].mean(axis=0) + net.offset - place)),
    )
    sides = np.linalg.norm(np.roll(near, -1, axis=0) - near, axis=1)
    assert sides == pytest.approx([lane.width, WIDTH, lane.width, WIDTH], abs=0.05)
    assert near[:2, :2].mean(axis=0) + net.offset == pytest.approx(place, abs=0.1)


def test_only_lanes_that_give_way_have_a_line_without_lights():
    route = RoadMap.from_opendrive(outside("xosc/xodr/fabriksgatan.xodr")).route()
    net, found = build_network(route), net_markings(route)
    give = {
        link.start
        for link in net.connections
        if not link.start.startswith(":")
        and all(other.yields for other in net.connections if other.start == link.start)
    }
    assert 0 < len(give) < 4
    assert len(found.yield_lines) == len(give)
    assert not found.stop_lines


def test_a_line_of_the_map_is_not_painted_twice():
    route = RoadMap.from_opendrive(outside("xosc/xodr/multi_intersections.xodr")).route()
    net, found = build_network(route), net_markings(route)
    lit = {link.start for link in net.connections if link.light and ":" not in link.start}
    own = {name for name in lit if lines_of_map(net, net.lanes[name], route.road_map.roads)[0]}
    assert own
    assert len(found.stop_lines) == len(lit - own)


def test_crossings_are_painted_for_people_only_and_lie_on_the_road(village):
    assert not net_markings(village).crossings
    found = net_markings(village, walkways=True).crossings
    net = build_network(village, walkways=True)
    assert len(found) == len(read_crossings(net.path, village.road_map.roads)) == 4
    for outline in found:
        assert outline[:, 2] == pytest.approx(0.0, abs=0.01)
        middle = outline[:, :2].mean(axis=0)
        apart = [np.hypot(*(other[:, :2].mean(axis=0) - middle)) for other in found]
        assert sorted(apart)[1] > 5.0


def test_persons_cross_where_the_map_paints_a_crossing(tmp_path):
    path = tmp_path / "painted.xodr"
    paint = '<object id="1" type="crosswalk" s="6" t="0" length="3" width="7"/>'
    path.write_text(crossing(f"<objects>{paint}</objects>"))
    road_map = RoadMap.from_opendrive(path)
    assert len(net_markings(road_map.route(), walkways=True).crossings) == 3
    net = build_network(road_map, walkways=True)
    ways = {c.roads: c for c in read_crossings(net.path, road_map.roads)}
    moved = ways[frozenset("0")]
    assert moved.axis.mean(axis=0) - net.offset == pytest.approx([HALF + 6.0, 0.0], abs=0.3)
    assert moved.outline.mean(axis=0) - net.offset == pytest.approx([HALF + 6.0, 0.0], abs=0.3)
    # Persons do not walk past the crossing and back.
    ends = [s.edge for side in moved.sides for s in side if s.edge.lstrip("-") == "0"]
    assert len(ends) == 2
    lanes = ElementTree.parse(net.path).getroot().iter("lane")
    shapes = {lane.get("id"): lane.get("shape").split() for lane in lanes}
    for edge in ends:
        along = [float(point.split(",")[0]) - net.offset[0] for point in shapes[f"{edge}_0"]]
        assert min(along) == pytest.approx(HALF + 6.0 + 2.0, abs=0.3)  # half of SUMO's width
    # Vehicles stop before the crossing; those of the other arms before theirs.
    stops = {name: lane.stop_offset for name, lane in net.lanes.items() if lane.stop_offset > 0.0}
    assert len(stops) == 4
    entry = next(name for name in stops if net.lanes[name].origin[0] == "0")
    assert stops[entry] > max(8.0, *(stops[name] for name in stops.keys() - {entry}))


def test_no_light_stands_where_two_roads_meet_with_walkways():
    road_map = RoadMap.from_opendrive(outside("xosc/xodr/multi_intersections.xodr"))
    net = build_network(road_map, walkways=True)
    assert len(net.lights) == 5
    root = ElementTree.parse(net.path).getroot()
    node = root.find("junction[@id='202#1']")
    assert node.get("type") == "priority"
    rows = {row.get("index"): row for row in node.findall("request")}
    # Of three ways of vehicles and a crossing, persons give way.
    assert {row.get("response") for index, row in rows.items() if index != "3"} == {"0000"}
    assert rows["3"].get("response") == rows["3"].get("foes") == "0111"


def test_a_road_without_junctions_has_no_paint_of_its_net():
    assert net_markings(RoadMap.builtin().route()) == Markings()
