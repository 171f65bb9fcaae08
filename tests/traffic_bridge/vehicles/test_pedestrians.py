"""Pedestrians of SUMO: they cross at crossings, and vehicles keep their lanes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from tests.model.crossing import crossing
from traffic_bridge import PureSim, TrafficConfig
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.walkways import LINE_GAP, read_crossings
from traffic_bridge.vehicles.pedestrians import FASTEST_BODY, SPEED_BOUNDS

CONFIG = TrafficConfig(density="dense", scope="map", speed_limit=12.5, pedestrians=400.0)


@pytest.fixture(scope="module")
def road_map(tmp_path_factory):
    path = tmp_path_factory.mktemp("crossing") / "crossing.xodr"
    path.write_text(crossing())
    return RoadMap.from_opendrive(path)


def walk(route, seconds, config=CONFIG, seed=2):
    with PureSim(route, config, seed=seed) as traffic:
        yield traffic.reset()
        for _ in range(round(10 * seconds)):
            yield traffic.step()


def test_walkways_move_no_lane_of_vehicles(road_map):
    plain, walked = (build_network(road_map, walkways=flag) for flag in (False, True))
    shapes = [
        {lane.origin: lane.shape for lane in net.lanes.values() if not lane.internal}
        for net in (plain, walked)
    ]
    assert shapes[0].keys() == shapes[1].keys()
    for origin, shape in shapes[0].items():
        assert np.array_equal(shape, shapes[1][origin])
    for net in (plain, walked):
        for link in net.connections:
            end, begin = net.lanes[link.start].shape[-1], net.lanes[link.via or link.end].shape[0]
            assert np.hypot(*(end - begin)) < 0.02


def test_stop_lines_lie_before_the_crossings(road_map):
    net = build_network(road_map, walkways=True)
    found = read_crossings(net.path, road_map.roads)
    assert len(found) == 4
    for lane in net.lanes.values():
        ways = [c for c in found if lane.edge in c.edges and lane.id in net.links]
        if lane.internal or not ways:
            continue
        course = lane.shape[-1] - lane.shape[-2]
        course /= np.hypot(*course)
        nearest = ((ways[0].outline - lane.shape[-1]) @ course).min()
        assert -lane.stop_offset <= nearest - LINE_GAP + 0.01


def test_persons_cross_the_road_and_do_not_jump(road_map):
    crossed, before, speeds = set(), {}, []
    for frame in walk(road_map.route(), 60.0):
        for row in frame:
            if row.kind != "pedestrian":
                continue
            if row.lane >= 0 and abs(row.station - 100.0) < 60.0:
                crossed.add(row.id)
            if row.id in before:
                away = np.hypot(row.x - before[row.id][0], row.y - before[row.id][1])
                assert away <= 0.1 * FASTEST_BODY + 1e-9
                speeds.append(10.0 * away)
            before[row.id] = row.x, row.y
    assert len(crossed) >= 3
    moving = [speed for speed in speeds if speed > 0.3]
    assert SPEED_BOUNDS[0] < np.median(moving) < SPEED_BOUNDS[1]


def test_one_seed_gives_one_walk(road_map):
    route = road_map.route()
    pairs = zip(walk(route, 15.0), list(walk(route, 15.0)), strict=True)
    assert all(one == other for one, other in itertools.islice(pairs, 151))


def test_flow_is_that_asked(road_map):
    names = {name for frame in walk(road_map.route(), 120.0) for name in frame.ids}
    count = sum(name.startswith("pedestrian") for name in names)
    asked = 4 * CONFIG.pedestrians * 120.0 / 3600.0
    assert abs(count - asked) < 3.0 * np.sqrt(asked)


def test_cyclists_ride_in_the_traffic(road_map):
    config = TrafficConfig(density=0.1, scope="map", speed_limit=12.5, bicycles=0.5)
    rows = [r for frame in walk(road_map.route(), 40.0, config) for r in frame]
    cyclists = {row.id for row in rows if row.kind == "bicycle"}
    assert cyclists
    assert max(row.speed for row in rows if row.kind == "bicycle") <= 5.56 + 0.01
    assert TrafficConfig.from_dict(config.as_dict()) == config


def test_a_road_without_sidewalks_has_no_pedestrians():
    with (
        PureSim(RoadMap.builtin().route(), TrafficConfig(pedestrians=10.0)) as traffic,
        pytest.raises(InputError, match=r"pedestrians need sidewalks: .*highway"),
    ):
        traffic.reset()


@pytest.mark.parametrize("value", [-1.0, 1e9, float("nan"), "many"])
def test_impossible_flows_are_refused(value):
    with pytest.raises(InputError, match="pedestrians"):
        TrafficConfig(pedestrians=value)
