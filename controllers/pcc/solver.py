"""The optimal control problem in the distance domain, solved by IPOPT through CasADi.

Nodes k = 0..n, intervals of length ds. Variables: b = v^2 at the nodes and the engine's force F at
the wheels in the intervals (per kilogram inside). What the motion asks for,

    N[k] = (b[k+1] - b[k]) m_e / (2 ds) + R(grade) + k_air (b[k] + b[k+1]) / 2       exact, linear

is F less the brake force, which is so eliminated:

    0 <= F - N <= B_max,    -P_drag <= F (v[k] + v[k+1]) / (2 eta) <= P_max
    b within the band and the limits,    sum dt <= T,    dt = 2 ds / (v[k] + v[k+1])      exact
    minimize sum dt (f0 + f1 P + f2 P^2 + k_a a^2) + price_time sum dt - price_energy b[n]

With a fence the time t[k] at the nodes joins the variables, so that `t[k] >= fence[k]` is a bound.
The cost is the paper's (section on the fuel-efficient speed planner) in the distance domain; its
fence `s <= s_fence(t)` becomes an earliest time of passing each station.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, durations
from iits_mj.errors import PlanningError

FloatArray = NDArray[np.float64]
_B, _T, _FUEL = 400.0, 100.0, 1e-3  # units of b [m2/s2], t [s] and fuel [kg] inside the solver


@dataclass(frozen=True)
class Task:
    """One problem.

    Attributes:
      road: grid; b_low, b_high: bounds of v^2 at the nodes, shape (n + 1,), equal where fixed.
      time_max: greatest trip time [s], inf for none; fence: earliest times, shape (n + 1,).
      k_a: weight of a^2 [kg/s per (m/s2)^2].
      price_time: cost of a second [kg/s]; price_energy: worth of final b [kg/(m2/s2)].
    """

    road: RoadProfile
    b_low: FloatArray
    b_high: FloatArray
    time_max: float
    fence: FloatArray
    k_a: float = 0.0
    price_time: float = 0.0
    price_energy: float = 0.0


@dataclass(frozen=True)
class Answer:
    """Node speeds (n + 1,), price of a second of trip time [kg/s], iterations, wall time [s]."""

    speed: FloatArray
    time_price: float
    iterations: int
    wall_time: float


class Solver:
    """IPOPT on a grid of fixed size; build once, solve often. `build_time` in seconds."""

    def __init__(
        self,
        vehicle: PointMass,
        intervals: int,
        step: float,
        fenced: bool = False,
        time_limit: float = 20.0,
    ) -> None:
        began = time.perf_counter()
        self.vehicle, self.intervals, self.step, self.fenced = vehicle, intervals, step, fenced
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 200,
            "ipopt.tol": 1e-6,
            "ipopt.acceptable_tol": 1e-5,
            "ipopt.max_wall_time": time_limit,
        }
        self._solve = ca.nlpsol("pcc", "ipopt", self._problem(), options)
        self.build_time = time.perf_counter() - began

    def solve(self, task: Task, guess: FloatArray) -> Answer:
        """Solves from a guess of the node speeds, shape (n + 1,).

        Raises:
          PlanningError: bounds contradict each other, or IPOPT ends without a solution.
        """
        self._check(task)
        began = time.perf_counter()
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
        result = self._solve(
            x0=self._pack(guess**2 / _B, np.maximum(net, 0.0) + 0.01, clock),
            lbx=self._pack(task.b_low / _B, np.full(n, -np.inf), task.fence / _T),
            ubx=self._pack(task.b_high / _B, np.full(n, np.inf), late),
            lbg=np.concatenate(low_rows),
            ubg=np.concatenate(high_rows),
            p=np.concatenate([slope, prices]),
        )
        wall_time = time.perf_counter() - began
        statistics = self._solve.stats()
        if not statistics["success"]:
            raise PlanningError(
                f"the speed optimization over {road.length:.0f} m ended with "
                f"{statistics['return_status']} after {statistics['iter_count']} iterations"
            )
        width = 3 if self.fenced else 2
        solution = np.asarray(result["x"]).ravel()
        b = np.append(solution[0 : width * n : width], solution[width * n])
        # b follows within its bounds to the solver's tolerance; the profile keeps to them exactly.
        speed = np.sqrt(np.clip(b * _B, task.b_low, task.b_high))
        price = float(np.asarray(result["lam_g"]).ravel()[2 * n]) * 100.0 * _FUEL / _T
        return Answer(speed, max(price, 0.0), int(statistics["iter_count"]), wall_time)

    def _check(self, task: Task) -> None:
        road = task.road
        if road.intervals != self.intervals or abs(road.step - self.step) > 1e-6:
            raise PlanningError(
                f"the solver is for {self.intervals} intervals of {self.step:g} m, the road has "
                f"{road.intervals} of {road.step:g} m"
            )
        empty = np.flatnonzero(task.b_low > task.b_high + 1e-9)
        if empty.size:
            k = int(empty[0])
            raise PlanningError(
                f"at station {road.station[k]:.0f} m the least speed "
                f"{np.sqrt(task.b_low[k]):.2f} m/s is above the greatest "
                f"{np.sqrt(max(task.b_high[k], 0.0)):.2f} m/s"
            )
        fastest = float(durations(np.sqrt(np.minimum(task.b_high, 1e4)), road).sum())
        if fastest > task.time_max:
            raise PlanningError(
                f"trip time {task.time_max:.1f} s is too short: even at the speed limits the road "
                f"takes {fastest:.1f} s"
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
            "f": cost / 100.0,
            "g": ca.vertcat(*rows),
        }

    def _pack(self, b: FloatArray, force: FloatArray, clock: FloatArray) -> FloatArray:
        columns, last = [b[:-1], force], [b[-1]]
        if self.fenced:
            columns.append(clock[:-1])
            last.append(clock[-1])
        return np.concatenate([np.column_stack(columns).ravel(), last])
