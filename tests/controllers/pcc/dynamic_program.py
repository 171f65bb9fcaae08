"""An independent check of the speed planner: dynamic programming from grid point to grid point.

Written from the equations, not from the planner's code. The state is b = v^2 on a grid of its own.
Each step leads from one grid point to another without interpolation, so the result is a drive that
keeps all limits, and its cost is an upper bound of the least cost. Trip time has the price that the
planner found. By weak duality no drive of the same trip time costs less than the least cost at that
price, minus the price of the time: the planner's optimum must not exceed this, and the grid's may
exceed it only by the rounding of the grid.
"""

import numpy as np


def least_cost(vehicle, road, b_low, b_high, price, states=800, reach=(-180.0, 60.0), rate=None):
    """Returns the least fuel + price * time [kg] between the end speeds, and the node speeds.

    Args:
      vehicle, road: of the planner.
      b_low, b_high: bounds of v^2, shape (n + 1,); the first and the last are fixed and equal.
      price: of a second [kg/s].
      states: grid points between the least and the greatest bound.
      reach: greatest decrease and increase of b in an interval [m2/s2].
      rate: fuel [kg/s] over wheel force [N] and speed [m/s]; default: the vehicle's convex model.
    """
    n, ds = road.intervals, road.step
    home = b_high[0]
    assert abs(b_high[-1] - home) < 1e-6
    width = (b_high.max() - b_low.min()) / states
    first = int(np.ceil((b_low.min() - home) / width))
    last = int(np.floor((b_high.max() - home) / width))
    b = home + width * np.arange(first, last + 1)
    jumps = np.arange(int(reach[0] / width), int(reach[1] / width) + 1)
    end = b[:, None] + width * jumps[None, :]
    target = np.arange(b.size)[:, None] + jumps[None, :]
    on_grid = (target >= 0) & (target < b.size)
    target = np.clip(target, 0, b.size - 1)
    v = 0.5 * (np.sqrt(b)[:, None] + np.sqrt(np.maximum(end, 1e-9)))
    level = vehicle.inertial_mass * (end - b[:, None]) / (2.0 * ds)
    level += vehicle.drag * 0.5 * (b[:, None] + end)
    slope = vehicle.mass * 9.81 * (np.diff(road.height) / ds + vehicle.rolling)
    fuel, eta = vehicle.fuel, vehicle.efficiency
    dragging = vehicle.power_drag
    value = np.where(np.abs(b - home) < 0.5 * width, 0.0, np.inf)
    choices = []
    for k in range(n - 1, -1, -1):
        force = level + slope[k]
        power = force * v / eta
        burning = np.maximum(power, -dragging)
        if rate is None:
            burnt = fuel.f0 + burning * (fuel.f1 + fuel.f2 * burning)
        else:
            burnt = rate(force, v)
        cost = (burnt + price) * ds / v
        allowed = on_grid & (power <= vehicle.power_max)
        allowed &= -(force + dragging * eta / v) <= vehicle.brake_max
        inside = (b >= b_low[k + 1] - 1e-9) & (b <= b_high[k + 1] + 1e-9)
        onward = np.where(inside, value, np.inf)
        total = np.where(allowed, cost + onward[target], np.inf)
        choice = total.argmin(axis=1)
        value = total[np.arange(b.size), choice]
        choices.append(target[np.arange(b.size), choice])
    at = -first
    least = float(value[at])
    path = [at]
    for choice in reversed(choices):
        at = int(choice[at])
        path.append(at)
    return least, np.sqrt(b[path])
