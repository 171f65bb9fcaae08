import itertools
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from tests.traffic_bridge.esmini_maps import MAPS, esmini
from tests.traffic_bridge.merge_map import LIMIT, write_merge_map
from tests.traffic_bridge.scripted_truck import ego_at, ego_box, overlap, vehicle_box
from traffic_bridge import InterSim, MapNetwork, PureSim, TrafficConfig
from traffic_bridge.session import load_libsumo

STEP = 0.1


@pytest.fixture(scope="module")
def merge(tmp_path_factory):
    return write_merge_map(tmp_path_factory.mktemp("maps") / "merge.xodr")


def config(**more):
    return TrafficConfig(density=0.08, scope="map", **more)


class Watch:
    """Asserts that no vehicle collides, jumps, or leaves the road or its surface."""

    def __init__(self, road_map):
        self._network = MapNetwork.of(road_map)
        self._collisions = load_libsumo().simulation.getCollisions
        self._before, self._place = {}, np.empty((0, 3))
        self.seen = {}

    def look(self, frame, check_places):
        assert not self._collisions()
        assert np.all(np.isfinite(frame.values))
        now = {name: k for k, name in enumerate(frame.ids)}
        both = [name for name in now if name in self._before]
        k = [now[name] for name in both]
        step = np.array([frame.values[i, :3] - self._place[self._before[name]]
                         for i, name in zip(k, both, strict=True)]).reshape(-1, 3)  # fmt: skip
        moved = np.hypot(step[:, 0], step[:, 1])
        # SUMO moves by the new speed, boxes turn about their centers, and lanes are not exact.
        assert np.all(np.abs(moved - STEP * frame.column("speed")[k]) < 0.2)
        assert np.all(np.abs(step[:, 2]) <= 0.2 * moved + 0.01)
        self._before, self._place = now, frame.values[:, :3]
        for vehicle in frame if check_places else ():
            place = self._network.locate(vehicle.x, vehicle.y, vehicle.yaw, vehicle.z)
            assert place is not None, vehicle
            assert self._network.point(place).z == pytest.approx(vehicle.z, abs=0.03)
            self.seen.setdefault(vehicle.id, []).append(place)


def drive(road_map, seconds, settings, seed=1, speed=8.0):
    """Runs InterSim with a truck that follows its route; returns the places of all vehicles."""
    route = road_map.route()
    watch = Watch(road_map)
    station = min(60.0, 0.3 * route.length)
    offset = route.lane_offset(0, station)
    with InterSim(route, settings, seed=seed) as traffic:
        watch.look(traffic.reset(ego_at(route, 0.0, station, speed, offset)), True)
        for k in range(round(seconds / STEP)):
            station = min(station + speed * STEP, route.length - 30.0)
            moving = speed if station < route.length - 30.0 else 0.0
            offset = route.lane_offset(0, station)
            ego = ego_at(route, (k + 1) * STEP, station, moving, offset)
            watch.look(traffic.step(ego), k % 10 == 0)
    return watch


def road_order(places):
    """Roads of a vehicle in the order of its drive."""
    roads = [place.road for place in places]
    return tuple(road for k, road in enumerate(roads) if k == 0 or road != roads[k - 1])


@pytest.mark.parametrize("name", MAPS)
def test_traffic_of_a_whole_map_stays_on_its_roads(name):
    assert drive(esmini(name), 15.0, config()).seen


@pytest.mark.slow
@pytest.mark.parametrize("model", ["lc2013", "mobil"])
@pytest.mark.parametrize("name", MAPS)
def test_traffic_of_a_whole_map_stays_on_its_roads_for_two_minutes(name, model):
    assert drive(esmini(name), 120.0, config(lane_change=model)).seen


def assert_no_overlap(frame):
    """No two vehicles of a frame overlap."""
    for a, b in itertools.combinations(frame, 2):
        if math.dist((a.x, a.y), (b.x, b.y)) < 0.5 * (a.length + b.length) + 1.0:
            assert not overlap(vehicle_box(a), vehicle_box(b)), (a, b)


def watch_all(road_map, seconds, settings, seed=1, touch=False):
    """Runs PureSim and returns the places of all vehicles; `touch` also checks for overlaps."""
    watch = Watch(road_map)
    with PureSim(road_map.route(), settings, seed=seed) as traffic:
        watch.look(traffic.reset(), True)
        for k in range(round(seconds / STEP)):
            frame = traffic.step()
            watch.look(frame, k % 20 == 0)
            if touch and k % 3 == 0:
                assert_no_overlap(frame)
    return watch


@pytest.mark.parametrize("model", ["lc2013", "mobil"])
def test_traffic_of_the_ramp_merges_before_its_lane_ends(merge, model):
    settings = TrafficConfig(density=0.2, scope="map", lane_change=model)
    seen = watch_all(merge, 60.0, settings).seen
    merged = 0
    for places in seen.values():
        on_lane = [place for place in places if place.road == "2" and place.lane == -4]
        # No vehicle drives where the lane is too narrow.
        assert all(place.station < 310.0 for place in on_lane)
        merged += places[0].road == "5" and places[-1].station > 360.0 and places[-1].road == "2"
    assert merged >= 3


def test_traffic_turns_at_a_junction_in_every_direction():
    town = esmini("fabriksgatan_traffic_lights")
    ways = set()
    # Cars only: in the bends of this junction a truck is wider than its lane.
    seen = watch_all(town, 200.0, config(mix={"car": 1.0}), touch=True).seen
    for places in seen.values():
        arms = [road for road in road_order(places) if int(road) < 4]
        if len(arms) == 2:
            ways.add(tuple(arms))
    assert len(ways) >= 7
    assert all(start != end for start, end in ways)
    assert {start for start, _ in ways} == {"0", "1", "2", "3"}


def test_traffic_does_not_touch_a_truck_stopped_in_a_junction():
    town = esmini("fabriksgatan_traffic_lights")
    route = town.route()
    station, speed = 70.0, 8.0
    with InterSim(route, config(mix={"car": 1.0}), seed=1) as traffic:
        traffic.reset(ego_at(route, 0.0, station, speed, route.lane_offset(0, station)))
        waiting = 0
        for k in range(500):
            speed = 8.0 if station < 123.0 else 0.0
            station += speed * STEP
            ego = ego_at(route, (k + 1) * STEP, station, speed, route.lane_offset(0, station))
            frame = traffic.step(ego)
            near = [v for v in frame if math.dist((v.x, v.y), (ego.x, ego.y)) < 25.0]
            assert not any(overlap(ego_box(ego), vehicle_box(v)) for v in near)
            waiting = sum(v.speed < 0.1 for v in frame)
    place = MapNetwork.of(town).locate(ego.x, ego.y, ego.yaw)
    assert place.junction == "4"
    assert waiting >= 2


def test_a_map_has_the_vehicles_that_the_density_asks_for(merge):
    settings = TrafficConfig(density="C", scope="map", speed_limit=20.0)
    lanes = [
        lane for lane in MapNetwork.of(merge).lanes.values() if lane.driving and not lane.internal
    ]
    asked = settings.steady.density * sum(lane.length for lane in lanes)
    with PureSim(merge.route(), settings, seed=2) as traffic:
        assert len(traffic.reset()) == pytest.approx(asked, rel=0.1)
        counts = [len(traffic.step()) for _ in range(400)]
    assert np.mean(counts) == pytest.approx(asked, rel=0.1)


def test_vehicles_begin_on_every_road_and_keep_its_limit(merge):
    with PureSim(merge.route(), TrafficConfig(density=0.3, scope="map", speed_limit=30.0)) as sim:
        network = MapNetwork.of(merge)
        limits = {"1": LIMIT, "2": LIMIT, "10": LIMIT, "5": 16.0, "11": 20.5}
        sim.reset()
        roads = set()
        for k in range(100):
            frame = sim.step()
            for vehicle in frame if k % 20 == 0 else ():
                place = network.locate(vehicle.x, vehicle.y, vehicle.yaw, vehicle.z)
                roads.add(place.road)
                assert vehicle.speed <= limits[place.road] * 1.05 + 0.5
        assert {"1", "2", "5"} <= roads


def test_one_seed_gives_one_traffic_on_the_whole_map(merge):
    def poses(seed):
        with PureSim(merge.route(), config(), seed=seed) as traffic:
            traffic.reset()
            return [traffic.step().values.tobytes() for _ in range(50)]

    assert poses(3) == poses(3)
    assert poses(3) != poses(4)


def test_an_unknown_scope_is_refused():
    with pytest.raises(InputError, match="route, both, map"):
        TrafficConfig(scope="everywhere")


def test_stored_configurations_of_version_0_1_are_read():
    stored = TrafficConfig().as_dict()
    del stored["scope"]
    assert TrafficConfig.from_dict(stored | {"oncoming": True}).scope == "both"
    assert TrafficConfig.from_dict(stored | {"oncoming": False}).scope == "route"


def test_vehicles_enter_a_short_lane_before_a_junction_without_messages(capfd):
    route = esmini("fabriksgatan_traffic_lights").route(along="roads:1,3")
    entered = 0
    settings = TrafficConfig(density=0.2, scope="map")
    with PureSim(route, settings, seed=1) as traffic:
        known = set(traffic.reset().ids)
        for _ in range(600):
            frame = traffic.step()
            entered += sum(v.station < 17.0 and v.id not in known for v in frame if v.lane >= 0)
            known |= set(frame.ids)
    assert entered > 0
    assert capfd.readouterr().err == ""
