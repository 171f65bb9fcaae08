import dataclasses

import numpy as np
import pytest

from iits_mj.analytic import (
    YawPlane,
    critical_speed,
    rearward_amplification,
    single_sine,
    steady_off_tracking,
    step_response,
    understeer_gradient,
    understeer_gradient_by_loads,
    worst_rearward_amplification,
    yaw_rate_gain,
)
from iits_mj.analytic.kinematic import Kinematic
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()
LADEN = YawPlane.from_parameters(PARAMETERS, 36_000.0)
EMPTY = YawPlane.from_parameters(PARAMETERS, 0.0)
V80 = 80.0 / 3.6


def _lumped(model):
    """The same truck with each axle group lumped in its center and without pneumatic trail."""
    return dataclasses.replace(
        model,
        position=np.array([model.position[0], *[model.group(0)] * 2, *[model.group(1)] * 3]),
        trail=0.0 * model.trail,
    )


@pytest.mark.parametrize("model", [LADEN, EMPTY], ids=["laden", "empty"])
def test_truck_is_stable_and_well_damped_at_80_kmh(model):
    system = model.at(V80)
    assert system.stable
    assert system.damping_ratio() > 0.3


@pytest.mark.parametrize("payload", [36_000.0, 10_000.0, 0.0])
def test_steady_yaw_gain_is_the_understeer_formula(payload):
    model = _lumped(YawPlane.from_parameters(PARAMETERS, payload))
    gradient = understeer_gradient_by_loads(PARAMETERS, payload)
    for speed in (5.0, 15.0, 25.0):
        expected = speed / (model.wheelbase + gradient * speed**2)
        assert yaw_rate_gain(model.at(speed)) == pytest.approx(expected, rel=1e-9)


def test_understeer_gradient_of_the_model_matches_the_axle_loads():
    gradient = understeer_gradient(_lumped(LADEN))
    assert gradient == pytest.approx(understeer_gradient_by_loads(PARAMETERS, 36_000.0), rel=1e-6)
    assert 1.0 < np.rad2deg(gradient * 9.81) < 3.0


def test_both_units_turn_alike_in_the_steady_state():
    state = LADEN.at(V80).steady_state(0.01)
    assert state[1] == pytest.approx(state[2])
    assert state[1] > 0.0


def test_step_response_settles_to_the_steady_state():
    system = LADEN.at(V80)
    response = step_response(system, 0.01, 20.0)
    final = system.steady_state(0.01)
    assert response.yaw_rate[-1] == pytest.approx(final[1], rel=1e-4)
    assert response.articulation[-1] == pytest.approx(final[3], rel=1e-4)
    assert response.lateral_acceleration[-1] == pytest.approx(V80 * final[1], rel=1e-3)


def test_oversteering_truck_has_a_critical_speed_where_the_yaw_gain_diverges():
    weak = dataclasses.replace(_lumped(LADEN), cornering=LADEN.cornering * [3, 1, 1, 1, 1, 1])
    gradient = understeer_gradient(weak)
    assert gradient < 0.0
    formula = np.sqrt(-weak.wheelbase / gradient)
    assert critical_speed(weak) == pytest.approx(formula, rel=1e-3)
    assert critical_speed(LADEN) == np.inf


def test_frequency_response_at_low_frequency_is_the_steady_gain():
    system = EMPTY.at(V80)
    gain = system.frequency_response(np.array([1e-4]))[0]
    np.testing.assert_allclose(gain.real, system.steady_state(), rtol=1e-3)


def test_rearward_amplification_grows_with_speed_and_is_near_one_for_a_semitrailer():
    values = [rearward_amplification(LADEN.at(v / 3.6)) for v in (60.0, 80.0, 100.0)]
    assert values == sorted(values)
    assert 0.7 < values[1] < 1.5
    gain, frequency = worst_rearward_amplification(LADEN.at(V80))
    assert gain > 1.0
    assert 0.1 < frequency < 1.0


def test_trailer_tracks_inside_when_slow_and_outside_when_fast():
    slow = steady_off_tracking(LADEN.at(1.0), 100.0)
    kinematic = Kinematic.from_parameters(PARAMETERS).off_tracking(100.0)
    assert slow == pytest.approx(kinematic, abs=0.02)
    assert steady_off_tracking(LADEN.at(25.0), 300.0) > 0.0


def test_single_sine_has_one_period_and_no_mean():
    time, sine = single_sine(2.5, 10.0)
    assert sine[time < 1.0].max() == 0.0
    assert abs(sine.sum()) < 1e-6
    assert sine.max() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("speed", [0.0, -3.0, float("nan"), float("inf")])
def test_speed_must_be_positive(speed):
    with pytest.raises(InputError, match="speed"):
        LADEN.at(speed)
