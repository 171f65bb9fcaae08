"""The same problem for IPOPT through CasADi: the cross-check of our own method.

Written from the equations once more, with the engine's force F (per kilogram) as variable in place
of the brake's, P = F (v0 + v1) / (2 eta), and the times at the nodes as variables with a fence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from controllers.pcc.interior_point import Optimum
from controllers.pcc.problem import Point, Problem
from controllers.pcc.vehicle import PointMass, durations
from iits_mj.core.arrays import FloatArray

if TYPE_CHECKING:
    from controllers.pcc.solver import Task, Units

# Units of b [m2/s2], t [s], fuel [kg] and of the whole cost [fuel] inside the solver.
_B, _T, _FUEL, _COST = 400.0, 100.0, 1e-3, 100.0


class Ipopt:
    """IPOPT on a grid of fixed size; build once, solve often."""

    def __init__(
        self, vehicle: PointMass, intervals: int, step: float, fenced: bool, time_limit: float
    ) -> None:
        self.vehicle, self.intervals, self.step, self.fenced = vehicle, intervals, step, fenced
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
        self._solve = ca.nlpsol("pcc", "ipopt", self._problem(), options)

    def solve(self, task: Task, guess: FloatArray, problem: Problem, units: Units) -> Optimum:
        """The optimum in the units of `problem`, which states the same task."""
        n, vehicle, road = self.intervals, self.vehicle, task.road
        mass, eta = vehicle.inertial_mass, vehicle.efficiency
        net = vehicle.net_force(guess, road) / mass
        clock = np.concatenate([[0.0], np.cumsum(durations(guess, road))]) / _T
        late = np.full(n + 1, np.inf)
        late[0] = 0.0
        brake = np.tile([0.0, -eta * vehicle.power_drag / mass], n)
        power = np.tile([vehicle.brake_max / mass, eta * vehicle.power_max / mass], n)
        low_rows = [brake, np.zeros(1)]
        high_rows = [power, np.array([task.time_max / _T])]
        if self.fenced:
            low_rows.append(np.zeros(n))
            high_rows.append(np.zeros(n))
        slope = vehicle.slope_force(road.grade) / mass
        prices = [task.k_a / _FUEL, task.price_time / _FUEL, task.price_energy / _FUEL]
        fence = np.maximum(task.fence, 0.0) / _T
        fence[0] = 0.0
        result = self._solve(
            x0=self._pack(guess**2 / _B, np.maximum(net, 0.0) + 0.01, clock),
            lbx=self._pack(task.b_low / _B, np.full(n, -np.inf), fence),
            ubx=self._pack(task.b_high / _B, np.full(n, np.inf), late),
            lbg=np.concatenate(low_rows),
            ubg=np.concatenate(high_rows),
            p=np.concatenate([slope, prices]),
        )
        statistics = self._solve.stats()
        note = ""
        if not statistics["success"]:
            note = f"IPOPT ended with {statistics['return_status']}"
        width = 3 if self.fenced else 2
        solution = np.asarray(result["x"]).ravel()
        b = np.append(solution[0 : width * n : width], solution[width * n]) * _B / units.b
        b = np.clip(b, problem.low, problem.high)
        force = solution[1 : width * n : width] / units.force
        point = Point(problem, b, force - problem.net(b))
        rows = np.asarray(result["lam_g"]).ravel() * _COST * _FUEL / units.fuel
        price = np.full(n, rows[2 * n] * units.time / _T)
        if self.fenced:
            price = price - rows[2 * n + 1 :] * units.time / _T
        costate = _costate(point, -rows[0 : 2 * n : 2] * units.force, price)
        return Optimum(
            b,
            point.y,
            float(rows[2 * n]) * units.time / _T,
            price,
            costate,
            int(statistics["iter_count"]),
            not note,
            note,
        )

    def _problem(self) -> dict[str, ca.SX]:
        """The NLP; variables and rows are interleaved by node, so that fill-in stays in a band."""
        vehicle, ds, n = self.vehicle, self.step, self.intervals
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
        columns = [b[:-1], force]
        last = [b[n]]
        if self.fenced:
            rows.append(t[1:] - t[:-1] - dt / _T)
            columns.append(t[:-1])
            last.append(t[n])
        return {
            "x": ca.vertcat(ca.vec(ca.horzcat(*columns).T), *last),
            "p": ca.vertcat(slope, prices),
            "f": cost / _COST,
            "g": ca.vertcat(*rows),
        }

    def _pack(self, b: FloatArray, force: FloatArray, clock: FloatArray) -> FloatArray:
        columns, last = [b[:-1], force], [b[-1]]
        if self.fenced:
            columns.append(clock[:-1])
            last.append(clock[-1])
        return np.concatenate([np.column_stack(columns).ravel(), last])


def _costate(point: Point, by_force: FloatArray, price: FloatArray) -> FloatArray:
    """Worth of b at the nodes, from the multiplier of the brake rows and prices of durations."""
    problem = point.problem
    own, by_duration, by_change = point.cost_slope()
    # What the Lagrangian's level along F leaves belongs to overrun (below) or full power (above).
    rest = own - by_force
    by_duration = by_duration + price - problem.overrun * np.maximum(rest, 0.0)
    by_duration += np.minimum(rest, 0.0)
    start, end = point.to_nodes(by_force, by_duration, by_change)
    return np.append(-start, end[-1])
