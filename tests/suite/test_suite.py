import numpy as np
import pytest
from dm_control.rl import control
from dm_control.utils import rewards

from iits_mj import suite
from iits_mj.core.errors import Error, InputError
from iits_mj.suite.tasks import Dock, LaneKeep
from iits_mj.suite.tasks.base import LINEAR, tolerance

TASKS = [task for _, task in suite.ALL_TASKS]


@pytest.fixture(scope="module")
def environments():
    made = {t: suite.load("truck", t, {"random": 3, "visuals": False}) for t in TASKS}
    yield made
    for environment in made.values():
        environment.close()


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
    assert len(TASKS) == 10
    assert set(suite.BENCHMARKING) <= set(suite.ALL_TASKS)
    assert set(suite.EASY) | set(suite.HARD) <= set(suite.ALL_TASKS)
    assert suite.TASKS_BY_DOMAIN["truck"] == tuple(TASKS)


@pytest.mark.parametrize("task", TASKS)
def test_random_actions_give_finite_observations_and_rewards_in_0_to_1(environments, task):
    environment = environments[task]
    spec = environment.action_spec()
    random = np.random.RandomState(0)
    for step in _episode(environment, lambda _: random.uniform(-1.0, 1.0, spec.shape), 60):
        assert 0.0 <= step.reward <= 1.0
        assert all(np.isfinite(values).all() for values in step.observation.values())
        terms = environment.task.reward_terms(environment.physics)
        assert all(0.0 <= term <= 1.0 for term in terms.values())


@pytest.mark.parametrize("task", TASKS)
def test_invalid_actions_are_refused(environments, task):
    environment = environments[task]
    environment.reset()
    count = environment.action_spec().shape[0]
    for action in (np.full(count, np.nan), np.zeros(count + 1)):
        with pytest.raises(InputError, match=rf"use finite numbers of shape \({count},\)"):
            environment.step(action)


@pytest.mark.parametrize("task", TASKS)
def test_observations_match_their_specification_and_have_scales(environments, task):
    environment = environments[task]
    spec = environment.observation_spec()
    observation = environment.reset().observation
    assert set(spec) == set(observation) == set(environment.task.scales)
    for name, values in observation.items():
        assert values.shape == spec[name].shape


@pytest.mark.parametrize("task", TASKS)
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


# Share of the greatest return that the scripted driver earns, and number of steps. Some cruises
# start below the target on a climb that exceeds the engine's power.
SOLVED = {
    "cruise": (0.8, 120),
    "stop": (0.9, 80),
    "hill_start": (0.5, 200),
    "lane_keep": (0.9, 250),
    "lane_change": (0.84, 300),
    "tight_turn": (0.9, 300),
    "dock": (0.7, 120),
    "cut_in": (0.6, 200),
    "emergency_stop": (0.7, 200),
}


def test_every_task_has_a_scripted_driver():
    assert set(suite.DRIVERS) == set(TASKS)
    assert set(SOLVED) == set(TASKS) - {"highway"}


@pytest.mark.parametrize("task", SOLVED)
def test_a_scripted_driver_solves_the_task_and_a_random_one_does_not(environments, task):
    environment = environments[task]
    environment.task.random.seed(3)
    wanted, steps = SOLVED[task]
    good = np.sum([s.reward for s in _episode(environment, suite.DRIVERS[task], steps)]) / steps
    random = np.random.RandomState(1)
    shape = environment.action_spec().shape
    bad = _episode(environment, lambda _: random.uniform(-1.0, 1.0, shape), steps)
    assert good > wanted
    assert np.sum([s.reward for s in bad]) / steps < 0.6 * good


@pytest.mark.slow
def test_overtaking_on_the_highway_earns_more_than_keeping_or_random_decisions():
    environment = suite.load("truck", "highway", {"visuals": False})
    random = np.random.RandomState(0)
    drivers = {
        "scripted": suite.DRIVERS["highway"],
        "keep": lambda _: np.zeros(1),
        "random": lambda _: random.uniform(-1.0, 1.0, 1),
    }
    returns = {}
    for name, driver in drivers.items():
        environment.task.random.seed(1)
        returns[name] = sum(
            step.reward for _ in range(3) for step in _episode(environment, driver, 180)
        )
    environment.close()
    assert returns["scripted"] > 1.2 * returns["keep"]
    assert returns["scripted"] > 1.2 * returns["random"]


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
    assert command.xbr_demand == pytest.approx(-0.5 * LaneKeep.brake_max)
    assert command.accelerator_pedal == 0.0
    assert command.steering_wheel_angle == pytest.approx(0.25 * LaneKeep.steer_max)


def test_time_limit_and_payload_are_arguments():
    settings = {"time_limit": 5.0, "payload": 0.0, "visuals": False}
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


def test_a_copy_of_the_physics_is_independent(environments):
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


def test_distance_to_the_dock_is_measured_from_the_trailers_rear(environments):
    environment = environments["dock"]
    environment.reset()
    physics = environment.physics
    physics.place(100.0, 0.5, 0.0)
    rear = 100.0 + physics.truck.footprint.front_overhang - physics.truck.footprint.length
    distance, aside, heading = environment.task.rear(physics)
    assert distance == pytest.approx(rear - 60.0, abs=0.02)
    assert aside == pytest.approx(0.5, abs=0.01)
    assert heading == pytest.approx(0.0, abs=1e-3)


def test_full_throttle_backs_into_the_dock_and_ends_the_episode(environments):
    environment = environments["dock"]
    full = lambda _: np.array([1.0, 0.0])  # noqa: E731
    steps = _episode(environment, full, 600)
    assert steps[0].observation["speed"][0] > steps[10].observation["speed"][0]
    assert steps[-1].discount == 0.0
    task = environment.task
    rammed = task.rear(environment.physics)[0] < Dock.rammed
    assert rammed or abs(environment.physics.articulation()) > Dock.jackknifed


def test_outline_of_a_truck_on_the_line_reaches_half_its_width_to_both_sides(environments):
    environment = environments["tight_turn"]
    environment.reset()
    environment.physics.place(40.0, 0.0, 2.0)
    offsets = environment.physics.outline_offsets()
    width = environment.physics.truck.footprint.width
    assert offsets.max() == pytest.approx(0.5 * width, abs=0.02)
    assert offsets.min() == pytest.approx(-0.5 * width, abs=0.02)
    assert environment.task.clearance(environment.physics) == pytest.approx(
        1.95 - 0.5 * width, abs=0.02
    )


def test_hill_starts_are_on_grades_of_4_to_9_percent(environments):
    environment = environments["hill_start"]
    grades = [float(environment.reset().observation["grade"][0]) for _ in range(12)]
    assert min(grades) > 0.035
    assert max(grades) < 0.095
    assert max(grades) - min(grades) > 0.02


def test_the_highway_refuses_copies_and_parts_of_a_cycle(environments):
    environment = environments["highway"]
    environment.reset()
    with pytest.raises(Error, match="SUMO"):
        environment.physics.copy()
    with pytest.raises(InputError, match="cycles"):
        environment.physics.step(3)


def test_physics_and_simulation_of_the_highway_share_the_truck(environments):
    environment = environments["highway"]
    environment.reset()
    for _ in range(3):
        step = environment.step(np.zeros(1))
    assert environment.physics.time() == pytest.approx(environment.physics.simulation.time)
    assert environment.physics.speed() == step.observation["speed"][0]
    assert environment.physics.station() > 80.0


def test_colors_show_the_reward_on_request():
    environment = suite.load("truck", "cruise", {"random": 0}, visualize_reward=True)
    environment.reset()
    colors = environment.physics.named.model.mat_rgba
    environment.step(np.array([0.3]))
    assert not np.array_equal(colors["self"], colors["self_default"])
    environment.close()


@pytest.mark.parametrize("form", [{}, LINEAR])
def test_the_tolerance_is_that_of_dm_control_bit_for_bit(form):
    random = np.random.default_rng(0)
    for value, low, width, margin in random.uniform(-3.0, 3.0, (2_000, 4)).tolist():
        bounds, margin = (low, low + abs(width)), abs(margin)
        expected = rewards.tolerance(value, bounds, margin, **{"value_at_margin": 0.1, **form})
        assert tolerance(value, *bounds, margin, **form) == expected


def test_the_truck_is_read_again_when_its_state_changes_and_only_then(environments):
    environment = environments["lane_keep"]
    environment.reset()
    physics = environment.physics
    first = physics.ego()
    assert physics.ego() is first
    physics.data.qpos[1] += 0.5
    moved = physics.ego()
    assert moved.offset == pytest.approx(first.offset + 0.5, abs=0.05)
    error = environment.task.lane_error(physics)
    physics.data.qpos[1] -= 0.5
    assert environment.task.lane_error(physics) == pytest.approx(error - 0.5, abs=0.05)
