"""The convex lower bound: below every drive, and equal to the plan."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile, SpeedTask, solve
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import lower_speeds, make_vehicle
from controllers.pcc.vehicle import cruise, durations, fastest_below, full_power_speed
from iits_mj.core.errors import PlanningError
from iits_mj.parameters import TruckParameters
from iits_mj.validation.planning.pcc_bound import (
    Relaxation,
    certificate,
    enough_speeds,
    lower_bound,
)

PARAMETERS = TruckParameters.load()
FUEL_MAP = FuelMap(PARAMETERS)


def random_road(seed, intervals=80, steepest=0.04):
    rng = np.random.default_rng(seed)
    grade = np.convolve(rng.normal(size=intervals + 20), np.ones(21) / 21.0, "valid")
    grade *= steepest * rng.uniform(0.3, 1.0) / np.abs(grade).max()
    height = np.concatenate([[0.0], np.cumsum(50.0 * grade)])
    station = 50.0 * np.arange(intervals + 1)
    return RoadProfile(station, height, np.full(station.size, np.inf), f"seed {seed}")


def task_on(road, mass=55_000.0, k_a=0.0, v_ref=20.0):
    config = PccConfig(v_ref=v_ref, v_max=25.0)
    vehicle = make_vehicle(PARAMETERS, FUEL_MAP, mass, config)
    base = cruise(vehicle, road, v_ref, v_ref)
    fastest = full_power_speed(vehicle, road, v_ref, np.full(base.size, config.v_max))
    low = lower_speeds(fastest, config.v_min) ** 2
    high = np.maximum(config.v_max**2, low)
    low[[0, -1]] = high[[0, -1]] = base[[0, -1]] ** 2
    total = float(durations(base, road).sum())
    return SpeedTask(vehicle, road, low, high, total, k_a=1e-3 * k_a), base


def cost(task, speed):
    a = np.diff(speed**2) / (2.0 * task.road.step)
    time = durations(speed, task.road)
    total = task.vehicle.fuel_of(speed, task.road).sum() + task.k_a * float(a**2 @ time)
    return total + task.price_time * time.sum() - task.price_energy * speed[-1] ** 2


def feasible(task, speed):
    vehicle = task.vehicle
    net = vehicle.net_force(speed, task.road)
    power = net * 0.5 * (speed[1:] + speed[:-1]) / vehicle.efficiency
    in_band = (speed**2 >= task.b_low - 1e-9).all() and (speed**2 <= task.b_high + 1e-9).all()
    in_time = durations(speed, task.road).sum() <= task.time_max + 1e-9
    brakes = -vehicle.power_drag * vehicle.efficiency / speed.max() - vehicle.brake_max
    return in_band and in_time and power.max() <= vehicle.power_max and net.min() >= brakes


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("mass", "k_a"), [(55_000.0, 0.0), (19_000.0, 2.0)])
def test_plan_meets_the_bound_so_it_is_the_global_optimum(seed, mass, k_a):
    task, base = task_on(random_road(seed), mass, k_a)
    answer = solve(task, base)
    bound = lower_bound(task)
    assert bound.converged
    assert bound.slack < 1e-5
    assert -1e-7 < bound.gap(cost(task, answer.speed)) < 1e-5
    assert np.abs(bound.speed - answer.speed).max() < 0.1


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("mass", "k_a"), [(55_000.0, 0.5), (19_000.0, 0.0)])
def test_multipliers_of_the_plan_certify_its_cost(seed, mass, k_a):
    task, base = task_on(random_road(seed), mass, k_a)
    answer = solve(task, base)
    bound = certificate(task, answer)
    total = cost(task, answer.speed)
    assert total * (1.0 - 1e-4) < bound < total * (1.0 + 1e-7)
    # The bound of the relaxation's solver is at least as high, within its tolerance.
    assert bound <= lower_bound(task).cost * (1.0 + 1e-6) + 1e-6


def test_wrong_multipliers_weaken_the_certificate_but_keep_it_valid():
    task, base = task_on(random_road(1))
    answer = solve(task, base)
    total = cost(task, answer.speed)
    rng = np.random.default_rng(4)
    for _ in range(50):
        wrong = replace(
            answer,
            time_price=answer.time_price * rng.uniform(0.0, 3.0),
            costate=answer.costate * rng.uniform(0.5, 1.5, answer.costate.size),
        )
        assert certificate(task, wrong) < total
    for speed in (base, answer.speed + 0.1 * rng.normal(size=base.size)):
        assert certificate(task, replace(answer, speed=speed)) < total


def test_no_drive_that_keeps_the_limits_is_below_the_bound():
    task, base = task_on(random_road(7), k_a=0.5)
    plan = solve(task, base).speed
    bound = lower_bound(task).cost
    rng = np.random.default_rng(1)
    tried = 0
    for _ in range(3000):
        # Between plan and cruise, with bumps of random length.
        bump = np.convolve(rng.normal(size=base.size + 10), np.ones(11) / 11.0, "valid")
        bump[[0, -1]] = 0.0
        speed = base + rng.uniform(0.0, 1.0) * (plan - base) + rng.uniform(0.0, 1.0) * np.abs(bump)
        speed[[0, -1]] = base[[0, -1]]
        if feasible(task, speed):
            tried += 1
            assert cost(task, speed) >= bound
    assert tried > 50


def test_any_point_and_any_multipliers_give_a_bound():
    task, base = task_on(random_road(3), k_a=0.5)
    optimum = cost(task, solve(task, base).speed)
    relaxation = Relaxation(task)
    point, multipliers, _, _ = relaxation.solve()
    rng = np.random.default_rng(2)
    for share in (0.0, 0.01, 0.3, 1.0):
        boxes = (relaxation.b_box, relaxation.e_box, relaxation.t_box)
        other = tuple(rng.uniform(low, high) for low, high in boxes)
        at = tuple((1.0 - share) * z + share * x for z, x in zip(point, other, strict=True))
        y = multipliers * rng.uniform(1.0 - share, 1.0 + share, multipliers.shape)
        value = relaxation.dual_value(at, y)
        assert value <= optimum
        if share == 0.0:
            assert value == pytest.approx(optimum, rel=1e-5)


def test_bound_stays_below_where_the_relaxation_is_loose():
    # With an unreasonable weight of acceleration, waiting on the spot pays.
    task, base = task_on(random_road(5, steepest=0.05), k_a=400.0)
    answer = solve(task, base)
    bound = lower_bound(task)
    assert bound.slack > 0.01
    assert bound.gap(cost(task, answer.speed)) > 0.0


def test_no_plan_takes_longer_than_the_chords_allow():
    task, _ = task_on(random_road(8))
    relaxation = Relaxation(task)
    rng = np.random.default_rng(5)
    for _ in range(200):
        b = rng.uniform(*relaxation.b_box)
        assert (relaxation.least_time(b) <= relaxation.most_time(b) * (1.0 + 1e-12)).all()
    for b in relaxation.b_box:
        # At the ends of the box both agree for equal speeds.
        inner = slice(1, -1)
        assert relaxation.most_time(b)[inner] == pytest.approx(
            0.5 * task.road.step * (1.0 / np.sqrt(b[1:-2]) + 1.0 / np.sqrt(b[2:-1]))
        )


def test_prices_of_time_and_end_speed_replace_a_trip_time():
    task, base = task_on(random_road(6))
    low, high = task.b_low.copy(), task.b_high.copy()
    low[-1], high[-1] = 12.5**2, 25.0**2
    task = replace(
        task, b_low=low, b_high=high, time_max=np.inf, price_time=0.008, price_energy=2e-3
    )
    answer = solve(task, base)
    gap = lower_bound(task).gap(cost(task, answer.speed))
    assert -1e-7 < gap < 1e-5


def test_bound_on_the_fuel_is_below_that_on_the_cost():
    task, _ = task_on(random_road(4), k_a=50.0)
    assert lower_bound(replace(task, k_a=0.0)).cost < lower_bound(task).cost


def test_less_time_never_lowers_the_bound():
    task, _ = task_on(random_road(2))
    shorter = replace(task, time_max=0.99 * task.time_max)
    assert lower_bound(shorter).cost > lower_bound(task).cost


def test_a_task_without_speed_limits_is_refused():
    task, _ = task_on(random_road(0))
    with pytest.raises(PlanningError, match="finite at every node"):
        lower_bound(replace(task, b_high=np.full(task.b_high.size, np.inf)))


def test_contradicting_bounds_are_named():
    task, _ = task_on(random_road(0))
    low = task.b_low.copy()
    low[10] = 700.0
    with pytest.raises(PlanningError, match="station 500 m"):
        lower_bound(replace(task, b_low=low))


@pytest.mark.parametrize("k_a", [0.0, 0.5])
def test_bound_equals_the_plan_on_a_level_road_from_below(k_a):
    # Plan and bound use the same tolerance of the trip time.
    station = 50.0 * np.arange(201)
    road = RoadProfile(station, np.zeros(201), np.full(201, np.inf), "level")
    task, base = task_on(road, k_a=k_a)
    answer = solve(task, base)
    total = cost(task, answer.speed)
    for bound in (certificate(task, answer), lower_bound(task).cost):
        assert total * (1.0 - 1e-5) < bound <= total


def climb_task():
    """A climb too steep for the least speed, which holds before and after it."""
    grade = np.concatenate([np.zeros(40), np.full(24, 0.05), np.full(56, -0.01)])
    height = np.concatenate([[0.0], np.cumsum(50.0 * grade)])
    road = RoadProfile(50.0 * np.arange(121), height, np.full(121, np.inf), "climb")
    task, base = task_on(road)
    fastest = full_power_speed(task.vehicle, road, 20.0, np.full(121, 25.0))
    low = lower_speeds(fastest, 15.5) ** 2
    low[[0, -1]] = task.b_low[[0, -1]]
    return replace(task, b_low=low, b_high=np.maximum(task.b_high, low)), base, fastest


def test_plan_that_returns_to_its_band_after_a_climb_is_certified():
    task, base, _ = climb_task()
    answer = solve(task, base)
    assert -1e-9 < lower_bound(task).gap(cost(task, answer.speed)) < 5e-4


def test_full_power_from_below_the_sufficient_speed_misses_a_least_speed_ahead():
    task, _, fastest = climb_task()
    low = np.sqrt(task.b_low)
    enough = enough_speeds(task.vehicle, task.road, low, fastest)
    raised = np.flatnonzero(enough[:-1] > low[:-1] + 1e-3)
    assert raised.size > 5
    for k in raised:
        for share, reached in ((1.001, True), (0.999, False)):
            if k + 4 > task.road.intervals:
                continue
            ahead, road = slice(k, k + 5), task.road
            rest = RoadProfile(road.station[ahead], road.height[ahead], road.v_limit[ahead])
            cap = np.append((share * enough[k]) ** 2, np.full(4, 900.0))
            speed = fastest_below(task.vehicle, rest, cap)
            assert (speed[1:] >= enough[k + 1 : k + 5] - 1e-6).all() == reached
