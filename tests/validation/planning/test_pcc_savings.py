"""Checks of a speed plan: its energy, its bound, its savings."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile
from iits_mj.core.errors import PlanningError
from iits_mj.parameters import TruckParameters
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning import pcc_savings
from iits_mj.validation.planning.pcc_accuracy import (
    bound_checks,
    convergence_checks,
    cost_checks,
    equal_times,
    finite_elements,
    long_road,
)
from iits_mj.validation.planning.pcc_case import (
    balance,
    bound,
    scaled_heights,
    solve,
    with_power,
    with_rolling,
)

BAND = PccConfig(v_max=25.0)


def test_a_long_road_is_bounded_by_its_own_multipliers(case):
    gap = next(check for check in cost_checks(case, 30.0) if "above the bound" in check.name)
    assert gap.ok
    assert gap.value > -1e-6


def test_band_above_the_climbing_speed_of_the_cruise_prevents_equal_trip_times():
    narrow = solve(hills(amplitude=0.05), PccConfig(v_min=19.5, v_max=25.0))
    assert not equal_times(narrow)
    assert equal_times(solve(hills(), BAND))


def hills(step=50.0, length=5_000.0, amplitude=0.03):
    station = step * np.arange(round(length / step) + 1)
    wave = 2.0 * np.pi / 2000.0
    height = amplitude / wave * (1.0 - np.cos(wave * station))
    return RoadProfile(station, height, np.full(station.size, np.inf), "hills")


@pytest.fixture(scope="module")
def case():
    return solve(hills(), BAND)


def test_case_has_the_problem_of_its_plan(case):
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


def test_balance_shows_missing_work(case):
    heavier = replace(case.vehicle, rolling=1.1 * case.vehicle.rolling)
    speed = case.solution.plan.speed
    # The forces of one truck do not fit the other: part of its work is missing.
    own = balance(case.vehicle, case.road, speed)
    other = balance(heavier, case.road, speed)
    assert other.engine - own.engine == pytest.approx(other.rolling - own.rolling, rel=0.5)


def test_saving_equals_the_brake_work_of_the_cruise_less_the_plans(case):
    plan = balance(case.vehicle, case.road, case.solution.plan.speed)
    cruise = balance(case.vehicle, case.road, case.solution.baseline.speed)
    saved = cruise.engine - plan.engine
    assert saved == pytest.approx(cruise.brakes - plan.brakes - (plan.air - cruise.air), rel=0.05)


def test_bound_is_below_plan_and_below_that_with_k_a(case):
    fuel, gap = bound(case, 0.0)
    whole, _ = bound(case, case.task.k_a)
    assert fuel <= case.solution.fuel
    # The solver meets the trip time and the limits to a tolerance of its own.
    assert fuel < whole <= case.task.cost(case.solution.plan.speed) * (1.0 + 1e-7)
    assert -1e-7 < gap < 1e-4


def test_finer_grid_confirms_the_fuel(case):
    optimum, driven = convergence_checks(case, hills(step=10.0))
    assert optimum.ok
    assert 0.0 < abs(optimum.value) < 0.1
    assert driven.ok
    # The drive on the fine grid is not better than its optimum, whose cost includes k_a.
    assert -0.02 < driven.value < 0.1


def test_missed_end_speed_after_a_climb_is_not_a_difference_of_the_grids():
    # Full power all the way up: a few mm/s less at the end save as much as the grids may differ.
    def climb(step):
        station = step * np.arange(round(6_000.0 / step) + 1)
        height = 0.04 * np.maximum(station - 2_000.0, 0.0)
        return RoadProfile(station, height, np.full(station.size, np.inf), "climb")

    assert all(check.ok for check in convergence_checks(solve(climb(50.0), BAND), climb(10.0)))


def test_the_plan_saves_no_more_by_the_map_than_the_bound_allows(case):
    _, _, by_map, _ = bound_checks(case)
    assert "engine map" in by_map.name
    assert by_map.value >= case.solution.map_saving_percent


def test_finite_elements_give_the_reason_for_a_missing_solution(case):
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


def test_quick_form_needs_no_files_and_has_no_check_on_the_papers_road():
    results = pcc_savings.run_savings(ValidateConfig(quick=True))
    assert any("--roads" in note for note in results.notes)
    assert not any("paper's road" in check.name for check in results.checks)
    slow = ("set-up", "cruise, bounds")
    assert [c.name for c in results.checks if not c.ok and not any(s in c.name for s in slow)] == []


def test_plan_over_steep_hills_is_checked_by_its_fuel_on_the_fine_road():
    # The optima of both grids differ by more than the possible improvement of the plan.
    steep = solve(hills(length=6_000.0, amplitude=0.05), BAND)
    optimum, driven = convergence_checks(steep, hills(step=5.0, length=6_000.0, amplitude=0.05))
    assert abs(optimum.value) > abs(driven.value)
    assert not optimum.must
    assert driven.must
    assert driven.ok


def test_shortest_possible_trip_is_the_same_on_every_grid():
    # The cruise has the greatest speed: there is only one drive in its time.
    fast = solve(hills(), PccConfig(v_ref=25.0, v_max=25.0))
    assert fast.solution.saving_percent == pytest.approx(0.0, abs=0.05)
    assert all(check.ok for check in convergence_checks(fast, hills(step=10.0)))


def test_road_without_fuel_consumption_is_named():
    road = hills()
    falling = replace(road, height=-0.04 * road.station, name="descent")
    with pytest.raises(PlanningError, match=r"'descent' .* no fuel"):
        solve(falling, replace(BAND, rolls=False))
