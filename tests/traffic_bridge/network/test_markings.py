"""Stop lines and crossings of a net are painted where vehicles stop and persons walk."""

import numpy as np
import pytest

from iits_mj.road import RoadMap
from tests.model.crossing import crossing
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


def test_a_road_without_junctions_has_no_paint_of_its_net():
    assert net_markings(RoadMap.builtin().route()) == Markings()
