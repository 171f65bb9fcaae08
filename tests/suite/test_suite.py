import numpy as np
import pytest
from dm_control.rl import control

from iits_mj import suite
from iits_mj.errors import InputError
from iits_mj.suite.tasks import BRAKE_MAX, STEER_MAX

TASKS = [task for _, task in suite.ALL_TASKS]


@pytest.fixture(scope="module")
def environments():
    return {t: suite.load("truck", t, {"random": 3, "visuals": False}) for t in TASKS}


def _episode(environment, policy, steps):
    step = environment.reset()
    found = []
    for _ in range(steps):
        step = environment.step(policy(step.observation))
        found.append(step)
        if step.last():
            break
    return found


def test_tags_cover_the_tasks():
    assert {"cruise", "stop", "hill_start", "lane_keep"} <= set(TASKS)
    assert set(suite.BENCHMARKING) <= set(suite.ALL_TASKS)
    assert set(suite.EASY) | set(suite.HARD) <= set(suite.ALL_TASKS)
    assert suite.TASKS_BY_DOMAIN["truck"] == tuple(TASKS)


@pytest.mark.parametrize("task", TASKS)
def test_random_actions_give_finite_observations_and_rewards_in_0_to_1(environments, task):
    environment = environments[task]
    spec = environment.action_spec()
    random = np.random.RandomState(0)
    steps = _episode(environment, lambda _: random.uniform(-1.0, 1.0, spec.shape), 60)
    for step in steps:
        assert 0.0 <= step.reward <= 1.0
        assert all(np.isfinite(values).all() for values in step.observation.values())
        terms = environment.task.reward_terms(environment.physics)
        assert all(0.0 <= term <= 1.0 for term in terms.values())


@pytest.mark.parametrize("task", TASKS)
def test_observations_match_their_specification_and_have_scales(environments, task):
    environment = environments[task]
    spec = environment.observation_spec()
    observation = environment.reset().observation
    assert set(spec) == set(observation) == set(environment.task.scales)
    for name, values in observation.items():
        assert values.shape == spec[name].shape


@pytest.mark.parametrize("task", ["cruise", "lane_keep"])
def test_same_seed_gives_the_same_episode(task):
    runs = []
    for _ in range(2):
        environment = suite.load("truck", task, {"random": 7, "visuals": False})
        action = np.full(environment.action_spec().shape, 0.2)
        steps = _episode(environment, lambda _, a=action: a, 20)
        runs.append(np.concatenate([np.concatenate(list(s.observation.values())) for s in steps]))
    np.testing.assert_array_equal(runs[0], runs[1])


def test_episodes_begin_in_different_places(environments):
    starts = {environments["cruise"].reset().observation["speed"][0] for _ in range(4)}
    assert len(starts) == 4


def _cruise(observation):
    ahead = float(observation["grade_ahead"][0])
    error = float(observation["speed_error"][0])
    return np.array([np.clip(0.3 - 0.6 * error + 8.0 * ahead, -1.0, 1.0)])


def _stop(observation):
    distance, speed = float(observation["distance"][0]), float(observation["speed"][0])
    wanted = np.sqrt(2.4 * max(distance - 0.5, 0.0))
    drive = 0.5 * (min(wanted, 20.0) - speed) - (0.3 if wanted < 20.0 else 0.0)
    return np.array([np.clip(drive, -1.0, 1.0)])


def _lane_keep(observation):
    value = {name: float(values[0]) for name, values in observation.items()}
    ahead = float(observation["curvature_ahead"][1])
    steer = 7.9 * ahead - 0.02 * value["lane_error"] - 0.35 * value["heading_error"]
    drive = 0.3 - 0.5 * value["speed_error"]
    return np.clip([drive, 21.0 * steer / STEER_MAX], -1.0, 1.0)


SCRIPTED = {
    "cruise": (_cruise, 0.85),
    "stop": (_stop, 0.9),
    "hill_start": (lambda _: np.array([0.7]), 0.4),
    "lane_keep": (_lane_keep, 0.9),
}


@pytest.mark.parametrize("task", TASKS)
def test_a_scripted_driver_solves_the_task_and_a_random_one_does_not(environments, task):
    environment = environments[task]
    policy, wanted = SCRIPTED[task]
    steps = 200 if task == "hill_start" else 250
    good = np.sum([s.reward for s in _episode(environment, policy, steps)]) / steps
    random = np.random.RandomState(1)
    shape = environment.action_spec().shape
    bad = _episode(environment, lambda _: random.uniform(-1.0, 1.0, shape), steps)
    assert good > wanted
    assert np.sum([s.reward for s in bad]) / steps < 0.6 * good


def test_leaving_the_lane_ends_the_episode_with_discount_0(environments):
    steps = _episode(environments["lane_keep"], lambda _: np.array([0.0, 1.0]), 300)
    assert steps[-1].last()
    assert steps[-1].discount == 0.0
    assert len(steps) < 300


def test_actions_become_the_trucks_command(environments):
    environment = environments["lane_keep"]
    environment.reset()
    environment.step(np.array([-0.5, 0.25]))
    command = environment.physics.truck.last_command()
    assert command.xbr_demand == pytest.approx(-0.5 * BRAKE_MAX)
    assert command.accelerator_pedal == 0.0
    assert command.steering_wheel_angle == pytest.approx(0.25 * STEER_MAX)


def test_time_limit_and_payload_are_arguments():
    settings = {"time_limit": 1.0, "payload": 0.0, "visuals": False}
    environment = suite.load("truck", "stop", settings)
    assert isinstance(environment, control.Environment)
    steps = _episode(environment, lambda _: np.zeros(1), 100)
    assert len(steps) == 10
    assert steps[-1].discount == 1.0
    assert environment.physics.ego().mass == pytest.approx(19_000.0)


def test_height_of_the_load_is_an_argument():
    settings = {"payload_height": 1.5, "visuals": False}
    model = suite.load("truck", "stop", settings).physics.model
    assert model.site("payload_cg").pos[2] == pytest.approx(1.5 - 1.10)


def test_a_copy_of_the_physics_goes_its_own_way(environments):
    environment = environments["cruise"]
    environment.reset()
    twin = environment.physics.copy()
    before = environment.physics.station()
    twin.step(100)
    assert twin.station() > before
    assert environment.physics.station() == before


def test_every_model_has_at_least_two_cameras(environments):
    assert all(e.physics.model.ncam >= 2 for e in environments.values())


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="domain"):
        suite.load("cheetah", "run")
    with pytest.raises(InputError, match="task"):
        suite.load("truck", "fly")
