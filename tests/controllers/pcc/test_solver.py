"""`solve`: IPOPT as reference, prices, a vehicle ahead, reasons of infeasible tasks."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile, SpeedTask, plan, solve
from controllers.pcc import solver as solver_module
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import make_vehicle
from controllers.pcc.vehicle import cruise, durations
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()
VEHICLE = make_vehicle(PARAMETERS, FuelMap(PARAMETERS), 40_000.0, PccConfig())
N, STEP = 60, 50.0


def road_of(grade, limit=math.inf, step=STEP):
    height = np.concatenate([[0.0], np.cumsum(np.asarray(grade) * step)])
    station = step * np.arange(height.size)
    return RoadProfile(station, height, np.full(height.size, limit), "test road")


def random_road(rng, n=N):
    grade = np.cumsum(rng.normal(0.0, 0.004, n))
    return road_of(np.clip((grade - grade.mean()) * rng.uniform(0.3, 1.5), -0.05, 0.05))


def task_of(road, vehicle=VEHICLE, **changes):
    """Returns a task from 18 m/s to 18 m/s in the time of a cruise at 18 m/s, and that cruise."""
    speed = cruise(vehicle, road, 18.0, 18.0)
    low, high = np.full(speed.size, 100.0), np.full(speed.size, 560.0)
    low[[0, -1]] = high[[0, -1]] = speed[[0, -1]] ** 2
    low = np.minimum(low, 0.8 * speed**2)
    low[[0, -1]] = high[[0, -1]]
    settings = {"time_max": float(durations(speed, road).sum()), "k_a": 5e-4}
    task = SpeedTask(vehicle, road, low, high, **(settings | changes))
    return task, speed


def cost_of(task, answer, vehicle=VEHICLE):
    """Returns the cost of a solution, from its definition [kg]."""
    road, v = task.road, answer.speed
    time = durations(v, road)
    a = np.diff(v**2) / (2.0 * road.step)
    fuel = vehicle.fuel_of(v, road).sum() + task.price_time * time.sum()
    return float(fuel + task.k_a * (a**2 * time).sum() - task.price_energy * v[-1] ** 2)


def passing_behind(road, gap, speed, reach):
    earliest = np.where(road.station <= reach, (road.station - gap) / speed + 1.8, 0.0)
    earliest[0] = 0.0
    return np.maximum(earliest, 0.0)


def test_ipopt_finds_the_same_optimum_on_random_roads():
    rng = np.random.default_rng(1)
    for _ in range(25):
        task, guess = task_of(random_road(rng))
        mine, other = solve(task, guess), solve(task, guess, "ipopt")
        assert (mine.method, other.method) == ("interior_point", "ipopt")
        assert cost_of(task, mine) == pytest.approx(cost_of(task, other), rel=1e-6)
        assert mine.time_price == pytest.approx(other.time_price, abs=2e-6)
        assert mine.speed == pytest.approx(other.speed, abs=0.02)
        assert mine.costate[1:-1] == pytest.approx(other.costate[1:-1], rel=0.01, abs=1e-5)


def test_ipopt_finds_the_same_optimum_behind_a_vehicle():
    rng = np.random.default_rng(2)
    for _ in range(10):
        road = random_road(rng)
        changes = {"time_max": math.inf, "price_time": 0.006, "price_energy": 1.5e-3}
        task, guess = task_of(road, **changes)
        low = np.append(task.b_low[0], np.full(N, 4.0))
        high = np.append(task.b_high[0], np.full(N, 560.0))
        earliest = passing_behind(road, 80.0, rng.uniform(13.0, 16.0), 1500.0)
        task = replace(task, b_low=low, b_high=high, earliest=earliest)
        mine, theirs = solve(task, guess), solve(task, guess, "ipopt")
        assert mine.method == "interior_point"
        assert cost_of(task, mine) == pytest.approx(cost_of(task, theirs), rel=1e-6)
        clock = np.append(0.0, np.cumsum(durations(mine.speed, road)))
        assert (clock >= earliest - 1e-4).all()
        assert mine.interval_price.min() < -1e-4  # the vehicle ahead costs time


def test_long_roads_take_no_more_iterations_than_short_ones():
    rng = np.random.default_rng(3)
    road = random_road(rng, 1200)
    task, guess = task_of(road)
    answer = solve(task, guess)
    assert answer.method == "interior_point"
    assert answer.iterations < 40


def test_a_loose_tolerance_gives_nearly_the_same_speeds_in_fewer_iterations():
    task, guess = task_of(random_road(np.random.default_rng(10)))
    exact = solve(task, guess)
    loose = solve(task, guess, tolerance=1e-6)
    assert loose.iterations < exact.iterations
    assert loose.speed == pytest.approx(exact.speed, abs=0.01)


def test_a_tolerance_of_nan_is_refused():
    with pytest.raises(InputError, match="tolerance"):
        solve(*task_of(road_of(np.zeros(N))), tolerance=math.nan)


def test_time_price_is_the_saving_by_one_more_second():
    task, guess = task_of(random_road(np.random.default_rng(4)))
    cost = [
        cost_of(task, solve(replace(task, time_max=task.time_max + more), guess))
        for more in (-0.5, 0.5)
    ]
    assert solve(task, guess).time_price == pytest.approx(cost[0] - cost[1], rel=0.01)


def test_costate_at_the_start_is_the_saving_by_more_speed_there():
    task, guess = task_of(random_road(np.random.default_rng(5)))

    def cost(more):
        low, high = task.b_low.copy(), task.b_high.copy()
        low[0] = high[0] = low[0] + more
        return cost_of(task, solve(replace(task, b_low=low, b_high=high), guess))

    saved = 0.5 * (cost(-1.0) - cost(1.0))
    assert solve(task, guess).costate[0] == pytest.approx(saved, rel=0.02)


def test_costate_at_the_end_is_the_cost_of_more_speed_there():
    task, guess = task_of(random_road(np.random.default_rng(6)))

    def cost(more):
        low, high = task.b_low.copy(), task.b_high.copy()
        low[-1] = high[-1] = low[-1] + more
        return cost_of(task, solve(replace(task, b_low=low, b_high=high), guess))

    spent = 0.5 * (cost(1.0) - cost(-1.0))
    assert solve(task, guess).costate[-1] == pytest.approx(spent, rel=0.02)


def test_costate_at_a_split_makes_the_first_part_optimal_alone():
    # With the costate as worth of speed at the split, the first half alone has the same optimum.
    task, guess = task_of(random_road(np.random.default_rng(7)))
    whole = solve(task, guess)
    half = N // 2
    low, high = task.b_low[: half + 1], task.b_high[: half + 1]
    part = replace(
        task,
        road=road_of(task.road.grade[:half]),
        b_low=low,
        b_high=high,
        earliest=np.zeros(half + 1),
        time_max=math.inf,
        price_time=whole.time_price,
        price_energy=float(whole.costate[half]),
    )
    again = solve(part, guess[: half + 1])
    assert again.speed == pytest.approx(whole.speed[: half + 1], abs=0.02)


def test_the_plan_is_the_only_drive_that_is_in_time():
    config = PccConfig(v_ref=22.0, v_max=22.0)
    solution = plan(road_of(np.zeros(N)), PARAMETERS, 40_000.0, config)
    assert solution.optimum.method == "interior_point"
    assert solution.plan.speed == pytest.approx(np.full(N + 1, 22.0), abs=0.01)


def test_an_end_speed_that_takes_full_power_all_the_way_is_reached():
    road = road_of(np.concatenate([np.zeros(20), np.full(40, 0.035)]))
    config = PccConfig(v_ref=22.0, v_max=22.0)
    solution = plan(road, PARAMETERS, 55_000.0, config)
    assert solution.optimum.method == "interior_point"
    assert solution.plan.speed == pytest.approx(solution.baseline.speed, abs=0.01)


def test_ipopt_takes_over_if_the_interior_point_method_does_not_converge(monkeypatch):
    task, guess = task_of(random_road(np.random.default_rng(8)))
    wanted = solve(task, guess)
    minimize = solver_module.minimize

    def fail(problem, b, settings):
        return replace(minimize(problem, b, settings), note="it did not")

    monkeypatch.setattr(solver_module, "minimize", fail)
    answer = solve(task, guess)
    assert answer.method == "ipopt"
    assert answer.speed == pytest.approx(wanted.speed, abs=0.02)
    with pytest.raises(PlanningError, match="it did not"):
        solve(task, guess, time_limit=0.5)


def test_without_casadi_ipopt_names_the_extra_that_has_it(monkeypatch):
    task, guess = task_of(random_road(np.random.default_rng(8)))
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(PlanningError, match=r"pip install 'iits-mj\[ipopt\]'"):
        solve(task, guess, method="ipopt")
    minimize = solver_module.minimize
    monkeypatch.setattr(
        solver_module, "minimize", lambda *args: replace(minimize(*args), note="it did not")
    )
    with pytest.raises(PlanningError, match=r"no result: it did not; .*iits-mj\[ipopt\]"):
        solve(task, guess)


def test_a_solve_beyond_its_time_limit_ends_with_the_reason():
    task, guess = task_of(random_road(np.random.default_rng(9)))
    with pytest.raises(PlanningError, match="time limit"):
        solve(task, guess, time_limit=1e-9)


def test_a_trip_time_too_short_for_the_speed_limits_is_refused_by_name():
    task, guess = task_of(road_of(np.zeros(N)))
    with pytest.raises(PlanningError, match="even at the speed limits the road takes 127"):
        solve(replace(task, time_max=100.0), guess)


def test_a_trip_time_too_short_for_full_power_is_refused_by_name():
    task, guess = task_of(road_of(np.full(N, 0.03)))
    with pytest.raises(PlanningError, match="at full power within the limits the road takes"):
        solve(replace(task, time_max=130.0), guess)


def test_a_least_speed_beyond_full_power_is_refused_with_its_station():
    task, guess = task_of(road_of(np.append(np.zeros(20), np.full(40, 0.05))))
    low = task.b_low.copy()
    low[1:-1] = 17.0**2
    with pytest.raises(
        PlanningError, match=r"least speed 17.00 m/s at station 2\d\d\d m is out of"
    ):
        solve(replace(task, b_low=low), guess)


def test_an_end_speed_out_of_reach_is_refused_by_name():
    task, guess = task_of(road_of(np.full(N, 0.04)))
    low = task.b_low.copy()
    low[-1] = 20.0**2
    high = np.maximum(task.b_high, low)
    with pytest.raises(PlanningError, match=r"the end speed 20\.00 m/s"):
        solve(replace(task, b_low=low, b_high=high), guess)


def test_a_limit_beyond_the_brakes_is_refused_with_both_stations():
    task, guess = task_of(road_of(np.zeros(N)))
    high, low = task.b_high.copy(), task.b_low.copy()
    high[30], low[30], low[29] = 9.0, 4.0, 15.0**2
    with pytest.raises(PlanningError, match=r"brakes .* station 1450 m .* station 1500 m"):
        solve(replace(task, b_low=low, b_high=high), guess)


def test_bounds_without_a_speed_between_them_are_refused_with_the_station():
    task, guess = task_of(road_of(np.zeros(N)))
    high = task.b_high.copy()
    high[10] = 50.0
    with pytest.raises(PlanningError, match="at station 500 m the least speed"):
        solve(replace(task, b_high=high), guess)


def test_a_leader_reached_even_with_full_brakes_is_refused_with_the_station():
    task, guess = task_of(road_of(np.zeros(N)))
    earliest = np.zeros(N + 1)
    earliest[1] = 10.0
    low = np.append(task.b_low[0], np.full(N, 1.0))
    with pytest.raises(PlanningError, match=r"vehicle ahead leaves station 50 m at 10\.0 s"):
        solve(replace(task, b_low=low, earliest=earliest), guess)


def test_a_leader_in_the_way_beyond_the_trip_time_is_refused():
    task, guess = task_of(road_of(np.zeros(N)))
    earliest = np.zeros(N + 1)
    earliest[-1] = task.time_max + 5.0
    low = np.append(task.b_low[0], np.full(N, 1.0))
    with pytest.raises(PlanningError, match="in the way until"):
        solve(replace(task, b_low=low, earliest=earliest), guess)


def test_tasks_with_wrong_shapes_or_nan_and_unknown_methods_are_refused():
    task, guess = task_of(road_of(np.zeros(N)))
    bad = guess.copy()
    bad[3] = math.nan
    with pytest.raises(PlanningError, match="guess"):
        solve(task, bad)
    with pytest.raises(PlanningError, match="price_time"):
        solve(replace(task, price_time=math.nan), guess)
    with pytest.raises(PlanningError, match="earliest must hold 61"):
        replace(task, earliest=np.ones(N))
    with pytest.raises(PlanningError, match="b_low must hold 62"):
        replace(task, road=road_of(np.zeros(N + 1)))
    with pytest.raises(InputError, match=r"method 'simplex' .* interior_point, ipopt.*pcc_hermite"):
        solve(task, guess, "simplex")
