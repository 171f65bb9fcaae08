import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.planning.speed_plan import SpeedState
from controllers.safe_stop.stop import StopLimits, roll_to_stop, stop_distance
from iits_mj.core.errors import InputError

STEP = 0.05


def _rolled(speed, acceleration, limits, duration=60.0):
    start = SpeedState(0.0, speed, acceleration)
    return roll_to_stop(start, limits, round(duration / STEP), STEP)


def test_the_stopping_distance_is_that_of_two_ramps_and_a_steady_part():
    limits = StopLimits(deceleration=1.5, jerk=1.0, jerk_end=1.0, deceleration_end=0.01)
    # Ramp of 1.5 s at both ends; v and s of cubic motion.
    lost_in_ramp = 0.5 * 1.5**2
    steady = (20.0 - 2.0 * lost_in_ramp) / 1.5
    way = 20.0 * 1.5 - 1.5**3 / 6.0
    after = 20.0 - lost_in_ramp
    way += after * steady - 0.75 * steady**2
    way += 1.5**3 / 6.0
    assert stop_distance(20.0, 0.0, limits) == pytest.approx(way, rel=0.005)


@settings(max_examples=150, deadline=None)
@given(
    speed=st.floats(0.0, 35.0),
    acceleration=st.floats(-2.0, 1.0),
    deceleration=st.floats(0.5, 4.0),
    jerk=st.floats(0.3, 3.0),
)
def test_every_stop_ends_and_keeps_its_limits(speed, acceleration, deceleration, jerk):
    limits = StopLimits(deceleration, jerk, 0.8 * jerk, 0.2)
    station, v, a = _rolled(speed, acceleration, limits, 200.0)
    assert v[-1] == 0.0
    assert a[-1] == 0.0
    assert np.all(np.diff(station) >= 0.0)
    assert a.min() >= -max(deceleration, -acceleration) - 1e-9
    moving = v > 0.0
    jerks = np.abs(np.diff(a)[moving[1:]]) / STEP
    assert jerks.size == 0 or jerks.max() <= jerk + 1e-6


def test_the_deceleration_eases_before_standstill():
    limits = StopLimits()
    _, v, a = _rolled(20.0, 0.0, limits)
    last = a[v > 0.0][-1]
    assert -0.35 < last <= -0.2
    assert a.min() == pytest.approx(-1.5)


def test_a_standing_truck_stays():
    station, v, a = _rolled(0.0, 0.3, StopLimits(), 1.0)
    assert not station.any()
    assert not v.any()
    assert not a.any()


@pytest.mark.parametrize(
    "wrong",
    [
        {"deceleration": 0.0},
        {"deceleration": math.nan},
        {"jerk": -1.0},
        {"jerk": 0.5},
        {"jerk_end": math.inf},
        {"deceleration_end": 2.0},
    ],
)
def test_impossible_limits_are_refused(wrong):
    with pytest.raises(InputError, match="stop limit"):
        StopLimits(**wrong)
