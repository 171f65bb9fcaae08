"""The fast world: traffic, the truck on hills, reward, ends of a trip.

`test_fast_world_agreement.py` compares it with its NumPy form.
"""

import dataclasses

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.config import (
    KINDS,
    SHARES,
    HighwayConfig,
    Kind,
    Obstacle,
)
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.fast_world.traffic import HighwayTraffic
from controllers.decision.observation import OBSERVATION_SIZE
from controllers.decision.trip import CELLS, TripConfig, TripLog, cell_trip
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.core.units import GRAVITY
from tests.controllers.decision import numpy_world
from traffic_bridge import TrafficConfig, default_types
from traffic_bridge.vehicles import mobil

UNSEEN = np.zeros(OBSERVATION_SIZE, np.float32)


def trip(decision_name, density="dense", speed=12.5, seed=0, duration=240.0):
    env = HighwayEnv()
    maker = make(decision_name)
    maker.reset()
    env.reset(np.random.default_rng(seed), cell_trip(density, speed, TripConfig(duration=duration)))
    poses = []
    over = False
    while not over:
        step = env.step(maker.decide(env.context()))
        poses.append((*env.state[["front", "speed", "lane"]].tolist(), *env.traffic.front.tolist()))
        over = step.terminated or step.truncated
    return env, poses


def test_the_same_seed_gives_the_same_trip_to_the_bit():
    assert trip("aggressive", seed=4)[1] == trip("aggressive", seed=4)[1]
    assert trip("aggressive", seed=4)[1] != trip("aggressive", seed=5)[1]


def test_kinds_and_shares_are_those_of_the_sumo_traffic():
    types = {kind.kind: kind for kind in default_types()}
    shares = dict(TrafficConfig().mix)
    names = [field.name for field in dataclasses.fields(Kind)]
    for kind, share in zip(KINDS, SHARES, strict=True):
        for name in names:
            assert getattr(kind, name) == getattr(types[kind.kind], name), (kind.kind, name)
        assert share == pytest.approx(shares[kind.kind] / sum(shares.values()))
    assert len(KINDS) == len(shares)


def brute_gain(vehicles, kinds, i, keeps_right):
    """Returns the gain by the SUMO traffic's MOBIL, one vehicle at a time."""
    types = {kind.kind: kind for kind in default_types()}

    def driver(j):
        changed = {} if keeps_right else {"keep_right_bias": 0.0, "politeness": 0.0}
        kind = dataclasses.replace(types[KINDS[kinds[j]].kind], **changed)
        kind = dataclasses.replace(kind, length=float(vehicles.length[j]))
        return mobil.MobilDriver(str(j), float(vehicles.speed[j]), float(vehicles.desired[j]), kind)

    def around(lane):
        others = [j for j in range(len(vehicles.front)) if j != i and vehicles.lane[j] == lane]
        ahead = [j for j in others if vehicles.front[j] > vehicles.front[i]]
        behind = [j for j in others if vehicles.front[j] <= vehicles.front[i]]
        found = {}
        if ahead:
            j = min(ahead, key=lambda j: vehicles.front[j])
            gap = vehicles.front[j] - vehicles.length[j] - vehicles.front[i]
            found |= {"gap_ahead": float(gap), "speed_ahead": float(vehicles.speed[j])}
        if behind:
            j = max(behind, key=lambda j: vehicles.front[j])
            gap = vehicles.front[i] - vehicles.length[i] - vehicles.front[j]
            found |= {"gap_behind": float(gap), "follower": driver(j)}
        return mobil.LaneNeighbors(**found)

    lane = int(vehicles.lane[i])
    return mobil.incentive(driver(i), around(lane), around(1 - lane), to_right=lane == 1)


@pytest.mark.parametrize("keeps_right", [False, True])
def test_mobil_in_numpy_gives_the_gains_of_the_sumo_traffic(keeps_right):
    rng = np.random.default_rng(7)
    compared = refused = 0
    for _ in range(60):
        n = 9
        kind = rng.integers(len(KINDS), size=n)
        # Speeds on both sides of the critical speed, above which the keep-right rule differs.
        vehicles = numpy_world.Vehicles(
            front=np.cumsum(rng.uniform(8.0, 45.0, n)),
            length=np.array([KINDS[k].length for k in kind]),
            speed=(speed := rng.uniform(9.0, 22.0, n)),
            desired=speed + rng.uniform(0.5, 5.0, n),
            lane=rng.integers(2, size=n),
            drivers=numpy_world.Drivers(kind),
        )
        sides = [numpy_world.gains(vehicles, np.arange(n), k, keeps_right) for k in (1, -1)]
        found = np.where(vehicles.lane == 0, *sides)
        for i in range(n):
            wanted = brute_gain(vehicles, kind, i, keeps_right)
            if wanted is None:
                assert found[i] == -np.inf
                refused += 1
            else:
                assert found[i] == pytest.approx(wanted, abs=1e-9)
                compared += 1
    assert compared > 100
    assert refused > 100


def test_traffic_never_overlaps_in_a_lane():
    traffic = HighwayTraffic.of(
        HighwayConfig(spawn_probability=0.12, traffic_speed=13.0), np.random.default_rng(0)
    )
    truck = Obstacle(0.0, 16.5, 11.0, 0)
    traffic.fill(truck)
    for _ in range(600):
        truck = Obstacle(truck.front + 11.0 * 0.2, 16.5, 11.0, 0)
        traffic.step([truck])
        for lane in (0, 1):
            order = np.argsort(traffic.front[traffic.lane == lane])
            front = traffic.front[traffic.lane == lane][order]
            rear = front - traffic.length[traffic.lane == lane][order]
            assert (rear[1:] - front[:-1] > 0.0).all()


@pytest.mark.parametrize("truck_speed", [9.0, 16.67])
def test_density_stays_constant_around_a_slower_and_a_faster_truck(truck_speed):
    config = HighwayConfig(spawn_probability=0.05, traffic_speed=12.5)
    traffic = HighwayTraffic.of(config, np.random.default_rng(1))
    # The truck drives on a lane of its own, so that it delays no vehicle.
    truck = Obstacle(0.0, 16.5, truck_speed, 7)
    traffic.fill(truck)
    counts = []
    for _ in range(6000):
        truck = Obstacle(truck.front + truck_speed * 0.2, 16.5, truck_speed, 7)
        traffic.step([truck])
        counts.append(traffic.front.size)
    headway = 0.92 * config.traffic_speed / config.spawn_probability
    wanted = 2 * (config.window_ahead + config.window_behind) / headway
    assert np.mean(counts[1000:]) == pytest.approx(wanted, rel=0.35)


def test_followers_brake_for_the_truck():
    traffic = HighwayTraffic.of(HighwayConfig(spawn_probability=0.0), np.random.default_rng(0))
    traffic.spawn(0, 0.0)
    for _ in range(300):
        traffic.step([Obstacle(80.0, 16.5, 0.0, 0), Obstacle(80.0, 16.5, 0.0, 1)])
    assert traffic.speed[0] == pytest.approx(0.0, abs=0.1)
    assert 80.0 - 16.5 - traffic.front[0] > 1.0


def test_lateral_motion_of_a_change_is_smooth_and_ends_in_the_lane():
    traffic = HighwayTraffic.of(HighwayConfig(spawn_probability=0.0), np.random.default_rng(0))
    traffic.spawn(0, 0.0)
    traffic.lane[0], traffic.change_time[0], traffic.change_from[0] = 1, 0.0, 0.0
    offsets = []
    for _ in range(25):
        traffic.state["clock"] += 0.2
        offsets.append(traffic.tracked()[0].offset)
    assert offsets[-1] == pytest.approx(4.0)
    assert (np.diff(offsets) >= 0.0).all()
    assert np.diff(offsets).max() < 0.5


def test_truck_climbs_at_the_speed_that_full_power_sustains():
    env = HighwayEnv(grade_max=0.0)
    trip = TripConfig(spawn_probability=0.0, payload=36_000.0, duration=600.0)
    env.reset(np.random.default_rng(0), trip)
    state = env.state
    state["rolling"] += np.sin(np.arctan(0.05))  # resists as a grade of 5 % does
    env.drive(make("keep"))
    force = state["power"] / state["speed"] - state["drag"] * state["speed"] ** 2
    assert force == pytest.approx(GRAVITY * state["mass"] * state["rolling"], rel=1e-3)
    assert 11.0 < state["speed"] < 15.0


def test_keeping_the_lane_never_ends_in_a_collision():
    for density, speed in CELLS:
        env, _ = trip("keep", density, speed, seed=2, duration=200.0)
        assert env.summary.collisions == 0
        assert env.summary.changes == 0


def test_overtaking_halves_the_speed_loss_in_medium_traffic():
    loss = {
        name: np.mean(
            [trip(name, "medium", seed=k, duration=500.0)[0].summary.speed_loss for k in range(4)]
        )
        for name in ("keep", "mobil")
    }
    assert loss["mobil"] < 0.5 * loss["keep"]


def test_a_change_takes_six_to_nine_seconds_and_costs_ten():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), TripConfig(spawn_probability=0.0))
    step = env.step(Decision.LEFT)
    assert 6.0 <= step.seconds <= 9.0
    assert step.reward.change == -10.0
    assert int(env.state["lane"]) == 1
    assert env.context().scene.ego.offset == pytest.approx(4.0)


def test_a_change_to_a_missing_lane_is_refused_and_still_costs_ten():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), TripConfig(spawn_probability=0.0))
    step = env.step(Decision.RIGHT)
    assert (step.seconds, step.reward.change, step.reward.danger) == (1.0, -10.0, 0.0)
    assert (int(env.state["lane"]), env.summary.refused, env.summary.changes) == (0, 1, 0)


def test_after_a_change_the_next_one_is_refused_for_three_seconds():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), TripConfig(spawn_probability=0.0))
    env.step(Decision.LEFT)
    steps = [env.step(Decision.RIGHT) for _ in range(4)]
    assert [step.seconds > 1.0 for step in steps] == [False, False, False, True]
    assert [step.reward.danger for step in steps] == [0.0] * 4
    assert (int(env.state["lane"]), env.summary.refused, env.summary.changes) == (0, 3, 2)


def test_a_change_beside_a_vehicle_is_refused_and_costs_thirty():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), TripConfig(spawn_probability=0.0))
    env.traffic.spawn(1, float(env.state["front"]) - 5.0)
    step = env.step(Decision.LEFT)
    assert (step.reward.change, step.reward.danger) == (-10.0, -20.0)
    assert (int(env.state["lane"]), env.summary.dangerous) == (0, 1)


def test_a_trip_is_truncated_after_its_duration():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), TripConfig(duration=5.0))
    for _ in range(4):
        step = env.step(Decision.KEEP)
        assert not step.terminated
        assert not step.truncated
    step = env.step(Decision.KEEP)
    assert step.truncated
    assert not step.terminated
    with pytest.raises(InputError, match="reset"):
        env.step(Decision.KEEP)


def test_a_collision_terminates_the_trip_and_costs_300():
    env = HighwayEnv()
    env.reset(np.random.default_rng(0), TripConfig(spawn_probability=0.0))
    env.traffic.spawn(0, float(env.state["front"]) + 1.0)
    env.traffic.change_time[0] = 0.0  # it has just changed lanes and does not change again
    step = env.step(Decision.KEEP)
    assert step.terminated
    assert step.reward.collision == -300.0
    assert env.summary.collisions == 1


def test_reward_charges_speed_below_and_above_the_reference_and_changes():
    log = TripLog(TripConfig(reference_speed=16.0))
    rest = {"changes": 0, "refused": 1, "dangerous": 1, "collision_at": None, "over": False}
    log.charge_speed(14.0, 1.0)
    assert log.end(Decision.KEEP, UNSEEN, **rest).reward.total == -2.0
    log.charge_speed(18.0, 1.0)
    assert log.end(Decision.KEEP, UNSEEN, **rest).reward.total == pytest.approx(-2.0 - 2.0 * 0.99)
    log.begin()
    assert log.end(Decision.KEEP, UNSEEN, **rest).reward.total == 0.0
    assert log.end(Decision.LEFT, UNSEEN, **rest).reward.total == -30.0


def test_unknown_density_is_refused():
    with pytest.raises(InputError, match="density 'packed' is unknown"):
        cell_trip("packed", 15.0)
