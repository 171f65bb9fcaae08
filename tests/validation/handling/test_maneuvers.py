"""Maneuvers at a coarse step: figures in the expected range."""

import numpy as np
import pytest

from iits_mj import validation
from iits_mj.commands import validate
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.validation import COMMANDS, ValidateConfig
from iits_mj.validation.handling import circle, low_speed_turn, step_steer, yaw_gain
from iits_mj.validation.handling.group import name_of
from iits_mj.validation.harness.maneuver import steady_truck
from iits_mj.validation.truck import axle_loads

STEP = 0.002
LADEN = 36_000.0
TRUCK = TruckParameters.load()
FREE = step_steer.free_couplings(TRUCK)


def _values(checks):
    return {check.name.rsplit(": ", 1)[1]: check.value for check in checks}


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_step_steer_follows_the_yaw_sideslip_model(payload):
    (recording,) = step_steer.step_steers(FREE, payload, (np.deg2rad(15.0),), STEP)
    found = step_steer.compare_step(FREE, payload, 15.0, ">= 98", recording)
    checks, panels = found.checks, found.panels
    fits = [check.value for check in checks if check.name.endswith("fit")]
    assert len(fits) == len(panels) == 4
    assert min(fits) > 96.0
    explained = [check.value for check in checks if check.name.endswith("yaw-roll model")]
    assert min(explained) > 98.0
    ends = [check.value for check in checks if check.name.endswith("end value")]
    np.testing.assert_allclose(ends, 1.0, atol=0.05)


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_truck_fits_the_yaw_roll_model_at_small_steer(name):
    truck = step_steer.free_couplings(TruckParameters.load(name))
    for payload in {truck.payload_max, 0.0}:
        (recording,) = step_steer.step_steers(truck, payload, (np.deg2rad(3.0),), STEP)
        found = step_steer.compare_step(truck, payload, 3.0, ">= 99", recording)
        assert [check.shortfall() for check in found.checks if not check.ok] == []
        fits = [check for check in found.checks if check.name.endswith("yaw-roll model")]
        assert len(fits) == 2 * len(truck.units)


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_effects_switched_off_one_at_a_time_explain_the_driven_yaw_gain(payload):
    found = yaw_gain.compare(None, payload, STEP)
    assert [check.shortfall() for check in found.checks if not check.ok] == []
    values = _values(found.checks)
    assert values["share of the plain model's gain, as driven"] < 88.0
    assert 1.5 < values["understeer gradient, plain yaw-sideslip model"] < 1.9
    changes = {c.name.rsplit(" without ", 1)[-1]: c.reference for c in found.checks}
    for effect in ("play and compliance of the steering", "drive forces", "pneumatic trail"):
        assert float(changes[f"{effect} either"]) > 4.0


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_truck_has_overlays_that_switch_the_effects_off(name):
    truck = TruckParameters.load(name)
    last = TruckParameters.load(name, [overlay for _, overlay in yaw_gain.overlays(truck)])
    assert {unit.cg_height for unit in last.units} == {0.5}
    assert {tire.pneumatic_trail for tire in last.tires.values()} == {0.0}
    assert all(coupling.yaw_friction == 0.0 for coupling in last.couplings)


def test_time_step_hardly_changes_the_step_steer():
    (coarse,) = step_steer.step_steers(FREE, LADEN, (np.deg2rad(15.0),), 0.002)
    (fine,) = step_steer.step_steers(FREE, LADEN, (np.deg2rad(15.0),), 0.001)
    assert coarse.yaw_rate[-1] == pytest.approx(fine.yaw_rate[-1], rel=0.005)
    assert coarse.yaw_rate.max() == pytest.approx(fine.yaw_rate.max(), rel=0.01)


def test_frequency_response_of_the_empty_truck_is_the_models():
    values = _values(step_steer.compare_frequency(FREE, 0.0, STEP).checks)
    assert values["yaw rate, gain error"] < 6.0
    assert values["yaw rate, phase error"] < 6.0


def test_trailer_follows_the_kinematic_trailer_round_the_corner():
    turn = low_speed_turn.turn(TRUCK, LADEN, STEP)
    assert turn.path_error() < 0.1
    assert turn.off_tracking() == pytest.approx(turn.kinematic_off_tracking(), abs=0.1)
    assert np.rad2deg(turn.recording.yaw[-1]) == pytest.approx(90.0, abs=3.0)


def test_understeer_on_the_circle_is_near_the_linear_models():
    found = circle.circle(TRUCK, LADEN, STEP, (8.0, 12.0))
    assert np.all(np.diff(found.lateral) > 0.3)
    assert found.gradient > found.reference
    assert found.gradient == pytest.approx(found.saturating_gradient, rel=0.05)


@pytest.mark.parametrize("group", validation.DEFAULT_ONLY)
def test_groups_of_the_default_truck_refuse_another_one(group):
    with pytest.raises(InputError, match="lateral"):
        validate.measure(validate.Options(what=group, truck="b_double"))


def test_a_truck_without_payload_has_one_state_and_the_page_names_it():
    config = ValidateConfig(truck="vecto_tractor")
    assert config.payloads() == (0.0,)
    assert name_of("truck", config) == "validate truck vecto_tractor"
    assert name_of("truck", ValidateConfig(truck=shipped_trucks()[0])) == "validate truck"


@pytest.mark.parametrize("name", shipped_trucks())
def test_axle_loads_at_rest_are_those_of_statics(name):
    parameters = TruckParameters.load(name)
    for payload in {parameters.payload_max, 0.0}:
        found = axle_loads(parameters, payload)
        assert [check.shortfall() for check in found.checks if not check.ok] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_trucks()[1:])
def test_page_of_a_shipped_truck_has_finite_figures(name):
    results = COMMANDS["truck"](ValidateConfig(truck=name))
    assert all(np.isfinite(check.value) for check in results.checks)
    assert results.figures


# A measured maneuver needs its file; the quick form of alks drives no situation with a plot.
@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"measured"}))
def test_quick_form_gives_finite_figures_within_a_minute(name):
    results = COMMANDS[name](ValidateConfig(quick=True))
    assert results.checks
    assert all(np.isfinite(check.value) for check in results.checks)
    assert results.figures or name == "alks"
    assert "checks" in results.to_json("0.0.0")


def test_the_trucks_of_the_yaw_gains_ladder_drive_at_the_greatest_step():
    applied = []
    for _, overlay in yaw_gain.overlays(TRUCK):
        applied.append(overlay)
        truck = TruckParameters.load(None, applied)
        steady_truck(LADEN, step_steer.SPEED, 0.005, parameters=truck)
