"""The published scenario: its start, its actions, its penalties, and what ends an episode."""

import numpy as np
import pytest

pytest.importorskip("libsumo")

from iits_mj.core.errors import InputError, TrafficError
from traffic_bridge import hoel2020
from traffic_bridge.hoel2020 import ACTIONS, LANE_WIDTH, STEPS, VEHICLES, HoelHighway


@pytest.fixture
def world():
    world = HoelHighway()
    yield world
    world.close()


def begun(world, seed, lane=None):
    """Resets a world, to the first seed from this one that starts in a lane."""
    while True:
        world.reset(np.random.default_rng(seed))
        if lane is None or (world.lane == lane and not world.changing):
            return world
        seed += 1


def test_slower_cars_start_ahead_and_faster_ones_behind():
    for seed in range(20):
        front, lane, speed = hoel2020._start(np.random.default_rng(seed))
        assert front[0] == 500.0
        assert speed[0] == 25.0
        ahead, behind = speed[front > 500.0], speed[front < 500.0]
        assert ahead.min() >= 15.0
        assert ahead.max() <= 25.0
        assert behind.min() >= 25.0
        assert behind.max() <= 35.0
        for number in range(3):
            assert (np.diff(np.sort(front[lane == number])) >= 30.0).all()


def test_a_seed_gives_the_same_episode_to_the_bit(world):
    def episode():
        seen = [world.reset(np.random.default_rng(4))]
        for action in (0, 1, 4, 0, 0, 0, 2, 2, 0, 1):
            seen.append(np.array([world.step(action).reward, *world.observation()]))
        return np.concatenate(seen)

    np.testing.assert_array_equal(episode(), episode())


def test_the_truck_obeys_its_acceleration_and_never_exceeds_25_mps(world):
    begun(world, 0)
    speed = world.speed[0]
    world.step(ACTIONS.index((-4.0, 0)))
    assert world.speed[0] == pytest.approx(speed - 4.0)
    world.step(ACTIONS.index((1.0, 0)))
    assert world.speed[0] == pytest.approx(speed - 3.0)
    for _ in range(8):
        if world.step(1).terminated:
            break
        assert world.speed[0] <= 25.0 + 1e-9


def test_a_lane_change_lasts_four_steps_and_costs_one(world):
    begun(world, 0, lane=1)
    steps = [world.step(4)]
    places = [world.offset[0]]
    assert world.changing
    assert world.lane == 2
    for _ in range(3):
        steps.append(world.step(2))
        places.append(world.offset[0])
    assert np.diff(places) == pytest.approx(np.full(3, LANE_WIDTH / 4))
    assert not world.changing
    assert steps[0].lane_change
    assert not steps[1].lane_change
    if not (steps[0].near_collision or steps[0].hard_braking):
        assert steps[0].reward == pytest.approx(world.speed[0] / 25.0 - 1.0, abs=0.2)


@pytest.mark.parametrize(("lane", "action"), [(0, 7), (2, 4)])
def test_a_change_beyond_the_outer_lane_leaves_the_road(lane, action, world):
    begun(world, 0, lane)
    step = world.step(action)
    assert step.left_road
    assert step.terminated
    assert step.reward <= 1.0 - 10.0 - 1.0


def test_who_never_brakes_hits_the_slower_car_ahead(world):
    """A gap below 2.5 m costs 10; the collision costs 10 more and ends the episode."""
    ends, touched, near = 0, 0, 0
    for seed in range(12):
        begun(world, seed)
        for _ in range(STEPS):
            step = world.step(1)
            near += step.near_collision
            if step.terminated:
                ends += step.collision
                rear = world.front[1:] - hoel2020._CAR_LENGTH
                lane = np.abs(world.offset[1:] - world.offset[0]) < LANE_WIDTH
                touched += (
                    lane & (rear < world.front[0]) & (world.front[1:] > world.front[0] - 16.0)
                ).any()
                break
    assert ends == 12
    # A car that changes into the lane less than 2.5 m behind the truck counts as well.
    assert touched >= 10
    assert near > 0


def test_the_observation_lists_the_cars_within_200_m(world):
    seen = begun(world, 7).observation()
    rows = seen[4:].reshape(VEHICLES, 4)
    ahead = world.front[1:] - world.front[0]
    inside = np.abs(ahead) <= 200.0
    count = int(inside.sum())
    np.testing.assert_allclose(rows[:count, 0], ahead[inside] / 200.0, rtol=1e-6)
    np.testing.assert_array_equal(rows[count:], [[-1.0, 0.0, 0.0, 0.0]] * (VEHICLES - count))
    assert seen[1] == pytest.approx(2.0 * world.speed[0] / 25.0 - 1.0)


def test_the_stack_sees_the_cars_where_sumo_has_them(world):
    scene = begun(world, 7).scene()
    assert len(scene.vehicles) == VEHICLES - 1
    leader = scene.neighbors.leader_in_lane(world.route, world.lane)
    same = np.abs(world.offset[1:] - world.offset[0]) < 1.0
    gaps = (world.front[1:] - hoel2020._CAR_LENGTH - world.front[0])[same]
    assert leader.gap == pytest.approx(gaps[gaps > 0.0].min())


def test_an_unknown_action_a_missing_episode_and_a_second_sumo_are_refused(world):
    with pytest.raises(InputError, match="no episode has begun"):
        world.step(0)
    begun(world, 0)
    for action in (-1, 10, 0.5, "left"):
        with pytest.raises(InputError, match=r"unknown; use 0 to 9"):
            world.step(action)
    with pytest.raises(TrafficError, match="already running in this process"):
        HoelHighway().reset(np.random.default_rng(0))
