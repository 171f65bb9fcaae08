"""Possible gain of gear choice and eco-roll: the convex plan against the engine's map itself.

The dynamic program uses the map with the gear of least fuel in every interval, with shifts at no
cost, and also neutral at idle. It is an upper bound of the gain of a plan with gears.
"""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc import PccConfig, RoadProfile, plan
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import make_vehicle
from iits_mj.parameters import TruckParameters
from iits_mj.validation.planning.pcc_bound import below_fit
from tests.controllers.pcc.dynamic_program import least_cost
from tests.paths import outside

PARAMETERS = TruckParameters.load()
FUEL_MAP = FuelMap(PARAMETERS)
IDLE = float(FUEL_MAP.engine_rate(np.zeros(1), np.array([PARAMETERS.engine.idle_speed]))[0])


def map_rate(neutral):
    """Fuel [kg/s] over wheel force and speed: tabulated map; in neutral at most idle."""
    speed = np.linspace(10.0, 25.2, 153)
    force = np.linspace(-3_000.0, 42_000.0, 451)
    at = np.meshgrid(force, speed, indexing="ij")
    table = FUEL_MAP.rate(at[0].ravel(), at[1].ravel())[0].reshape(at[0].shape)

    def rate(f, v):
        x = np.clip((f - force[0]) / (force[1] - force[0]), 0.0, force.size - 1.001)
        y = np.clip((v - speed[0]) / (speed[1] - speed[0]), 0.0, speed.size - 1.001)
        i, j = x.astype(int), y.astype(int)
        p, q = x - i, y - j
        low = (1.0 - q) * table[i, j] + q * table[i, j + 1]
        high = (1.0 - q) * table[i + 1, j] + q * table[i + 1, j + 1]
        burnt = (1.0 - p) * low + p * high
        return np.where(f <= 0.0, np.minimum(burnt, IDLE), burnt) if neutral else burnt

    return rate


def test_an_engine_without_load_burns_more_in_top_gear_than_idling_in_neutral():
    # So eco-roll gains something at any speed, and more where the engine would turn fast.
    rate, gear = FUEL_MAP.rate(np.array([1e-3]), np.array([20.0]))
    assert gear[0] == 12
    assert 1.2 * IDLE < rate[0] < 1.7 * IDLE
    faster, _ = FUEL_MAP.rate(np.array([1e-3]), np.array([25.0]))
    assert faster[0] > 1.1 * rate[0]


def test_fuel_by_the_map_is_at_least_fuel_by_the_fit_less_their_greatest_distance():
    station = 50.0 * np.arange(61)
    height = 15.0 * np.sin(2.0 * np.pi * station / 2000.0)
    road = RoadProfile(station, height, np.full(61, np.inf), "hills")
    config = PccConfig(k_a=0.0, rolls=False)
    solution = plan(road, PARAMETERS, 55e3, config)
    vehicle = make_vehicle(PARAMETERS, FUEL_MAP, 55e3, config)
    below = below_fit(FUEL_MAP, vehicle.fuel, config.v_min, config.v_max)
    base = solution.baseline.speed
    low, high = np.full(base.size, config.v_min**2), np.full(base.size, config.v_max**2)
    low[[0, -1]] = high[[0, -1]] = base[[0, -1]] ** 2
    price, time = solution.time_price, solution.plan.time
    free = replace(vehicle, power_drag=1e6)
    least = least_cost(free, road, low, high, price, 200, rate=map_rate(False))[0] - price * time
    assert solution.fuel - below * time < least < float(solution.plan.map_fuel.sum()) * 1.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mass", "choice", "coasting"), [(55e3, 0.015, 0.001), (19e3, 0.015, 0.004)]
)
def test_gear_choice_and_eco_roll_leave_little_to_gain(mass, choice, coasting):
    road = RoadProfile.from_csv(outside("road/jinan_altimap_pcc.csv"), length=15_000.0)
    config = PccConfig(k_a=0.0, rolls=False)
    solution = plan(road, PARAMETERS, mass, config)
    vehicle = replace(
        make_vehicle(PARAMETERS, FUEL_MAP, mass, config),
        power_drag=1e6,  # friction brakes and engine together; the map has the fuel of overrun
    )
    base = solution.baseline.speed
    low, high = np.full(base.size, config.v_min**2), np.full(base.size, config.v_max**2)
    low[[0, -1]] = high[[0, -1]] = base[[0, -1]] ** 2
    price = solution.time_price
    spent = float(solution.plan.map_fuel.sum())
    least = [
        least_cost(vehicle, road, low, high, price, 500, rate=map_rate(neutral))[0]
        - price * solution.plan.time
        for neutral in (False, True)
    ]
    assert 0.0 < 1.0 - least[0] / spent < choice
    assert 0.0 <= (least[0] - least[1]) / spent < coasting
