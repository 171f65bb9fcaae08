"""Maneuvers at a coarse step: figures in the expected range."""

import numpy as np
import pytest

from iits_mj.validation import COMMANDS, ValidateConfig
from iits_mj.validation.handling import circle, low_speed_turn, step_steer

STEP = 0.002
LADEN = 36_000.0


def _values(checks):
    return {check.name.rsplit(": ", 1)[1]: check.value for check in checks}


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_step_steer_follows_the_yaw_sideslip_model(payload):
    (recording,) = step_steer.step_steers(payload, (np.deg2rad(15.0),), STEP)
    found = step_steer.compare_step(payload, 15.0, ">= 97", recording)
    checks, panels = found.checks, found.panels
    fits = [check.value for check in checks if check.name.endswith("fit")]
    assert len(fits) == len(panels) == 4
    assert min(fits) > 96.0
    explained = [check.value for check in checks if check.name.endswith("yaw-roll model")]
    assert min(explained) > 98.0
    ends = [check.value for check in checks if check.name.endswith("end value")]
    np.testing.assert_allclose(ends, 1.0, atol=0.05)


def test_time_step_hardly_changes_the_step_steer():
    (coarse,) = step_steer.step_steers(LADEN, (np.deg2rad(15.0),), 0.002)
    (fine,) = step_steer.step_steers(LADEN, (np.deg2rad(15.0),), 0.001)
    assert coarse.yaw_rate[-1] == pytest.approx(fine.yaw_rate[-1], rel=0.005)
    assert coarse.yaw_rate.max() == pytest.approx(fine.yaw_rate.max(), rel=0.01)


def test_frequency_response_of_the_empty_truck_is_the_models():
    values = _values(step_steer.compare_frequency(0.0, STEP).checks)
    assert values["yaw rate, gain error"] < 6.0
    assert values["yaw rate, phase error"] < 6.0


def test_trailer_follows_the_kinematic_trailer_round_the_corner():
    turn = low_speed_turn.turn(LADEN, STEP)
    assert turn.path_error() < 0.1
    assert turn.off_tracking() == pytest.approx(turn.kinematic_off_tracking(), abs=0.1)
    assert np.rad2deg(turn.recording.yaw[-1]) == pytest.approx(90.0, abs=3.0)


def test_understeer_on_the_circle_is_near_the_linear_models():
    found = circle.circle(LADEN, STEP, (8.0, 12.0))
    assert np.all(np.diff(found.lateral) > 0.3)
    assert found.gradient > found.reference
    assert found.gradient == pytest.approx(found.saturating_gradient, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_quick_form_gives_finite_figures_within_a_minute(name):
    results = COMMANDS[name](ValidateConfig(quick=True))
    assert results.checks
    assert all(np.isfinite(check.value) for check in results.checks)
    assert results.figures
    assert "checks" in results.to_json("0.0.0")
