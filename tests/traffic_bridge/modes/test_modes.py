import math
import subprocess
import sys

import numpy as np
import pytest

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.road import Route
from tests.paths import ROOT
from tests.traffic_bridge.scripted_truck import ego_at, ego_box, overlap, vehicle_box
from traffic_bridge import InterSim, PureSim, Traffic, TrafficConfig

CROWDED = TrafficConfig(density=0.2, fill_ahead=800.0, fill_behind=800.0)
DIGEST = """
import sys
sys.path.insert(0, {folder!r})
from tests.traffic_bridge.scripted_truck import ego_at
from iits_mj.road import Route
from traffic_bridge import InterSim, PoseDigest, TrafficConfig
route = Route.straight(length=4000.0)
digest = PoseDigest()
config = TrafficConfig(density=0.2, fill_ahead=800.0, fill_behind=800.0)
with InterSim(route, config, seed=5) as traffic:
    digest.add(traffic.reset(ego_at(route, 0.0, 1500.0, 10.0, 4.0)))
    for k in range(1, 101):
        digest.add(traffic.step(ego_at(route, 0.1 * k, 1500.0 + k, 10.0, 4.0)))
print(digest.hexdigest())
"""


def test_importing_the_package_does_not_load_libsumo():
    code = "import sys, traffic_bridge; print('libsumo' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "False", result.stderr


def test_follower_stops_behind_a_braking_truck(straight):
    # On one lane no vehicle can overtake.
    route = Route.straight(length=3000.0, lanes=1)
    config = TrafficConfig(density=0.15, fill_ahead=0.0, fill_behind=900.0)
    closest, stopped = math.inf, False
    with InterSim(route, config, seed=3) as traffic:
        station, speed = 1000.0, 12.0
        vehicles = traffic.reset(ego_at(route, 0.0, station, speed, 0.0))
        assert any(v.station < station for v in vehicles)
        for k in range(1, 601):
            speed = max(speed - 0.1 * 4.0, 0.0) if k > 50 else speed
            station += 0.1 * speed
            vehicles = traffic.step(ego_at(route, 0.1 * k, station, speed, 0.0))
            rear = station + 1.40 - 16.5
            behind = [v for v in vehicles if v.station < rear]
            gaps = [rear - (v.station + 0.5 * v.length) for v in behind]
            closest = min([closest, *gaps])
            stopped = stopped or any(
                v.speed < 0.1 and gap < 15.0 for v, gap in zip(behind, gaps, strict=True)
            )
    assert stopped
    assert closest > 2.0


@pytest.mark.parametrize("lane_change", ["lc2013", "mobil"])
def test_faster_traffic_overtakes_the_truck_without_contact(straight, lane_change):
    config = TrafficConfig(
        density=0.2, lane_change=lane_change, fill_ahead=800.0, fill_behind=800.0
    )
    behind, passed = set(), set()
    with InterSim(straight, config, seed=2) as traffic:
        traffic.reset(ego_at(straight, 0.0, 1000.0, 8.0, 0.0))
        for k in range(1, 601):
            ego = ego_at(straight, 0.1 * k, 1000.0 + 0.8 * k, 8.0, 0.0)
            for v in traffic.step(ego):
                if v.station < ego.station - 20.0:
                    behind.add(v.id)
                elif v.station > ego.station + 10.0 and v.id in behind:
                    passed.add(v.id)
                if abs(v.station - ego.station) < 40.0:
                    assert not overlap(vehicle_box(v), ego_box(ego)), (k, v)
    assert len(passed) >= 3


def test_shown_vehicles_do_not_overlap_or_jump(straight):
    with InterSim(straight, CROWDED, seed=4) as traffic:
        before = {}
        changes = 0
        traffic.reset(ego_at(straight, 0.0, 1000.0, 8.0, 4.0))
        for k in range(1, 401):
            ego = ego_at(straight, 0.1 * k, 1000.0 + 0.8 * k, 8.0, 4.0)
            vehicles = traffic.step(ego)
            for i, v in enumerate(vehicles):
                if v.id in before:
                    old = before[v.id]
                    assert math.hypot(v.x - old.x, v.y - old.y) < 0.1 * 15.0 + 0.5
                    assert abs(v.offset - old.offset) < 0.5
                    changes += v.lane != old.lane
                for w in vehicles[:i]:
                    if abs(v.station - w.station) < 20.0:
                        assert not overlap(vehicle_box(v), vehicle_box(w)), (k, v, w)
            before = {v.id: v for v in vehicles}
    assert changes > 5


def test_no_vehicle_appears_near_the_truck(straight):
    with InterSim(straight, CROWDED, seed=6) as traffic:
        known = {v.id for v in traffic.reset(ego_at(straight, 0.0, 30.0, 10.0, 0.0))}
        for k in range(1, 401):
            ego = ego_at(straight, 0.1 * k, 30.0 + k, 10.0, 0.0)
            for v in traffic.step(ego):
                if v.id not in known:
                    assert math.hypot(v.x - ego.x, v.y - ego.y) > 140.0
                    known.add(v.id)


def test_one_seed_gives_identical_poses_in_two_processes(straight):
    code = DIGEST.format(folder=str(ROOT))
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        for _ in range(2)
    ]
    assert len(runs[0].stdout.strip()) == 64, runs[0].stderr
    assert runs[0].stdout == runs[1].stdout


def test_a_reset_repeats_the_traffic_and_another_seed_changes_it():
    route = Route.straight(length=2000.0)
    with PureSim(route, CROWDED, seed=1) as traffic:
        first = [traffic.reset(), *(traffic.step() for _ in range(50))]
        again = [traffic.reset(), *(traffic.step() for _ in range(50))]
    with PureSim(route, CROWDED, seed=2) as traffic:
        other = traffic.reset()
    assert first == again
    assert first[0] != other


def test_densities_give_increasing_numbers_of_vehicles(straight):
    counts = []
    for density in ("sparse", "medium", "dense"):
        with PureSim(straight, TrafficConfig(density=density), seed=1) as traffic:
            traffic.reset()
            for _ in range(300):
                vehicles = traffic.step()
            counts.append(len(vehicles))
    assert 0 < counts[0] < counts[1] < counts[2], counts


def test_flow_at_the_entrance_has_the_configured_probability():
    route = Route.straight(length=1500.0)
    with PureSim(route, TrafficConfig(density=0.1, fill_ahead=0.0), seed=1) as traffic:
        known = {v.id for v in traffic.reset()}
        for _ in range(1500):
            known |= {v.id for v in traffic.step()}
    # 150 s, 3 lanes, 0.1 per second and lane: 45 +/- 6.7; a few find no room in time.
    assert 28 <= len(known) <= 62


def test_a_second_simulation_in_the_process_is_refused(straight):
    with PureSim(straight, CROWDED) as first:
        first.reset()
        with pytest.raises(TrafficError, match="already running in this process"):
            PureSim(straight, CROWDED).reset()
        # The first one continues.
        assert first.step()


def test_a_step_before_the_first_reset_is_refused_with_advice(straight):
    traffic = PureSim(straight, CROWDED)
    with pytest.raises(TrafficError, match="reset"):
        traffic.step()


def test_an_ego_state_that_is_not_finite_is_refused_and_the_traffic_continues(straight):
    with InterSim(straight, CROWDED, seed=1) as traffic:
        traffic.reset(ego_at(straight, 0.0, 500.0, 5.0, 0.0))
        with pytest.raises(InputError, match=r"ego\.x = nan"):
            traffic.step(ego_at(straight, 0.1, 500.0, 5.0, 0.0).__class__(x=math.nan))
        with pytest.raises(InputError, match="needs the ego"):
            traffic.step(None)
        assert traffic.step(ego_at(straight, 0.1, 500.5, 5.0, 0.0))


def test_lane_changes_in_bends_do_not_shift_vehicles_along_the_road(highway):
    config = TrafficConfig(density=0.15, fill_ahead=1500.0, fill_behind=1500.0)
    worst, changes = 0.0, 0
    with PureSim(highway, config, seed=2) as traffic:
        before = {}
        for k in range(400):
            vehicles = traffic.reset(ego_at(highway, 0.0, 4000.0, 0.0, 0.0)) if k == 0 else None
            vehicles = traffic.step() if vehicles is None else vehicles
            for v in vehicles:
                old = before.get(v.id, v)
                worst = max(worst, math.hypot(v.x - old.x, v.y - old.y) - 0.1 * v.speed)
                changes += v.lane != old.lane
            before = {v.id: v for v in vehicles}
    assert changes > 5
    assert worst < 0.1


def test_vehicles_lie_on_the_road_and_report_their_lane(highway):
    with InterSim(highway, TrafficConfig(density="dense"), seed=1) as traffic:
        traffic.reset(ego_at(highway, 0.0, 3000.0, 12.0, highway.lane_offset(0, 3000.0)))
        seen = 0
        for k in range(1, 101):
            s = 3000.0 + 1.2 * k
            for v in traffic.step(ego_at(highway, 0.1 * k, s, 12.0, highway.lane_offset(0, s))):
                point = highway.evaluate(v.station, v.offset)
                assert np.hypot(v.x - point.x, v.y - point.y) < 0.02
                assert abs(v.z - point.z) < 0.002
                assert v.lane == highway.lane_at(v.station, v.offset) >= 0
                seen += 1
        assert seen > 100
        assert isinstance(traffic, Traffic)


def test_the_whole_highway_is_driven_without_a_collision_in_the_traffic(highway):
    with PureSim(highway, TrafficConfig(density="dense", fill_ahead=15_000.0), seed=1) as traffic:
        count = len(traffic.reset())
        for _ in range(150):
            vehicles = traffic.step()
        assert count > 60
        assert len(vehicles) > 60
        assert not traffic.session.api.simulation.getCollidingVehiclesIDList()


def test_traffic_avoids_both_lanes_of_a_truck_that_stands_between_them(straight):
    # A stopped truck with its wheels in the next lane: no vehicle passes it there or touches it.
    config = TrafficConfig(density=0.1, fill_ahead=100.0, fill_behind=700.0)
    passed = set()
    with InterSim(straight, config, seed=8) as traffic:
        traffic.reset(ego_at(straight, 0.0, 1200.0, 0.0, 1.5))
        for k in range(1, 501):
            ego = ego_at(straight, 0.1 * k, 1200.0, 0.0, 1.5)
            for v in traffic.step(ego):
                if abs(v.station - 1193.0) < 20.0:
                    assert not overlap(vehicle_box(v), ego_box(ego))
                # Beside the cab a passing vehicle has left the blocked lanes.
                if abs(v.station - 1199.0) < 3.0:
                    assert v.lane == 2, v
                    passed.add(v.id)
    assert passed


def test_parameters_of_one_vehicle_and_of_a_type_change_during_the_run(straight):
    with PureSim(straight, TrafficConfig(density=0.1), seed=1) as traffic:
        name = next(v.id for v in traffic.reset() if v.kind == "car")
        traffic.vehicles.change(name, desired_speed=5.0)
        traffic.vehicles.change("truck", time_headway=3.0)
        for _ in range(200):
            vehicles = {v.id: v for v in traffic.step()}
        assert vehicles[name].speed < 5.1
        truck = next(v.id for v in vehicles.values() if v.kind == "truck")
        assert traffic.vehicles.type_of(truck).time_headway == 3.0
        with pytest.raises(InputError, match="allowed are"):
            traffic.vehicles.change("car", courage=1.0)
        with pytest.raises(InputError, match="no vehicle"):
            traffic.vehicles.change("bus.1", time_headway=1.0)
