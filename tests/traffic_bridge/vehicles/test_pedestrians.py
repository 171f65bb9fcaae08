"""Pedestrians of SUMO: they cross at crossings, and vehicles keep their lanes."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from iits_mj.core.boxes import UnitShape, unit_boxes
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap
from tests.model.crossing import crossing
from traffic_bridge import PureSim, TrafficConfig
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.walkways import LINE_GAP, read_crossings
from traffic_bridge.vehicles.pedestrians import (
    AWAY,
    CLOSE,
    FASTEST_BODY,
    SPEED_BOUNDS,
    kept_off,
    pedestrian_type,
    toward,
)

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


@pytest.mark.parametrize("truck", ["tractor_semitrailer_6x4", "rigid_drawbar", "b_double"])
@pytest.mark.parametrize("bend", [0.0, 0.5, -1.2])
def test_nobody_walks_into_a_truck_that_stands_bent(truck, bend):
    shapes = TruckParameters.load(truck).unit_shapes
    units = unit_boxes(0.0, 0.0, 0.0, (bend / (len(shapes) - 1),) * (len(shapes) - 1), shapes)
    rng, step = np.random.default_rng(4), 0.1 * FASTEST_BODY
    passed, room = 0, math.sqrt(0.5) * pedestrian_type().width
    for _ in range(30):
        begin, end = (rng.uniform([-20.0, -10.0], [5.0, 10.0]) for _ in range(2))
        body = tuple(begin.tolist())
        if min(gap(unit, body) for unit in units) < CLOSE:
            continue
        passed += any(
            gap(u, begin + t * (end - begin)) < 0.0 for t in np.arange(50) / 50 for u in units
        )
        for _ in range(150):
            place = kept_off(units, body, toward(body, end, step), stands=False)
            body = toward(body, place, step)
            assert min(gap(unit, body) for unit in units) > room
    assert passed > 3


def gap(unit, point):
    """Distance of a point from a unit [m], negative inside."""
    ahead, left = unit.place(*point)
    beside = abs(left) - 0.5 * unit.width
    along = max(ahead - unit.ahead, -unit.behind - ahead)
    return max(beside, along) if min(beside, along) < 0.0 else np.hypot(beside, along)


def test_a_person_who_stands_steps_back_from_the_side_but_not_from_the_front():
    (unit,) = unit_boxes(0.0, 0.0, 0.0, (), [UnitShape(0.0, 1.4, 10.0, 2.5)])
    assert kept_off([unit], (-3.0, 2.0), (-3.0, 2.0), stands=True) == (-3.0, 1.25 + AWAY)
    assert kept_off([unit], (5.0, 0.0), (5.0, 0.0), stands=True) == (5.0, 0.0)
    assert kept_off([unit], (2.5, 0.0), (2.1, 0.0), stands=False) == (1.4 + CLOSE, 0.0)


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
