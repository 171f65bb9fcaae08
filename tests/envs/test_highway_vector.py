"""The fast highways that one call steps."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from iits_mj.core.errors import InputError
from iits_mj.envs.highway import HighwayFastEnv
from iits_mj.envs.highway_vector import HighwayFastVectorEnv

COUNT = 4
SETTINGS = {"density": "dense", "traffic_speed": 12.5, "duration": 25.0}


def _actions(steps):
    return np.random.default_rng(0).integers(3, size=(steps, COUNT))


@pytest.mark.parametrize("trucks", [{}, {"truck": ["tractor_semitrailer_6x2", None]}])
def test_each_environment_drives_bit_for_bit_as_it_does_alone_over_autoresets(trucks):
    settings = {**SETTINGS, **trucks}
    together = gymnasium.make_vec("iits_mj/HighwayFast-v0", num_envs=COUNT, **settings)
    assert isinstance(together, HighwayFastVectorEnv)
    alone = [HighwayFastEnv(**settings) for _ in range(COUNT)]
    observations, infos = together.reset(seed=7)
    for number, environment in enumerate(alone):
        observation, info = environment.reset(seed=7 + number)
        np.testing.assert_array_equal(observation, observations[number])
        assert info == {name: infos[name][number] for name in info}
    over, ends = [False] * COUNT, 0
    for actions in _actions(120):
        observations, rewards, terminated, truncated, infos = together.step(actions)
        for k, environment in enumerate(alone):
            if over[k]:
                observation, info = environment.reset()
                expected = 0.0, False, False
            else:
                observation, *expected, info = environment.step(actions[k])
            np.testing.assert_array_equal(observation, observations[k])
            assert tuple(expected) == (rewards[k], terminated[k], truncated[k])
            assert info == {name: infos[name][k] for name in info}
            over[k] = expected[1] or expected[2]
            ends += over[k]
    assert ends >= 3 * COUNT
    together.close()


def test_reset_in_the_same_step_gives_the_last_observation_and_info():
    runs = [
        gymnasium.make_vec(
            "iits_mj/HighwayFast-v0", num_envs=COUNT, autoreset_mode=mode, **SETTINGS
        )
        for mode in ("NextStep", "SameStep")
    ]
    assert runs[1].metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    for run in runs:
        run.reset(seed=1)
    keep = np.ones(COUNT, dtype=int)
    outcome = [np.zeros(COUNT)] * 3
    while not outcome[2].any():
        (later, *outcome, infos), (first, *other, finals) = (run.step(keep) for run in runs)
        np.testing.assert_array_equal(outcome, other)
    assert outcome[2].all()
    np.testing.assert_array_equal(np.stack(finals["final_obs"]), later)
    np.testing.assert_array_equal(finals["final_info"]["station"], infos["station"])
    # The next step of the other run begins the same episode.
    np.testing.assert_array_equal(runs[0].step(keep)[0], first)


def test_three_lanes_ramps_and_a_limit_of_trucks_are_settings():
    settings = {"lanes": 3, "truck_speed_limit": 11.0, "ramp_probability": 0.1}
    environments = gymnasium.make_vec("iits_mj/HighwayFast-v0", num_envs=2, **settings)
    environments.reset(seed=0)
    for _ in range(60):
        _, _, _, _, infos = environments.step(np.zeros(2, dtype=int))
    assert infos["lane"].max() == 2
    with pytest.raises(InputError, match="lanes = 5"):
        gymnasium.make("iits_mj/HighwayFast-v0", lanes=5)


def test_nonsense_is_refused():
    environments = HighwayFastVectorEnv(2)
    with pytest.raises(InputError, match="reset first"):
        environments.step(np.ones(2, dtype=int))
    environments.reset(seed=[1, None])
    for wrong in (np.array([0, 3]), np.array([1]), np.array([0.5, 1.0])):
        with pytest.raises(InputError, match="actions are 2 of 0, 1 and 2"):
            environments.step(wrong)
    with pytest.raises(InputError, match="3 seeds: use 2"):
        environments.reset(seed=[1, 2, 3])
    with pytest.raises(InputError, match="num_envs 0"):
        HighwayFastVectorEnv(0)
    with pytest.raises(InputError, match="Disabled"):
        HighwayFastVectorEnv(2, autoreset_mode="Disabled")
