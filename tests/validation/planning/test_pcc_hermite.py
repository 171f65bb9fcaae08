"""The paper's finite elements in time against the distance domain."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile, SpeedTask, solve
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import lower_speeds, make_vehicle
from controllers.pcc.vehicle import cruise, durations, full_power_speed
from iits_mj.core.errors import PlanningError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.validation.planning.pcc_hermite import ElementsProgram, basis

PARAMETERS = TruckParameters.load()
FUEL_MAP = FuelMap(PARAMETERS)


def hills(amplitude=0.03, intervals=100, limit=np.inf):
    station = 50.0 * np.arange(intervals + 1)
    # Height of a sine grade of 2 km; zero grade at both ends.
    wave = 2.0 * np.pi / 2000.0
    height = amplitude / wave * (1.0 - np.cos(wave * station))
    return RoadProfile(station, height, np.full(station.size, limit), "hills")


def task_on(road, k_a=0.5):
    config = PccConfig(v_max=25.0)
    vehicle = make_vehicle(PARAMETERS, FUEL_MAP, 55_000.0, config)
    base = cruise(vehicle, road, 20.0, 20.0)
    cap = np.minimum(road.v_limit, config.v_max)
    low = lower_speeds(full_power_speed(vehicle, road, 20.0, cap), config.v_min) ** 2
    high = np.maximum(cap**2, low)
    low[[0, -1]] = high[[0, -1]] = base[[0, -1]] ** 2
    total = float(durations(base, road).sum())
    return SpeedTask(vehicle, road, low, high, total, k_a=1e-3 * k_a), base


def by_elements(task, guess, **settings):
    return solve(task, guess, "finite_elements", **settings)


@pytest.fixture(scope="module")
def hilly():
    task, base = task_on(hills())
    return task, base, by_elements(task, base)


def motion(answer, samples=50):
    """Station, speed and acceleration within all elements, from the cubics, shape (3, m)."""
    tau = (np.arange(samples) + 0.5) / samples
    h = answer.clock[1]
    s, v = answer.node_station, answer.node_speed
    parts = np.array([s[:-1], v[:-1] * h, s[1:], v[1:] * h])
    return np.array([(parts.T @ basis(tau)[k] / h**k).ravel() for k in range(3)])


def test_basis_gives_values_and_slopes_at_both_ends():
    ends = basis(np.array([0.0, 1.0]))
    np.testing.assert_allclose(ends[0].T, np.eye(4)[[0, 2]])
    np.testing.assert_allclose(ends[1].T, np.eye(4)[[1, 3]])


def test_derivatives_of_the_basis_agree_with_differences():
    tau, step = np.linspace(0.1, 0.9, 9), 1e-5
    table = basis(tau)
    for k in (0, 1):
        ahead, behind = basis(tau + step)[k], basis(tau - step)[k]
        assert table[k + 1] == pytest.approx((ahead - behind) / (2.0 * step), abs=1e-8)


def test_gradient_of_the_program_agrees_with_differences():
    import casadi as ca

    task, base = task_on(hills(intervals=20))
    problem = ElementsProgram(task, 100.0, 4)
    program = problem.functions
    value = ca.Function("f", [program["x"]], [program["f"], program["g"]])
    slope = ca.Function(
        "j",
        [program["x"]],
        [ca.gradient(program["f"], program["x"]), ca.jacobian(program["g"], program["x"])],
    )
    rng = np.random.default_rng(0)
    start = problem.start(base)
    along = rng.normal(size=start.size)
    # Bounds of v^2 have kinks at the nodes of the road, where the first guess has its ends.
    x = start + rng.uniform(0.001, 0.01, start.size)
    step = 1e-6
    up, down = value(x + step * along), value(x - step * along)
    gradient, jacobian = slope(x)
    assert float((up[0] - down[0]) / (2 * step)) == pytest.approx(
        float(np.asarray(gradient).ravel() @ along), rel=1e-6
    )
    rows = np.asarray(up[1] - down[1]).ravel() / (2 * step)
    assert rows == pytest.approx(np.asarray(jacobian @ along).ravel(), abs=1e-5)


def test_ends_and_trip_time_are_met_exactly(hilly):
    task, base, answer = hilly
    assert answer.clock[-1] == pytest.approx(task.time_max, rel=1e-12)
    assert answer.node_station[[0, -1]] == pytest.approx(task.road.station[[0, -1]])
    assert answer.node_speed[[0, -1]] == pytest.approx(base[[0, -1]], rel=1e-6)


def test_fuel_agrees_with_the_motion_of_the_elements(hilly):
    task, _, answer = hilly
    vehicle = task.vehicle
    s, v, a = motion(answer)
    wave = 2.0 * np.pi / 2000.0
    grade = 0.03 * np.sin(wave * s)
    resistance = vehicle.mass * GRAVITY * (grade + vehicle.rolling)
    power = (vehicle.inertial_mass * a + resistance + vehicle.drag * v**2) * v / vehicle.efficiency
    assert power.max() < 1.03 * vehicle.power_max
    rate = vehicle.fuel.rate(np.maximum(power, -vehicle.power_drag))
    assert rate.mean() * task.time_max == pytest.approx(answer.fuel, rel=2e-3)


def test_both_transcriptions_agree_within_half_a_percent(hilly):
    task, base, answer = hilly
    plan = solve(task, base).speed
    fuel = task.vehicle.fuel_of(plan, task.road).sum()
    assert answer.fuel == pytest.approx(fuel, rel=5e-3)
    assert task.vehicle.fuel_of(answer.speed, task.road).sum() == pytest.approx(fuel, rel=5e-3)
    assert np.sqrt(np.mean((answer.speed - plan) ** 2)) < 0.5


def test_shorter_elements_approach_the_distance_domain(hilly):
    task, base, _ = hilly
    plan = solve(task, base).speed
    fuel = task.vehicle.fuel_of(plan, task.road).sum()
    long, short = (abs(by_elements(task, base, element=e).fuel / fuel - 1.0) for e in (250.0, 62.5))
    assert short < long
    assert short < 2e-3


def test_constant_speed_is_the_optimum_on_a_level_road():
    task, base = task_on(hills(0.0))
    answer = by_elements(task, base)
    vehicle = task.vehicle
    # Only the last stretch may coast a little and recover, because the end speed is fixed.
    assert np.abs(answer.node_speed - 20.0).max() < 0.2
    power = (vehicle.slope_force(np.zeros(1))[0] + vehicle.drag * 400.0) * 20.0
    steady = float(vehicle.fuel.rate(np.array([power / vehicle.efficiency]))[0]) * task.time_max
    assert answer.fuel == pytest.approx(steady, rel=1e-3)


def test_speed_limits_hold_at_the_points_of_the_elements():
    road = hills()
    limit = np.full(road.station.size, np.inf)
    limit[50:70] = 17.0
    task, base = task_on(replace(road, v_limit=limit))
    answer = by_elements(task, base)
    assert (answer.speed - np.sqrt(task.b_high)).max() < 0.5
    inside = (answer.node_station >= 2500.0) & (answer.node_station <= 3450.0)
    assert answer.node_speed[inside].max() <= 17.0 + 1e-4


def test_a_vehicle_ahead_holds_the_truck_back():
    task, base = task_on(hills())
    free = by_elements(task, base)
    # The vehicle ahead falls behind by up to 8 s on the first half of the road, and leaves it.
    clock = np.concatenate([[0.0], np.cumsum(durations(base, task.road))])
    late = clock + np.minimum(8.0, 0.12 * clock)
    earliest = np.where(task.road.station < 2500.0, late, 0.0)
    held = by_elements(replace(task, earliest=earliest), base)
    passed = np.interp(2400.0, held.node_station, held.clock)
    assert passed >= earliest[48] - 0.05
    assert np.interp(2400.0, free.node_station, free.clock) < earliest[48] - 1.0
    assert held.fuel > free.fuel


def test_prices_and_open_trip_times_are_refused():
    task, base = task_on(hills())
    with pytest.raises(PlanningError, match="trip time"):
        by_elements(replace(task, time_max=np.inf), base)
    with pytest.raises(PlanningError, match="price"):
        by_elements(replace(task, price_time=0.01), base)


def test_a_vehicle_ahead_beyond_the_trip_time_is_refused():
    task, base = task_on(hills())
    late = np.full(base.size, 2.0 * task.time_max)
    late[0] = 0.0
    with pytest.raises(PlanningError, match="vehicle ahead"):
        by_elements(replace(task, earliest=late), base)


def test_a_trip_time_out_of_reach_ends_with_a_reason():
    task, base = task_on(hills())
    with pytest.raises(PlanningError, match="iterations"):
        by_elements(replace(task, time_max=0.7 * task.time_max), base)
