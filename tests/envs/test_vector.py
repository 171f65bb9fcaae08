import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from iits_mj.core.errors import InputError
from iits_mj.envs.driving import DrivingEnv
from iits_mj.envs.vector import DrivingVectorEnv

COUNT = 3


def _actions(steps):
    generator = np.random.default_rng(0)
    return generator.uniform(-0.3, 0.3, (steps, COUNT, 2)).astype(np.float32)


def test_each_environment_drives_bit_for_bit_as_it_does_alone_over_autoresets():
    together = gymnasium.make_vec("iits_mj/LaneKeep-v0", num_envs=COUNT, threads=2, time_limit=1.5)
    assert isinstance(together, DrivingVectorEnv)
    alone = [DrivingEnv("lane_keep", time_limit=1.5) for _ in range(COUNT)]
    observations, _ = together.reset(seed=7)
    for number, environment in enumerate(alone):
        np.testing.assert_array_equal(environment.reset(seed=7 + number)[0], observations[number])
    over = [False] * COUNT
    ends = 0
    for actions in _actions(40):
        observations, rewards, terminated, truncated, _ = together.step(actions)
        for k, environment in enumerate(alone):
            if over[k]:
                expected = (environment.reset()[0], 0.0, False, False)
            else:
                expected = environment.step(actions[k])[:4]
            np.testing.assert_array_equal(expected[0], observations[k])
            assert expected[1:] == (rewards[k], terminated[k], truncated[k])
            over[k] = expected[2] or expected[3]
            ends += over[k]
    assert ends >= 2 * COUNT
    together.close()


def test_threads_change_nothing():
    runs = []
    for threads in (1, 2):
        environments = gymnasium.make_vec("iits_mj/Dock-v0", num_envs=COUNT, threads=threads)
        environments.reset(seed=3)
        runs.append(np.array([environments.step(a)[0] for a in _actions(10)]))
        environments.close()
    np.testing.assert_array_equal(runs[0], runs[1])


def test_reset_in_the_same_step_gives_the_last_observation_in_the_info():
    environments = gymnasium.make_vec(
        "iits_mj/Stop-v0", num_envs=2, time_limit=1.5, autoreset_mode="SameStep"
    )
    assert environments.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    environments.reset(seed=0)
    for _ in range(3):
        _, _, _, truncated, infos = environments.step(np.zeros((2, 1), np.float32))
    assert truncated.all()
    assert infos["final_obs"][0].shape == (8,)
    environments.close()


def test_wrong_actions_and_numbers_are_refused():
    environments = gymnasium.make_vec("iits_mj/Cruise-v0", num_envs=2)
    environments.reset(seed=0)
    with pytest.raises(InputError, match="actions"):
        environments.step(np.full((2, 1), np.nan, np.float32))
    with pytest.raises(InputError, match="actions"):
        environments.step(np.zeros((3, 1), np.float32))
    environments.close()
    with pytest.raises(InputError, match="num_envs 0"):
        DrivingVectorEnv(0, task="lane_keep")


@pytest.mark.slow
def test_environments_of_several_processes_give_the_same():
    make = [lambda: gymnasium.make("iits_mj/LaneKeep-v0") for _ in range(2)]
    processes = AsyncVectorEnv(make)
    together = gymnasium.make_vec("iits_mj/LaneKeep-v0", num_envs=2)
    np.testing.assert_array_equal(processes.reset(seed=1)[0], together.reset(seed=1)[0])
    for _ in range(5):
        actions = np.full((2, 2), 0.1, np.float32)
        np.testing.assert_array_equal(processes.step(actions)[0], together.step(actions)[0])
    processes.close()
    together.close()
