"""The tightening turn at a coarse step: grip or roll-over as the first limit."""

import numpy as np
import pytest

from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling import tightening_turn
from iits_mj.validation.handling.roll_plane import RollPlane
from iits_mj.validation.handling.steady_turn import effort, grip_limit

STEP = 0.005
LADEN = 36_000.0


@pytest.fixture(scope="module")
def turns():
    cases = ((LADEN, 0.8), (LADEN, 0.3), (0.0, 0.8), (0.0, 0.3))
    return {case: tightening_turn.tighten(TruckParameters.load(), *case, STEP) for case in cases}


def test_laden_truck_on_a_dry_road_rolls_over_near_its_static_threshold(turns):
    turn = turns[LADEN, 0.8]
    statics = RollPlane.from_parameters(TruckParameters.load(), LADEN).threshold()
    assert turn.rolled_over()
    assert turn.ending() == "roll-over"
    assert turn.greatest() == pytest.approx(statics, rel=0.1)
    assert abs(turn.recording.trailer_roll[-1]) > np.deg2rad(10.0)
    assert np.max(turn.effort[:, turn.end()]) < tightening_turn.SLIDING


def test_empty_truck_on_a_dry_road_rolls_over_near_its_static_threshold(turns):
    turn = turns[0.0, 0.8]
    statics = RollPlane.from_parameters(TruckParameters.load(), 0.0).threshold()
    assert turn.ending() == "roll-over"
    assert turn.greatest() == pytest.approx(statics, rel=0.1)
    assert np.max(turn.effort[:, turn.end()]) < tightening_turn.SLIDING


def test_traction_control_slows_the_empty_truck_before_it_rolls_over(turns):
    free, controlled = (
        turns[0.0, 0.8],
        tightening_turn.tighten(TruckParameters.load(), 0.0, 0.8, STEP, control=True),
    )
    assert not controlled.rolled_over()
    assert controlled.greatest() < free.greatest()
    same = slice(0, 3000)  # until the inner driven wheels spin
    assert np.array_equal(controlled.recording.speed[same], free.recording.speed[same])
    assert controlled.recording.speed[free.end()] < free.recording.speed[free.end()]


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_tires_saturate_on_a_slippery_road(turns, payload):
    turn = turns[payload, 0.3]
    grip = grip_limit(TruckParameters.load(), payload, 0.3)
    assert not turn.rolled_over()
    assert "grip" in turn.ending()
    assert 0.7 * grip < turn.greatest() < grip
    assert turn.growth() > 1.5
    # Four seconds of steering later the lateral acceleration is no greater.
    assert turn.lateral[-1] <= turn.lateral[-400]
    assert turn.recording.steering_wheel[-1] > turn.recording.steering_wheel[-400]


def test_slip_is_small_and_linear_in_a_gentle_turn(turns):
    turn = turns[LADEN, 0.8]
    gentle = int(np.argmax(turn.lateral > 1.0))
    # The slip follows from the yaw balance: each axle carries its share of the weight.
    assert np.all(np.rad2deg(turn.slip[:, gentle]) > 0.5)
    assert np.all(np.rad2deg(turn.slip[:, gentle]) < 2.5)
    assert np.all(turn.effort[:, gentle] < 0.4)


def test_grip_limit_is_the_friction_that_the_load_leaves():
    parameters = TruckParameters.load()
    common = parameters.tire_common
    for payload in (0.0, LADEN):
        dry = grip_limit(parameters, payload, 0.8)
        assert dry == pytest.approx(common.friction_lateral, rel=common.friction_load_slope)
        slippery = grip_limit(parameters, payload, 0.3)
        assert slippery == pytest.approx(0.375 * dry)
    heavy, light = (grip_limit(parameters, p, 0.8) for p in (LADEN, 0.0))
    assert heavy < light


def test_effort_grows_to_one_and_stays_there():
    slip = np.deg2rad(np.linspace(0.0, 40.0, 200))
    share = effort(TruckParameters.load(), LADEN, 0.8, 0, slip)
    assert share[0] == 0.0
    assert np.all(np.diff(share) >= 0.0)
    assert share[-1] == pytest.approx(1.0)
    # On a slippery road the same slip uses a greater share of the grip.
    assert np.all(effort(TruckParameters.load(), LADEN, 0.3, 0, slip) >= share)


def test_roll_over_counts_from_the_last_wheel_that_lifts(turns):
    turn = turns[LADEN, 0.8]
    assert np.all(turn.inner[: turn.end()] > 0.0)
    assert turn.inner[turn.end()] <= 0.0
    assert turn.inner[0] == 1.0
