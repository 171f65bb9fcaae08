"""What judges a speed plan: its energy, its bound, its savings."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile
from iits_mj.errors import PlanningError
from iits_mj.parameters import TruckParameters
from iits_mj.validation import pcc_savings
from iits_mj.validation.config import ValidateConfig
from iits_mj.validation.pcc_accuracy import convergence_checks, finite_elements, long_road
from iits_mj.validation.pcc_case import (
    balance,
    bound,
    scaled_heights,
    solve,
    with_power,
    with_rolling,
)

BAND = PccConfig(v_max=25.0)


def hills(step=50.0, length=5_000.0, amplitude=0.03):
    station = step * np.arange(round(length / step) + 1)
    wave = 2.0 * np.pi / 2000.0
    height = amplitude / wave * (1.0 - np.cos(wave * station))
    return RoadProfile(station, height, np.full(station.size, np.inf), "hills")


@pytest.fixture(scope="module")
def case():
    return solve(hills(), BAND)


def test_the_same_problem_is_set_again(case):
    speed = case.solution.plan.speed
    assert (speed**2 >= case.task.b_low - 1e-6).all()
    assert (speed**2 <= case.task.b_high + 1e-6).all()
    assert case.answer.speed == pytest.approx(speed, abs=1e-3)


def test_engine_work_goes_into_resistances_height_and_brakes(case):
    for drive in (case.solution.plan, case.solution.baseline):
        flow = balance(case.vehicle, case.road, drive.speed)
        assert abs(flow.residual) < 1e-3 * flow.engine
        assert abs(flow.time_error) < 1e-6
        assert flow.brakes >= 0.0


def test_missing_work_is_seen_by_the_balance(case):
    heavier = replace(case.vehicle, rolling=1.1 * case.vehicle.rolling)
    speed = case.solution.plan.speed
    # The forces of one truck do not drive the other: its work is not accounted for.
    own = balance(case.vehicle, case.road, speed)
    other = balance(heavier, case.road, speed)
    assert other.engine - own.engine == pytest.approx(other.rolling - own.rolling, rel=0.5)


def test_saving_is_what_the_cruise_brakes_away(case):
    plan = balance(case.vehicle, case.road, case.solution.plan.speed)
    cruise = balance(case.vehicle, case.road, case.solution.baseline.speed)
    saved = cruise.engine - plan.engine
    assert saved == pytest.approx(cruise.brakes - plan.brakes - (plan.air - cruise.air), rel=0.05)


def test_bound_is_below_plan_and_below_that_with_k_a(case):
    fuel, gap = bound(case, 0.0)
    whole, _ = bound(case, case.task.k_a)
    assert fuel <= case.solution.fuel
    # The solver meets the trip time and the limits to a tolerance of its own.
    assert fuel < whole <= case.cost(case.solution.plan.speed) * (1.0 + 1e-7)
    assert -1e-7 < gap < 1e-4


def test_finer_grid_confirms_the_fuel(case):
    (check,) = convergence_checks(case, hills(step=10.0))
    assert check.ok
    assert 0.0 < check.value < 0.1


def test_finite_elements_tell_why_there_are_none(case):
    assert "5 km" in finite_elements(case, length_max=1_000.0).reason


def test_long_road_goes_there_and_back(case):
    road = long_road(case.road, 12_000.0)
    assert road.length == 12_000.0
    assert road.height[:101] == pytest.approx(case.road.height)
    assert road.height[100:201] == pytest.approx(case.road.height[::-1])
    assert np.abs(road.grade).max() == pytest.approx(np.abs(case.road.grade).max())


def test_lower_hills_and_higher_rolling_resistance_leave_less_to_save(case):
    lower = solve(scaled_heights(case.road, 0.5), BAND)
    stiff = solve(case.road, BAND, parameters=with_rolling(TruckParameters.load(), 0.009))
    assert stiff.vehicle.rolling == 0.009
    assert lower.solution.saving_percent < case.solution.saving_percent
    assert stiff.solution.saving_percent < case.solution.saving_percent


def test_a_share_of_the_full_load_is_a_share_of_the_power(case):
    weaker = solve(case.road, BAND, parameters=with_power(TruckParameters.load(), 0.8))
    assert weaker.vehicle.power_max == pytest.approx(0.8 * case.vehicle.power_max)
    assert weaker.solution.plan.power.max() <= weaker.vehicle.power_max * (1.0 + 1e-4)


def test_quick_form_needs_no_files_and_demands_nothing_of_the_paper():
    results = pcc_savings.run_savings(ValidateConfig(quick=True))
    assert any("--roads" in note for note in results.notes)
    assert not any("paper's road" in check.name for check in results.checks)
    slow = ("set-up", "cruise, bounds")
    assert [c.name for c in results.checks if not c.ok and not any(s in c.name for s in slow)] == []


def test_a_trip_as_short_as_can_be_has_no_price_and_no_other_grid():
    # The cruise drives at the greatest speed already: there is only one drive in its time.
    fast = solve(hills(), PccConfig(v_ref=25.0, v_max=25.0))
    assert fast.solution.saving_percent == pytest.approx(0.0, abs=0.05)
    assert convergence_checks(fast, hills(step=10.0)) == []


def test_a_road_that_needs_no_fuel_is_named():
    road = hills()
    falling = replace(road, height=-0.04 * road.station, name="descent")
    with pytest.raises(PlanningError, match=r"'descent' .* no fuel"):
        solve(falling, BAND)
