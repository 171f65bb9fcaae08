import warnings

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.envs.platoon import PlatoonEnv
from iits_mj.suite.drivers import platoon


@pytest.fixture(scope="module")
def environment():
    with PlatoonEnv((36_000.0, 0.0, 36_000.0), time_limit=20.0) as made:
        yield made


def _driven(environment, seed, act):
    """Returns rewards, gap errors and speeds, each of shape (steps, agents), and both ends."""
    environment.reset(seed=seed)
    rewards, gaps, speeds = [], [], []
    while environment.agents:
        actions = {agent: act(environment, agent) for agent in environment.agents}
        _, reward, terminated, truncated, infos = environment.step(actions)
        rewards.append(list(reward.values()))
        gaps.append([environment.seen(agent)["gap_error"][0] for agent in infos])
        speeds.append([info["speed"] for info in infos.values()])
    return np.array(rewards), np.array(gaps), np.array(speeds), terminated, truncated


def _drive(environment, agent):
    return platoon(environment.seen(agent)).astype(np.float32)


def _nothing(environment, agent):
    return np.zeros(2, np.float32)


def test_the_scripted_platoon_holds_lane_and_gaps(environment):
    rewards, gaps, _, terminated, truncated = _driven(environment, 0, _drive)
    assert not any(terminated.values())
    assert all(truncated.values())
    assert len(rewards) == 200
    assert rewards.mean(axis=0).min() > 0.85
    assert np.abs(gaps[50:]).max() < 4.0
    assert (gaps[:, 0] == 0.0).all()


def test_a_truck_without_steering_leaves_the_lane_and_ends_the_episode_for_all(environment):
    rewards, _, _, terminated, truncated = _driven(environment, 0, _nothing)
    assert any(terminated.values())
    assert all(terminated[a] != truncated[a] for a in terminated)
    assert len(rewards) < 200
    assert environment.agents == []
    with pytest.raises(InputError, match="call reset"):
        environment.step({})


def test_a_truck_that_does_not_brake_runs_into_the_one_ahead(environment):
    def act(environment, agent):
        action = _drive(environment, agent)
        if agent == "truck1":
            action[0] = 1.0
        if agent == "truck0":
            action[0] = -1.0
        return action

    _, _, _, terminated, truncated = _driven(environment, 3, act)
    assert terminated == {"truck0": True, "truck1": True, "truck2": False}
    assert truncated == {"truck0": False, "truck1": False, "truck2": True}


def test_a_disturbance_does_not_grow_along_the_platoon(environment):
    def act(environment, agent):
        action = _drive(environment, agent)
        time = environment.fleet.time
        if agent == "truck0" and 4.0 < time < 6.0:
            action[0] = -0.35
        return action

    _, _, speeds, _, _ = _driven(environment, 5, act)
    dips = speeds[30] - speeds[40:].min(axis=0)
    assert dips[0] > 2.0
    assert (np.diff(dips) < 0.3).all()


def test_equal_seeds_repeat_bit_for_bit(environment):
    first = _driven(environment, 7, _drive)
    again = _driven(environment, 7, _drive)
    other = _driven(environment, 8, _drive)
    for one, two in zip(first[:3], again[:3], strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first[2], other[2])


def test_rewards_are_the_products_of_their_terms(environment):
    environment.reset(seed=1)
    actions = {agent: _drive(environment, agent) for agent in environment.agents}
    observations, rewards, _, _, infos = environment.step(actions)
    for agent, info in infos.items():
        terms = [value for name, value in info.items() if name.startswith("reward_")]
        assert rewards[agent] == pytest.approx(np.prod(terms))
        assert environment.observation_space(agent).contains(observations[agent])
    assert environment.state().shape == (3 * len(environment.observation_names),)


def test_only_the_first_truck_observes_the_set_speed(environment):
    environment.reset(seed=2)
    before = environment.seen("truck1")
    environment.tasks[0].target += 1.0
    np.testing.assert_equal(environment.seen("truck1"), before)
    assert environment.seen("truck0")["speed_error"] < 0.5


def test_pettingzoos_own_test_passes(environment):
    parallel_api_test = pytest.importorskip("pettingzoo.test").parallel_api_test
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        parallel_api_test(environment, num_cycles=30)


def test_unusable_arguments_are_refused(environment):
    with pytest.raises(InputError, match="payloads = 1: allowed is 2 to 8"):
        PlatoonEnv((0.0,))
    with pytest.raises(InputError, match="time_gap"):
        PlatoonEnv(time_gap=float("nan"))
    with pytest.raises(InputError, match="time_limit"):
        PlatoonEnv(time_limit=1_000.0)
    with pytest.raises(InputError, match="truck9"):
        environment.action_space("truck9")
    environment.reset(seed=0)
    with pytest.raises(InputError, match="truck0"):
        environment.step({"truck0": np.zeros(2)})
    with pytest.raises(InputError, match="action of truck1"):
        environment.step(
            {
                "truck0": np.zeros(2),
                "truck1": np.array([np.nan, 0.0]),
                "truck2": np.zeros(2),
            }
        )


def test_a_picture_shows_the_platoon():
    with PlatoonEnv((0.0, 0.0), render_mode="rgb_array") as environment:
        environment.reset(seed=0)
        picture = environment.render()
        assert picture.shape == (360, 640, 3)
        assert picture.std() > 10.0
