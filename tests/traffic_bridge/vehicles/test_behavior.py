"""Behavior of the traffic around the truck, with both lane-change models."""

import math
import os
import subprocess
import sys

import pytest

from iits_mj.road import Route
from tests.paths import ROOT
from tests.traffic_bridge.articulated_truck import ArticulatedTruck
from tests.traffic_bridge.esmini_maps import esmini
from tests.traffic_bridge.scripted_truck import overlap, vehicle_box
from traffic_bridge import InterSim, PureSim, TrafficConfig

MODELS = ("lc2013", "mobil")
both_models = pytest.mark.parametrize("lane_change", MODELS)


def crowd(lane_change, density=0.2, behind=800.0, **changes):
    return TrafficConfig(
        density=density,
        lane_change=lane_change,
        fill_ahead=changes.pop("ahead", 800.0),
        fill_behind=behind,
        **changes,
    )


def drive(config, seed, truck, seconds, plan=lambda truck, vehicles: 0.0):
    """Yields (truck, vehicles) after each step; `plan` gives the truck's acceleration."""
    with InterSim(truck.route, config, seed=seed) as traffic:
        vehicles = traffic.reset(truck.state())
        for _ in range(round(seconds * 10)):
            vehicles = traffic.step(truck.advance(plan(truck, vehicles)))
            yield truck, vehicles


def overlapping(vehicles):
    """Pairs of vehicles whose boxes overlap."""
    boxes = [(v, vehicle_box(v)) for v in vehicles]
    return [
        (v, w)
        for i, (v, box) in enumerate(boxes)
        for w, other in boxes[:i]
        if abs(v.station - w.station) < 20.0 and overlap(box, other)
    ]


def braking(deceleration):
    """A plan that brakes to a standstill from 4 s on."""
    return lambda truck, _: -deceleration if truck.time > 4.0 else 0.0


def in_lane(route, lane, station, speed):
    return ArticulatedTruck(route, station, route.lane_offset(lane, station), speed)


def rear(truck):
    return truck.station + 1.40 - 16.5


def may_enter(truck, offset, vehicles):
    """Whether the lane at an offset has room for the truck during its lane change."""
    for v in vehicles:
        if abs(v.offset - offset) > 3.0:
            continue
        ahead = v.station - 0.5 * v.length - (truck.station + 1.4)
        behind = rear(truck) - (v.station + 0.5 * v.length)
        if ahead < 8.0 + 6.0 * max(truck.speed - v.speed, 0.0) and behind < 8.0 + 6.0 * max(
            v.speed - truck.speed, 0.0
        ):
            return False
    return True


def keep_distance(truck, vehicles, desired=8.0):
    """Acceleration of a truck that keeps its distance to vehicles ahead."""
    wanted = min(0.5, desired - truck.speed)
    for v in vehicles:
        gap = v.station - 0.5 * v.length - (truck.station + 1.4)
        if gap > -3.0 and abs(v.offset - truck.offset) < 2.9:
            room = max(gap - 3.0 - truck.speed, 0.1)
            closing = max(truck.speed - v.speed, 0.0)
            wanted = min(wanted, -0.5 * closing * closing / room, 0.3 * room)
    return max(wanted, -6.0)


class LaneChanges:
    """A plan that changes lanes repeatedly when there is room, fast and slowly in turn."""

    def __init__(self, lane, durations=(4.0, 10.0)):
        self.lane, self.durations, self.begun, self.next = lane, durations, 0, 4.0

    def __call__(self, truck, vehicles):
        self._change(truck, vehicles)
        return keep_distance(truck, vehicles)

    def _change(self, truck, vehicles):
        if truck.changing or truck.time < self.next:
            return
        sides = (1, -1) if self.begun % 2 else (-1, 1)
        for lane in (self.lane + side for side in sides):
            if not 0 <= lane < truck.route.lane_count(truck.station):
                continue
            offset = truck.route.lane_offset(lane, truck.station)
            if may_enter(truck, offset, vehicles):
                duration = self.durations[self.begun % len(self.durations)]
                truck.change_lane(offset, duration)
                self.lane, self.next = lane, truck.time + duration + 2.0
                self.begun += 1
                break


@both_models
def test_followers_stop_behind_a_truck_that_brakes_as_hard_as_it_can(lane_change):
    route = Route.straight(length=3000.0, lanes=1)
    closest, standing = math.inf, set()
    config = crowd(lane_change, density=0.15, ahead=0.0, behind=900.0)
    truck = in_lane(route, 0, 1000.0, 12.0)
    for _, vehicles in drive(config, 3, truck, 30.0, braking(6.0)):
        for v in vehicles:
            assert v.station < truck.station
            closest = min(closest, rear(truck) - v.station - 0.5 * v.length)
            if v.speed < 0.01 and truck.speed == 0.0:
                standing.add(v.id)
    assert len(standing) >= 2
    assert closest > 2.0


@both_models
def test_the_queue_behind_a_stopped_truck_passes_it_without_contact(lane_change):
    route = Route.straight(length=3000.0)
    behind, passed, touched = set(), set(), []
    config = crowd(lane_change, density=0.15, ahead=0.0, behind=900.0)
    truck = in_lane(route, 1, 1000.0, 12.0)
    for _, vehicles in drive(config, 1, truck, 45.0, braking(4.0)):
        for v in vehicles:
            if v.station < rear(truck) - 10.0:
                behind.add(v.id)
            elif v.station > truck.station + 10.0 and v.id in behind:
                passed.add(v.id)
            if truck.touches(v):
                touched.append((truck.time, v))
        touched += [(truck.time, *pair) for pair in overlapping(vehicles)]
    assert not touched
    assert len(passed) >= 5


@both_models
def test_traffic_touches_neither_unit_while_the_truck_changes_lanes_repeatedly(lane_change):
    route = Route.straight(length=4000.0)
    behind, passed, touched = set(), set(), []
    changes = LaneChanges(1)
    most = 0.0
    truck = in_lane(route, 1, 1000.0, 8.0)
    for _, vehicles in drive(crowd(lane_change, density=0.15), 1, truck, 70.0, changes):
        most = max(most, abs(truck.yaw - truck.trailer_yaw))
        for v in vehicles:
            if v.station < rear(truck) - 10.0:
                behind.add(v.id)
            elif v.station > truck.station + 10.0 and v.id in behind:
                passed.add(v.id)
            if truck.touches(v):
                touched.append((truck.time, v))
    assert not touched
    assert changes.begun >= 2
    assert most > math.radians(1.5)
    assert len(passed) >= 3


@both_models
def test_a_truck_that_stops_between_two_lanes_blocks_both(lane_change):
    route = Route.straight(length=3000.0)
    behind, passed, touched = set(), set(), []
    truck = in_lane(route, 1, 1000.0, 8.0)
    config = crowd(lane_change, density=0.15, ahead=100.0, behind=700.0)
    # The lane change begins at once, while the initial traffic leaves room around the truck.
    truck.change_lane(0.5 * (route.lane_offset(0, 1000.0) + truck.offset), 3.0)

    def plan(truck, vehicles):
        return -3.0 if truck.time > 1.0 else 0.0

    for _, vehicles in drive(config, 5, truck, 40.0, plan):
        for v in vehicles:
            if truck.speed == 0.0 and v.station < rear(truck) - 20.0:
                behind.add(v.id)
            if truck.touches(v):
                touched.append((truck.time, v))
            # Beside the cab a passing vehicle has left the blocked lanes.
            if v.id in behind and abs(v.station - truck.station) < 2.0:
                assert v.lane == 2, v
                passed.add(v.id)
    assert truck.trailer_yaw != 0.0
    assert not touched
    assert len(passed) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
@both_models
def test_five_minutes_of_dense_traffic_without_contact(lane_change, seed):
    route = Route.straight(length=6000.0)
    touched, known = [], set()
    changes = LaneChanges(1)
    truck = in_lane(route, 1, 1000.0, 8.0)
    for _, vehicles in drive(crowd(lane_change), seed, truck, 300.0, changes):
        known.update(v.id for v in vehicles)
        touched += [(truck.time, v) for v in vehicles if truck.touches(v)]
        touched += [(truck.time, *pair) for pair in overlapping(vehicles)]
    assert not touched
    # With LC2013 and seed 5 the truck (8 m/s) is in the right lane from 4 s on. Vehicles of 14 m/s
    # pass it in the middle lane until 291 s, and each takes the room that `may_enter` asks for
    # 7.5 s. With seeds 0 and 1 it begins 14 and 15 changes.
    assert changes.begun >= 2
    assert len(known) > 50


@both_models
def test_traffic_stops_at_a_red_light_and_the_queue_starts_at_green(lane_change):
    route = esmini("fabriksgatan_traffic_lights").route()
    config = TrafficConfig(density=0.2, lane_change=lane_change, speed_limit=10.0)
    with PureSim(route, config, seed=1) as traffic:
        vehicles = traffic.reset()
        ahead = traffic.signals.light_ahead(0.0)
        assert ahead is not None
        for light in traffic.signals.lights():
            traffic.signals.set_state(light, "r")
        before = {v.id for v in vehicles if front(v) < ahead.station}
        for _ in range(300):
            for v in traffic.step():
                assert v.id not in before or v.lane < 0 or front(v) < ahead.station, v
                if v.lane >= 0 and front(v) < ahead.station:
                    before.add(v.id)
        queue = [v for v in traffic.step() if v.id in before and v.lane >= 0 and v.speed < 0.1]
        assert len(queue) >= 3
        first = {v.id for v in sorted(queue, key=front)[-3:]}
        for light in traffic.signals.lights():
            traffic.signals.set_state(light, "G")
        for _ in range(150):
            vehicles = traffic.step()
        assert not any(v.id in first and front(v) < ahead.station for v in vehicles)


def front(vehicle):
    """Station of the front bumper of a vehicle that drives along the route."""
    return vehicle.station + 0.5 * vehicle.length


DIGEST = """
import sys
sys.path.insert(0, {folder!r})
from tests.traffic_bridge.articulated_truck import ArticulatedTruck
from iits_mj.road import Route
from traffic_bridge import InterSim, PoseDigest, TrafficConfig
route = Route.straight(length=3000.0)
for model in ("lc2013", "mobil"):
    config = TrafficConfig(density=0.2, lane_change=model, fill_ahead=400.0, fill_behind=400.0)
    truck = ArticulatedTruck(route, 1200.0, route.lane_offset(1, 1200.0), 10.0)
    truck.change_lane(route.lane_offset(0, 1200.0), 6.0)
    digest = PoseDigest()
    with InterSim(route, config, seed=5) as traffic:
        digest.add(traffic.reset(truck.state()))
        for _ in range(60):
            digest.add(traffic.step(truck.advance()))
    print(digest.hexdigest())
"""


def test_poses_are_identical_in_processes_with_different_hash_seeds():
    code = DIGEST.format(folder=str(ROOT))
    outputs = []
    for hash_seed in ("0", "4711"):
        result = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONHASHSEED": hash_seed},
        )
        outputs.append(result.stdout.split())
        assert len(outputs[-1]) == 2, result.stderr
    assert outputs[0] == outputs[1]
    assert outputs[0][0] != outputs[0][1]
