"""Methods beside the lower hull of the rules at the same number of lane changes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.own_parts import DECISION
from iits_mj.evaluation.evaluate import EvaluateConfig, tasks_of
from iits_mj.evaluation.figures import figures, hull_means
from iits_mj.evaluation.hulls import (
    SWEEP,
    Point,
    against_hull,
    family,
    is_hull_rule,
    lower_hull,
    mean_over_cells,
)
from tests.evaluation.rows_of import task, trial


def trips(method, losses, changes, cell=("dense", 12.5)):
    """Trials of a method: losses [%] and lane changes by seed."""
    return tuple(
        trial(task(method, seed, cell), 0.01 * loss, count)
        for seed, (loss, count) in enumerate(zip(losses, changes, strict=True))
    )


@given(
    st.lists(st.tuples(st.integers(0, 20), st.floats(0.0, 50.0, allow_subnormal=False)), min_size=1)
)
def test_no_rule_lies_below_the_hull_and_the_hull_is_convex(values):
    known = [Point("mobil", float(c), loss) for c, loss in values]
    known.sort(key=lambda point: (point.changes, point.loss))
    hull = lower_hull(known)
    assert hull[0].changes == known[0].changes
    assert hull[-1].loss == min(point.loss for point in known)
    places = [point.changes for point in hull]
    losses = [point.loss for point in hull]
    for point in known:
        assert point.loss >= np.interp(point.changes, places, losses) - 1e-9
    slopes = np.diff(losses) / np.diff(places)
    assert (slopes < 0.0).all()
    assert (np.diff(slopes) >= -1e-9).all()


def test_a_method_is_compared_with_the_mixture_of_two_rules():
    both = {
        "keep": trips("keep", [30.0, 32.0, 34.0], [0, 0, 0]),
        "mobil": trips("mobil", [10.0, 12.0, 14.0], [4, 4, 4]),
        "lookahead": trips("lookahead", [9.0, 11.0, 13.0], [8, 8, 8]),
        "ddqn": trips("ddqn", [9.0, 11.0, 13.0], [6, 6, 6]),
    }
    found = against_hull(both, "ddqn")
    assert found.ends == ("mobil", "lookahead")
    assert (found.changes, found.loss) == pytest.approx((6.0, 11.0))
    # Halfway between 12 and 11 %; every trip is 0.5 points better.
    assert found.hull == pytest.approx(11.5)
    assert found.difference.mean == pytest.approx(-0.5)
    assert found.difference.half == pytest.approx(0.0, abs=1e-9)


def test_the_difference_is_that_of_the_means_whatever_the_changes_of_each_trip():
    generator = np.random.default_rng(3)

    def some(method, loss, changes):
        return trips(
            method, loss + generator.normal(0.0, 2.0, 40), generator.poisson(changes, 40).tolist()
        )

    both = {
        "keep": some("keep", 30.0, 0.0),
        "mobil:threshold=0.4": some("mobil:threshold=0.4", 12.0, 4.0),
        "lookahead": some("lookahead", 9.0, 8.0),
        "ddqn": some("ddqn", 9.0, 6.0),
    }
    found = against_hull(both, "ddqn")
    assert found.difference.mean == pytest.approx(found.loss - found.hull)
    # The spread of the changes counts, too: 0.75 points for a change of the hull.
    losses = [100.0 * t.speed_loss for t in both["ddqn"]]
    changes = [t.changes for t in both["ddqn"]]
    assert found.difference.std > 0.8 * np.std(np.array(losses) + 0.75 * np.array(changes))


def test_a_method_with_more_changes_than_the_best_rule_is_compared_with_that_rule():
    both = {
        "keep": trips("keep", [30.0, 30.0], [0, 0]),
        "mobil": trips("mobil", [10.0, 12.0], [4, 4]),
        "ddqn": trips("ddqn", [10.0, 13.0], [9, 9]),
    }
    found = against_hull(both, "ddqn")
    assert found.ends == ("mobil",)
    assert found.difference.mean == pytest.approx(0.5)


def test_there_is_no_comparison_without_rules_common_trips_or_as_few_changes():
    rules = {"mobil": trips("mobil", [10.0], [4]), "lookahead": trips("lookahead", [9.0], [6])}
    assert against_hull({"ddqn": trips("ddqn", [9.0], [5])}, "ddqn") is None
    assert against_hull(rules, "ddqn") is None
    assert against_hull({**rules, "ddqn": trips("ddqn", [9.0], [3])}, "ddqn") is None
    other = tuple(replace(t, seed=7) for t in trips("ddqn", [9.0], [5]))
    assert against_hull({**rules, "ddqn": other}, "ddqn") is None


def test_the_mean_of_independent_cells_has_a_narrower_interval():
    def cell(name, shift):
        return {
            "keep": trips("keep", [30.0] * 4, [0] * 4),
            "mobil": trips("mobil", [10.0] * 4, [4] * 4),
            "ddqn": trips("ddqn", [10.0 + shift + d for d in (-0.2, 0.2, -0.1, 0.1)], [4] * 4),
        }

    found = [against_hull(cell(name, shift), "ddqn") for name, shift in (("a", 0.5), ("b", -1.5))]
    mean = mean_over_cells(found)
    assert mean.mean == pytest.approx(-0.5)
    assert mean.half == pytest.approx(found[0].difference.half / math.sqrt(2.0))
    assert math.isnan(mean_over_cells([]).mean)


def test_the_sweep_has_rules_of_four_families_with_normal_names():
    for name in SWEEP:
        DECISION.check(name)
        assert is_hull_rule(DECISION.normal_name(name))
    families = {family(DECISION.normal_name(name)) for name in SWEEP}
    assert families == {"keep", "mobil", "lookahead 14 s", "lookahead 30 s", "lookahead 60 s"}


def test_the_sweep_adds_trials_that_no_table_of_methods_shows():
    config = EvaluateConfig(trials=2, methods="ddqn,mobil", cells="dense-12.5")
    swept = replace(config, sweep=True)
    assert set(tasks_of(config)) < set(tasks_of(swept))
    # The default look-ahead and MOBIL are points of the sweep.
    assert len(swept.driven()) == len(SWEEP) + 1
    rows = [
        trial(one, 0.2 if one.method == "keep" else 0.1, 0 if one.method == "keep" else 3)
        for one in tasks_of(swept)
    ]
    (cell,) = figures(rows, swept.chosen_cells(), swept.names())
    assert set(cell.trials) == {"ddqn", "mobil"}
    assert len(cell.swept) == len(SWEEP) - 1
    assert [one.method for one in cell.comparisons] == ["ddqn"]
    assert hull_means([cell])["ddqn"].mean == pytest.approx(0.0)
