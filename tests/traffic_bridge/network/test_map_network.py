import math
from dataclasses import replace

import numpy as np
import pytest

from iits_mj.core.errors import Error, InputError, MapError, TrafficError
from iits_mj.road import RoadMap, Route
from iits_mj.road.elements import OpenDriveMap, RoadType
from iits_mj.road.writer import to_xml, write
from tests.traffic_bridge.esmini_maps import MAPS, esmini
from tests.traffic_bridge.merge_map import (
    BANK,
    GRADE,
    SIDE,
    WIDTH,
    dirty_map,
    merge_map,
    write_merge_map,
)
from traffic_bridge import MapNetwork
from traffic_bridge.network.net_file import NetFile


@pytest.fixture(scope="module")
def merge(tmp_path_factory):
    return MapNetwork.of(write_merge_map(tmp_path_factory.mktemp("maps") / "merge.xodr"))


@pytest.fixture(scope="module")
def town():
    return MapNetwork.of(esmini("fabriksgatan_traffic_lights"))


def driving(network):
    return [lane for lane in network.lanes.values() if lane.driving and lane.length > 1.0]


def assert_round_trips(network, count):
    rng = np.random.default_rng(0)
    lanes = driving(network)
    for _ in range(count):
        lane = lanes[rng.integers(len(lanes))]
        position = float(rng.uniform(0.5, lane.length - 0.5))
        place = network.place_on(lane.id, position, float(rng.uniform(-1.0, 1.0)))
        point = network.point(place)
        found = network.locate(point.x, point.y, point.heading, point.z)
        assert (found.road, found.lane, found.sumo_lane) == (place.road, place.lane, lane.id)
        assert found.position == pytest.approx(position, abs=1e-3)
        assert found.offset == pytest.approx(place.offset, abs=1e-9)
        assert network.point(found) == pytest.approx(point, abs=1e-9)


def assert_continuous(network):
    """Each lane begins at the end of the preceding lane, in every coordinate."""
    surfaces = {name: network.surface(name, 5.0) for name in network.lanes}
    assert network.connections or len(network.entrances) == len(network.exits)
    for link in network.connections:
        before, after = surfaces[link.start], surfaces[link.via or link.end]
        for name in ("x", "y", "z", "grade", "bank"):
            assert getattr(after, name)[0] == pytest.approx(getattr(before, name)[-1], abs=1e-9)
        turn = math.remainder(after.heading[0] - before.heading[-1], 2.0 * math.pi)
        assert abs(turn) < 1e-9


@pytest.mark.parametrize("name", MAPS)
def test_places_of_a_foreign_map_convert_to_points_and_back(name):
    network = MapNetwork.of(esmini(name))
    assert_round_trips(network, 40)
    assert_continuous(network)


def test_places_of_a_merge_convert_to_points_and_back(merge):
    assert_round_trips(merge, 80)
    assert_continuous(merge)


def test_lanes_of_the_highway_agree_with_its_route(highway):
    network = MapNetwork.of(highway.road_map)
    assert_round_trips(network, 40)
    for lane in driving(network)[::5]:
        if lane.internal:
            continue
        surface = network.surface(lane.id, 50.0)
        for k in (0, len(surface.x) // 2, -1):
            station, offset = highway.locate(surface.x[k], surface.y[k])
            index = highway.lane_at(station, offset)
            # Where a lane opens or closes, SUMO's lane ends in its taper.
            assert index >= 0
            assert offset == pytest.approx(highway.lane_offset(index, station), abs=0.02)
            truth = highway.evaluate(station, offset)
            assert surface.z[k] == pytest.approx(float(truth.z), abs=0.01)
            assert surface.bank[k] == pytest.approx(float(truth.superelevation), abs=1e-3)


def test_surface_of_a_lane_off_the_route_follows_its_own_road(merge):
    surface = merge.surface("-5_0", 2.0)
    assert np.allclose(np.diff(surface.position), surface.position[1])
    assert np.all(np.hypot(np.diff(surface.x), np.diff(surface.y)) > 0.0)
    assert np.allclose(surface.grade, GRADE, atol=1e-3)
    assert np.allclose(surface.bank, BANK)
    assert surface.heading[0] == pytest.approx(0.15)
    # The ramp climbs to the highway's height at the lane that continues it.
    inside = merge.surface(":100_0_0", 1.0)
    y = SIDE - 0.5 * WIDTH
    assert inside.y[-1] == pytest.approx(y, abs=1e-6)
    assert inside.z[-1] == pytest.approx(GRADE * inside.x[-1] + y * math.tan(BANK), abs=1e-6)


def test_grade_of_an_oncoming_lane_has_the_opposite_sign():
    network = MapNetwork.of(esmini("curves_elevation"))
    along, against = network.surface("-1_0", 1.0), network.surface("1_0", 1.0)
    assert np.allclose(along.grade, -against.grade[::-1][: along.grade.size], atol=0.02)
    turn = np.cos(along.heading[0] - against.heading[-1])
    assert turn == pytest.approx(-1.0, abs=1e-3)


def test_each_of_two_roads_takes_half_of_the_step_between_them(tmp_path):
    network = MapNetwork.of(RoadMap.from_opendrive(write(dirty_map(), tmp_path / "dirty.xodr")))
    assert_continuous(network)
    lanes = ("-1_0", "-2_0", "-3_0")
    surfaces = [network.surface(lane, 1.0) for lane in lanes]
    joined = [np.concatenate([getattr(s, name) for s in surfaces]) for name in ("x", "y", "z")]
    x, y, z = joined
    way = np.hypot(np.diff(x), np.diff(y))
    # Overlaps are distributed along the lanes, without jumps.
    assert np.all(way < 1.1)
    assert np.all(np.abs(np.diff(z)) < 0.05)
    assert np.all(np.abs(np.diff(np.concatenate([s.heading for s in surfaces]))) < 0.012)
    for surface, road in zip(surfaces, ("1", "2", "3"), strict=True):
        k = surface.x.size // 2
        place = network.locate(surface.x[k], surface.y[k], surface.heading[k])
        assert place.road == road
        assert network.point(place).z == pytest.approx(surface.z[k], abs=1e-9)
        path = np.arctan2(np.diff(surface.y), np.diff(surface.x))
        middle = 0.5 * (surface.heading[1:] + surface.heading[:-1])
        # At the ends each lane takes half of the turn of 0.01 rad.
        assert np.all(np.abs(path - middle) < 0.006)
    step = 0.5 * (0.15 - 0.2 * math.tan(BANK))
    assert surfaces[0].z[-1] - GRADE * 300.0 + 1.5 * WIDTH * math.tan(BANK) == pytest.approx(
        step, abs=0.02
    )


def test_cross_slopes_are_scaled_as_on_the_route():
    network = MapNetwork.of(esmini("velodrome"))
    route = network.road_map.route()
    surface = network.surface("-1#0_1", 10.0)
    for k in range(0, surface.x.size, 10):
        station, offset = route.locate(surface.x[k], surface.y[k])
        assert surface.z[k] == pytest.approx(float(route.evaluate(station, offset).z), abs=0.01)


def test_a_point_off_the_road_has_no_place(merge):
    assert merge.locate(300.0, 500.0) is None
    assert merge.locate(-50.0, -2.0) is None
    with pytest.raises(InputError, match="finite"):
        merge.locate(math.nan, 0.0)


def test_heading_decides_between_overlapping_roads(town):
    for lane in driving(town):
        if not lane.internal or lane.length < 5.0:
            continue
        surface = town.surface(lane.id, 1.0)
        k = surface.x.size // 2
        found = town.locate(surface.x[k], surface.y[k], surface.heading[k])
        assert found.road == lane.road
        assert found.junction == "4"


def test_paths_through_a_town_turn_at_its_light(town):
    assert set(town.entrances) == {"-2", "-3", "0", "1"}
    assert set(town.exits) == {"-0", "-1", "2", "3"}
    routes = town.routes()
    assert len(routes) == 12
    for path in routes:
        lengths = [next(lane.length for lane in town.lanes.values() if lane.edge == edge)
                   for edge in path.edges]  # fmt: skip
        assert path.length > sum(lengths)
        assert path.time > path.length / 14.0
    assert town.path("-2", "3").edges == ("-2", "3")
    lights = [link for link in town.connections if link.light]
    assert len(lights) == 12
    assert {link.turn for link in lights} == {"s", "l", "r"}
    (light,) = town.lights
    assert {light.phases[0][1][link.link] for link in lights} >= {"r"}
    node = town.junctions["4"]
    assert node.kind == "traffic_light"
    assert town.locate(node.x, node.y).junction == "4"
    assert town.roads["5"].junction == "4"
    assert town.roads["2"].edges == ("-2", "2")
    assert town.reachable("-2") == {"-2", "3", "-0", "-1"}


def test_the_quickest_path_is_found_and_a_missing_path_is_reported(merge):
    assert merge.entrances == ("-1", "-5")
    ramp = merge.path("-5", merge.exits[0])
    assert ramp.edges[:2] == ("-5", "-2#0")
    assert ramp.length == pytest.approx(300.0 + 20.0 + 1400.0, abs=3.0)
    with pytest.raises(InputError, match="no way from edge '-5' to edge '-1'"):
        merge.path("-5", "-1")
    with pytest.raises(InputError, match="no edge '-7'"):
        merge.reachable("-7")


def test_the_limit_of_a_road_holds_on_all_its_lanes(merge):
    for lane in driving(merge):
        if not lane.internal:
            assert lane.speed == (16.0 if lane.road == "5" else 25.0)


def test_a_limit_that_changes_along_a_road_splits_its_lanes(tmp_path):
    (road,) = Route.straight(length=1000.0).road_map.content.roads
    (section,) = road.sections
    lanes = tuple(replace(lane, speeds=()) for lane in section.lanes)
    types = (RoadType(0.0, "motorway", math.inf), RoadType(400.0, "motorway", 20.0))
    changed = replace(road, sections=(replace(section, lanes=lanes),), types=types)
    path = write(OpenDriveMap(roads=(changed,)), tmp_path / "map.xodr")
    network = MapNetwork.of(RoadMap.from_opendrive(path))
    limits = {(lane.begin < 395.0, lane.speed) for lane in driving(network) if not lane.internal}
    # SUMO needs a limit: 70 m/s stands for no limit.
    assert limits == {(True, 70.0), (False, 20.0)}
    assert network.place("1", -1, 405.0).sumo_lane != network.place("1", -1, 390.0).sumo_lane


def test_a_closing_lane_is_closed_to_traffic_where_it_is_narrow(merge):
    closing = [lane for lane in merge.lanes.values() if lane.road == "2" and lane.lane == -4]
    for lane in closing:
        surface = merge.surface(lane.id, 1.0)
        width = np.clip(WIDTH * (350.0 - (surface.x - 620.0)) / 100.0, 0.0, WIDTH)
        assert lane.driving == (width.min() > 1.8)
    assert sum(not lane.driving for lane in closing) == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda n: n.surface("none"), "no lane 'none'"),
        (lambda n: n.surface("-1_0", 0.0), "spacing"),
        (lambda n: n.place("9", -1, 0.0), "no road '9'"),
        (lambda n: n.place("1", -4, 10.0), "no lane -4"),
        (lambda n: n.place("1", -1, 700.0), "0 to 600"),
        (lambda n: n.place("1", -1, math.nan), "nan"),
        (lambda n: n.place("1", -1, 1.0, math.inf), "finite"),
        (lambda n: n.place_on("-1_0", 999.0), "position"),
        (lambda n: n.path(n.locate(0.0, 900.0), "-1"), "beside every road"),
        (lambda n: MapNetwork.of("map.xodr"), "not of 'map.xodr'"),
        (lambda n: n.path(n.place("10", -1, 5.0), "-1"), "no edge of its own"),
    ],
)
def test_a_wrong_query_gives_one_clear_error(merge, call, message):
    with pytest.raises(InputError, match=message):
        call(merge)


def test_a_net_of_another_map_is_refused(merge, highway):
    with pytest.raises(TrafficError, match="another map"):
        MapNetwork(highway.road_map, merge.net)
    with pytest.raises(Error, match="not a SUMO network"):
        MapNetwork(highway.road_map, NetFile.read(merge.road_map.path))


def test_a_road_made_in_memory_has_a_network(straight):
    network = MapNetwork.of(straight.road_map)
    place = network.locate(1000.0, 0.0)
    assert (place.road, place.lane, place.edge) == ("1", -3, "-1")
    assert MapNetwork.of(Route.straight(length=4000.0).road_map).net.path == network.net.path


def test_a_changed_map_file_is_refused_until_it_is_read_again(tmp_path):
    path = tmp_path / "map.xodr"
    first = write_merge_map(path)
    net = MapNetwork.of(first).net
    path.write_text(to_xml(merge_map()).replace('max="25.0"', 'max="20.0"'))
    with pytest.raises(MapError, match="changed"):
        MapNetwork.of(first)
    second = MapNetwork.of(RoadMap.from_opendrive(path))
    assert second.net.path != net.path
    assert second.lanes["-1_0"].speed == 20.0
