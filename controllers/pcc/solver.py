"""Solves speed tasks: one entry, `solve(task, guess, method)`, for every method.

`interior_point` is our own and takes time linear in the number of intervals. `ipopt` solves the
same program, written independently with CasADi (the extra `ipopt`), as reference and if the former
does not converge.
Other packages add methods to `METHODS`: importing `iits_mj.validation.planning.pcc_hermite` adds
`finite_elements`, the paper's transcription.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from controllers.pcc.interior_point import Optimum, Settings, minimize
from controllers.pcc.problem import Problem, Units, scaled
from controllers.pcc.task import Solution, SpeedTask, require_feasible
from controllers.pcc.vehicle import passing_times
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError, PlanningError

Method = Callable[..., Solution]
"""Solves a task from a guess of the node speeds (n + 1,); further settings are keywords."""

_MORE = "finite_elements needs `import iits_mj.validation.planning.pcc_hermite`"

_PATIENCE = 2.0  # [s] that must be left for IPOPT: CasADi alone takes a second to load
# After a long climb at full power the end speed hardly depends on the earlier drive, and its
# multiplier would have no bound. There it has a worth instead of a bound, and this tolerance [m/s].
_END_SHORT = 0.02
_END_ITERATIONS = 40  # with the end speed as a bound, before that
_END_EXACT = 1e-6  # relative difference of v^2 within which the end speed is the wanted one
_END_NEAR = 1e-3  # relative difference of v^2 between wanted and greatest end speed of such a climb


def solve(
    task: SpeedTask,
    guess: FloatArray | None = None,
    method: str = "interior_point",
    **settings: Any,
) -> Solution:
    """Returns the optimal speed of a task.

    Args:
      task: road, truck, limits and prices.
      guess: node speeds to start from, shape (n + 1,) [m/s]; default: the fastest drive.
      method: one of METHODS.
      settings: of the method; every method has `time_limit` [s], interior_point also `tolerance`,
        finite_elements `element` and `points`.

    Raises:
      InputError: the method is not known, or the tolerance is not allowed.
      PlanningError: no drive keeps the task's limits, or the time limit passes without a solution.
    """
    if method not in METHODS:
        known = ", ".join(METHODS)
        raise InputError(f"method {method!r} is not known; use one of {known}; {_MORE}")
    if guess is None:
        guess = require_feasible(task)
    task.check_nodes("guess", guess)
    return METHODS[method](task, guess, **settings)


def casadi() -> Any:
    """Returns the module `casadi`, which takes a second to load.

    Raises:
      PlanningError: it is not installed.
    """
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise PlanningError(
            f"IPOPT needs CasADi ({error}); install it with: pip install 'iits-mj[ipopt]'"
        ) from error


def _by_interior_point(
    task: SpeedTask, guess: FloatArray, *, time_limit: float = 20.0, tolerance: float = 1e-8
) -> Solution:
    """Solves by our own method, or by IPOPT if that does not converge and time is left.

    The tolerance is in the program's units of about 1: the default makes the multipliers exact;
    1e-6 gives speeds within 5 mm/s in three quarters of the time.
    """
    in_range("tolerance", tolerance, 1e-12, 1e-2)
    began = time.perf_counter()
    fastest = require_feasible(task)
    problem, units = scaled(task)
    settings = Settings(tolerance=tolerance, time_limit=time_limit)
    b = guess**2 / units.b
    if fastest[-1] ** 2 < task.b_low[-1] * (1.0 + _END_NEAR):
        half = replace(settings, time_limit=0.5 * time_limit)
        optimum = minimize(problem, b, replace(half, iterations=_END_ITERATIONS, fallback=False))
        if not optimum.converged:
            optimum = minimize(scaled(task, soft_end=True)[0], b, half)
    else:
        optimum = minimize(problem, b, settings)
    if not optimum.converged and time_limit - (time.perf_counter() - began) > _PATIENCE:
        try:
            second = _ipopt_optimum(task, guess, problem, units, time_limit)
        except PlanningError as missing:
            optimum = replace(optimum, note=f"{optimum.note}; {missing}")
        else:
            return _solution(task, second, units, began, "ipopt")
    return _solution(task, optimum, units, began, "interior_point")


def _by_ipopt(task: SpeedTask, guess: FloatArray, *, time_limit: float = 20.0) -> Solution:
    began = time.perf_counter()
    require_feasible(task)
    problem, units = scaled(task)
    optimum = _ipopt_optimum(task, guess, problem, units, time_limit)
    return _solution(task, optimum, units, began, "ipopt")


METHODS: dict[str, Method] = {"interior_point": _by_interior_point, "ipopt": _by_ipopt}


def _solution(
    task: SpeedTask, optimum: Optimum, units: Units, began: float, method: str
) -> Solution:
    """Returns an optimum in SI units; PlanningError if not converged or the end speed is off."""
    note, reached = optimum.note, optimum.b[-1] * units.b
    short = math.sqrt(task.b_low[-1]) - math.sqrt(reached)
    if not note and short > _END_SHORT:
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
        method=method,
        iterations=optimum.iterations,
        solve_time=time.perf_counter() - began,
        time_price=max(optimum.time_price, 0.0) * per_second,
        costate=optimum.costate * (units.fuel / units.b),
        interval_price=optimum.prices * per_second,
    )


# Units of IPOPT's b [m2/s2], t [s], fuel [kg], whole cost [fuel]:
_B, _T, _FUEL, _COST = 400.0, 100.0, 1e-3, 100.0


def _ipopt_optimum(
    task: SpeedTask, guess: FloatArray, problem: Problem, units: Units, time_limit: float
) -> Optimum:
    """Returns the optimum by IPOPT, in the units of `problem`, which states the same task.

    The program is written independently from the equations, with the engine's force F (per
    kilogram) instead of the brake's, P = F (v0 + v1) / (2 eta), and the times t at the nodes.
    """
    ca = casadi()
    vehicle, road, n, ds = task.vehicle, task.road, task.road.intervals, task.road.step
    mass, eta, fuel = vehicle.inertial_mass, vehicle.efficiency, vehicle.fuel
    b, force, t = ca.SX.sym("b", n + 1), ca.SX.sym("F", n), ca.SX.sym("t", n + 1)
    b0, b1, v = b[:-1] * _B, b[1:] * _B, ca.sqrt(b * _B)
    mean = 0.5 * (v[:-1] + v[1:])
    dt = ds / mean
    a = (b1 - b0) / (2.0 * ds)
    net = a + vehicle.slope_force(road.grade) / mass + vehicle.drag / mass * 0.5 * (b0 + b1)
    # dt P = F ds / eta and dt P^2 = F^2 v ds / eta^2: no division by speed.
    work = force * mass * ds / eta
    square = (force * mass / eta) ** 2 * mean * ds
    cost = fuel.f0 * dt + fuel.f1 * work + fuel.f2 * square + task.k_a * a**2 * dt
    total = ca.sum1(cost + task.price_time * dt) - task.price_energy * b1[-1]
    program = {
        "x": ca.vertcat(b, force, t),
        "f": total / (_FUEL * _COST),
        "g": ca.vertcat(force - net, force * mean, t[1:] - t[:-1] - dt / _T),
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
        "ipopt.max_wall_time": min(time_limit, 1e6),
    }
    nlp = ca.nlpsol("pcc", "ipopt", program, options)
    driving = np.maximum(vehicle.net_force(guess, road) / mass, 0.0) + 0.01
    earliest, latest = np.maximum(task.earliest, 0.0) / _T, np.full(n + 1, task.time_max / _T)
    earliest[0] = latest[0] = 0.0
    zero, free, one = np.zeros(n), np.full(n, np.inf), np.ones(n)
    result = nlp(
        x0=np.concatenate([guess**2 / _B, driving, passing_times(guess, road) / _T]),
        lbx=np.concatenate([task.b_low / _B, -free, earliest]),
        ubx=np.concatenate([task.b_high / _B, free, latest]),
        lbg=np.concatenate([zero, -eta * vehicle.power_drag / mass * one, zero]),
        ubg=np.concatenate(
            [vehicle.brake_max / mass * one, eta * vehicle.power_max / mass * one, zero]
        ),
    )
    statistics = nlp.stats()
    x = np.asarray(result["x"]).ravel()
    found = np.clip(x[: n + 1] * _B / units.b, problem.low, problem.high)
    driving = x[n + 1 : 2 * n + 1] / units.force
    rows = np.asarray(result["lam_g"]).ravel() * _COST * _FUEL / units.fuel
    price = -rows[2 * n :] * units.time / _T
    # The costate, from the multipliers of the brake rows and the prices of durations. The rest of
    # the stationary Lagrangian along F belongs to overrun (below) or full power (above).
    by_force = -rows[:n] * units.force
    speed, change = np.sqrt(found), np.diff(found)
    duration = 2.0 / (speed[:-1] + speed[1:])
    pull = driving / duration
    c0, c1, c2 = problem.fuel
    rest = c1 + 2.0 * c2 * pull - by_force
    by_duration = c0 - c2 * pull**2 + problem.calm * change**2 + price + np.minimum(rest, 0.0)
    by_duration -= problem.overrun * np.maximum(rest, 0.0)
    by_duration *= -0.25 * duration**2
    by_change = 2.0 * problem.calm * change * duration
    first, last = problem.slope
    start = first * by_force + by_duration / speed[:-1] - by_change
    end = last * by_force + by_duration / speed[1:] + by_change
    return Optimum(
        b=found,
        y=driving - problem.net(found),
        time_price=float(price[-1]),
        prices=price,
        costate=np.append(-start, end[-1]),
        iterations=int(statistics["iter_count"]),
        note="" if statistics["success"] else f"IPOPT ended with {statistics['return_status']}",
    )
