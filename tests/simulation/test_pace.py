"""Soft real time counts every tick and skips none."""

from __future__ import annotations

import pytest

from iits_mj.core.errors import InputError
from iits_mj.simulation.server import Pace


class Clock:
    """A clock that advances by sleep and work; a sleep ends a little late."""

    def __init__(self, oversleep: float = 0.0) -> None:
        self.now = 50.0
        self.oversleep = oversleep

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.now += seconds + self.oversleep


def _pace(clock: Clock) -> Pace:
    return Pace(0.01, longest_lag=0.05, clock=clock, sleep=clock.sleep)


def test_ticks_do_not_drift_with_the_work_and_the_sleep() -> None:
    clock = Clock(oversleep=0.0002)
    pace = _pace(clock)
    for _ in range(1001):
        pace.wait()
        clock.now += 0.003
    assert clock.now == pytest.approx(50.0 + 10.0 + 0.0002 + 0.003)
    assert (pace.ticks, pace.late, pace.slips) == (1001, 0, 0)
    assert pace.mean == pytest.approx(0.0002, rel=0.01)


def test_short_lag_is_caught_up_and_counted() -> None:
    clock = Clock()
    pace = _pace(clock)
    pace.wait()
    clock.now += 0.035
    lateness = [pace.wait() for _ in range(5)]
    assert lateness == pytest.approx([0.025, 0.015, 0.005, 0.0, 0.0], abs=1e-9)
    assert pace.worst == pytest.approx(0.025)
    assert pace.late in (2, 3)
    assert (pace.slips, pace.slipped) == (0, 0.0)
    assert clock.now == pytest.approx(50.05)


def test_long_lag_sets_the_clock_back_and_is_counted() -> None:
    clock = Clock()
    pace = _pace(clock)
    pace.wait()
    clock.now += 1.01
    assert pace.wait() == pytest.approx(1.0)
    assert (pace.slips, pace.slipped) == (1, pytest.approx(1.0))
    assert pace.wait() == pytest.approx(0.0, abs=1e-9)
    assert clock.now == pytest.approx(51.02)
    assert pace.ticks == 3


@pytest.mark.parametrize("bad", [0.0, -0.01, float("nan"), float("inf")])
def test_period_is_positive(bad: float) -> None:
    with pytest.raises(InputError, match="period"):
        Pace(bad)
