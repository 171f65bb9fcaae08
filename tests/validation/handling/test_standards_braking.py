"""Split friction, locked wheels, the circle's end, and the step-size study."""

import numpy as np
import pytest

from iits_mj.core.results import Check
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.validation.handling import braking_stability, circle, step_size
from iits_mj.validation.handling.steady_turn import SteadyTurn

STEP = 0.005
TRUCK = TruckParameters.load()
LADEN = 36_000.0


def test_split_friction_turns_the_truck_to_the_side_with_grip():
    free = braking_stability.stop_on(TRUCK, LADEN, 0.8, 0.3, STEP, driver=False, duration=2.0)
    assert np.rad2deg(free.yaw[-1]) > 0.5
    mirrored = braking_stability.stop_on(TRUCK, LADEN, 0.3, 0.8, STEP, driver=False, duration=2.0)
    assert mirrored.yaw[-1] == pytest.approx(-free.yaw[-1], rel=0.02)


def test_a_driver_holds_the_lane_on_split_friction():
    held = braking_stability.stop_on(TRUCK, 0.0, 0.8, 0.3, STEP, driver=True, duration=30.0)
    assert np.max(np.abs(held.y)) < 1.0
    assert np.rad2deg(np.max(np.abs(held.steering_wheel_angle))) < braking_stability.STEER_TOTAL
    assert braking_stability.braking_rate(held) > braking_stability.RATE


def test_locked_drive_axles_jack_knife():
    run = braking_stability.bend(TRUCK, LADEN, braking_stability.DRIVE, STEP)
    assert np.max(run.articulation) > braking_stability.FOLDED


def test_locked_trailer_axles_swing_the_trailer_out():
    run = braking_stability.bend(TRUCK, LADEN, braking_stability.TRAILER, STEP)
    assert np.min(run.articulation - run.articulation[0]) < -braking_stability.SWUNG
    assert np.max(run.articulation) < braking_stability.FOLDED


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_abs_cycles_as_air_systems_do(payload):
    low = braking_stability.LOW
    stop = braking_stability.stop_on(TRUCK, payload, low, low, 0.002, driver=False, duration=30.0)
    assert np.all(braking_stability.abs_cycles(stop) >= 1.0)
    assert np.all(braking_stability.abs_cycles(stop) <= 3.0)


@pytest.mark.parametrize("payload", [LADEN, 0.0])
def test_with_abs_the_truck_stays_in_line(payload):
    run = braking_stability.bend(TRUCK, payload, braking_stability.ABS, STEP)
    assert np.max(np.abs(run.articulation - run.articulation[0])) < braking_stability.STEADY
    assert run.speed[-1] < 1.0


@pytest.mark.parametrize("name", shipped_trucks())
@pytest.mark.parametrize("laden", [True, False])
def test_gentle_steady_turn_is_the_linear_models(name, laden):
    from iits_mj.analytic import YawPlane, yaw_rate_gain

    parameters = TruckParameters.load(name)
    payload = parameters.payload_max if laden else 0.0
    radius, lateral = 400.0, 0.1
    speed = np.sqrt(lateral * radius)
    model = YawPlane.from_parameters(parameters, payload, cruise_speed=speed).at(speed)
    steer = SteadyTurn.from_parameters(parameters, payload).steer(radius, lateral)
    assert steer == pytest.approx(speed / radius / yaw_rate_gain(model), rel=0.02)


def test_steady_turn_steepens_towards_the_limit_and_ends_there():
    turn = SteadyTurn.from_parameters(TruckParameters.load(), 0.0)
    steer = [turn.steer(100.0, a) for a in (1.0, 2.0, 4.0, 5.0)]
    assert (steer[3] - steer[2]) > 1.5 * (steer[1] - steer[0])
    assert np.isnan(turn.steer(100.0, 8.0))


@pytest.mark.slow
def test_empty_truck_follows_the_statics_round_the_circle_and_saturates():
    checks = circle.compare_limit(TRUCK, 0.0, STEP).checks
    assert [check.name for check in checks if not check.ok] == []


@pytest.mark.parametrize(
    ("fine", "coarse", "unit", "name", "change"),
    [
        (2.0, 2.01, "m/s2", "a: peak", 0.5),
        (98.0, 97.5, "%", "a: yaw rate, fit", 0.5),
        (0.0, 0.0, "m", "a: tail swing", 0.0),
    ],
)
def test_change_by_the_step_is_relative_for_figures_and_in_points_for_fits(
    fine, coarse, unit, name, change
):
    found = step_size.difference(Check(name, fine, unit), Check(name, coarse, unit))
    assert found == pytest.approx(change)


def test_change_from_nothing_to_something_is_not_a_number():
    assert np.isnan(step_size.difference(Check("a", 0.0, "m"), Check("a", 0.1, "m")))
