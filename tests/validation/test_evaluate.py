"""The table of decision makers: paired, resumable, honest about its intervals."""

from dataclasses import replace

import numpy as np
import pytest

from iits_mj.errors import InputError
from iits_mj.validation import evaluate, trials
from iits_mj.validation.evaluate import EvaluateConfig, half_width, run, summarize

CONFIG = EvaluateConfig(trials=2, methods="keep,aggressive", length=600.0)


def test_all_methods_meet_the_same_seeds_outside_training(tmp_path):
    path = tmp_path / "trials.csv"
    run(replace(CONFIG, file=path))
    rows = trials.read_trials(path)
    seeds = {name: sorted(t.seed for t in rows if t.method == name) for name in CONFIG.names()}
    assert seeds["keep"] == seeds["aggressive"]
    assert min(seeds["keep"]) >= 3_000_000
    assert len(rows) == 2 * 2 * 6


def test_what_is_in_the_file_is_not_driven_again(tmp_path, monkeypatch):
    path = tmp_path / "trials.csv"
    first = run(replace(CONFIG, file=path))

    def fail(*arguments):
        raise AssertionError("driven again")

    monkeypatch.setattr(evaluate, "_drive", fail)
    second = run(replace(CONFIG, file=path))
    assert [c.value for c in second.checks] == pytest.approx([c.value for c in first.checks])


def test_a_torn_last_row_is_driven_again(tmp_path):
    path = tmp_path / "trials.csv"
    run(replace(CONFIG, file=path))
    whole = path.read_text()
    path.write_text(whole[:-40])
    run(replace(CONFIG, file=path))
    assert sorted(path.read_text().splitlines()) == sorted(whole.splitlines())


def test_half_width_is_students():
    values = np.array([1.0, 2.0, 3.0, 4.0])
    assert half_width(values) == pytest.approx(3.182446 * values.std(ddof=1) / 2.0, rel=1e-5)
    assert half_width(np.array([1.0])) == 0.0


def test_claims_compare_ddqn_with_the_best_rule_trip_by_trip():
    rows = []
    for density, speed in trials.CELLS:
        for name, losses, changes in (
            ("aggressive", (0.10, 0.20), 5),
            ("ddqn", (0.08, 0.19), 6),
        ):
            rows += [
                trials.Trial(
                    "fast", density, speed, name, i, loss, changes, 0, 0, 1.0, 1.0, 1.0, np.nan
                )
                for i, loss in enumerate(losses)
            ]
    results = summarize(rows, EvaluateConfig(trials=2, methods="aggressive,ddqn"))
    by_name = {c.name: c for c in results.checks}
    difference = by_name["dense 12.5: speed loss, ddqn less aggressive, paired"]
    assert difference.value == pytest.approx(-1.5)
    assert difference.ok
    assert not by_name["dense 12.5: lane changes, ddqn less aggressive"].ok


def test_unknown_methods_are_refused():
    with pytest.raises(InputError, match="method 'best' is unknown"):
        EvaluateConfig(methods="best")


def test_a_foreign_file_of_trials_is_refused(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="not a file of trials"):
        run(replace(CONFIG, file=path))
    assert path.read_text() == "a,b\n1,2\n"
