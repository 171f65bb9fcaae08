"""Stable-Baselines3 trains on the unchanged environments, and a short training helps."""

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

EPISODES = 5


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def _score(act, name, **settings):
    """Returns the mean return over the same episodes."""
    environment = gymnasium.make(name, **settings)
    returns = []
    for episode in range(EPISODES):
        observation, _ = environment.reset(seed=1_000 + episode)
        environment.action_space.seed(episode)
        over, total = False, 0.0
        while not over:
            observation, reward, terminated, truncated, _ = environment.step(
                act(environment, observation)
            )
            over = terminated or truncated
            total += reward
        returns.append(total)
    environment.close()
    return np.mean(returns)


def _learned(model):
    return lambda _, observation: model.predict(observation, deterministic=True)[0]


def _random(environment, _):
    return environment.action_space.sample()


@pytest.mark.slow
def test_ppo_learns_to_start_on_a_hill():
    name, settings = "iits_mj/HillStart-v0", {"time_limit": 10.0}
    model = PPO(
        "MlpPolicy", gymnasium.make(name, **settings), learning_rate=1e-3, n_steps=400,
        batch_size=100, gamma=0.97, policy_kwargs={"log_std_init": -0.5}, seed=0, device="cpu",
    )  # fmt: skip
    # The untrained policy hardly uses the pedal, and a random pedal moves no truck uphill.
    assert _score(_learned(model), name, **settings) < 0.1
    assert _score(_random, name, **settings) < 0.1
    model.learn(4_000)
    assert _score(_learned(model), name, **settings) > 1.0


def test_dqn_learns_to_avoid_refused_changes():
    name, settings = "iits_mj/HighwayFast-v0", {"duration": 60.0}
    model = DQN(
        "MlpPolicy", gymnasium.make(name, **settings), learning_rate=5e-4, learning_starts=200,
        train_freq=1, target_update_interval=200, exploration_fraction=0.5, seed=0, device="cpu",
    )  # fmt: skip
    untrained = max(_score(act, name, **settings) for act in (_random, _learned(model)))
    model.learn(2_000)
    assert _score(_learned(model), name, **settings) > untrained + 100.0


@pytest.mark.parametrize("name", ["iits_mj/LaneKeep-v0", "iits_mj/HighwayFast-v0"])
def test_stable_baselines3_checker_has_no_complaint(name):
    environment = gymnasium.make(name).unwrapped
    check_env(environment, skip_render_check=True)
    assert environment.observation_space.dtype == np.float32
    environment.close()


def test_an_environment_drives_in_worker_processes_as_it_does_here():
    name = "iits_mj:iits_mj/Cruise-v0"
    processes = make_vec_env(name, 2, seed=3, vec_env_cls=SubprocVecEnv)
    here = make_vec_env(name, 2, seed=3)
    np.testing.assert_array_equal(processes.reset(), here.reset())
    actions = np.full((2, 1), 0.4, np.float32)
    for _ in range(3):
        np.testing.assert_array_equal(processes.step(actions)[0], here.step(actions)[0])
    processes.close()
    here.close()
