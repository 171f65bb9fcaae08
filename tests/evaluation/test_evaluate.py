"""Trials of decision makers: paired seeds, interrupted runs, several processes."""

import csv
import functools
import itertools
import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from controllers.decision import trip
from controllers.decision.policy import SHIPPED, QNetwork
from controllers.decision.prices import Prices
from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.process_pool import TasksError, run_all
from iits_mj.evaluation import drives, trials
from iits_mj.evaluation.evaluate import (
    EvaluateConfig,
    describe,
    run,
    tasks_of,
    trial_seed,
)
from iits_mj.validation.harness import run_cache
from tests.evaluation.rows_of import die_once, task, trial
from tests.paths import ROOT

CONFIG = EvaluateConfig(trials=2, methods="keep,aggressive", cells="dense-12.5,medium-15")


class Fake:
    """Replaces the drives by artificial trials; some fail."""

    def __init__(self, faulty=(), order=None):
        self.driven, self.faulty, self.order = [], faulty, order

    def __call__(self, tasks, jobs, drive, keep):
        for asked in self.order(tasks) if self.order else tasks:
            if asked.seed in self.faulty:
                raise TrafficError("SUMO fell over")
            self.driven.append(asked)
            keep(trial(asked, 0.1 + 1e-4 * (asked.seed % 7), code=drives.trial_code(asked.world)))


def test_digest_of_fast_trials_covers_every_module_of_the_fast_world(tmp_path):
    assert drives.trial_code("fast") != drives.trial_code("full")
    for name in ("__init__.py", "env.py", "changes.py"):
        (tmp_path / name).write_text("")
    package = ModuleType("package")
    package.__path__, package.__file__ = [str(tmp_path)], str(tmp_path / "__init__.py")
    before = run_cache.drive_digest(package)
    (tmp_path / "changes.py").write_text("MARGIN = 3.0")
    assert run_cache.drive_digest(package) != before


def test_kinds_of_seeds_do_not_overlap():
    starts = (trip.TRAINING_SEEDS, trip.VALIDATION_SEEDS, trip.TEST_SEEDS)
    assert all(b - a >= trip.SEEDS_EACH for a, b in itertools.pairwise(starts))
    for kind, start in (("validation", starts[1]), ("test", starts[2])):
        config = EvaluateConfig(seeds=kind, seed=9)
        assert trial_seed(0, 0, replace(config, seed=0)) == start
        assert trial_seed(5, 999, config) < start + trip.SEEDS_EACH


def test_all_methods_have_the_same_traffic_in_each_trial():
    driven = [t for t in tasks_of(CONFIG) if t.density != "empty"]
    assert len(driven) == len(set(driven)) == 2 * 2 * 2
    by_method = {name: [t.seed for t in driven if t.method == name] for name in CONFIG.names()}
    assert by_method["keep"] == by_method["aggressive"]
    assert len({t.seed for t in driven}) == 4
    # All cells and methods of the first trial come before the second.
    first = driven[:4]
    assert {(t.density, t.method) for t in first} == {
        (density, name) for density in ("dense", "medium") for name in CONFIG.names()
    }
    assert {t.seed % 1000 for t in first} == {0}


def test_free_road_is_driven_once_for_each_speed():
    free = [t for t in tasks_of(CONFIG) if t.density == "empty"]
    assert [(t.traffic_speed, t.method) for t in free] == [(12.5, "keep"), (15.0, "keep")]


def test_a_rule_with_options_is_a_method_of_its_own():
    texts = "lookahead,lookahead:change_cost=25:horizon=30,mobil:threshold=0.40,politeness=0.2"
    config = EvaluateConfig(methods=f"{texts},lookahead:horizon=30.0,change_cost=25", trials=1)
    names = ("lookahead", "lookahead:horizon=30:change_cost=25", "mobil:threshold=0.4")
    assert config.names() == names
    tasks = [t for t in tasks_of(config) if t.density != "empty"]
    assert {(t.method, t.weights) for t in tasks} == {(name, "") for name in names}


def test_trials_in_the_file_are_not_driven_again(tmp_path):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    first, second = Fake(), Fake()
    made = run(config, drive_all=first)
    assert run(config, drive_all=second) == made
    assert first.driven == tasks_of(config)
    assert second.driven == []
    more = Fake()
    run(replace(config, trials=3), drive_all=more)
    assert {t.seed % 1000 for t in more.driven} == {2}


def test_trials_before_a_fault_are_kept(tmp_path):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    bad = tasks_of(config)[-1].seed
    with pytest.raises(TrafficError, match="SUMO fell over"):
        run(config, drive_all=Fake(faulty=(bad,)))
    rest = Fake()
    assert [t.task for t in run(config, drive_all=rest)] == tasks_of(config)
    assert {t.seed for t in rest.driven} == {bad}


@pytest.mark.parametrize("cut", [1, 3, 17, 60])
def test_incomplete_last_row_is_removed_with_a_message_and_driven_again(tmp_path, cut):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    run(config, drive_all=Fake())
    whole = config.file.read_bytes()
    config.file.write_bytes(whole[:-cut])
    messages, again = [], Fake()
    run(config, say=messages.append, drive_all=again)
    assert len(again.driven) == 1
    assert "ended with an incomplete row" in messages[0]
    assert config.file.read_bytes() == whole


def test_trials_of_earlier_versions_are_read_and_get_the_new_columns(tmp_path):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    made = run(config, drive_all=Fake())
    whole = config.file.read_bytes()
    with config.file.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    columns = list(rows[0])
    old = columns[: columns.index("code") + 1]
    old.remove("lane_discipline")
    with config.file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, old, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    # The last row was cut off by a kill.
    config.file.write_bytes(config.file.read_bytes()[:-7])
    again = Fake()
    found = run(config, say=lambda text: None, drive_all=again)
    assert len(again.driven) == 1
    assert [t.task for t in found] == [t.task for t in made]
    unknown = [math.isnan(t.imposed_brakings) for t in found]
    assert unknown.count(False) == 1
    # The new file has the columns of this version.
    assert config.file.read_bytes().split(b"\n")[0] == whole.split(b"\n")[0]


def test_traffic_that_keeps_right_has_trials_of_its_own():
    right = replace(CONFIG, lane_discipline="right")
    assert not set(tasks_of(CONFIG)) & set(tasks_of(right))
    config = replace(right, world="fast", cells="medium-15", methods="keep", length=3_000.0)
    free, kept = (
        drives.drive(next(t for t in tasks_of(c) if t.density == "medium"))
        for c in (replace(config, lane_discipline="free"), config)
    )
    assert free.distance != kept.distance
    assert free.right_share == kept.right_share == 1.0


def test_a_truck_that_keeps_right_has_trials_of_its_own_and_drives_on_the_right():
    cell = replace(CONFIG, world="fast", cells="sparse-12.5", methods="mobil", length=15_000.0)
    off, on = (
        replace(cell, lane_discipline="right", keep_right=keep_right, duration=3_000.0)
        for keep_right in ("off", "on")
    )
    assert not set(tasks_of(off)) & set(tasks_of(on))
    before, after = (
        drives.drive(next(t for t in tasks_of(config) if t.density == "sparse"))
        for config in (off, on)
    )
    assert before.right_share < 0.4
    assert after.right_share > 0.6
    assert after.changes > before.changes
    assert after.collisions == 0


def test_incomplete_header_counts_as_an_empty_file(tmp_path):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    config.file.write_text("world,dens")
    assert len(run(config, say=lambda text: None, drive_all=Fake())) == len(tasks_of(config))


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "a,b", "half a line"])
def test_a_foreign_file_is_refused_and_left_as_it_is(tmp_path, text):
    path = tmp_path / "other.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="not a file of trials"):
        run(replace(CONFIG, file=path), drive_all=Fake())
    assert path.read_text() == text


def test_file_does_not_depend_on_the_order_of_the_trials(tmp_path):
    def content(order):
        path = tmp_path / "trials.csv"
        path.unlink(missing_ok=True)
        run(replace(CONFIG, file=path), drive_all=Fake(order=order))
        return path.read_bytes()

    assert content(lambda tasks: tasks) == content(lambda tasks: tasks[::-1])


def test_other_weights_are_driven_and_the_rules_are_kept(tmp_path):
    config = EvaluateConfig(
        trials=1, methods="aggressive,ddqn", cells="dense-12.5", file=tmp_path / "trials.csv"
    )
    run(config, drive_all=Fake())
    policy = tmp_path / "policy.npz"
    QNetwork.random(np.random.default_rng(0)).save(policy)
    other = Fake()
    rows = run(replace(config, weights=policy), drive_all=other)
    assert [(t.method, t.weights) for t in other.driven] == [
        ("ddqn", trials.weights_digest("ddqn", policy))
    ]
    assert {t.method for t in rows} == {"keep", "aggressive", "ddqn"}
    # The rows of the first policy are kept.
    assert len(trials.read_trials(config.file, print)) == 4
    assert trials.weights_digest("aggressive", policy) == ""
    assert trials.weights_digest("ddqn", None) == trials.weights_digest("ddqn", SHIPPED)


def test_each_price_of_a_lane_change_is_a_policy_of_its_own(tmp_path):
    config = EvaluateConfig(
        trials=1, methods="mobil,ddqn", cells="dense-12.5", file=tmp_path / "trials.csv"
    )
    for price in (None, 60.0, 250.0):
        run(replace(config, lane_change_price=price), drive_all=Fake())
    rows = trials.read_trials(config.file, print)
    digests = {row.weights for row in rows if row.method == "ddqn"}
    assert len(digests) == 3
    assert sum(row.method == "mobil" for row in rows) == 1
    asked = task("ddqn", 0, weights=trials.weights_digest("ddqn", None, Prices(60.0)))
    with pytest.raises(InputError, match="has changed since"):
        drives.drive(asked, prices=Prices(61.0))


def test_weights_that_cannot_drive_are_refused_before_the_first_trial(tmp_path):
    policy = tmp_path / "policy.npz"
    policy.write_bytes(b"no weights")
    config = EvaluateConfig(trials=1, methods="keep,ddqn", weights=policy, jobs=1)
    idle = Fake()
    with pytest.raises(InputError, match=r"policy\.npz.* cannot be read"):
        run(config, drive_all=idle)
    assert idle.driven == []
    # Without the method ddqn the policy is not read.
    assert len(run(replace(config, methods="keep"), drive_all=idle)) == len(idle.driven) > 0


def test_weights_that_change_while_trials_are_driven_are_refused(tmp_path):
    policy = tmp_path / "policy.npz"
    policy.write_bytes(b"one")
    asked = task("ddqn", 0, weights=trials.weights_digest("ddqn", policy))
    policy.write_bytes(b"two")
    with pytest.raises(InputError, match="has changed since the trials were planned"):
        drives.drive(asked, policy)


def test_no_drive_uses_only_the_trials_of_the_file(tmp_path):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    run(replace(config, trials=1), drive_all=Fake())
    idle = Fake()
    assert len(run(replace(config, drive=False), drive_all=idle)) == 2 + 4
    assert idle.driven == []
    with pytest.raises(InputError, match="name it by --file"):
        run(replace(CONFIG, drive=False), drive_all=idle)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"methods": "best"}, "decision maker 'best' is not known"),
        ({"methods": "keep:gap=2"}, "'keep' is a shipped one, without options"),
        ({"methods": "mobil:threshold=nan"}, "threshold is nan: a finite number"),
        ({"methods": "horizon=30"}, "decision maker 'horizon=30' is not known"),
        ({"cells": "dense-13"}, "cell .dense-13. is not known .* use one of: dense-12.5"),
        ({"seed": 10}, "seed 10 is not allowed; use 0 to 9"),
        ({"weights": SHIPPED.with_name("none.npz")}, "cannot be read"),
    ],
)
def test_unusable_settings_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        tasks_of(EvaluateConfig(**settings))


def _threads(tasks, drive, keep):
    run_all(tasks, 2, drive, keep, describe, what="trials", make_pool=ThreadPoolExecutor)


def test_a_trial_that_fails_is_left_out_and_named_at_the_end():
    tasks = [task("keep", seed) for seed in range(6)]
    kept = []

    def drive(asked):
        if asked.seed in (1, 4):
            raise TrafficError("SUMO fell over")
        return trial(asked, 0.1)

    with pytest.raises(TasksError, match=r"2 trials .* seed 1: SUMO fell over"):
        _threads(tasks, drive, kept.append)
    assert sorted(t.seed for t in kept) == [0, 2, 3, 5]


def test_many_failures_end_the_run():
    tasks = [task("keep", seed) for seed in range(50)]
    count = itertools.count()

    def drive(asked):
        next(count)
        time.sleep(0.01)
        raise TrafficError("SUMO is missing")

    with pytest.raises(TasksError, match="5 trials could not be done"):
        _threads(tasks, drive, print)
    assert next(count) < 50


def test_unwritable_file_ends_the_run_with_its_own_error():
    def keep(row):
        raise InputError("the disk is full")

    with pytest.raises(InputError, match=r"^the disk is full$"):
        _threads([task("keep", 0)], lambda asked: trial(asked, 0.1), keep)


def test_a_process_that_dies_loses_no_trial(tmp_path):
    kept = []
    run_all(
        [task("keep", seed) for seed in range(6)],
        2,
        functools.partial(die_once, tmp_path / "died"),
        kept.append,
        describe,
        what="trials",
    )
    assert sorted(t.seed for t in kept) == list(range(6))
    assert (tmp_path / "died").exists()


def test_two_runs_cannot_use_one_file_at_a_time(tmp_path):
    config = replace(CONFIG, file=tmp_path / "trials.csv")
    with (
        trials.locked(config.file),
        pytest.raises(InputError, match="in use by another evaluate"),
    ):
        run(config, drive_all=Fake())
    assert len(run(config, drive_all=Fake())) == len(tasks_of(config))
    assert [path.name for path in tmp_path.iterdir()] == ["trials.csv"]


def test_real_trials_in_two_processes_equal_those_of_one_process(tmp_path):
    def rows(jobs):
        config = EvaluateConfig(
            trials=1,
            methods="ddqn",
            cells="dense-15",
            duration=10.0,
            jobs=jobs,
            file=tmp_path / f"{jobs}.csv",
        )
        run(config)
        with config.file.open(newline="") as stream:
            return [row | {"wall_time": ""} for row in csv.DictReader(stream)]

    two = rows(2)
    assert two == rows(1)
    assert [row["density"] for row in two] == ["dense", "empty"]
    loss = [float(row["speed_loss"]) for row in two]
    # The speed is 15 m/s at the start, the reference 16.67 m/s.
    assert all(0.0 < value < 0.101 for value in loss)
    assert all(row["ended"] == "reached the end of the time" for row in two)
    way = [float(row["distance"]) for row in two]
    assert loss == pytest.approx([1.0 - d / 10.0 / (60.0 / 3.6) for d in way])


def test_a_row_that_does_not_fit_on_the_disk_leaves_the_file_whole(tmp_path, full_disk):
    path = tmp_path / "trials.csv"
    trials.write_trials(path, [trial(task("keep", 1), 0.1)])
    whole = path.read_bytes()
    with full_disk(len(whole) + 20), pytest.raises(InputError, match=r"trials.csv' cannot be wri"):
        trials.append_trial(path, trial(task("keep", 2), 0.1))
    assert path.read_bytes() == whole


def test_an_own_decision_maker_is_compared_in_several_processes(monkeypatch, tmp_path):
    monkeypatch.chdir(ROOT)
    own = "examples/own_decision.py:Impatient:room=30"
    settings = {"methods": f"keep,{own}", "trials": 2, "length": 500.0, "cells": "dense-12.5"}
    file = tmp_path / "trials.csv"
    config = EvaluateConfig(world="fast", jobs=2, file=file, **settings)
    trials = [trial for trial in run(config) if trial.method == own]
    assert [len(trial.weights) for trial in trials] == [12, 12]
    kept = run(replace(config, drive=False))[-1]
    assert (kept.task, kept.speed_loss) == (trials[-1].task, trials[-1].speed_loss)
    with pytest.raises(InputError, match=r"decision maker .* has no 'Impatent' \(did you mean"):
        EvaluateConfig(methods="keep,examples/own_decision.py:Impatent")
