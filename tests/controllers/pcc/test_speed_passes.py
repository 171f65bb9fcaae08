"""The compiled passes over the nodes against their Python form, bit for bit."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import make_vehicle
from controllers.pcc.schedule import Schedule
from controllers.pcc.vehicle import brakeable, fastest_below, rolling_speed
from iits_mj.core.errors import PlanningError
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()


@pytest.fixture(scope="module")
def vehicle():
    return make_vehicle(PARAMETERS, FuelMap(PARAMETERS), 55_000.0, PccConfig())


def random_road(rng):
    grade = np.clip(np.cumsum(rng.normal(0.0, 0.02, 80)), -0.2, 0.2)
    station = rng.uniform(20.0, 60.0) * np.arange(81)
    height = np.append(0.0, np.cumsum(grade * station[1]))
    return RoadProfile(station, height, np.full(81, np.inf))


def braked(vehicle, road, cap, force):
    twice = 2.0 * road.step / vehicle.inertial_mass
    half = 0.5 * vehicle.drag * twice
    fall = twice * (force + vehicle.slope_force(road.grade))
    b = cap.copy()
    for k in reversed(range(road.intervals)):
        met = (b[k + 1] * (1.0 + half) + fall[k]) / (1.0 - half)
        if met < b[k]:
            b[k] = max(met, 0.0)
    return b


def driven(vehicle, road, cap):
    """Returns the speeds (n + 1,) of full power below a cap of v^2."""
    wanted = np.sqrt(np.maximum(cap, 0.0))
    speed, slope = wanted.copy(), vehicle.slope_force(road.grade)
    half, push = 0.5 * vehicle.drag, vehicle.inertial_mass / (2.0 * road.step)
    work = 2.0 * vehicle.efficiency * vehicle.power_max
    short = vehicle.net_force(wanted, road) * 0.5 * (wanted[1:] + wanted[:-1]) > 0.5 * work
    for k in range(road.intervals):
        if speed[k] == wanted[k] and not short[k]:
            continue
        a, c = push + half, (half - push) * speed[k] * speed[k] + slope[k]
        end = at_full_power(float(speed[k]), a, c, work)
        if end < wanted[k + 1]:
            speed[k + 1] = end
            if end <= 0.0:
                speed[k + 1 :] = 0.0
                return speed
    return speed


def at_full_power(v, a, c, work):
    """Returns the root w of `a w^2 + c = work / (v + w)` by Newton's method, 0 for a stall."""
    if c * (v + 1e-3) >= work:
        return 0.0
    w = v
    for _ in range(30):
        total = v + w
        share = work / total
        step = (a * w * w + c - share) / (2.0 * a * w + share / total)
        w = w - step if step < 0.9 * w else 0.1 * w
        if abs(step) < 1e-9:
            break
    return w


def rolled(vehicle, road, start, cap, top):
    """Returns the speeds (n + 1,) of a truck that rolls above a cap up to `top` [m/s]."""
    speed, slope = cap.copy(), vehicle.slope_force(road.grade)
    speed[0] = start
    half, push = 0.5 * vehicle.drag, vehicle.inertial_mass / (2.0 * road.step)
    for k in range(road.intervals):
        v = speed[k]
        a, c = push + half, (half - push) * v * v + slope[k]
        slowest = at_full_power(float(v), a, c, -2.0 * vehicle.power_overrun)
        fastest = at_full_power(float(v), a, c, 2.0 * vehicle.efficiency * vehicle.power_max)
        wanted = min(speed[k + 1], fastest)
        speed[k + 1] = min(max(wanted, slowest), max(top[k + 1], wanted))
        if speed[k + 1] <= 0.0:
            speed[k + 1 :] = 0.0
            return speed
    return speed


def test_passes_over_random_roads_equal_their_python_form(vehicle):
    rng = np.random.default_rng(1)
    stalls = rolling = 0
    for number in range(300):
        # A twentieth of the power stalls on some roads.
        truck = replace(vehicle, power_max=vehicle.power_max * (1.0, 0.05)[number % 2])
        road = random_road(rng)
        cap = rng.choice([4.0, 100.0, 400.0, 600.0], 81) * rng.uniform(0.9, 1.0, 81)
        force = rng.uniform(0.0, 3e5)
        b = brakeable(truck, road, cap, force)
        assert np.array_equal(b, braked(truck, road, cap, force))
        speed = fastest_below(truck, road, b)
        assert np.array_equal(speed, driven(truck, road, b))
        stalls += speed[-1] == 0.0
        set_speed, top = np.full(81, 15.0), np.full(81, rng.uniform(16.0, 30.0))
        strong = replace(truck, brake_max=3e5)
        try:
            found = rolling_speed(strong, road, 15.0, set_speed, top)
        except PlanningError:
            continue
        held = np.sqrt(braked(strong, road, top**2, strong.brake_max))
        wanted = np.minimum(set_speed, held)
        assert np.array_equal(found, rolled(strong, road, 15.0, wanted, held))
        rolling += 1
    assert rolling > 100
    assert 0 < stalls < 300


def test_greatest_speed_of_a_schedule_is_that_of_interpolated_nodes():
    rng = np.random.default_rng(2)
    station = 200.0 + 50.0 * np.arange(60)
    nothing = np.zeros(60)
    schedule = Schedule(station, rng.uniform(10.0, 25.0, 60), nothing, nothing, 0.0)
    for place in [*rng.uniform(0.0, 3500.0, 500), *station[:5], 200.0, station[-1]]:
        ahead = place + np.linspace(0.0, 500.0, 11)
        assert schedule.fastest(place, 50.0, 11) == schedule.speed_at(ahead).max()
        assert schedule.fastest(place) == schedule.speed_at(place)
    copied = copy.deepcopy(schedule)
    assert copied._table[1] != schedule._table[1]
    assert copied.fastest(900.0) == schedule.fastest(900.0)
