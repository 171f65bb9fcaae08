"""An independent check of the speed planner: dynamic programming on a grid of v^2.

Written from the equations, not from the planner's code: the state is b = v^2 on a grid with linear
interpolation of the value, the control is the acceleration, trip time has a price that is found by
bisection.
"""

import numpy as np


def optimal_speed(vehicle, road, b_low, b_high, time_max, states=241, controls=121):
    """Node speeds (n + 1,) of least fuel with at most `time_max` [s], by bisection on its price."""
    low, high = 0.0, 0.05
    for _ in range(9):
        price = 0.5 * (low + high)
        speed = _rollout(vehicle, road, b_low, b_high, price, states, controls)
        if np.sum(2.0 * road.step / (speed[1:] + speed[:-1])) > time_max:
            low = price
        else:
            high = price
    return _rollout(vehicle, road, b_low, b_high, high, states, controls)


def _stage(vehicle, road, k, b, a, price):
    """Cost and end b of accelerations a (m,) from states b (n, 1): arrays (n, m)."""
    ds = road.step
    end = b + 2.0 * ds * a
    v = 0.5 * (np.sqrt(b) + np.sqrt(np.maximum(end, 1e-6)))
    angle = np.arctan(road.grade[k])
    resistance = vehicle.mass * 9.81 * (np.sin(angle) + vehicle.rolling * np.cos(angle))
    force = vehicle.inertial_mass * a + resistance + vehicle.drag * 0.5 * (b + end)
    power = force * v / vehicle.efficiency
    fuel = vehicle.fuel
    burning = np.maximum(power, -vehicle.power_drag)
    rate = fuel.f0 + fuel.f1 * burning + fuel.f2 * burning**2
    cost = (rate + price) * ds / v
    brake = force + vehicle.power_drag * vehicle.efficiency / v
    bad = (power > vehicle.power_max * 1.0005) | (-brake > vehicle.brake_max) | (end < 1.0)
    return np.where(bad, 1e3, cost), end


def _rollout(vehicle, road, b_low, b_high, price, states, controls):
    n = road.intervals
    grid = np.linspace(b_low.min(), b_high.max(), states)
    a = np.concatenate([np.linspace(-0.5, 0.45, controls), [0.0]])
    # The end speed is held by a stiff price on missing it, in both directions.
    value = 0.02 * np.abs(grid - b_high[-1])
    values = [value]
    for k in range(n - 1, -1, -1):
        cost, end = _stage(vehicle, road, k, grid[:, None], a[None, :], price)
        outside = (end < b_low[k + 1] - 0.5) | (end > b_high[k + 1] + 0.5)
        onward = np.interp(end, grid, value)
        value = np.minimum((cost + np.where(outside, 1e3, 0.0) + onward).min(axis=1), 1e4)
        values.append(value)
    values.reverse()
    b = np.empty(n + 1)
    b[0] = b_high[0]
    fine = np.linspace(-0.5, 0.45, 8 * controls)
    for k in range(n):
        cost, end = _stage(vehicle, road, k, np.array([[b[k]]]), fine[None, :], price)
        outside = (end < b_low[k + 1] - 0.5) | (end > b_high[k + 1] + 0.5)
        total = cost + np.where(outside, 1e3, 0.0) + np.interp(end, grid, values[k + 1])
        b[k + 1] = end[0, int(total.argmin())]
    return np.sqrt(b)
