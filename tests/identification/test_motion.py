"""Hidden masses and forces must come back from logs of an independent integration."""

import numpy as np
import pytest

from iits_mj.identification import identify
from tests.identification.point_mass import (
    BUILD_UP,
    DEAD_TIME,
    DRAG,
    MASS,
    PARAMETERS,
    ROLLING,
    drive,
)

TRUTH = {
    "mass": MASS,
    "rolling_resistance": ROLLING,
    "drag_area": DRAG,
    "brake_gain": 0.85,
}


@pytest.fixture(scope="module")
def found():
    return identify(drive(), PARAMETERS)


@pytest.mark.parametrize(("name", "truth"), TRUTH.items())
def test_hidden_parameter_comes_back_within_5_percent(found, name, truth):
    estimate = found[name]
    assert estimate.identifiable, estimate.reason
    assert estimate.value == pytest.approx(truth, rel=0.05)
    assert abs(estimate.value - truth) < 2.0 * estimate.half_width
    assert estimate.half_width < 0.15 * truth


def test_build_up_time_comes_back_within_10_percent(found):
    for circuit in ("front", "drive", "trailer"):
        assert found[f"{circuit}_build_up_time"].value == pytest.approx(BUILD_UP, rel=0.1)


def test_model_fits_the_recorded_speed_better_than_before(found):
    motion = found.motion
    noise = 0.01 * motion.recorded.mean()
    before = np.std(motion.before - motion.recorded)
    after = np.std(motion.after - motion.recorded)
    assert after < 1.2 * noise
    assert before > 1.5 * after


@pytest.mark.slow
def test_intervals_cover_the_truth_in_most_of_several_logs():
    covered = []
    for seed in range(1, 7):
        result = identify(drive(seed, duration=420.0), PARAMETERS, groups=("motion",))
        for name in ("mass", "rolling_resistance", "drag_area", "brake_gain"):
            estimate = result[name]
            covered.append(abs(estimate.value - TRUTH[name]) <= estimate.half_width)
    assert np.mean(covered) >= 0.8


def test_torque_scale_and_mass_are_not_identified_together(found):
    assert not found["engine_torque_scale"].identifiable
    assert "mass" in found["engine_torque_scale"].reason


def test_torque_scale_comes_back_when_the_mass_is_known():
    result = identify(drive(scale=1.12, duration=300.0), PARAMETERS, mass=MASS, groups=("motion",))
    assert result["engine_torque_scale"].value == pytest.approx(1.12, rel=0.03)
    assert result["rolling_resistance"].value == pytest.approx(ROLLING, rel=0.05)


def test_circuits_that_brake_together_show_only_their_common_gain(found):
    for circuit in ("front", "drive", "trailer"):
        estimate = found[f"brake_gain_{circuit}"]
        assert not estimate.identifiable
        assert "together" in estimate.reason


@pytest.mark.slow
def test_gain_of_each_circuit_comes_back_if_circuits_brake_in_turn():
    gains = (0.8, 0.95, 1.1)
    log = drive(gains=gains, brake="in turn", duration=600.0)
    result = identify(log, PARAMETERS, groups=("motion",))
    for circuit, gain in zip(("front", "drive", "trailer"), gains, strict=True):
        assert result[f"brake_gain_{circuit}"].identifiable
        assert result[f"brake_gain_{circuit}"].value == pytest.approx(gain, rel=0.05)


def test_unused_brakes_are_not_identified():
    result = identify(drive(brake="", duration=300.0), PARAMETERS)
    for name in ("brake_gain", "front_dead_time", "trailer_build_up_time"):
        assert not result[name].identifiable
        assert result[name].value == result[name].prior
        assert result[name].reason
    assert result["mass"].identifiable


def test_constant_speed_on_the_flat_shows_neither_resistance():
    log = drive(flat=True, coast=False, brake="", duration=200.0)
    result = identify(log, PARAMETERS, groups=("motion",))
    for name in ("rolling_resistance", "drag_area"):
        assert not result[name].identifiable
        assert result[name].reason


def test_dead_time_is_not_identified_from_a_slow_table():
    estimate = identify(drive(), PARAMETERS, groups=("brakes",))["trailer_dead_time"]
    assert not estimate.identifiable
    assert "50 ms" in estimate.reason
    assert estimate.half_width > 0.025
    assert estimate.value == estimate.prior != DEAD_TIME


def test_reasons_name_missing_grade_and_pressures():
    log = drive(duration=60.0)
    bare = log.only([name for name in log.signals if name != "grade" and "pressure" not in name])
    result = identify(bare, PARAMETERS)
    assert "lacks grade" in result["mass"].reason
    assert "lacks brake_pressure_front_left" in result["front_dead_time"].reason
    assert not any(estimate.identifiable for estimate in result.estimates)
