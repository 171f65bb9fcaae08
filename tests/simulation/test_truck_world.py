"""Trips of the MuJoCo truck in SUMO traffic: observations, rewards and steps of a learner."""

import dataclasses

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.trip import SPAWN_PROBABILITY, TripConfig, cell_trip
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from traffic_bridge.config import DENSITIES

pytest.importorskip("libsumo")

from iits_mj.simulation.truck_world import TruckWorld

SHORT = TripConfig(duration=40.0, payload=12_000.0)


def drive(world, trip, decisions, seed=0):
    observations = [world.reset(np.random.default_rng(seed), trip)]
    steps = []
    for decision in decisions:
        steps.append(world.step(decision))
        observations.append(steps[-1].observation)
        if steps[-1].terminated or steps[-1].truncated:
            break
    return np.array(observations), steps


@pytest.fixture(scope="module")
def world():
    with TruckWorld() as made:
        yield made


def test_the_papers_densities_equal_those_of_the_traffic():
    # Decision makers and traffic do not import each other: each has its own copy.
    shared = {name: DENSITIES[name] for name in SPAWN_PROBABILITY}
    assert shared == SPAWN_PROBABILITY


def test_a_trip_repeats_bit_for_bit_and_another_seed_changes_it(world):
    trip = cell_trip("dense", 12.5, dataclasses.replace(SHORT, duration=12.0))
    first, _ = drive(world, trip, [Decision.KEEP] * 20, seed=4)
    again, _ = drive(world, trip, [Decision.KEEP] * 20, seed=4)
    other, _ = drive(world, trip, [Decision.KEEP] * 20, seed=5)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_larger_time_step_gives_nearly_the_same_trip(world):
    world.close()  # a process has one SUMO
    trip = cell_trip("dense", 12.5, SHORT)
    decisions = [Decision.KEEP] * 4 + [Decision.LEFT] + [Decision.KEEP] * 40
    losses, seen = [], []
    for timestep in (0.005, 0.002):
        with TruckWorld(timestep) as made:
            observations, _ = drive(made, trip, decisions)
            losses.append(made.summary.speed_loss)
            seen.append(observations)
            assert made.summary.changes == 1
    # 0.02 m/s of the reference speed; distances, offsets and speeds within a hundredth of a range.
    assert losses[0] == pytest.approx(losses[1], abs=1e-3)
    np.testing.assert_allclose(seen[0], seen[1], atol=0.01)


def test_a_lane_change_is_one_step_and_costs_ten(world):
    trip = dataclasses.replace(SHORT, spawn_probability=0.0)
    _, steps = drive(world, trip, [Decision.LEFT, Decision.KEEP])
    change, keep = steps
    assert 4.0 < change.seconds < 10.0
    assert keep.seconds == pytest.approx(1.0)
    assert (change.reward.change, change.reward.danger) == (-10.0, 0.0)
    assert keep.reward.change == 0.0
    assert world.summary.changes == 1
    assert world.simulation.frame.lane == 1


def test_a_change_off_the_road_is_refused_without_danger(world):
    trip = dataclasses.replace(SHORT, spawn_probability=0.0)
    _, (step,) = drive(world, trip, [Decision.RIGHT])
    assert step.seconds == pytest.approx(1.0)
    assert (step.reward.change, step.reward.danger) == (-10.0, 0.0)
    assert (world.summary.refused, world.summary.dangerous, world.summary.changes) == (1, 0, 0)


def test_context_of_the_world_is_that_of_its_observation(world):
    trip = cell_trip("dense", 12.5, SHORT)
    observation = world.reset(np.random.default_rng(0), trip)
    context = world.context()
    np.testing.assert_array_equal(context.observation, observation)
    assert (context.lane, context.lanes) == (0, (0, 1))
    assert context.reference_speed == pytest.approx(trip.reference_speed)
    assert make("mobil").decide(context) in Decision


def test_reward_falls_with_the_difference_to_the_reference_speed(world):
    trip = dataclasses.replace(SHORT, spawn_probability=0.0, traffic_speed=10.0)
    _, (step,) = drive(world, trip, [Decision.KEEP])
    # The truck starts 6.7 m/s below the reference and gains at most 1 m/s in a second.
    assert -6.9 < step.reward.speed < -5.6


def test_a_trip_ends_by_time_or_distance_without_termination(world):
    by_time = dataclasses.replace(SHORT, spawn_probability=0.0, duration=3.0)
    by_way = dataclasses.replace(by_time, duration=100.0, length=40.0)
    for trip in (by_time, by_way):
        _, steps = drive(world, trip, [Decision.KEEP] * 10)
        assert steps[-1].truncated
        assert not steps[-1].terminated
        with pytest.raises(InputError, match="reset"):
            world.step(Decision.KEEP)
    assert 40.0 <= world.summary.distance < 42.0


def test_traffic_without_keeping_right_fills_both_lanes(world):
    def shares(keeps_right):
        trip = dataclasses.replace(SHORT, spawn_probability=0.08, keeps_right=keeps_right)
        drive(world, trip, [Decision.KEEP] * 20)
        lanes = [vehicle.lane for vehicle in world.simulation.vehicles]
        return np.mean(np.array(lanes) == 0)

    assert shares(True) > shares(False) + 0.15
    assert 0.25 < shares(False) < 0.75


def test_a_truck_that_keeps_right_does_not_pass_on_an_empty_road(world):
    trip = dataclasses.replace(SHORT, spawn_probability=0.0, truck_keeps_right=True)
    _, (step,) = drive(world, trip, [Decision.LEFT])
    assert step.seconds == pytest.approx(1.0)
    assert (world.summary.refused, world.summary.dangerous, world.summary.changes) == (1, 0, 0)
    assert not world.context().may_pass
    assert not [*world.context().sides()]


def test_a_step_that_does_not_fit_the_commands_is_refused(world):
    world.close()
    with pytest.raises(InputError, match=r"0\.003"):
        TruckWorld(0.003).reset(np.random.default_rng(0), SHORT)
