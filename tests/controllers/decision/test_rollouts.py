"""Labels of the priced policy: what a lane change adds in the fast world, the fit, the training."""

import dataclasses
import shutil

import numpy as np
import pytest

from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.learning import rollouts
from controllers.decision.learning.config import RolloutConfig
from controllers.decision.learning.priced_training import RESULT, train_priced
from controllers.decision.learning.rollouts import Chunk, Labels, make_labels
from controllers.decision.priced import (
    EASE,
    EASED,
    EASES_FROM,
    PRICED_LAYERS,
    PricedNetwork,
    priced_layers,
)
from controllers.decision.trip import TripConfig
from iits_mj.core.errors import InputError

TINY = Chunk(trips=4, windows=2, seconds=30.0)
SMALL = RolloutConfig(
    rounds=2, chunks=2, chunk_trips=3, chunk_windows=1, horizon=20.0, epochs=2, members=2
)
PRICES = np.array([[60.0, 0.0, 0.0]])


def keep(worlds, prices, braking):
    del prices, braking
    return np.zeros(len(worlds), np.int64)


def empty_road(grade=0.0):
    worlds = FastWorlds(1, grade)
    trip = TripConfig(spawn_probability=0.0, traffic_speed=20.0)
    worlds.reset(0, np.random.default_rng(0), trip)
    return worlds


def changed(worlds, seconds):
    """What a change to the left adds, if the truck keeps its lane afterwards."""
    return rollouts.compare(worlds, PRICES, keep, seconds)


def test_on_an_empty_road_a_change_adds_a_change_and_time_in_the_left_lane_alone():
    components, possible = changed(empty_road(), 60.0)
    assert possible.tolist() == [[True, False]]
    way, changes, braking, left_time = components[0, 0]
    assert abs(way) < 1e-9
    assert (changes, braking) == (1.0, 0.0)
    assert left_time == pytest.approx(60.0)
    assert not components[0, 1].any()


def test_passing_a_slow_leader_gains_the_difference_of_the_speeds():
    worlds = empty_road()
    worlds.states["count"] = 1
    vehicle = worlds.states["vehicles"][0, :1]
    vehicle[:] = np.zeros(1, vehicle.dtype)
    vehicle["serial"], vehicle["length"] = 1, 4.8
    vehicle["front"] = worlds.states["front"] + 80.0
    vehicle["speed"] = 8.0
    vehicle["change_time"] = -np.inf
    vehicle["desired"] = 8.0
    components, _ = changed(worlds, 100.0)
    # The truck closes 80 m less its following distance before it must slow down. The speed at the
    # end counts for some time.
    seconds = 100.0 + rollouts.TAIL * PRICES[0, 0]
    assert 0.7 * seconds * (16.67 - 8.0) < components[0, 0, 0] + 80.0 < seconds * (16.67 - 8.0)


def test_the_speed_at_the_end_of_a_roll_out_counts_for_longer_at_a_higher_price():
    worlds = empty_road().copy([0, 0])
    prices = np.array([[50.0, 0.0, 0.0], [250.0, 0.0, 0.0]])
    totals = rollouts.roll_out(worlds, np.zeros(2, np.int64), prices, keep, 30.0)
    speed = worlds.states["speed"][0]
    assert totals[1, 0] - totals[0, 0] == pytest.approx(rollouts.TAIL * 200.0 * speed)


def test_a_truck_that_keeps_its_lane_at_first_keeps_it_for_some_decisions():
    def left(worlds, prices, braking):
        return np.where(np.isfinite(braking[:, 0]), -1, 0)

    for seconds, changes in ((rollouts.WAIT - 0.5, 0.0), (rollouts.WAIT + 0.5, 1.0)):
        worlds = empty_road()
        totals = rollouts.roll_out(worlds, np.zeros(1, np.int64), PRICES, left, seconds)
        assert totals[0, 1] == changes


def test_a_step_that_ends_after_the_roll_out_counts_in_part():
    worlds = empty_road().copy([0, 0])
    totals = rollouts.roll_out(worlds, np.array([0, -1]), np.repeat(PRICES, 2, 0), keep, 3.0)
    assert totals[1, 0] == pytest.approx(totals[0, 0], rel=0.02)


@pytest.mark.parametrize("speed_action", [False, True])
def test_labels_repeat_with_their_seed_and_hold_finite_numbers(speed_action):
    first, again = (
        make_labels(TINY, None, np.random.default_rng([0, 7]), speed_action) for _ in range(2)
    )
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, vars(again)[name])
        assert np.isfinite(values).all()
    assert first.possible.any(axis=1).all()
    assert first.components.shape[1] == first.possible.shape[1] == 2 + speed_action


def test_to_ease_off_on_a_free_road_costs_way_and_nothing_else():
    worlds = empty_road()
    worlds.states["speed"] = worlds.states["reference_speed"]
    components, possible = rollouts.compare(worlds, PRICES, keep, 60.0, actions=3)
    assert possible.tolist() == [[True, False, True]]
    way, *others = components[0, 2]
    # 2 m/s slower for 5 s, and as long again to slow down and to speed up.
    assert -EASED * 3.0 * rollouts.EASE_WAIT < way < -0.2 * rollouts.EASE_WAIT
    assert others == [0.0] * 3


def test_a_truck_that_eases_off_holds_one_speed_until_it_decides_otherwise():
    worlds = empty_road()
    worlds.states["speed"] = 16.0
    for _ in range(30):
        rollouts.drive_step(worlds, np.array([EASE]))
    assert worlds.states["speed"][0] == pytest.approx(14.0, abs=0.2)
    rollouts.drive_step(worlds, np.array([0]))
    assert worlds.states["speed_max"][0] == np.inf
    for _ in range(40):
        rollouts.drive_step(worlds, np.array([0]))
    assert worlds.states["speed"][0] > 16.0


def test_a_slow_truck_does_not_ease_off():
    worlds = empty_road().copy([0, 0])
    worlds.states["speed"] = EASES_FROM + np.array([-0.1, 0.1])
    assert np.isfinite(rollouts.braking_of_actions(worlds, 3))[:, 2].tolist() == [False, True]


def test_worlds_refuse_a_highest_speed_that_is_not_one():
    for wrong in (np.nan, 0.0, [1.0, 2.0]):
        with pytest.raises(InputError, match="speed_max"):
            empty_road().step([0], wrong)


def labels(count=500, actions=2):
    """Labels of a known law: a change to the left gains 200 m times the truck's lateral offset."""
    random = np.random.default_rng(2)
    observation = np.zeros((count, 216), np.float32)
    observation[:, 2] = random.uniform(0.0, 0.5, count)
    components = np.zeros((count, actions, 4), np.float32)
    components[:, 0, 0] = 200.0 * observation[:, 2]
    components[:, :, 1] = 1.0
    prices = np.column_stack([random.uniform(20.0, 200.0, count), np.zeros((count, 2))])
    return Labels(
        observation,
        prices.astype(np.float32),
        components,
        np.ones((count, actions), bool),
        np.zeros(count, bool),
    )


def test_a_fit_finds_a_law_of_its_labels():
    pytest.importorskip("torch", reason="torch is not installed (the train extra)")
    from controllers.decision.learning.fitting import fit

    known = labels()
    half = len(known.prices) // 2
    network = fit(Labels(*(column[:half] for column in vars(known).values())), 0, 100)
    found = network.components(known.observation[half:], known.prices[half:])[0]
    wanted = known.components[half:]
    assert np.corrcoef(found[:, 0, 0], wanted[:, 0, 0])[0, 1] > 0.95
    assert np.abs(found[..., 1] - 1.0).mean() < 0.2


def test_mirror_images_exchange_the_sides_and_the_time_in_the_lanes():
    pytest.importorskip("torch", reason="torch is not installed (the train extra)")
    from controllers.decision.learning.fitting import mirror_images

    known = labels(4, actions=3)
    known = dataclasses.replace(known, symmetric=np.array([True, True, False, True]))
    known.prices[1, 2] = 1.0
    known.components[0, 0, 3] = 25.0
    image = mirror_images(known)
    assert len(image.prices) == 2
    np.testing.assert_array_equal(image.components[:, 1, :3], known.components[[0, 3], 0, :3])
    assert image.components[0, 1, 3] == -25.0
    np.testing.assert_array_equal(image.components[:, 2, :3], known.components[[0, 3], 2, :3])
    assert image.observation[0, 2] == pytest.approx(0.5 - known.observation[0, 2])


def test_a_training_continues_to_the_same_bits(tmp_path):
    pytest.importorskip("torch", reason="torch is not installed (the train extra)")
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    first = train_priced(SMALL, whole, seed=3, jobs=1)
    shutil.copytree(whole, parts)
    policies = ("policies/priced_00.npz", "policies/member_00_0.npz", "policies/member_01_1.npz")
    for name in (RESULT, "labels/00_0000.npz", "labels/01_0000.npz", *policies):
        (parts / name).unlink()
    again = train_priced(SMALL, parts, seed=3, jobs=2, resume=True)
    assert first.read_bytes() == again.read_bytes()
    network = PricedNetwork.load(first)
    assert len(network) == SMALL.members
    assert network.metadata["config"]["seed"] == 3
    assert network.weights[0].shape[1:] == PRICED_LAYERS[1::-1]


def test_a_training_with_the_speed_action_makes_a_policy_that_may_ease_off(tmp_path):
    pytest.importorskip("torch", reason="torch is not installed (the train extra)")
    config = dataclasses.replace(SMALL, speed_action=True)
    network = PricedNetwork.load(train_priced(config, tmp_path, seed=3, jobs=1))
    assert network.layers == priced_layers(3)
    assert network.gains(np.zeros((7, 216)), PRICES).shape == (SMALL.members, 7, 3)


def test_a_folder_of_another_training_is_refused(tmp_path):
    pytest.importorskip("torch", reason="torch is not installed (the train extra)")
    with pytest.raises(InputError, match="no training in folder"):
        train_priced(SMALL, tmp_path, seed=0, jobs=1, resume=True)
    (tmp_path / "settings.json").write_text("{}")
    with pytest.raises(InputError, match="continue it with --resume"):
        train_priced(SMALL, tmp_path, seed=0, jobs=1)
    with pytest.raises(InputError, match="has the settings"):
        train_priced(SMALL, tmp_path, seed=0, jobs=1, resume=True)
