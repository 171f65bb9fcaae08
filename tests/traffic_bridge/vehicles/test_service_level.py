import dataclasses
import itertools
import json
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge import InterSim, PureSim, TrafficConfig, default_types, motorway_types
from traffic_bridge.vehicles.service_level import (
    BOUNDS,
    MILE,
    MPH,
    TARGETS,
    LevelTraffic,
    in_cars,
    level_of,
    speed_at,
    steady_flow,
)
from traffic_bridge.vehicles.types import HEAVY

LIMIT = 33.33


@pytest.mark.parametrize("level", BOUNDS)
def test_traffic_of_a_level_has_a_density_within_its_bounds(level):
    below = [bound for name, bound in BOUNDS.items() if name < level]
    assert max(below, default=0.0) < TARGETS[level] <= BOUNDS[level]
    steady = TrafficConfig(density=level, speed_limit=LIMIT).steady
    assert level_of(in_cars(steady.density, 0.18)) == level


@pytest.mark.parametrize(
    ("free", "density", "speed", "flow"),
    [(75.0, 11.0, 75.0, 825.0), (70.0, 45.0, 53.3, 2400.0), (50.0, 45.0, 44.4, 2000.0)],
)
def test_speed_and_flow_are_those_of_the_capacity_manual(free, density, speed, flow):
    found = speed_at(density / MILE, free * MPH) / MPH
    assert found == pytest.approx(speed, rel=0.02)
    assert found * density == pytest.approx(flow, rel=0.02)


def test_speed_falls_with_density_and_meets_the_free_speed_on_an_empty_road():
    densities = np.linspace(0.0, 45.0, 30) / MILE
    for free in (12.0, 22.0, 30.0, 36.0):
        speeds = [speed_at(density, free) for density in densities]
        assert speeds[0] == free
        assert all(a >= b - 1e-9 for a, b in itertools.pairwise(speeds))
        assert speeds[-1] > 0.6 * free


def test_a_heavy_vehicle_counts_as_two_cars():
    assert in_cars(0.02, 0.0) == 0.02
    assert in_cars(0.02, 1.0) == 0.04


def test_drivers_along_a_lane_have_the_density_of_the_level_and_their_least_gaps():
    config = TrafficConfig(density="D", speed_limit=LIMIT)
    level = LevelTraffic(config.shares, LIMIT, config.steady)
    drawn = list(level.along(0, 1, 100_000.0, np.random.default_rng(0)))
    assert len(drawn) / 100_000.0 == pytest.approx(config.steady.density, rel=0.03)
    for (back, follower, _), (front, leader, _) in itertools.pairwise(drawn):
        least = follower.minimum_gap + follower.time_headway * config.steady.speed
        assert front - leader.length - back >= least - 1e-6


def test_most_heavy_vehicles_of_a_level_are_on_the_right_lane():
    config = TrafficConfig(density="C", speed_limit=LIMIT)
    level = LevelTraffic(config.shares, LIMIT, config.steady)
    rng = np.random.default_rng(1)
    right, left = (
        np.mean([level.draw(lane, 2, rng)[0].heavy for _ in range(4_000)]) for lane in (0, 1)
    )
    assert right == pytest.approx(1.8 * 0.18, abs=0.03)
    assert left == pytest.approx(0.2 * 0.18, abs=0.015)


def test_headways_of_drivers_vary_with_the_mean_of_their_type():
    car = motorway_types()[0]
    rng = np.random.default_rng(2)
    headways = np.array([car.sample_driver(rng).time_headway for _ in range(4_000)])
    assert headways.mean() == pytest.approx(car.time_headway, rel=0.03)
    assert np.log(headways).std() == pytest.approx(car.time_headway_spread, rel=0.15)
    assert headways.min() > 0.3
    assert default_types()[0].sample_driver(rng) is default_types()[0]


def test_governed_trucks_are_no_faster_than_90_km_per_hour():
    truck = motorway_types()[2]
    rng = np.random.default_rng(3)
    assert max(truck.sample_desired_speed(36.1, rng) for _ in range(500)) == 25.0
    assert truck.mean_desired_speed(36.1) == pytest.approx(25.0, abs=0.01)
    car = motorway_types()[0]
    drawn = [car.sample_desired_speed(LIMIT, rng) for _ in range(4_000)]
    assert car.mean_desired_speed(LIMIT) == pytest.approx(np.mean(drawn), rel=0.005)


def test_the_flow_of_level_f_is_that_of_drivers_at_their_least_distance():
    steady = steady_flow("F", TrafficConfig(density="F").shares, LIMIT)
    assert 5.0 < steady.speed < 15.0
    assert 1_400.0 < 3600.0 * steady.flow < 2_200.0


def test_a_level_in_sumo_has_its_density_its_headways_and_the_same_bits_again():
    route = Route.straight(4_000.0, lanes=2, speed_limit=LIMIT)
    config = TrafficConfig(density="D", speed_limit=LIMIT)
    with PureSim(route, config, seed=1) as traffic:
        runs = []
        for _ in range(2):
            frame = traffic.reset()
            for _ in range(300):
                frame = traffic.step()
            runs.append(frame)
        headways = {traffic.vehicles.in_force(name)["time_headway"] for name in frame.ids[:20]}
        name = frame.ids[0]
        own = traffic.vehicles.type_of(name).time_headway
        undo = traffic.vehicles.change(name, time_headway=3.0)
        undo()
        assert traffic.vehicles.in_force(name)["time_headway"] == pytest.approx(own)
    assert np.array_equal(runs[0].values, runs[1].values)
    assert len(headways) == 20
    density = len(frame) / 2.0 / 4_000.0
    assert density == pytest.approx(config.steady.density, rel=0.12)


def test_queue_of_level_f_stays_because_the_end_of_the_road_is_slow():
    route = Route.straight(2_500.0, lanes=2, speed_limit=LIMIT)
    config = TrafficConfig(density="F", speed_limit=LIMIT)
    with InterSim(route, config, seed=0) as traffic:
        frame = traffic.reset()
        assert traffic.signals.speed_limit(2_400.0) < 25.0
        for _ in range(100):
            frame = traffic.step(traffic._at_start())
    ahead = frame.column("station") < 2_000.0
    assert frame.column("speed")[ahead].mean() < 14.0


def test_share_of_heavy_vehicles_replaces_that_of_the_mix():
    config = TrafficConfig(density="B", heavy_share=0.3)
    heavy = sum(share for kind, share in config.shares if kind.look in HEAVY)
    assert heavy == pytest.approx(0.3)
    shares = {kind.name: share for kind, share in config.shares}
    assert shares["truck"] / shares["articulated"] == pytest.approx(0.8)
    assert {k.name for k, _ in TrafficConfig(heavy_share=0.0).shares} == {"car", "van"}
    again = TrafficConfig.from_dict(json.loads(json.dumps(config.as_dict())))
    assert again == config


@pytest.mark.parametrize("wrong", [-0.1, 0.7, math.nan, "many"])
def test_share_of_heavy_vehicles_outside_its_range_is_refused(wrong):
    with pytest.raises(InputError, match=r"heavy_share.*allowed is 0 to 0\.6"):
        TrafficConfig(heavy_share=wrong)


def test_share_of_heavy_vehicles_without_trucks_in_the_mix_is_refused():
    with pytest.raises(InputError, match="no heavy vehicles"):
        TrafficConfig(mix={"car": 1.0}, heavy_share=0.2)


def test_own_types_keep_their_drivers_at_a_level():
    car = dataclasses.replace(default_types()[0], time_headway=2.5)
    config = TrafficConfig(density="A", types=(car,), mix={"car": 1.0})
    assert config.types[0].time_headway == 2.5
    assert TrafficConfig(density="A").types == motorway_types()
    assert TrafficConfig(density="dense").types == default_types()
