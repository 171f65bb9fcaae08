"""Due times of cyclic messages."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from iits_mj.core.errors import InputError
from iits_mj.j1939.schedule import Schedule, spread


def times_sent(schedule, times, place=0):
    return [time for time in times if place in schedule.due(time)]


def test_a_period_is_kept_for_an_hour_without_drift():
    schedule = Schedule([0.02])
    # Time accumulates with rounding, as in MuJoCo.
    time, sent = 0.0, 0
    for _ in range(3_600_000 // 10):
        sent += len(schedule.due(time))
        time += 0.01
    assert sent == 3600 * 50


def test_a_late_message_keeps_its_grid_and_missed_ones_are_not_sent():
    schedule = Schedule([0.1])
    assert times_sent(schedule, [0.0, 0.07, 0.13, 0.19, 0.2, 0.55, 0.56, 0.6]) == [
        0.0,
        0.13,
        0.2,
        0.55,
        0.6,
    ]


def test_no_message_is_due_twice_at_the_same_time():
    schedule = Schedule([0.01, 1.0])
    assert schedule.due(5.0) == [0, 1]
    assert schedule.due(5.0) == []


def test_offset_delays_a_message_from_the_first_call_on():
    schedule = Schedule([0.1, 0.1], [0.0, 0.03])
    assert schedule.due(7.0) == [0]
    assert schedule.due(7.029) == []
    assert schedule.due(7.03) == [1]
    assert schedule.due(7.1) == [0]


def test_a_new_drive_restarts_the_schedule():
    schedule = Schedule([1.0])
    assert schedule.due(40.0) == [0]
    assert schedule.due(40.5) == []
    assert schedule.due(0.0) == [0]
    assert schedule.due(0.5) == []


@given(st.lists(st.floats(0.0, 0.05), min_size=1, max_size=200))
def test_at_most_one_frame_per_period_is_due_at_any_rate_of_calls(steps):
    schedule = Schedule([0.02])
    time, sent = 0.0, len(schedule.due(0.0))
    for step in steps:
        time += step
        sent += len(schedule.due(time))
        assert sent <= 1 + math.floor(time / 0.02 + 1e-3)


@pytest.mark.parametrize("period", [0.0, -0.1, float("nan"), float("inf")])
def test_a_period_must_be_positive(period):
    with pytest.raises(InputError, match="period"):
        Schedule([period])


@pytest.mark.parametrize("time", [float("nan"), float("inf")])
def test_a_time_must_be_finite(time):
    with pytest.raises(InputError, match="time"):
        Schedule([0.02]).due(time)


def test_frames_are_spread_as_evenly_as_their_periods_allow():
    periods, weights = [0.1] * 10 + [0.02, 0.02], [1] * 12
    offsets = spread(periods, weights)
    schedule = Schedule(periods, offsets)
    load = [len(schedule.due(0.01 * tick)) for tick in range(20)]
    assert set(load[10:]) == {2}
    assert max(offsets) < 0.1
