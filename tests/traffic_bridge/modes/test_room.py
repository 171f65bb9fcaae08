"""Free space around the truck across the center line and at the road's end, and at entrances."""

import dataclasses
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.road import RoadMap, Route
from iits_mj.road.writer import write
from tests.traffic_bridge.merge_map import two_way_road
from tests.traffic_bridge.scripted_truck import ego_at, ego_box, overlap, vehicle_box
from traffic_bridge import Departure, InterSim, PureSim, SlowConvoy, TrafficConfig
from traffic_bridge.network.lane_table import LaneTable
from traffic_bridge.vehicles.ego_room import EgoRoom

both_models = pytest.mark.parametrize("lane_change", ["lc2013", "mobil"])
FRONT, LENGTH = 1.40, 16.5


@pytest.fixture(scope="module")
def two_way(tmp_path_factory):
    path = write(two_way_road(), tmp_path_factory.mktemp("maps") / "two_way.xodr")
    return RoadMap.from_opendrive(path).route()


def overlapping(vehicles):
    """Names of the pairs of vehicles whose boxes overlap."""
    boxes = [(v, vehicle_box(v)) for v in vehicles]
    return [
        (v.id, w.id)
        for i, (v, box) in enumerate(boxes)
        for w, other in boxes[:i]
        if math.hypot(v.x - w.x, v.y - w.y) < 20.0 and overlap(box, other)
    ]


def entrance_overlaps(lane_change, density, seed, seconds, length=2000.0):
    """Pairs of vehicles that overlap at some time on a straight road without a truck."""
    config = TrafficConfig(density=density, lane_change=lane_change, fill_ahead=length)
    pairs = set()
    with PureSim(Route.straight(length=length), config, seed=seed) as traffic:
        traffic.reset()
        for _ in range(round(seconds * 10)):
            pairs.update(overlapping([v for v in traffic.step() if v.station < 300.0]))
    return pairs


@pytest.mark.parametrize(("density", "seed"), [(0.1, 1), (0.1, 2), (0.1, 4), (0.2, 2), (0.2, 4)])
@both_models
def test_no_vehicle_enters_a_lane_that_another_one_is_still_leaving(lane_change, density, seed):
    assert not entrance_overlaps(lane_change, density, seed, 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("density", [0.1, 0.15, 0.2])
@both_models
def test_five_minutes_of_entering_traffic_without_an_overlap(lane_change, density, seed):
    assert not entrance_overlaps(lane_change, density, seed, 300.0)


def test_mobil_changes_lanes_after_the_entrance():
    lanes, changed = {}, 0
    config = TrafficConfig(density=0.1, lane_change="mobil", fill_ahead=0.0)
    with PureSim(Route.straight(length=800.0), config, seed=1) as traffic:
        traffic.reset()
        for _ in range(400):
            for v in traffic.step():
                changed += lanes.setdefault(v.id, v.lane) != v.lane
                lanes[v.id] = v.lane
    assert changed >= 3


def first_speeds(route, config, seconds=3.0):
    """First reported speed of each vehicle, and the speeds at the end."""
    first, last = {}, {}
    with PureSim(route, config, seed=1) as traffic:
        traffic.reset()
        for _ in range(round(seconds * 10)):
            for v in traffic.step():
                first.setdefault(v.id, v.speed)
                last[v.id] = v.speed
    return first, last


def test_a_departure_faster_than_the_limit_begins_at_the_limit_and_then_accelerates(highway):
    config = TrafficConfig(density="empty", departures=(Departure(time=1.0, speed=35.0),))
    first, last = first_speeds(highway, config, 20.0)
    assert len(first) == 1
    assert all(14.0 < speed < 16.0 for speed in first.values())
    assert all(21.0 < speed < 22.3 for speed in last.values())


def test_departures_and_convoys_keep_to_the_limit_of_a_town():
    convoy = SlowConvoy(at_time=1.0, station=60.0, speed=20.0, count=1, type="car")
    config = TrafficConfig(density="empty", departures=(Departure(time=1.0),), events=(convoy,))
    first, _ = first_speeds(Route.straight(length=500.0, speed_limit=13.89), config)
    assert len(first) == 2
    assert all(10.0 < speed <= 13.9 for speed in first.values())


@both_models
def test_oncoming_traffic_stops_before_a_truck_across_the_center_line(two_way, lane_change):
    route = two_way
    truck = ego_at(route, 0.0, 60.0, 0.0, -0.1)
    config = TrafficConfig(density=0.2, scope="both", lane_change=lane_change)
    standing, nearest = set(), math.inf
    with InterSim(route, config, seed=1) as traffic:
        traffic.reset(truck)
        for _ in range(300):
            for v in traffic.step(truck):
                if v.lane < 0 and v.station > 60.0:
                    assert not overlap(ego_box(truck), vehicle_box(v)), v
                    nearest = min(nearest, v.station - 0.5 * v.length - 60.0 - FRONT)
                    if v.speed < 0.01:
                        standing.add(v.id)
    assert len(standing) >= 3
    assert 1.0 < nearest < 6.0


def test_oncoming_traffic_passes_a_truck_that_has_returned_to_its_lane(two_way):
    route = two_way
    config = TrafficConfig(density=0.2, scope="both")
    passed = set()
    with InterSim(route, config, seed=1) as traffic:
        traffic.reset(ego_at(route, 0.0, 60.0, 0.0, -0.1))
        for step in range(400):
            truck = ego_at(route, 0.1 * step, 60.0, 0.0, -0.1 if step < 150 else -1.6)
            vehicles = traffic.step(truck)
            passed.update(v.id for v in vehicles if v.lane < 0 and v.station < 30.0 and step > 150)
    assert len(passed) >= 2


@pytest.mark.parametrize("scope", ["both", "map"])
def test_no_vehicle_begins_in_front_of_a_truck_across_the_center_line(two_way, scope):
    route = two_way
    truck = ego_at(route, 0.0, 200.0, 0.0, 0.5)
    for seed in range(4):
        with InterSim(route, TrafficConfig(density=0.5, scope=scope), seed=seed) as traffic:
            oncoming = [v for v in traffic.reset(truck) if v.lane < 0]
        assert oncoming
        for v in oncoming:
            assert not 200.0 - LENGTH < v.station < 230.0, v


def crossing_lane(length=200.0, spacing=5.0):
    """A lane of another road that runs northward and crosses the x axis at its middle."""
    count = round(length / spacing) + 1
    y = np.linspace(-0.5 * length, 0.5 * length, count)
    pose = np.zeros((7, count))
    pose[1], pose[3] = y, 0.5 * math.pi
    return LaneTable("a_0", "a", 0, -1, 0, length, spacing, np.zeros(count), y, pose)


def test_a_crossing_road_is_kept_free_before_the_truck_and_not_behind_it():
    axis = np.stack((np.linspace(-8.0, 8.5, 17), np.zeros(17)), axis=1)
    room = EgoRoom(8.5, 0, 0.0, axis, EgoFootprint(), traffic_speed=10.0)
    taken = {front: room.blocks(crossing_lane(), front, 4.7, 1.85) for front in range(10, 200, 10)}
    # The truck's side is at 98.7 m, 30 m before it are kept free, and a rear past it is allowed.
    assert [front for front, blocked in taken.items() if blocked] == [70, 80, 90, 100]


@both_models
def test_traffic_stops_behind_the_trailer_of_a_truck_whose_front_has_left_the_road(lane_change):
    route = Route.straight(length=1000.0, lanes=1)
    offset = float(route.lane_offset(0, 900.0))
    config = TrafficConfig(density=0.2, lane_change=lane_change)
    station, nearest, hardest = 940.0, math.inf, 0.0
    with InterSim(route, config, seed=1) as traffic:
        traffic.reset(ego_at(route, 0.0, station, 15.0, offset))
        for step in range(300):
            speed = 15.0 if station + FRONT < 1008.0 else 0.0
            station += 0.1 * speed
            truck = ego_at(route, 0.1 * step, station, speed, offset)
            for v in traffic.step(truck):
                assert not overlap(ego_box(truck), vehicle_box(v)), v
                if v.station < station:
                    gap = station + FRONT - LENGTH - v.station - 0.5 * v.length
                    nearest, hardest = min(nearest, gap), min(hardest, v.acceleration)
    assert 2.0 < nearest < 5.0
    assert hardest > -4.0


def test_a_truck_leaves_sumo_once_its_trailer_has_left_the_road():
    route = Route.straight(length=1000.0, lanes=1)
    offset = float(route.lane_offset(0, 900.0))
    with InterSim(route, TrafficConfig(density="empty"), seed=1) as traffic:
        traffic.reset(ego_at(route, 0.0, 960.0, 15.0, offset))
        for step in range(60):
            station = 960.0 + 1.5 * step
            traffic.step(ego_at(route, 0.1 * step, station, 15.0, offset))
            on_road = "ego" in traffic.session.api.vehicle.getIDList()
            assert on_road == (station + FRONT - LENGTH < 998.5)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"station": 1e9}, "ego.station = 1e"),
        ({"x": 161.0}, "ego.x = 161"),
        ({"y": -60.0}, "ego.y = -60"),
        ({"speed": None}, "ego.speed = None"),
        ({"yaw": "north"}, "ego.yaw = 'north'"),
    ],
)
def test_an_inconsistent_ego_state_is_refused_and_the_traffic_continues(changes, text):
    route = Route.straight(length=1000.0)
    good = ego_at(route, 0.0, 100.0, 10.0, 0.0)
    bad = dataclasses.replace(good, **changes)
    with InterSim(route, TrafficConfig(density="empty"), seed=1) as traffic:
        with pytest.raises(InputError, match=text):
            traffic.reset(bad)
        traffic.reset(good)
        with pytest.raises(InputError, match=text):
            traffic.step(bad)
        traffic.step(good)
        assert traffic.time == pytest.approx(0.1)


@pytest.mark.parametrize("ego", ["x", {}, 3.0])
def test_an_ego_of_another_type_is_refused(ego):
    with InterSim(Route.straight(length=1000.0), TrafficConfig(density="empty")) as traffic:
        with pytest.raises(InputError, match="must be an EgoState"):
            traffic.reset(ego)
        traffic.reset()
        with pytest.raises(InputError, match="must be an EgoState"):
            traffic.step(ego)


def test_a_follower_brakes_gently_for_a_truck_that_enters_its_lane_far_ahead():
    route, speed = Route.straight(3000.0), 15.0
    behind = Departure(time=0.0, type="car", lane=1, station=450.0, speed=speed)
    config = TrafficConfig(density="empty", speed_limit=20.0, departures=(behind,))

    def truck(time):
        station = 500.0 + speed * time
        right, left = (float(route.lane_offset(lane, station)) for lane in (0, 1))
        part = min(max((time - 3.0) / 4.0, 0.0), 1.0)
        return ego_at(route, time, station, speed, right + part * (left - right))

    with InterSim(route, config) as traffic:
        frames = [traffic.reset(truck(0.0))]
        frames += [traffic.step(truck(0.1 * k)) for k in range(1, 101)]
    # 35 m behind the trailer the Intelligent Driver Model asks for 0.7 m/s2 at most.
    hardest = min(vehicle.acceleration for frame in frames for vehicle in frame)
    assert -1.0 < hardest < -0.3


def test_in_traffic_of_a_level_vehicles_may_begin_beside_the_truck():
    axis = np.array([[60.0, 0.0], [80.0, 0.0]])
    room = EgoRoom(80.0, 0, 15.0, axis, EgoFootprint(), traffic_speed=15.0)
    beside = dataclasses.replace(room, beside=True)
    assert room.takes(75.0, 4.7, 1)
    assert not beside.takes(75.0, 4.7, 1)
    assert beside.takes(75.0, 4.7, 0)
    assert dataclasses.replace(beside, lane=-1).takes(75.0, 4.7, 1)
