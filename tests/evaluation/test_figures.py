"""Statistics of paired trips against hand values and SciPy; verdicts; checks."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import stats

from controllers.decision.trip import CELLS
from iits_mj.evaluation.evaluate import EvaluateConfig
from iits_mj.evaluation.figures import figures, over_all, summarize
from iits_mj.evaluation.trials import LEFT_RANGE
from iits_mj.validation.harness.statistics import estimate, half_width, holm, paired
from tests.evaluation.rows_of import rows, task, trial

CELL = (("dense", 12.5),)
FOUR = ("conservative", "neutral", "aggressive", "ddqn")


def spread(mean, count=12, step=1e-3):
    """Different losses around a mean, with different differences between two means."""
    return [mean + step * (i - 0.5 * (count - 1)) + 1e-6 * mean * i**2 for i in range(count)]


def judged(losses, floor=0.01, **settings):
    (cell,) = figures(rows(losses, floor=floor, **settings), CELL, FOUR)
    return cell


def test_interval_is_students():
    known = estimate([1.0, 2.0, 3.0, 4.0])
    assert known.std == pytest.approx(math.sqrt(5.0 / 3.0))
    # 3.182446 is the 97.5 % quantile of 3 degrees of freedom.
    assert known.half == pytest.approx(3.182446 * known.std / 2.0, rel=1e-6)
    assert (known.low, known.high) == (2.5 - known.half, 2.5 + known.half)
    assert half_width(np.array([1.0])) == 0.0
    assert estimate([1.0]).half == math.inf
    assert estimate([]).count == 0


def test_paired_tests_agree_with_scipy():
    generator = np.random.default_rng(1)
    a, b = generator.normal(0.0, 1.0, 30), generator.normal(0.4, 1.0, 30)
    difference = paired(a, b)
    assert difference.mean == pytest.approx(a.mean() - b.mean())
    assert difference.t_p == pytest.approx(stats.ttest_rel(a, b).pvalue)
    assert difference.wilcoxon_p == pytest.approx(stats.wilcoxon(a, b).pvalue)
    interval = stats.ttest_rel(a, b).confidence_interval()
    assert (difference.low, difference.high) == pytest.approx(tuple(interval))


def test_one_trip_or_equal_trips_have_a_p_of_one():
    for a, b in (([1.0], [2.0]), ([1.0, 2.0], [1.0, 2.0])):
        assert (paired(a, b).t_p, paired(a, b).wilcoxon_p) == (1.0, 1.0)


def test_holm_by_hand():
    # 3 x 0.01, 2 x 0.03; the last value is at least the one before it.
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_the_policy_wins_when_it_is_lowest_beyond_chance():
    losses = dict(zip(FOUR, map(spread, (0.30, 0.27, 0.25, 0.23)), strict=True))
    cell = judged(losses)
    assert (cell.verdict, cell.best) == ("wins", "aggressive")
    assert cell.against["aggressive"].mean == pytest.approx(-2.0, abs=1e-3)
    assert cell.room == pytest.approx(24.0, abs=0.01)


def test_the_policy_loses_when_a_rule_is_lower_beyond_chance():
    losses = dict(zip(FOUR, map(spread, (0.30, 0.27, 0.25, 0.26)), strict=True))
    assert judged(losses).verdict == "loses"
    # Also without trials of the free road.
    assert judged(losses, floor=math.nan).verdict == "loses"


def test_pairs_have_the_same_traffic_in_any_order_of_rows():
    made = rows({"aggressive": spread(0.25), "ddqn": spread(0.24)})
    (cell,) = figures(made[::-1], CELL, FOUR)
    difference = cell.against["aggressive"]
    # The traffic explains all of the spread: the difference has none.
    assert difference.std == pytest.approx(0.0, abs=1e-4)
    missing = [t for t in made if (t.method, t.seed) != ("aggressive", 0)]
    (cell,) = figures(missing, CELL, FOUR)
    assert (cell.against["aggressive"].count, cell.loss["ddqn"].count) == (11, 12)


def test_cell_without_room_is_trivial_and_only_bounds_the_loss():
    losses = dict(zip(FOUR, map(spread, (0.013, 0.0125, 0.0125, 0.014)), strict=True))
    cell = judged(losses, floor=0.01)
    assert cell.trivial
    assert "0.25 points are all that is left" in cell.reason
    results, _ = summarize(rows(losses, floor=0.01), EvaluateConfig(trials=12))
    bounds = {c.name: c.must for c in results.checks if "ddqn less neutral" in c.name}
    assert list(bounds.values()) == ["<= 0.3", ""]


def test_trips_beyond_the_range_of_their_plant_are_counted():
    made = rows({"aggressive": spread(0.25), "ddqn": spread(0.24)})
    plain, _ = summarize(made, EvaluateConfig(trials=12))
    ended = f"reached the end of the route{LEFT_RANGE}a wheel has lifted off the road"
    left = [dataclasses.replace(made[0], ended=ended), *made[1:]]
    results, _ = summarize(left, EvaluateConfig(trials=12))
    (note,) = set(results.notes) - set(plain.notes)
    assert note == f"in 1 of {len(made)} trips the plant left its valid range"


def test_policy_loses_a_cell_without_room_if_it_is_much_worse():
    losses = dict(zip(FOUR, map(spread, (0.013, 0.0125, 0.0125, 0.035)), strict=True))
    assert judged(losses, floor=0.01).verdict == "loses"


def noise(mean, number, count=12):
    """Random losses with a given mean."""
    drawn = np.random.default_rng(number).normal(0.0, 0.05, count)
    return list(mean + drawn - drawn.mean())


def test_difference_within_chance_is_level_and_not_trivial():
    losses = {name: noise(0.25, number) for number, name in enumerate(FOUR)}
    cell = judged(losses)
    assert cell.verdict == "level"
    assert cell.winnable
    few = {name: own[:3] for name, own in losses.items()}
    assert judged(few).verdict == "too few trips"


@pytest.mark.parametrize(("best", "winnable"), [(0.24, False), (0.15, True)])
def test_cell_is_winnable_if_a_stronger_rule_wins(best, winnable):
    losses = {name: noise(0.25, number) for number, name in enumerate(FOUR)}
    losses |= {"mobil": noise(0.26, 7), "lookahead": noise(best, 8)}
    made = rows(losses, floor=0.01)
    results, (cell,) = summarize(made, EvaluateConfig(trials=12, cells="dense-12.5"))
    assert (cell.verdict, cell.winnable) == ("level", winnable)
    assert cell.stronger["lookahead"].mean == pytest.approx(100.0 * (best - 0.25))
    checks = [c for c in results.checks if "speed loss, ddqn less" in c.name][:2]
    # The lowest mean is always required, significance only in a winnable cell.
    assert [c.must for c in checks] == ["< 0", "< 0.05" if winnable else ""]
    assert ("more to win" in cell.reason) is winnable
    assert ("no stronger rule wins" in cell.reason) is not winnable


def test_checks_state_the_claims_of_every_cell():
    made = []
    for cell in CELLS:
        losses = {name: spread(0.25) for name in FOUR[:3]} | {
            "ddqn": spread(0.24),
            "lookahead": spread(0.23),
        }
        made += rows(losses, cell, changes={"ddqn": 4})
    made.append(trial(task("neutral", 99), 0.25, collisions=1, failures=1))
    config = EvaluateConfig(trials=12)
    results, cells = summarize(made, config)
    checks = {c.name: c for c in results.checks}
    assert len(cells) == 6
    claim = checks["medium 15: speed loss, ddqn less conservative"]
    assert (claim.value, claim.ok) == (pytest.approx(-1.0, abs=1e-3), True)
    assert checks["medium 15: speed loss, ddqn less conservative, p"].ok
    assert not checks["medium 15: lane changes, ddqn less aggressive"].ok
    assert not checks["dense 12.5, neutral: collisions"].ok
    level = over_all(cells, "ddqn", "lookahead")
    assert (level.mean, level.count) == (pytest.approx(1.0, abs=1e-3), 72)
    assert not checks["all cells: speed loss, ddqn less lookahead, lower end of the interval"].ok
    assert max(map(len, results.notes[1:])) <= 110


def test_policy_is_level_if_it_is_not_worse_by_more_than_chance():
    made = rows({"ddqn": [0.2, 0.3, 0.25], "lookahead": [0.21, 0.27, 0.25]})
    results, _ = summarize(made, EvaluateConfig(trials=3, cells="dense-12.5"))
    checks = {c.name: c for c in results.checks}
    assert checks["all cells: speed loss, ddqn less lookahead"].value > 0.0
    assert checks["all cells: speed loss, ddqn less lookahead, lower end of the interval"].ok
