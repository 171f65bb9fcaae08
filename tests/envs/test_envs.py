import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from iits_mj.envs import ENVIRONMENTS, register
from iits_mj.errors import InputError

LOW_LEVEL = ["iits_mj/Cruise-v0", "iits_mj/LaneKeep-v0"]


@pytest.fixture(scope="module")
def highway():
    pytest.importorskip("libsumo")
    environment = gymnasium.make("iits_mj/Highway-v0", duration=20.0)
    yield environment
    environment.close()


def test_registering_twice_changes_nothing():
    register()
    register()
    assert set(ENVIRONMENTS) <= set(gymnasium.registry)


@pytest.mark.parametrize("name", LOW_LEVEL)
def test_gymnasiums_checker_has_nothing_to_say(name):
    environment = gymnasium.make(f"iits_mj.envs:{name}")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(environment.unwrapped, skip_render_check=True)
    environment.close()


@pytest.mark.parametrize("name", LOW_LEVEL)
def test_reward_is_the_product_of_the_terms_in_info(name):
    environment = gymnasium.make(name)
    environment.reset(seed=1)
    for _ in range(10):
        _, reward, terminated, truncated, info = environment.step(environment.action_space.sample())
        terms = [value for key, value in info.items() if key.startswith("reward_")]
        assert reward == pytest.approx(np.prod(terms))
        if terminated or truncated:
            break
    environment.close()


def test_seeds_decide_the_episode():
    environment = gymnasium.make("iits_mj/LaneKeep-v0")
    first, _ = environment.reset(seed=5)
    again, _ = environment.reset(seed=5)
    other, _ = environment.reset(seed=6)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    environment.close()


def test_truncation_at_the_time_limit_is_no_termination():
    environment = gymnasium.make("iits_mj/Cruise-v0", time_limit=0.5)
    environment.reset(seed=0)
    outcomes = [environment.step(np.zeros(1, np.float32))[2:4] for _ in range(5)]
    assert outcomes[-1] == (False, True)
    assert outcomes[:-1] == [(False, False)] * 4
    environment.close()


def test_leaving_the_lane_terminates():
    environment = gymnasium.make("iits_mj/LaneKeep-v0")
    environment.reset(seed=0)
    for _ in range(200):
        _, _, terminated, truncated, _ = environment.step(np.array([0.0, 1.0], np.float32))
        if terminated or truncated:
            break
    assert terminated
    assert not truncated
    environment.close()


def test_unusable_arguments_are_refused():
    with pytest.raises(InputError, match="render_mode"):
        gymnasium.make("iits_mj/Cruise-v0", render_mode="ansi").close()
    environment = gymnasium.make("iits_mj/Cruise-v0", disable_env_checker=True)
    environment.reset(seed=0)
    with pytest.raises(InputError, match="action"):
        environment.unwrapped.step(np.array([np.nan]))
    environment.close()


def test_specification_survives_pickling():
    import pickle

    spec = gymnasium.spec("iits_mj/Cruise-v0")
    assert pickle.loads(pickle.dumps(spec)) == spec


def test_highway_gives_the_papers_observation_and_reward_terms(highway):
    observation, _ = highway.reset(seed=2)
    assert observation.shape == (216,)
    assert observation.dtype == np.float32
    observation, reward, terminated, _, info = highway.step(np.int64(1))
    assert highway.observation_space.contains(observation)
    terms = {key: value for key, value in info.items() if key.startswith("reward_")}
    assert reward == pytest.approx(sum(terms.values()))
    assert terms["reward_change"] == 0.0
    assert terms["reward_speed"] < 0.0
    assert not terminated


def test_highway_charges_a_change_to_a_lane_that_is_not_there(highway):
    highway.reset(seed=2)
    _, _, _, _, info = highway.step(np.int64(2))
    assert info["reward_change"] == -10.0
    assert info["refused"] == 1
    assert info["lane_changes"] == 0


def test_highway_repeats_bit_for_bit_with_a_seed(highway):
    runs = []
    for _ in range(2):
        trace = [highway.reset(seed=4)[0]]
        trace += [highway.step(np.int64(action))[0] for action in (1, 0)]
        runs.append(np.concatenate(trace))
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.slow
def test_highway_passes_gymnasiums_checker(highway):
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(highway.unwrapped, skip_render_check=True)
