import subprocess
import sys
import threading
import time
import types
import warnings

import gymnasium
import mujoco.viewer
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from controllers import decision
from controllers.decision.trip import ACTIONS
from iits_mj import suite
from iits_mj.core.errors import InputError, RenderError
from iits_mj.envs import ENVIRONMENTS, LEVELS, register, registrations
from iits_mj.envs.driving import DrivingEnv
from iits_mj.envs.highway import HighwayFastEnv
from iits_mj.suite.tasks import DRIVING_TASKS
from iits_mj.truck import Truck

LOW_LEVEL = [name for name, settings in ENVIRONMENTS.items() if "kwargs" in settings]
HARD = [name for name in registrations() if "Hard-v" in name]


@pytest.fixture(scope="module")
def highway():
    pytest.importorskip("libsumo")
    environment = gymnasium.make("iits_mj/Highway-v0", duration=20.0)
    yield environment
    environment.close()


@pytest.mark.parametrize(
    "imports",
    ["import gymnasium", "import gymnasium, iits_mj", "import iits_mj, gymnasium"],
)
def test_an_id_with_the_packages_name_is_found_in_any_order_of_imports(imports):
    program = (
        f"{imports}\n"
        "environment = gymnasium.make('iits_mj:iits_mj/Cruise-v0')\n"
        "print(*sorted(n for n in gymnasium.registry if n.startswith('iits_mj/')))\n"
        "print(environment.reset(seed=0)[0].shape)\n"
    )
    names, shape = _printed(program)
    assert tuple(names.split()) == tuple(sorted(registrations()))
    assert "iits_mj/Highway-v0" in names.split()
    assert shape == "(13,)"


def test_an_id_alone_is_found_after_import_of_the_environments():
    program = (
        "import gymnasium, sys\n"
        "assert 'iits_mj' not in sys.modules\n"
        "import iits_mj.envs\n"
        "print(gymnasium.make('iits_mj/Cruise-v0').reset(seed=0)[0].shape)\n"
    )
    assert _printed(program) == ["(13,)"]


def _printed(program):
    """Returns the lines that a program prints in a separate process."""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd="/", check=True
    )
    return done.stdout.splitlines()


def test_registering_twice_changes_nothing():
    register()
    register()
    assert set(registrations()) <= set(gymnasium.registry)


def test_every_driving_task_of_the_suite_has_an_environment():
    assert [ENVIRONMENTS[name]["kwargs"]["task"] for name in LOW_LEVEL] == list(DRIVING_TASKS)


@pytest.mark.parametrize("name", LOW_LEVEL)
def test_the_specification_ends_an_episode_at_the_tasks_time_limit(name):
    spec = gymnasium.spec(name)
    task = DRIVING_TASKS[spec.kwargs["task"]]
    assert spec.max_episode_steps == task.time_limit / task.period
    assert 0.0 < spec.reward_threshold < spec.max_episode_steps


def test_max_episode_steps_ends_an_episode_alone_and_vectorized_alike():
    settings = {"max_episode_steps": 3, "time_limit": 8.0}
    alone = gymnasium.make("iits_mj/Cruise-v0", **settings)
    together = gymnasium.make_vec("iits_mj/Cruise-v0", num_envs=2, **settings)
    for environment, action in ((alone, np.zeros(1)), (together, np.zeros((2, 1)))):
        environment.reset(seed=0)
        ends = [np.all(environment.step(action.astype(np.float32))[3]) for _ in range(3)]
        assert ends == [False, False, True]
        environment.close()


@pytest.mark.parametrize("name", HARD)
def test_a_hard_level_differs_only_by_its_arguments_and_starts(name):
    if name == "iits_mj/HighwayHard-v0":
        pytest.importorskip("libsumo")
    base = name.replace("Hard", "")
    assert set(LEVELS[base]) == {"Easy", "Hard"}
    environment, plain = gymnasium.make(name), gymnasium.make(base)
    assert environment.observation_space == plain.observation_space
    assert environment.spec.max_episode_steps == plain.spec.max_episode_steps
    environment.reset(seed=0)
    environment.step(environment.action_space.sample())
    environment.close()


def test_the_thin_traffic_of_an_easy_highway_holds_the_truck_back_less():
    losses = []
    for level in ("Easy", "Hard"):
        environment = gymnasium.make(f"iits_mj/HighwayFast{level}-v0")
        total = 0.0
        for seed in range(5):
            environment.reset(seed=seed)
            over = False
            while not over:
                _, reward, terminated, truncated, _ = environment.step(np.int64(1))
                total, over = total + reward, terminated or truncated
        losses.append(total)
    assert losses[0] > losses[1]


@pytest.mark.parametrize("name", LOW_LEVEL)
def test_gymnasiums_checker_has_no_complaint(name):
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


@pytest.mark.parametrize("name", LOW_LEVEL)
def test_an_episode_is_that_of_dm_control_bit_for_bit(name):
    task = ENVIRONMENTS[name]["kwargs"]["task"]
    environment = DrivingEnv(task, time_limit=3.0)
    theirs = suite.load("truck", task, {"time_limit": 3.0, "visuals": False})
    environment.reset(seed=1)
    environment.task.random.seed(4)
    theirs.task.random.seed(4)
    environment._environment.reset()
    theirs.reset()
    scales, random, over = theirs.task.scales, np.random.default_rng(2), False
    while not over:
        action = random.uniform(-1.2, 1.2, environment.action_space.shape)
        seen, reward, terminated, truncated, _ = environment.step(action)
        step = theirs.step(action)
        parts = [values / scales[key] for key, values in step.observation.items()]
        expected = np.clip(np.concatenate(parts), -5.0, 5.0).astype(np.float32)
        np.testing.assert_array_equal(seen, expected)
        assert reward == step.reward
        over = terminated or truncated
        assert over == step.last()
        assert terminated == (over and step.discount == 0.0)
    with pytest.raises(InputError, match="call reset"):
        environment.step(action)


def test_seeds_decide_the_episode():
    environment = gymnasium.make("iits_mj/LaneKeep-v0")
    first, _ = environment.reset(seed=5)
    again, _ = environment.reset(seed=5)
    other, _ = environment.reset(seed=6)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    environment.close()


def test_the_time_limit_truncates_without_termination():
    environment = gymnasium.make("iits_mj/Stop-v0", time_limit=2.5)
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


def test_unusable_arguments_are_refused(monkeypatch):
    with pytest.raises(InputError, match="render_mode 'ansi'"):
        DrivingEnv("cruise", render_mode="ansi")
    with pytest.raises(InputError, match="camera 'roof'"):
        DrivingEnv("cruise", camera="roof")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(RenderError, match="no display"):
        DrivingEnv("cruise", render_mode="human")
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
    assert info["reward_change"] == pytest.approx(-0.1)
    assert info["refused"] == 1
    assert info["lane_changes"] == 0


def test_the_fast_highway_is_the_same_task(highway):
    fast = gymnasium.make("iits_mj/HighwayFast-v0", duration=20.0)
    assert fast.observation_space == highway.observation_space
    assert fast.action_space == highway.action_space
    _, info = fast.reset(seed=2)
    _, expected = highway.reset(seed=2)
    assert set(info) == set(expected) - {"ended"}
    _, _, _, _, info = fast.step(np.int64(2))
    assert (info["reward_change"], info["refused"], info["lane_changes"]) == (-0.1, 1, 0)


def test_the_fast_highway_passes_gymnasiums_checker_and_refuses_nonsense():
    environment = gymnasium.make("iits_mj/HighwayFast-v0").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(environment, skip_render_check=True)
    with pytest.raises(InputError, match="action 3"):
        environment.step(3)
    with pytest.raises(InputError, match="density 'full'"):
        gymnasium.make("iits_mj/HighwayFast-v0", density="full")


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


def test_pictures_have_the_documented_size():
    environment = gymnasium.make("iits_mj/Stop-v0", render_mode="rgb_array")
    environment.reset(seed=0)
    picture = environment.render()
    assert picture.shape == (360, 640, 3)
    assert picture.std() > 10.0
    environment.close()


def test_closing_a_window_ends_its_thread(monkeypatch):
    class Window:
        def __init__(self):
            self.cam = types.SimpleNamespace()
            self.drawn, self._closed = 0, threading.Event()
            self.thread = threading.Thread(target=self._draw, daemon=True)
            self.thread.start()

        def _draw(self):
            self._closed.wait()
            time.sleep(0.2)

        def sync(self):
            self.drawn += 1

        def close(self):
            self._closed.set()

    made = []
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(
        mujoco.viewer, "launch_passive", lambda model, data: made.append(Window()) or made[-1]
    )
    environment = DrivingEnv("cruise", render_mode="human")
    environment.reset(seed=0)
    for _ in range(3):
        environment.step(np.zeros(1, np.float32))
    assert environment.render() is None
    environment.close()
    (window,) = made
    assert window.drawn == 4
    assert not window.thread.is_alive()


def test_two_highways_in_one_process_are_independent(highway):
    alone = highway.reset(seed=5)[0]
    alone_next = highway.step(np.int64(1))[0]
    highway.reset(seed=6)
    other = gymnasium.make("iits_mj/Highway-v0", duration=20.0)
    np.testing.assert_array_equal(other.reset(seed=5)[0], alone)
    highway.step(np.int64(1))
    np.testing.assert_array_equal(other.step(np.int64(1))[0], alone_next)
    other.close()


@pytest.fixture(scope="module")
def planning():
    environment = gymnasium.make(
        "iits_mj/SpeedPlanning-v0", timestep=0.005, length=1_000.0, payload=0.0
    )
    yield environment
    environment.close()


def test_speed_planning_repeats_bit_for_bit_and_counts_in_fuel(planning):
    runs = []
    for _ in range(2):
        observation, _ = planning.reset(seed=1)
        trace, terms = [observation], []
        over = False
        while not over:
            observation, reward, terminated, over, info = planning.step(np.float32([0.2]))
            parts = [value for key, value in info.items() if key.startswith("reward_")]
            assert reward == pytest.approx(sum(parts))
            assert not terminated
            trace.append(observation)
            terms.append(info["reward_fuel"])
        runs.append(np.concatenate(trace))
        assert -sum(terms) == pytest.approx(info["fuel_used"], abs=0.02)
    np.testing.assert_array_equal(runs[0], runs[1])


def test_the_truck_follows_the_set_speed(planning):
    for action, share in ((-1.0, 0.8), (1.0, 1.1)):
        planning.reset(seed=4)
        for _ in range(6):
            observation = planning.step(np.float32([action]))[0]
        assert observation[1] == pytest.approx(share, abs=1e-6)
        assert observation[0] == pytest.approx(share, abs=0.06)


def test_speed_planning_passes_gymnasiums_checker_and_refuses_nonsense(planning):
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(planning.unwrapped, skip_render_check=True)
    with pytest.raises(InputError, match="length"):
        gymnasium.make("iits_mj/SpeedPlanning-v0", length=1.0)
    planning.reset(seed=0)
    with pytest.raises(InputError, match="action"):
        planning.unwrapped.step(np.array([np.nan]))


@pytest.mark.parametrize("name", ["Stop", "HighwayFast"])
def test_a_step_before_reset_or_after_close_is_refused_and_reset_begins_again(name):
    environment = gymnasium.make(f"iits_mj/{name}-v0", render_mode=None).unwrapped
    action = environment.action_space.sample()
    with pytest.raises(InputError, match="not begun: call reset"):
        environment.step(action)
    for _ in range(2):
        environment.reset(seed=1)
        environment.step(action)
        environment.close()
        environment.close()
        with pytest.raises(InputError, match="not begun: call reset"):
            environment.step(action)


def test_the_fast_highway_draws_the_road_from_above_and_opens_no_window():
    with pytest.raises(InputError, match="render_mode 'human' is not known; use one of: None, rgb"):
        HighwayFastEnv(render_mode="human")
    assert HighwayFastEnv().render() is None
    environment = gymnasium.make("iits_mj/HighwayFast-v0", render_mode="rgb_array", density="dense")
    environment.reset(seed=1)
    for _ in range(20):
        environment.step(np.int64(1))
    picture = environment.render()
    assert picture.shape == (360, 640, 3)
    red, blue = ((picture == color).all(axis=-1) for color in ((190, 30, 30), (40, 90, 180)))
    # The truck is in the right lane, 16.5 m long at 2 pixels a meter, its front at a quarter.
    rows, columns = np.nonzero(red)
    assert rows.min() > 180
    assert columns.max() == 159
    assert 30 <= np.ptp(columns) + 1 <= 36
    assert blue.any()


def test_decision_makers_decide_in_the_environments():
    environment = gymnasium.make("iits_mj/HighwayFast-v0").unwrapped
    environment.reset(seed=1)
    maker = decision.make("lookahead")
    assert maker.decide(environment.context()) in ACTIONS


def test_videos_are_recorded(tmp_path):
    pytest.importorskip("moviepy")
    environment = gymnasium.make("iits_mj/HighwayFast-v0", render_mode="rgb_array")
    recorded = gymnasium.wrappers.RecordVideo(environment, str(tmp_path), video_length=3)
    recorded.reset(seed=0)
    for _ in range(4):
        recorded.step(np.int64(1))
    recorded.close()
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]


def test_the_info_of_a_planar_plant_tells_the_limits_that_it_left(monkeypatch):
    environment = gymnasium.make("iits_mj/LaneKeep-v0", plant="yaw-sideslip")
    assert environment.reset(seed=0)[1]["left_range"] == ""
    monkeypatch.setattr(Truck, "left_range", ("one limit", "another"))
    info = environment.step(np.zeros(environment.action_space.shape))[4]
    assert info["left_range"] == "one limit; another"
    assert "left_range" not in gymnasium.make("iits_mj/LaneKeep-v0").reset(seed=0)[1]


def test_emergency_braking_guards_the_highway_on_request():
    env = gymnasium.make("iits_mj/Highway-v0", density="empty", aeb=True, sensors="front")
    try:
        env.reset(seed=0)
        info = env.step(1)[-1]
        assert info["aeb"] == "standby"
        assert env.unwrapped.simulation.perception is not None
    finally:
        env.close()
    for wrong in ({"aeb": "yes"}, {"sensors": "lidar"}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            gymnasium.make("iits_mj/Highway-v0", **wrong)
