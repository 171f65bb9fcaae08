"""Solves speed tasks: one entry, `solve(task, guess, method)`, for every method.

Methods that come with the package: `interior_point` (default; no set-up, time linear in the number
of intervals) and `ipopt` (the same program written once more with CasADi, as reference, and as
fallback where the interior-point method does not converge). Other packages add methods with
`register`: importing `iits_mj.validation.planning.pcc_hermite` adds `finite_elements`, the paper's
transcription.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from controllers.pcc.interior_point import Optimum, Settings, minimize
from controllers.pcc.problem import Point, Problem, Units, scaled
from controllers.pcc.task import Solution, SpeedTask, require_feasible
from controllers.pcc.vehicle import PointMass, passing_times
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, PlanningError

Method = Callable[..., Solution]
"""Solves a task from a guess of the node speeds (n + 1,); further settings are keywords."""

METHODS: dict[str, Method] = {}
_MORE = "finite_elements needs `import iits_mj.validation.planning.pcc_hermite`"

_PATIENCE = 2.0  # [s] left, from which IPOPT may take over: CasADi alone takes a second to load
# After a long climb at full power the end speed hardly depends on what was done before: to hold it
# exactly would take multipliers without bound. There it has a worth instead, and may be missed by
# so little [m/s].
_END_SHORT = 0.02
_END_ITERATIONS = 40  # with the end speed as a bound, before that
_END_EXACT = 1e-6  # of v^2, within which the end speed is the wanted one
_END_NEAR = 1e-3  # of v^2: how near the end speed is to the greatest possible one there


def register(name: str) -> Callable[[Method], Method]:
    """Decorator that makes a method known to `solve` by a name."""

    def add(method: Method) -> Method:
        METHODS[name] = method
        return method

    return add


def require_method(name: str) -> None:
    """Raises InputError when no method has that name."""
    if name not in METHODS:
        raise InputError(f"method {name!r} is not known; use one of {', '.join(METHODS)}; {_MORE}")


def solve(
    task: SpeedTask,
    guess: FloatArray | None = None,
    method: str = "interior_point",
    **settings: Any,
) -> Solution:
    """The optimal speed of a task.

    Args:
      task: road, truck, limits and prices.
      guess: node speeds to begin with, shape (n + 1,) [m/s]; default: the fastest drive.
      method: one of METHODS.
      settings: of the method; every method has `time_limit` [s], interior_point also `tolerance`,
        finite_elements `element` and `points`.

    Raises:
      InputError: the method is not known, or the tolerance is not allowed.
      PlanningError: there is no such drive, with the reason, or no solution within the time limit.
    """
    require_method(method)
    if guess is None:
        guess = require_feasible(task)
    task.check_nodes("guess", guess)
    return METHODS[method](task, guess, **settings)


@register("interior_point")
def _by_interior_point(
    task: SpeedTask, guess: FloatArray, *, time_limit: float = 20.0, tolerance: float = 1e-8
) -> Solution:
    """By our own method; IPOPT takes over where it does not converge and time is left.

    The tolerance is in the program's units of about 1: the default makes the multipliers exact,
    1e-6 gives speeds within 5 mm/s in three quarters of the time.
    """
    if not 1e-12 <= tolerance <= 1e-2:
        raise InputError(f"tolerance = {tolerance!r} is not allowed: use 1e-12 to 1e-2")
    began = time.perf_counter()
    fastest = require_feasible(task)
    problem, units = scaled(task)
    settings = Settings(
        tolerance=tolerance,
        dual_tolerance=100.0 * tolerance,
        polish=2 if tolerance <= 1e-8 else 0,
        time_limit=time_limit,
    )
    b = guess**2 / units.b
    if fastest[-1] ** 2 < task.b_low[-1] * (1.0 + _END_NEAR):
        half = replace(settings, time_limit=0.5 * time_limit)
        optimum = minimize(problem, b, replace(half, iterations=_END_ITERATIONS, fallback=False))
        if not optimum.converged:
            optimum = minimize(scaled(task, soft_end=True)[0], b, half)
    else:
        optimum = minimize(problem, b, settings)
    if not optimum.converged and time_limit - (time.perf_counter() - began) > _PATIENCE:
        optimum = _ipopt_optimum(task, guess, problem, units, time_limit)
        return _solution(task, optimum, units, began, "ipopt")
    return _solution(task, optimum, units, began, "interior_point")


@register("ipopt")
def _by_ipopt(task: SpeedTask, guess: FloatArray, *, time_limit: float = 20.0) -> Solution:
    began = time.perf_counter()
    require_feasible(task)
    problem, units = scaled(task)
    optimum = _ipopt_optimum(task, guess, problem, units, time_limit)
    return _solution(task, optimum, units, began, "ipopt")


def _solution(
    task: SpeedTask, optimum: Optimum, units: Units, began: float, method: str
) -> Solution:
    """An optimum in SI units; PlanningError where it has not converged or misses the end speed."""
    note, reached = optimum.note, optimum.b[-1] * units.b
    short = math.sqrt(task.b_low[-1]) - math.sqrt(reached)
    if optimum.converged and short > _END_SHORT:
        note = f"the end speed is missed by {short:.2f} m/s"
    if note:
        raise PlanningError(
            f"the speed optimization over {task.road.length:.0f} m has no result: {note}"
        )
    per_second = units.fuel / units.time
    b = np.clip(optimum.b * units.b, task.b_low, task.b_high)
    if reached < task.b_low[-1] * (1.0 - _END_EXACT):
        b[-1] = reached
    speed = np.sqrt(b)
    return Solution(
        speed=speed,
        cost=task.cost(speed),
        fuel=float(task.vehicle.fuel_of(speed, task.road).sum()),
        method=method,
        iterations=optimum.iterations,
        solve_time=time.perf_counter() - began,
        time_price=max(optimum.time_price, 0.0) * per_second,
        costate=optimum.costate * (units.fuel / units.b),
        interval_price=optimum.prices * per_second,
    )


# IPOPT. The program is written from the equations once more, with the engine's force F (per
# kilogram) as variable in place of the brake's, P = F (v0 + v1) / (2 eta), and the times at the
# nodes as variables behind a vehicle. Units of b [m2/s2], t [s], fuel [kg], whole cost [fuel]:
_B, _T, _FUEL, _COST = 400.0, 100.0, 1e-3, 100.0


def _ipopt_optimum(
    task: SpeedTask, guess: FloatArray, problem: Problem, units: Units, time_limit: float
) -> Optimum:
    """The optimum by IPOPT, in the units of `problem`, which states the same task."""
    vehicle, road, n = task.vehicle, task.road, task.road.intervals
    nlp = _ipopt(vehicle, n, road.step, task.behind, min(time_limit, 1e6))
    mass, eta = vehicle.inertial_mass, vehicle.efficiency
    net = vehicle.net_force(guess, road) / mass
    late = np.full(n + 1, np.inf)
    late[0] = 0.0
    brake = np.tile([0.0, -eta * vehicle.power_drag / mass], n)
    power = np.tile([vehicle.brake_max / mass, eta * vehicle.power_max / mass], n)
    low_rows = [brake, np.zeros(1)]
    high_rows = [power, np.array([task.time_max / _T])]
    if task.behind:
        low_rows.append(np.zeros(n))
        high_rows.append(np.zeros(n))
    slope = vehicle.slope_force(road.grade) / mass
    prices = [task.k_a / _FUEL, task.price_time / _FUEL, task.price_energy / _FUEL]
    earliest = np.maximum(task.earliest, 0.0) / _T
    earliest[0] = 0.0

    def pack(b: FloatArray, force: FloatArray, clock: FloatArray) -> FloatArray:
        columns = (b, np.append(force, 0.0), clock) if task.behind else (b, np.append(force, 0.0))
        table = np.column_stack(columns)
        return np.concatenate([table[:-1].ravel(), np.delete(table[-1], 1)])

    result = nlp(
        x0=pack(guess**2 / _B, np.maximum(net, 0.0) + 0.01, passing_times(guess, road) / _T),
        lbx=pack(task.b_low / _B, np.full(n, -np.inf), earliest),
        ubx=pack(task.b_high / _B, np.full(n, np.inf), late),
        lbg=np.concatenate(low_rows),
        ubg=np.concatenate(high_rows),
        p=np.concatenate([slope, prices]),
    )
    statistics = nlp.stats()
    converged = bool(statistics["success"])
    width = 3 if task.behind else 2
    x = np.asarray(result["x"]).ravel()
    b = np.append(x[0 : width * n : width], x[width * n]) * _B / units.b
    b = np.clip(b, problem.low, problem.high)
    point = Point(problem, b, x[1 : width * n : width] / units.force - problem.net(b))
    rows = np.asarray(result["lam_g"]).ravel() * _COST * _FUEL / units.fuel
    price = np.full(n, rows[2 * n] * units.time / _T)
    if task.behind:
        price = price - rows[2 * n + 1 :] * units.time / _T
    # The costate, from the multipliers of the brake rows and the prices of durations. What the
    # Lagrangian's level along F leaves belongs to overrun (below) or full power (above).
    by_force = -rows[0 : 2 * n : 2] * units.force
    own, by_duration, by_change = point.cost_slope()
    rest = own - by_force
    by_duration = by_duration + price - problem.overrun * np.maximum(rest, 0.0)
    by_duration += np.minimum(rest, 0.0)
    start, end = point.to_nodes(by_force, by_duration, by_change)
    return Optimum(
        b,
        point.y,
        float(rows[2 * n]) * units.time / _T,
        price,
        np.append(-start, end[-1]),
        int(statistics["iter_count"]),
        converged,
        "" if converged else f"IPOPT ended with {statistics['return_status']}",
    )


@lru_cache(maxsize=8)
def _ipopt(vehicle: PointMass, n: int, ds: float, behind: bool, time_limit: float) -> Any:
    """IPOPT for grids of n intervals of ds [m]; kept, as CasADi takes a second to load and build.

    Variables and rows are interleaved by node, so that fill-in stays in a band.
    """
    import casadi as ca

    mass, fuel = vehicle.inertial_mass, vehicle.fuel
    b, force, t = ca.SX.sym("b", n + 1), ca.SX.sym("F", n), ca.SX.sym("t", n + 1)
    slope, prices = ca.SX.sym("slope", n), ca.SX.sym("prices", 3)
    b0, b1, v = b[:-1] * _B, b[1:] * _B, ca.sqrt(b * _B)
    mean = 0.5 * (v[:-1] + v[1:])
    dt = ds / mean
    a = (b1 - b0) / (2.0 * ds)
    net = a + slope + vehicle.drag / mass * 0.5 * (b0 + b1)
    # dt P = F ds / eta and dt P^2 = F^2 v ds / eta^2: no division by speed.
    work = force * mass * ds / vehicle.efficiency
    square = (force * mass / vehicle.efficiency) ** 2 * mean * ds
    burnt = (fuel.f0 * dt + fuel.f1 * work + fuel.f2 * square) / _FUEL
    total = ca.sum1(dt)
    cost = ca.sum1(burnt + prices[0] * a**2 * dt) + prices[1] * total - prices[2] * b1[-1]
    rows = [ca.vec(ca.horzcat(force - net, force * mean).T), total / _T]
    columns, last = [b[:-1], force], [b[n]]
    if behind:
        rows.append(t[1:] - t[:-1] - dt / _T)
        columns.append(t[:-1])
        last.append(t[n])
    program = {
        "x": ca.vertcat(ca.vec(ca.horzcat(*columns).T), *last),
        "p": ca.vertcat(slope, prices),
        "f": cost / _COST,
        "g": ca.vertcat(*rows),
    }
    options: dict[str, Any] = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 300,
        "ipopt.tol": 1e-9,
        "ipopt.constr_viol_tol": 1e-9,
        "ipopt.acceptable_tol": 1e-7,
        "ipopt.acceptable_constr_viol_tol": 1e-7,
        "ipopt.max_wall_time": time_limit,
    }
    return ca.nlpsol("pcc", "ipopt", program, options)
