"""Long runs of powertrain and air brake give the signals of the accepted version.

After a wanted change of a law, `python -m tests.plugin.laws_runs` writes the new signals; the
difference of the file shows what the change did.
"""

import csv

import numpy as np
import pytest

from tests.plugin.laws_runs import LADEN, REFERENCE, STOPS, drive, runs, stop


@pytest.fixture(scope="module")
def signals():
    return runs()


def test_runs_have_the_accepted_signals(signals):
    with REFERENCE.open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == sum(run.shape[1] for run in signals.values())
    for row in rows:
        signal = signals[row["run"]][:, int(row["signal"])]
        scale = np.abs(signal).max()
        expected = [float(row[name]) for name in ("mean", "deviation", "end")]
        found = [signal.mean(), signal.std(), signal[-1]]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-7 * scale), row


def test_runs_reach_every_gear_and_abs(signals):
    assert {0, 1, 2, 3, 4, 5} <= set(signals["laden adaptive"][:, 7])
    assert -1 in signals["laden tables"][:, 7]
    for name in ("wet", "split"):
        assert signals[name][:, 4].any()
    assert not signals["dry"][:, 4].any()


def test_stop_on_a_slippery_road_uses_most_of_its_friction(signals):
    speed = signals["wet"][:, 0]
    assert (15 - speed[60]) / (0.05 * 61 - 0.4) > 0.85 * 0.3 * 9.81


def test_runs_hardly_depend_on_the_time_step():
    for half, whole in (
        (drive(0, LADEN[:1], h=0.001)[:, 10:11], drive(0, LADEN[:1])[:, 10:11]),
        (stop(*STOPS["dry"], h=0.001), stop(*STOPS["dry"])),
    ):
        assert half[:, 0].mean() == pytest.approx(whole[:, 0].mean(), rel=0.01)


@pytest.mark.parametrize("name", ["dry", "split"])
def test_brake_gives_the_same_at_another_step_than_expected_and_computed_twice(name, signals):
    assert (stop(*STOPS[name], repeat=2) == signals[name]).all()
    assert (
        stop(*STOPS[name], prepared=0.002, h=0.001)[:, 0] == stop(*STOPS[name], h=0.001)[:, 0]
    ).all()


def test_release_of_the_spring_brakes_takes_air_of_the_circuits_that_have_them(signals):
    # Reservoirs of front, driven and trailer axles, before and after the release.
    before, after = signals["parked"][[59, 79], 6:9]
    assert (after < before).tolist() == [False, True, True]
