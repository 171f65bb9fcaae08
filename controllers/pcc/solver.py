"""The optimal control problem in the distance domain, solved by IPOPT through CasADi.

Nodes k = 0..n, intervals of length ds. States b = v^2 and time t, controls engine force F and brake
force B >= 0, constant over an interval (forces are per kilogram inside):

    b[k+1] = b[k] + 2 ds / m_e (F - B - R(grade) - k_air (b[k] + b[k+1]) / 2)      exact, linear
    t[k+1] = t[k] + 2 ds / (v[k] + v[k+1])                                          exact
    -P_drag <= F (v[k] + v[k+1]) / 2 / eta <= P_max
    b within the band and the limits, t[k] >= fence[k], t[n] <= T
    minimize sum dt (f0 + f1 P + f2 P^2 + k_a a^2) + price_time t[n] - price_energy b[n]

The cost is the paper's (section on the fuel-efficient speed planner) in the distance domain; its
fence `s <= s_fence(t)` becomes an earliest time of passing each station.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

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
        self, vehicle: PointMass, intervals: int, step: float, iterations_max: int = 150
    ) -> None:
        began = time.perf_counter()
        self.vehicle, self.intervals, self.step = vehicle, intervals, step
        self._previous: FloatArray | None = None
        n = intervals
        b, t = ca.SX.sym("b", n + 1), ca.SX.sym("t", n + 1)
        drive, brake = ca.SX.sym("F", n), ca.SX.sym("B", n)
        slope, prices = ca.SX.sym("slope", n), ca.SX.sym("prices", 3)
        cost, constraints = self._problem(b, t, drive, brake, slope, prices)
        # Interleaved by node: the factorization's fill-in stays in a narrow band.
        inner = ca.horzcat(b[:-1], t[:-1], drive, brake)
        variables = ca.vertcat(ca.vec(inner.T), b[n], t[n])
        options = {
            "print_time": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": iterations_max,
            "ipopt.tol": 1e-6,
            "ipopt.acceptable_tol": 1e-5,
            "ipopt.mu_strategy": "adaptive",
            "ipopt.max_wall_time": 20.0,
        }
        nlp = {"x": variables, "p": ca.vertcat(slope, prices), "f": cost, "g": constraints}
        self._solve = ca.nlpsol("pcc", "ipopt", nlp, options)
        self.build_time = time.perf_counter() - began

    def solve(self, task: Task, guess: FloatArray) -> Answer:
        """Solves from a guess of the node speeds, shape (n + 1,).

        Raises:
          PlanningError: bounds contradict each other, or IPOPT ends without a solution.
        """
        self._check(task)
        began = time.perf_counter()
        n, vehicle, road = self.intervals, self.vehicle, task.road
        net = vehicle.net_force(guess, road) / vehicle.inertial_mass
        times = np.concatenate([[0.0], np.cumsum(durations(guess, road))])
        power = vehicle.efficiency * vehicle.power_max / vehicle.inertial_mass
        x0 = self._pack(guess**2 / _B, times / _T, np.maximum(net, 0.01), np.maximum(-net, 0.01))
        late = np.full(n + 1, np.inf)
        late[0], late[-1] = 0.0, task.time_max / _T
        brake = np.full(n, vehicle.brake_max / vehicle.inertial_mass)
        fence = np.maximum(task.fence / _T, 0.0)
        low = self._pack(task.b_low / _B, fence, np.full(n, -np.inf), np.zeros(n))
        high = self._pack(task.b_high / _B, late, np.full(n, np.inf), brake)
        slope = vehicle.slope_force(road.grade) / vehicle.inertial_mass
        prices = [task.k_a / _FUEL, task.price_time / _FUEL, task.price_energy / _FUEL]
        drag = vehicle.efficiency * vehicle.power_drag / vehicle.inertial_mass
        below = np.tile([0.0, 0.0, -drag], n)
        above = np.tile([0.0, 0.0, power], n)
        result = self._solve(
            x0=x0, lbx=low, ubx=high, lbg=below, ubg=above, p=np.concatenate([slope, prices])
        )
        wall_time = time.perf_counter() - began
        statistics = self._solve.stats()
        if not statistics["success"]:
            raise PlanningError(
                f"the speed optimization over {road.length:.0f} m ended with "
                f"{statistics['return_status']} after {statistics['iter_count']} iterations"
            )
        solution = np.asarray(result["x"]).ravel()
        speed = np.sqrt(np.maximum(np.append(solution[0 : 4 * n : 4], solution[4 * n]), 0.0) * _B)
        price = float(np.asarray(result["lam_x"]).ravel()[-1]) * _FUEL / _T
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

    def _problem(
        self, b: ca.SX, t: ca.SX, drive: ca.SX, brake: ca.SX, slope: ca.SX, prices: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        vehicle, ds = self.vehicle, self.step
        mass, fuel = vehicle.inertial_mass, vehicle.fuel
        b0, b1 = b[:-1] * _B, b[1:] * _B
        mean = 0.5 * (ca.sqrt(b0) + ca.sqrt(b1))
        dt = ds / mean
        air = vehicle.drag / mass * 0.5 * (b0 + b1)
        motion = (b1 - b0 - 2.0 * ds * (drive - brake - slope - air)) / _B
        clock = (t[1:] - t[:-1]) - dt / _T
        # dt P = F ds / eta and dt P^2 = F^2 v ds / eta^2: no division by speed.
        work = drive * mass * ds / vehicle.efficiency
        square = (drive * mass / vehicle.efficiency) ** 2 * mean * ds
        a = (b1 - b0) / (2.0 * ds)
        burnt = (fuel.f0 * dt + fuel.f1 * work + fuel.f2 * square) / _FUEL
        cost = ca.sum1(burnt + prices[0] * a**2 * dt)
        cost += prices[1] * t[-1] * _T - prices[2] * b[-1] * _B
        return cost, ca.vec(ca.horzcat(motion, clock, drive * mean).T)

    def _pack(
        self, b: FloatArray, t: FloatArray, drive: FloatArray, brake: FloatArray
    ) -> FloatArray:
        inner = np.column_stack([b[:-1], t[:-1], drive, brake]).ravel()
        return np.concatenate([inner, [b[-1], t[-1]]])
