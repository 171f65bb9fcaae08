"""The benchmark's trainings continue after a kill, and its page shows its tables."""

import dataclasses

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from benchmarks import rl_results, rl_suite
from controllers.decision.trip import TEST_SEEDS
from iits_mj.envs import ENVIRONMENTS
from iits_mj.envs.baselines import Policy

PAGE = "".join(
    f"<!-- {name} -->\n<!-- end -->\n" for name in ("scores", "summary", "transfer", "costs")
)


class Killed(Exception):
    """Stands for a kill."""


@pytest.mark.parametrize(
    ("environment", "algorithm", "steps", "hyperparameters"),
    [
        ("iits_mj/HillStart-v0", "ppo", 192, {"n_steps": 32, "batch_size": 16}),
        ("iits_mj/HighwayFast-v0", "dqn", 150, {"buffer_size": 100, "learning_starts": 20}),
        ("iits_mj/HillStart-v0", "sac", 60, {"learning_starts": 10, "batch_size": 8}),
    ],
)
def test_a_killed_training_ends_with_the_same_policy(
    environment, algorithm, steps, hyperparameters, tmp_path, monkeypatch
):
    monkeypatch.setattr(rl_suite, "VALIDATION_EPISODES", 1)
    monkeypatch.setattr(rl_suite, "TEST_EPISODES", 1)
    task = rl_suite.Training(environment, algorithm, 1, steps, 3, 2, None, hyperparameters)
    through, stopped = tmp_path / "through", tmp_path / "stopped"
    rl_suite.train(task, through)
    store, calls = rl_suite._store, []

    def kill(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            (stopped / "partial").mkdir()
            raise Killed
        store(*arguments)

    monkeypatch.setattr(rl_suite, "_store", kill)
    with pytest.raises(Killed):
        rl_suite.train(task, stopped)
    assert rl_suite.finished_parts(stopped) == 1
    rl_suite.train(task, stopped)
    files = [folder / "part-3" / "policy.npz" for folder in (through, stopped)]
    policies = [Policy.load(file) for file in files]
    for first, second in zip(policies[0].weights, policies[1].weights, strict=True):
        np.testing.assert_array_equal(first, second)
    assert (through / "scores.csv").read_text() == (stopped / "scores.csv").read_text()
    curve = rl_suite._rows(stopped / "part-3" / "curve.csv")
    assert len(curve) == 3
    assert int(curve[-1]["steps"]) >= steps


@pytest.mark.parametrize("algorithm", ["ppo", "dqn", "sac"])
def test_the_exported_network_acts_as_the_model(algorithm):
    environment = "iits_mj/HighwayFast-v0" if algorithm == "dqn" else "iits_mj/LaneKeep-v0"
    settings = {} if algorithm == "ppo" else {"buffer_size": 10}
    task = rl_suite.Training(environment, algorithm, 0, 1, 1, 1, None, settings)
    model = rl_suite._model(task, None)
    policy = rl_suite.exported(model)
    observation = model.env.reset()[0]
    expected = model.predict(observation, deterministic=True)[0]
    np.testing.assert_allclose(policy(observation), expected, atol=1e-5)


def test_a_network_of_rows_acts_as_the_model_whatever_their_order():
    task = next(task for task in rl_suite.trainings() if task.rows is not None)
    model = rl_suite._model(dataclasses.replace(task, hyperparameters={"buffer_size": 10}), None)
    policy = rl_suite.exported(model)
    assert policy.row_layers == len(task.rows["layers"])
    own, row = task.rows["own"], task.rows["row"]
    generator = np.random.default_rng(0)
    for _ in range(20):
        observation = generator.uniform(-1.0, 1.0, model.observation_space.shape)
        observation = observation.astype(np.float32)
        rows = generator.permutation(observation[own:].reshape(-1, row))
        reordered = np.concatenate([observation[:own], rows.ravel()])
        expected = model.predict(observation, deterministic=True)[0]
        assert policy(observation) == policy(reordered) == expected


def test_the_interquartile_mean_leaves_out_the_quarters_and_lies_in_its_interval():
    sample = np.array([0.0, 1.0, 2.0, 3.0, 100.0, 4.0, 5.0, 6.0])
    middle, low, high = rl_results.interquartile_mean([sample])
    assert middle == pytest.approx(np.mean([2.0, 3.0, 4.0, 5.0]))
    assert low < middle < high
    assert np.isnan(rl_results.interquartile_mean([np.ones(1)])[1])
    # Strata without spread leave none to the mean.
    assert rl_results.interquartile_mean([np.ones(5), np.ones(5)])[1:] == (1.0, 1.0)


def test_every_environment_is_trained_with_five_seeds_and_has_a_scripted_driver():
    tasks = rl_suite.trainings()
    assert {task.environment for task in tasks} == set(ENVIRONMENTS)
    assert len({task.name for task in tasks}) == len(tasks)
    assert [task.seed for task in tasks] == sorted(task.seed for task in tasks)
    environment = gymnasium.make("iits_mj/Stop-v0")
    observation, _ = environment.reset(seed=TEST_SEEDS)
    action = rl_suite.scripted("iits_mj/Stop-v0")(environment, observation)
    assert environment.action_space.contains(action)


def test_scores_repeat_with_their_seeds():
    act = rl_suite._random
    runs = [rl_suite.score("iits_mj/HighwayFast-v0", act, TEST_SEEDS, 2) for _ in range(2)]
    assert runs[0] == runs[1]


def test_a_threshold_is_95_percent_of_the_way_from_random_to_scripted():
    found = rl_results.returns(rl_results.read("scores"))
    scored = [name for name in ENVIRONMENTS if {(name, "random"), (name, "scripted")} <= set(found)]
    assert len(scored) >= 8
    for name in scored:
        low, high = (float(found[name, method][0]) for method in ("random", "scripted"))
        wanted = low + 0.95 * (high - low)
        threshold = gymnasium.spec(name).reward_threshold
        assert wanted - 0.02 * (high - low) < threshold <= wanted


def test_the_levels_are_scored_on_the_first_test_episodes(tmp_path, monkeypatch):
    monkeypatch.setattr(rl_suite, "LEVEL_EPISODES", 2)
    monkeypatch.setattr(rl_results, "TABLES", tmp_path)
    monkeypatch.setattr(rl_results, "write_page", lambda: None)
    name = "iits_mj/HighwayFast-v0"
    rl_suite.score_levels([name], tmp_path / "out")
    rows = rl_results.read("levels")
    levels = {"iits_mj/HighwayFastEasy-v0", name, "iits_mj/HighwayFastHard-v0"}
    assert {row["environment"] for row in rows} == levels
    returned, *_ = rl_suite.score("iits_mj/HighwayFastHard-v0", rl_suite._random, TEST_SEEDS, 2)
    found = rl_results.returns(rows)
    assert found["iits_mj/HighwayFastHard-v0", "random"] == pytest.approx(
        np.mean(returned), abs=1e-4
    )
    line = next(x for x in rl_results.level_table(rows).splitlines() if f"`{name}`" in x)
    assert "pending" not in line


def test_a_policy_of_the_kinematic_world_is_scored_in_both(tmp_path, monkeypatch):
    monkeypatch.setattr(rl_suite, "VALIDATION_EPISODES", 1)
    monkeypatch.setattr(rl_suite, "TEST_EPISODES", 2)
    monkeypatch.setattr(rl_results, "TABLES", tmp_path)
    monkeypatch.setattr(rl_results, "write_page", lambda: None)
    settings = {"n_steps": 16, "batch_size": 16}
    task = rl_suite.Training("iits_mj/TightTurn-v0", "ppo", 0, 16, 1, 1, None, settings)
    rl_suite.score_transfers([task], tmp_path)
    assert rl_results.read("transfer") == []
    trained = rl_suite.with_plant(task, "kinematic")
    rl_suite.train(trained, tmp_path / "kinematic" / task.name)
    rl_suite.score_transfers([task], tmp_path)
    rows = rl_results.read("transfer")
    # The policy of seed 0 in the physical world ships with the package.
    pairs = [(row["trained"], row["tested"]) for row in rows]
    kinds = ("kinematic", "physical")
    assert pairs == [(trained, tested) for trained in kinds for tested in kinds]
    assert len({row["return"] for row in rows}) == 4
    table = rl_results.transfer_table(rows)
    assert "| `iits_mj/TightTurn-v0` ppo | physical | 1 | 100.0 %, " in table


def test_the_page_shows_the_tables_of_its_files():
    text = rl_results.PAGE.read_text(encoding="utf-8")
    assert rl_results.page(text) == text, "python benchmarks/rl_results.py makes the page"


def test_finished_trainings_join_the_tables_and_are_not_trained_again(tmp_path, monkeypatch):
    monkeypatch.setattr(rl_results, "TABLES", tmp_path / "tables")
    monkeypatch.setattr(rl_results, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(rl_suite, "FOLDER", tmp_path / "weights")
    monkeypatch.setattr("iits_mj.envs.baselines.FOLDER", tmp_path / "weights")
    monkeypatch.setattr(rl_suite, "VALIDATION_EPISODES", 1)
    monkeypatch.setattr(rl_suite, "TEST_EPISODES", 1)
    rl_results.PAGE.write_text(PAGE, encoding="utf-8")
    settings = {"n_steps": 16, "batch_size": 16}
    tasks = [
        rl_suite.Training("iits_mj/HillStart-v0", "ppo", seed, 32, 1, 1, None, settings)
        for seed in (0, 1)
    ]
    for task in tasks:
        # Another machine: only the tables and the weights are left of the first training.
        out = tmp_path / f"out-{task.seed}"
        assert not rl_suite.recorded(task)
        rl_suite.train(task, out / task.name)
        rl_suite.results(out)
    assert all(rl_suite.recorded(task) for task in tasks)
    assert [row["seed"] for row in rl_results.read("scores")] == ["0", "1"]
    shipped = rl_suite.shipped_file("iits_mj/HillStart-v0", "ppo")
    metadata = Policy.load(shipped).metadata
    assert (metadata["seed"], metadata["return"]) == ("0", rl_results.read("scores")[0]["return"])
    assert "pending (2 of 5)" in rl_results.PAGE.read_text(encoding="utf-8")
    # With more steps, or without the policy of seed 0, a training is to be done.
    longer = [rl_suite.Training(task.environment, "ppo", task.seed, 64, 1) for task in tasks]
    assert not any(rl_suite.recorded(task) for task in longer)
    shipped.unlink()
    assert [rl_suite.recorded(task) for task in tasks] == [False, True]


def test_an_incomplete_cell_is_pending_with_its_seeds():
    rows = [
        {"environment": "iits_mj/Stop-v0", "method": "ppo", "seed": f"{seed}", "return": "3"}
        for seed in range(2)
    ]
    line = next(x for x in rl_results.score_table(rows).splitlines() if "Stop-v0" in x)
    assert "3 [3, 3] pending (2 of 5)" in line
    assert "pending (0 of 1)" in line


def test_a_variant_is_trained_although_the_tables_have_the_training(tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr(rl_suite, "recorded", lambda task: True)
    monkeypatch.setattr(rl_suite, "score_fixed", lambda *_: None)
    monkeypatch.setattr(rl_suite, "train", lambda task, folder: trained.append(task))
    command = ["rl_suite", "train", "--out", f"{tmp_path}", "--only", "Stop", "--seeds", "0"]
    monkeypatch.setattr("sys.argv", command)
    rl_suite.main()
    assert trained == []
    monkeypatch.setattr("sys.argv", [*command, "--algorithms", "ppo", "--set", "gamma=0.9"])
    rl_suite.main()
    assert [task.hyperparameters["gamma"] for task in trained] == [0.9]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train", "--only", "Stpo"], "--only Stpo: must be of Cruise, CutIn, Dock"),
        (["train", "--only", "Stop", "--algorithms", "dqn"], "no training has"),
        (["levels", "--steps", "5"], "--steps, --set and --plant are of train"),
    ],
)
def test_a_wrong_choice_of_trainings_is_refused(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["rl_suite", *arguments, "--out", f"{tmp_path}"])
    with pytest.raises(SystemExit):
        rl_suite.main()
    assert said in capsys.readouterr().err
