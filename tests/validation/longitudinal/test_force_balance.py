"""The point mass against figures by hand, and its roads with slopes."""

import numpy as np
import pytest

from iits_mj.core.results import Findings
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.parameters.mass_state import static_axle_loads
from iits_mj.validation.longitudinal import speed_accuracy
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.hill_climb import check_climb
from iits_mj.validation.longitudinal.hills import hills, sloping

PARAMETERS = TruckParameters.load()
LADEN = ForceBalance(PARAMETERS, 36_000.0)


def test_resistances_are_rolling_grade_and_air():
    rolling = PARAMETERS.tires["steer"].rolling_resistance
    weight = 55_000.0 * GRAVITY
    assert LADEN.resistance(0.0) == pytest.approx(weight * rolling)
    slope = np.arctan(0.05)
    on_grade = weight * (np.sin(slope) + rolling * np.cos(slope))
    assert LADEN.resistance(0.0, 0.05) == pytest.approx(on_grade)
    drag = 0.5 * PARAMETERS.aerodynamics.density * PARAMETERS.aerodynamics.drag_area * 400.0
    assert LADEN.resistance(20.0) - LADEN.resistance(0.0) == pytest.approx(drag)


def test_losses_of_the_gears_reduce_pull_and_increase_overrun():
    gearbox = PARAMETERS.gearbox
    ideal = 1000.0 * gearbox.ratios[4] * gearbox.final_drive / LADEN.wheel_radius
    assert LADEN.pull(1000.0, 5, 120.0) < ideal < -LADEN.pull(-1000.0, 5, 120.0)
    assert LADEN.pull(1000.0, 5, 120.0) == pytest.approx(
        ideal * gearbox.efficiency * gearbox.driveline_efficiency
    )


def test_drive_axles_carry_their_static_load_on_the_level_and_more_uphill():
    rolling = {"tires": {"*": {"rolling_resistance": 0.0}}}
    free = ForceBalance(TruckParameters.load(overlay=rolling), 36_000.0)
    static = static_axle_loads(PARAMETERS, 36_000.0)[1:3].sum()
    assert free.drive_axle_load(0.0) == pytest.approx(static)
    assert free.drive_axle_load(0.2) > static
    # The kingpin is pulled above the road: rolling resistance of the trailer loads the drive axles.
    assert LADEN.drive_axle_load(0.0) > static


@pytest.mark.parametrize("grade", [0.0, 0.1, 0.3])
def test_grade_for_a_force_has_that_resistance(grade):
    assert LADEN.grade_for(float(LADEN.resistance(0.0, grade))) == pytest.approx(grade, abs=1e-9)


def test_grip_limit_is_the_grade_whose_resistance_equals_the_traction():
    grade = LADEN.traction_grade()
    assert LADEN.traction(grade) == pytest.approx(float(LADEN.resistance(0.0, grade)))
    assert ForceBalance(PARAMETERS, 0.0).traction_grade() != pytest.approx(grade, rel=0.02)


def test_engine_settles_at_launch_where_clutch_and_floored_pedal_agree():
    speed = LADEN.launch_speed
    engine = PARAMETERS.engine
    share = (speed - engine.idle_speed) / PARAMETERS.clutch.launch_range
    assert LADEN.full_torque(speed) == pytest.approx(share * engine.reference_torque, rel=1e-6)
    assert engine.idle_speed < speed < engine.idle_speed + PARAMETERS.clutch.launch_range


def test_grip_grows_with_the_friction_of_the_road():
    assert LADEN.traction(0.1, 0.4) == pytest.approx(0.5 * LADEN.traction(0.1))
    assert LADEN.traction_grade(0.3) < LADEN.traction_grade()


@pytest.mark.parametrize(("gear", "grade"), [(12, 0.01), (10, 0.03), (8, 0.05)])
def test_steady_speed_balances_and_is_stable(gear, grade):
    speed = LADEN.steady_speed(gear, grade)

    def surplus(v):
        engine_speed = v * LADEN.reduction(gear)
        return LADEN.pull(LADEN.full_torque(engine_speed), gear, engine_speed) - LADEN.resistance(
            v, grade
        )

    assert surplus(speed) == pytest.approx(0.0, abs=1.0)
    assert surplus(1.02 * speed) < 0.0 < surplus(0.98 * speed)


def test_a_gear_too_high_has_no_steady_speed_and_the_best_gear_is_not_slower_than_any():
    assert np.isnan(LADEN.steady_speed(12, 0.05))
    speeds = [LADEN.steady_speed(gear, 0.05) for gear in range(1, 13)]
    assert LADEN.best_speed(0.05) == np.nanmax(speeds)


def test_published_tables_reproduce_the_published_run():
    run = speed_accuracy.compute(speed_accuracy.balance(), 0.4, 40.0)
    assert run.speed[-1] * 3.6 == pytest.approx(46.9, rel=0.02)
    assert run.time[run.gear >= 10.0][0] == pytest.approx(31.0, abs=1.5)
    assert run.gear[0] == 2.0
    assert set(np.diff(run.gear)) == {0.0, 1.0}


def test_hills_end_higher_and_stay_within_their_grades():
    road = hills()
    grades = np.asarray(road.evaluate(np.arange(0.0, road.length, 5.0)).grade)
    assert grades.min() == pytest.approx(-0.045)
    assert grades.max() == pytest.approx(0.04)
    assert float(road.evaluate(road.length).z) == pytest.approx(18.25, abs=0.01)


def test_ramp_keeps_its_grade_before_and_after_the_change():
    road = sloping(500.0, 0.12, ((100.0, 0.25, 30.0),))
    assert float(road.evaluate(80.0).grade) == pytest.approx(0.12)
    assert float(road.evaluate(120.0).grade) == pytest.approx(0.25)


@pytest.mark.parametrize("name", shipped_trucks())
def test_forces_of_every_truck_balance_at_its_steady_speed(name):
    truck = TruckParameters.load(name)
    balance, gear = ForceBalance(truck, truck.payload_max), len(truck.gearbox.ratios) - 2
    speed = balance.steady_speed(gear, 0.01)
    turns = speed * float(balance.reduction(gear))
    needed = balance.needed_torque(float(balance.resistance(speed, 0.01)), gear, turns)
    assert needed <= float(balance.full_torque(turns)) + 1.0
    assert 0.0 < balance.traction_grade() <= 0.6


@pytest.mark.parametrize("name", shipped_trucks())
def test_driven_axles_of_every_truck_carry_their_static_load_on_the_level(name):
    truck = TruckParameters.load(name, overlay={"tires": {"*": {"rolling_resistance": 0.0}}})
    loads = static_axle_loads(truck, truck.payload_max)
    driven = [axle.driven for axle in truck.axles]
    free = ForceBalance(truck, truck.payload_max)
    assert free.drive_axle_load(0.0) == pytest.approx(loads[driven].sum())


def test_steady_speed_of_a_climb_is_read_after_the_torque_has_built_up():
    parameters = TruckParameters.load("b_double")
    found, balance = Findings(), ForceBalance(parameters, parameters.payload_max)
    check_climb(found, balance, 0.03, 0.002)
    assert all(check.ok for check in found.checks)
