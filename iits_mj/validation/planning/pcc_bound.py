"""Lower bound on the cost of every speed plan, by a convex relaxation and weak duality.

A plan on the grid is b = v^2 at the nodes, work E of the engine and duration t of each interval:

    t = 2 ds / (v[k] + v[k+1])                                                     (1)
    0 <= eta E / ds - N(b) <= B_max                          brakes; N is linear in b
    -P_drag t <= E <= P_max t                                power E / t
    b_low <= b <= b_high,   sum t <= T
    cost = sum f0 t + f1 E + f2 E^2 / t + k_a (b[k+1] - b[k])^2 / (2 ds (v[k] + v[k+1]))
           + price_time sum t - price_energy b[n]

`v[k] + v[k+1]` is concave in b, so (1) is a convex function of b, and so is the term of k_a, a
square over a concave function. `E^2 / t` is convex in (E, t) together. Only the equality (1) is not
convex. The relaxation has `t >= 2 ds / (v[k] + v[k+1])` in its place: every plan stays feasible at
its own cost, so the relaxed optimum is at most the cost of any plan. Where it meets (1), which it
does while waiting does not pay (`f0 + price > f2 P^2` off the limits of power), the relaxed optimum
is itself a plan, and this plan is the global optimum. Where waiting would pay,
`t <= ds (c(b[k]) + c(b[k+1])) / 2` limits it, with c the chord of `1 / sqrt(b)` over the bounds of
b. Every plan satisfies this as well: a harmonic mean is at most the arithmetic mean, and a chord
lies above its curve. First the bounds of b are narrowed by full power: to the fastest drive, and to
the slowest drive that still reaches the least speeds ahead.

The number is a bound even if the relaxed problem is solved inexactly. With multipliers y >= 0 the
Lagrangian L(x, y) is at most the cost for every feasible x; it is convex in x, so it lies above its
tangent at any point z, whose least value over the box of x is a sum over the components:

    cost(x) >= L(x, y) >= L(z, y) + sum min over the box of dL/dx (x - z)

(weak duality; S. Boyd, L. Vandenberghe, Convex Optimization, sections 5.1.3 and 3.1.3). A vehicle
ahead only removes plans, so the bound also holds behind a vehicle. Power, brakes and trip time have
the same tolerances as in the optimizer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.pcc.fuel import FuelMap, Willans
from controllers.pcc.problem import with_room
from controllers.pcc.profile import RoadProfile
from controllers.pcc.solver import casadi
from controllers.pcc.task import Solution, SpeedTask, require_feasible
from controllers.pcc.vehicle import PointMass
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError

# Units inside the solver: b [m2/s2], E [J], t [s], cost [kg].
_B, _E, _T, _COST = 400.0, 3e5, 2.5, 0.1
_ROUNDING = 1e-7  # of v^2, relative
_AT_LIMIT = 1e-3  # relative distance from a limit that counts as on it
_HALVINGS = 40

Point = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class LowerBound:
    """Lower bound on the cost of every plan of a task.

    Attributes:
      cost: lower bound on the cost [kg]; that on the fuel when k_a and the prices are zero.
      relaxed: optimum of the relaxation by IPOPT [kg].
      slack: greatest excess of t over (1), relative; zero where the relaxation is a plan.
      speed: node speeds of the relaxation, shape (n + 1,) [m/s].
      converged: whether IPOPT converged; the bound holds either way.
      wall_time: of set-up and solve [s].
    """

    cost: float
    relaxed: float
    slack: float
    speed: FloatArray
    converged: bool
    wall_time: float

    def gap(self, cost: float) -> float:
        """Greatest distance of a plan's cost [kg] from the global optimum, relative."""
        return cost / self.cost - 1.0 if self.cost > 0.0 else np.inf


def lower_bound(task: SpeedTask) -> LowerBound:
    """Lower bound on the cost of the task; `replace(task, k_a=0.0)` bounds the fuel.

    Raises:
      PlanningError: no drive fulfils the task, or a speed limit is infinite.
    """
    began = time.perf_counter()
    if not np.isfinite(task.b_high).all():
        raise PlanningError("the bound needs speed limits that are finite at every node")
    relaxation = Relaxation(task)
    point, multipliers, relaxed, converged = relaxation.solve()
    cost = relaxation.dual_value(point, multipliers)
    b, _, t = point
    tight = relaxation.least_time(b)
    return LowerBound(
        cost=cost,
        relaxed=relaxed,
        slack=float(np.max(t / tight) - 1.0),
        speed=np.sqrt(b),
        converged=converged,
        wall_time=time.perf_counter() - began,
    )


def certificate(task: SpeedTask, solution: Solution) -> float:
    """Lower bound on the cost [kg] from a solution's own multipliers, without solving: O(n).

    The price of trip time and the costates q of the solution give the multipliers y of the
    relaxation where it meets (1). With G = f1 + 2 f2 P and A = f0 + prices - f2 P^2 stationarity by
    E and t gives, with g the multiplier of full power (s = 1, limit p = P_max) or of overrun
    (s = -1, p = P_drag), zero between both,

        multiplier of N: (G + s g) ds / eta,     multiplier of (1): A - p g

    and q[k] is the worth of v^2 at the interval's start: one linear equation for g. If the
    relaxation is loose, the bound is only weaker; `lower_bound` then finds the best bound.
    """
    relaxation = Relaxation(task)
    task, vehicle = relaxation.task, relaxation.task.vehicle
    v, fuel, ds = solution.speed, vehicle.fuel, task.road.step
    b, sums, gain = v**2, v[1:] + v[:-1], np.diff(v**2)
    t = 2.0 * ds / sums
    net = vehicle.net_force(v, task.road)
    work = np.clip(
        net * ds / vehicle.efficiency, *(p * t for p in (-vehicle.power_drag, vehicle.power_max))
    )
    power = work / t
    lever = ds / vehicle.efficiency
    inertia = vehicle.inertial_mass / (2.0 * ds) - 0.5 * vehicle.drag
    force = fuel.f1 + 2.0 * fuel.f2 * power
    wait = fuel.f0 + task.price_time + solution.time_price - fuel.f2 * power**2
    by_time = ds / (sums**2 * v[:-1])
    calm = task.k_a * (gain / (ds * sums) + gain**2 / (4.0 * ds * sums**2 * v[:-1]))
    missing = solution.costate[:-1] - wait * by_time - calm - lever * force * inertia
    full = power >= vehicle.power_max * (1.0 - _AT_LIMIT)
    over = power <= -vehicle.power_drag * (1.0 - _AT_LIMIT)
    of_full = np.where(full, missing / (lever * inertia - vehicle.power_max * by_time), 0.0)
    of_over = np.where(over, missing / (-lever * inertia - vehicle.power_drag * by_time), 0.0)
    of_full, of_over = np.maximum(of_full, 0.0), np.maximum(of_over, 0.0)
    push = -lever * (force + of_full - of_over)
    late = wait - vehicle.power_max * of_full - vehicle.power_drag * of_over
    columns = (np.maximum(-push, 0.0), np.maximum(push, 0.0), of_full, of_over)
    table = np.column_stack([*columns, np.maximum(late, 0.0), np.zeros(late.size)])
    return relaxation.dual_value(
        (b, work, t), np.vstack([table, [solution.time_price, *[0.0] * 5]])
    )


class Relaxation:
    """The convex problem of one task."""

    def __init__(self, task: SpeedTask) -> None:
        task = self.task = with_room(task)
        vehicle = task.vehicle
        self.step = task.road.step
        self.slope = vehicle.slope_force(task.road.grade)
        # Between the drive at full power and the slowest drive that reaches the least speeds
        # ahead: the narrower the box, the closer the chord.
        fastest = require_feasible(task) ** 2 * (1.0 + _ROUNDING)
        slowest = enough_speeds(vehicle, task.road, np.sqrt(task.b_low), np.sqrt(fastest)) ** 2
        low = np.maximum(task.b_low, slowest * (1.0 - _ROUNDING))
        high = np.maximum(np.minimum(task.b_high, fastest), low)
        t_low, t_high = self.least_time(high), self.least_time(low)
        self.b_box = (low, high)
        self.t_box = (t_low, t_high)
        self.e_box = (-vehicle.power_drag * t_high, vehicle.power_max * t_high)
        # The chord of 1 / sqrt(b): its value at `low` and its slope.
        v_low, v_high = np.sqrt(low), np.sqrt(high)
        self.chord = (1.0 / v_low, -1.0 / (v_low * v_high * (v_low + v_high)))

    def least_time(self, b: FloatArray) -> FloatArray:
        """Durations (1) [s], shape (n,), for b [m2/s2], shape (n + 1,)."""
        v = np.sqrt(b)
        return np.asarray(2.0 * self.step / (v[1:] + v[:-1]))

    def most_time(self, b: Any) -> Any:
        """Upper bounds of the durations (n,) of a plan, linear in b [m2/s2], shape (n + 1,)."""
        slowness = self.chord[0] + self.chord[1] * (b - self.b_box[0])
        return 0.5 * self.step * (slowness[:-1] + slowness[1:])

    def solve(self) -> tuple[Point, FloatArray, float, bool]:
        """Point (b, E, t), multipliers, optimum [kg], and whether IPOPT converged.

        Columns of the multipliers: brakes low, brakes high, power, drag, time (1), chord; the price
        of the trip time is in the last row, first column: shape (n + 1, 6).
        """
        ca = casadi()
        task, n, ds = self.task, self.task.road.intervals, self.step
        vehicle, fuel = task.vehicle, task.vehicle.fuel
        b, work, t = ca.SX.sym("b", n + 1), ca.SX.sym("E", n), ca.SX.sym("t", n)
        b_, work_, t_ = b * _B, work * _E, t * _T
        v = ca.sqrt(b_)
        sums, gain = v[1:] + v[:-1], b_[1:] - b_[:-1]
        scale = vehicle.inertial_mass
        net = gain * scale / (2.0 * ds) + self.slope + 0.5 * vehicle.drag * (b_[1:] + b_[:-1])
        cost = ca.sum1(
            (fuel.f0 + task.price_time) * t_
            + fuel.f1 * work_
            + fuel.f2 * work_**2 / t_
            + task.k_a * gain**2 / (2.0 * ds * sums)
        )
        rows = (
            (work_ * vehicle.efficiency / ds - net) / scale,
            (work_ - vehicle.power_max * t_) / _E,
            (-work_ - vehicle.power_drag * t_) / _E,
            (2.0 * ds / sums - t_) / _T,
            (t_ - self.most_time(b_)) / _T,
        )
        problem = {
            "x": ca.vertcat(b, work, t),
            "f": (cost - task.price_energy * b_[n]) / _COST,
            "g": ca.vertcat(*rows, ca.sum1(t_) / 100.0),
        }
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 200,
        }
        solver = ca.nlpsol("bound", "ipopt", problem, options)
        boxes = ((self.b_box, _B), (self.e_box, _E), (self.t_box, _T))
        low, high = (np.concatenate([box[k] / unit for box, unit in boxes]) for k in (0, 1))
        brakes = np.full(n, vehicle.brake_max / scale)
        result = solver(
            x0=0.5 * (low + high),
            lbx=low,
            ubx=high,
            lbg=np.concatenate([np.zeros(n), np.full(4 * n + 1, -np.inf)]),
            ubg=np.concatenate([brakes, np.zeros(4 * n), [task.time_max / 100.0]]),
        )
        x = np.clip(np.asarray(result["x"]).ravel(), low, high)
        point = (x[: n + 1] * _B, x[n + 1 : 2 * n + 1] * _E, x[2 * n + 1 :] * _T)
        raw = np.asarray(result["lam_g"]).ravel() * _COST
        price = max(float(raw[-1]), 0.0) / 100.0
        raw = raw[:-1].reshape(5, n).T / np.array([scale, _E, _E, _T, _T])
        y = np.vstack([np.column_stack([-raw[:, 0], raw]), [price, *[0.0] * 5]])
        converged = bool(solver.stats()["success"])
        return point, np.maximum(y, 0.0), float(result["f"]) * _COST, converged

    def dual_value(self, point: Point, multipliers: FloatArray) -> float:
        """Lower bound [kg] of multipliers >= 0, from the Lagrangian's tangent at any point."""
        vehicle, task, ds = self.task.vehicle, self.task, self.step
        b, work, t = point
        v = np.sqrt(b)
        sums, gain = v[1:] + v[:-1], np.diff(b)
        slow, fast, power, drag, late, early = multipliers[:-1].T
        price = float(multipliers[-1, 0]) if np.isfinite(task.time_max) else 0.0
        fuel, eta, kinetic = vehicle.fuel, vehicle.efficiency, vehicle.inertial_mass / (2.0 * ds)
        net = gain * kinetic + self.slope + 0.5 * vehicle.drag * (b[1:] + b[:-1])
        excess = work * eta / ds - net
        least = 2.0 * ds / sums
        value = np.sum(
            (fuel.f0 + task.price_time) * t
            + fuel.f1 * work
            + fuel.f2 * work**2 / t
            + task.k_a * gain**2 / (2.0 * ds * sums)
            - slow * excess
            + fast * (excess - vehicle.brake_max)
            + power * (work - vehicle.power_max * t)
            + drag * (-work - vehicle.power_drag * t)
            + late * (least - t)
            + early * (t - self.most_time(b))
        )
        value -= task.price_energy * b[-1]
        if price > 0.0:
            value += price * (t.sum() - task.time_max)
        push = fast - slow
        d_work = fuel.f1 + 2.0 * fuel.f2 * work / t + push * eta / ds + power - drag
        d_t = fuel.f0 + task.price_time - fuel.f2 * (work / t) ** 2 + price - late + early
        d_t -= power * vehicle.power_max + drag * vehicle.power_drag
        # At the two ends of an interval: by the sum of speeds, by the difference of b, and by N.
        root = -late * 2.0 * ds / sums**2 - task.k_a * gain**2 / (2.0 * ds * sums**2)
        ride = task.k_a * gain / (ds * sums)
        d_b = np.zeros(b.size)
        d_b[:-1] += root / (2.0 * v[:-1]) - ride - push * (0.5 * vehicle.drag - kinetic)
        d_b[1:] += root / (2.0 * v[1:]) + ride - push * (0.5 * vehicle.drag + kinetic)
        d_b[:-1] -= 0.5 * ds * early * self.chord[1][:-1]
        d_b[1:] -= 0.5 * ds * early * self.chord[1][1:]
        d_b[-1] -= task.price_energy
        for slope, at, (low, high) in (
            (d_b, b, self.b_box),
            (d_work, work, self.e_box),
            (d_t, t, self.t_box),
        ):
            value += np.minimum(slope * (low - at), slope * (high - at)).sum()
        return float(value)


def enough_speeds(
    vehicle: PointMass, road: RoadProfile, low: FloatArray, fastest: FloatArray
) -> FloatArray:
    """Least node speeds (n + 1,) from which full power still reaches all least speeds ahead.

    Args:
      vehicle: the truck.
      road: with n intervals.
      low: least speeds, shape (n + 1,).
      fastest: greatest speeds of any drive, shape (n + 1,), at least `low`.
    """
    push, half = vehicle.inertial_mass / (2.0 * road.step), 0.5 * vehicle.drag
    work = 2.0 * vehicle.efficiency * vehicle.power_max
    slope = vehicle.slope_force(road.grade)

    def missing(k: int, v: float, w: float) -> float:
        """Force that full power lacks to come from v to w in interval k [N]."""
        return float((push + half) * w * w + (half - push) * v * v + slope[k] - work / (v + w))

    speed = np.array(low, dtype=float)
    lacks = (push + half) * low[1:] ** 2 + (half - push) * low[:-1] ** 2 + slope
    for last in np.flatnonzero(lacks > work / (low[1:] + low[:-1]))[::-1]:
        for k in range(int(last), -1, -1):
            w, below, above = float(speed[k + 1]), float(speed[k]), float(fastest[k])
            if missing(k, below, w) <= 0.0:
                break
            # The lower end of the bisection misses w: the result is never more than necessary.
            for _ in range(_HALVINGS):
                middle = 0.5 * (below + above)
                if missing(k, middle, w) > 0.0:
                    below = middle
                else:
                    above = middle
            speed[k] = below
    return speed


def below_fit(fuel_map: FuelMap, fit: Willans, v_min: float, v_max: float) -> float:
    """Greatest excess of a fit over the map [kg/s] in a band of speeds [m/s].

    The fuel of a drive of time T by the map is at least its fuel by the fit less T times this.
    Sampled on a grid of speeds and powers, from overrun to full power.
    """
    speed = np.repeat(np.linspace(v_min, v_max, 60), 200)
    power = np.tile(np.linspace(-fit.overrun_power, fuel_map.full_power(), 200), 60)
    rate, _ = fuel_map.rate(power * fuel_map.efficiency / speed, speed)
    return max(float((fit.rate(power) - rate).max()), 0.0)
