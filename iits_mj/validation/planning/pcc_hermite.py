"""The paper's transcription of a speed task: cubic Hermite finite elements in time.

Importing this module adds the method `finite_elements` to `controllers.pcc.solver.METHODS`.

Unknown are station and speed at the ends of n elements of equal duration h = T / n, the paper's

    X = [s_1, v_1, s_2, v_2, ..., s_n, v_n]

between which s(t) is the cubic of these values; v and a are its derivatives. At Gauss points of
each element (Legendre, weights w) the engine's power P is a further unknown. With the force that
the motion needs, N = m_e a + R(grade(s)) + k_air v^2, these limits hold there:

    0 <= eta P - N v <= B_max v,    -P_drag <= P <= P_max,    b_low(s) <= v^2 <= b_high(s)

The brakes take the rest. The cost is the paper's integral of fuel rate and k_a a^2, by the same
quadrature: h sum w (f0 + f1 P + f2 P^2 + k_a a^2). First and last s and v are given; a vehicle
ahead gives a greatest station at each element's end. The grade is the derivative of the quintic
spline through the heights, so that the derivative of the cost by s is continuous; bounds of v^2 are
linear between the road's nodes, as in the distance domain, and hold at the Gauss points and at the
elements' ends.

The station at a time is unknown here, so the road enters as a curve over an unknown, and the
problem has local optima: over the paper's road they differ by 0.03 % of the fuel, more with longer
elements. In the distance domain the road is data, and the problem has the bound of
`iits_mj.validation.planning.pcc_bound`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.pcc.solver import METHODS, casadi
from controllers.pcc.task import Solution, SpeedTask
from controllers.pcc.vehicle import passing_times
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError
from iits_mj.core.units import GRAVITY

# Units inside the solver: s [m], v [m/s], P [W], cost [kg].
_S, _V, _P, _COST = 100.0, 10.0, 1e5, 0.1
_SAMPLES = 40


@dataclass(frozen=True, kw_only=True)
class ElementsSolution(Solution):
    """The optimum in time.

    Attributes:
      fuel: by the elements' own quadrature [kg].
      clock, node_station, node_speed: X of the finite elements with their times, shape
        (elements + 1,).
    """

    fuel: float
    clock: FloatArray
    node_station: FloatArray
    node_speed: FloatArray


def basis(tau: FloatArray) -> FloatArray:
    """Cubic Hermite basis and its first two derivatives, shape (3, 4, q), at tau in 0..1.

    Order of the four: value at 0, slope at 0, value at 1, slope at 1; slopes are per unit of tau.
    """
    one = np.ones_like(tau)
    value = (
        2 * tau**3 - 3 * tau**2 + 1,
        tau**3 - 2 * tau**2 + tau,
        -2 * tau**3 + 3 * tau**2,
        tau**3 - tau**2,
    )
    first = (
        6 * tau**2 - 6 * tau,
        3 * tau**2 - 4 * tau + one,
        -6 * tau**2 + 6 * tau,
        3 * tau**2 - 2 * tau,
    )
    second = (12 * tau - 6, 6 * tau - 4, -12 * tau + 6, 6 * tau - 2)
    return np.array([value, first, second])


def finite_elements(
    task: SpeedTask,
    guess: FloatArray,
    *,
    element: float = 100.0,
    points: int = 4,
    time_limit: float = 120.0,
) -> ElementsSolution:
    """Solves a task with elements of about `element` [m] at the mean speed.

    Args:
      task: with a trip time, which the plan takes in full, and without prices.
      guess: speeds at the road's nodes, shape (n + 1,) [m/s].
      element: mean length of an element [m].
      points: Gauss points of an element; 4 integrate the cost of a given P exactly.
      time_limit: of IPOPT [s].

    Raises:
      PlanningError: no finite trip time, prices, or IPOPT ends without a solution.
    """
    if not np.isfinite(task.time_max):
        raise PlanningError("finite elements in time need a given trip time")
    if task.price_time != 0.0 or task.price_energy != 0.0:
        raise PlanningError("finite elements in time have no price of time or of end speed")
    ca = casadi()
    began = time.perf_counter()
    program = ElementsProgram(task, element, points)
    options: dict[str, Any] = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 500,
        "ipopt.tol": 1e-6,
        "ipopt.max_wall_time": time_limit,
        # The units above scale the problem; IPOPT's own scaling fails on short elements.
        "ipopt.nlp_scaling_method": "none",
    }
    solver = ca.nlpsol("hermite", "ipopt", program.functions, options)
    result = solver(x0=program.start(guess), **program.bounds())
    statistics = solver.stats()
    if not statistics["success"]:
        raise PlanningError(
            f"the finite elements over {task.road.length:.0f} m ended with "
            f"{statistics['return_status']} after {statistics['iter_count']} iterations"
        )
    x = np.asarray(result["x"]).ravel()
    n = program.elements
    station, speed = x[: n + 1] * _S, x[n + 1 : 2 * n + 2] * _V
    intervals = task.road.intervals
    return ElementsSolution(
        speed=_speed_over(station, speed, program.duration, program.station),
        method="finite_elements",
        iterations=int(statistics["iter_count"]),
        solve_time=time.perf_counter() - began,
        time_price=np.nan,
        costate=np.full(intervals + 1, np.nan),
        interval_price=np.full(intervals, np.nan),
        fuel=float(program.fuel(x)),
        clock=np.asarray(program.duration * np.arange(n + 1), dtype=float),
        node_station=station + task.road.station[0],
        node_speed=speed,
    )


METHODS["finite_elements"] = finite_elements


class ElementsProgram:
    """The nonlinear program: x = [s, v at the elements' ends, P at the Gauss points]."""

    def __init__(self, task: SpeedTask, element: float, points: int) -> None:
        ca = casadi()
        self.task, vehicle = task, task.vehicle
        self.station = task.road.station - task.road.station[0]
        # A B-spline is zero outside its knots, so the road extends a little beyond both ends.
        step = task.road.step
        self.padded = np.concatenate([[-step], self.station, [self.station[-1] + step]])
        self.elements = n = max(round(task.road.length / element), 2)
        self.duration = task.time_max / n
        self.count = n * points
        roots, weights = np.polynomial.legendre.leggauss(points)
        weight = np.tile(0.5 * weights * self.duration, n)
        s, v = ca.MX.sym("s", n + 1), ca.MX.sym("v", n + 1)
        power = ca.MX.sym("P", self.count)
        table = basis(0.5 * (roots + 1.0))
        at, speed, acceleration = (
            self._at_points(table[k], s * _S, v * _V) / self.duration**k for k in range(3)
        )
        watt, fuel = power * _P, vehicle.fuel
        need = self._needed_power(at, speed, acceleration)
        burnt = ca.dot(weight, fuel.f0 + fuel.f1 * watt + fuel.f2 * watt**2)
        spare = (vehicle.efficiency * watt - need) / _P
        where, fast = ca.vertcat(at, s * _S), ca.vertcat(speed, v * _V)
        low, high = (self._bound(b)(where.T).T for b in (task.b_low, task.b_high))
        x = ca.vertcat(s, v, power)
        self.functions = {
            "x": x,
            "f": (burnt + task.k_a * ca.dot(weight, acceleration**2)) / _COST,
            "g": ca.vertcat(
                spare,
                spare - vehicle.brake_max * speed / _P,
                (fast**2 - low) / _V**2,
                (fast**2 - high) / _V**2,
            ),
        }
        self.fuel = ca.Function("fuel", [x], [burnt])
        self._need = ca.Function("need", [x], [need])

    def _at_points(self, table: FloatArray, s: Any, v: Any) -> Any:
        """Values at all Gauss points, element by element; `table` of shape (4, points)."""
        ca = casadi()
        parts = (s[:-1], v[:-1] * self.duration, s[1:], v[1:] * self.duration)
        terms = (
            ca.mtimes(ca.DM(row[:, None]), part.T) for row, part in zip(table, parts, strict=True)
        )
        return ca.vec(sum(terms))

    def _needed_power(self, station: Any, speed: Any, acceleration: Any) -> Any:
        """Power at the wheels for the motion [W]."""
        from scipy.interpolate import make_interp_spline

        vehicle, road = self.task.vehicle, self.task.road
        before, after = road.height[0] - road.height[1], road.height[-1] - road.height[-2]
        height = np.pad(road.height, 1, mode="edge") + _at_ends(before, after, road.height.size)
        slope = _curve(make_interp_spline(self.padded, height, 5).derivative())
        grade = slope.map(self.count)(station.T).T
        resistance = (grade + vehicle.rolling) * vehicle.mass * GRAVITY
        force = vehicle.inertial_mass * acceleration + resistance + vehicle.drag * speed**2
        return force * speed

    def _bound(self, b: FloatArray) -> Any:
        """Bound of v^2 over station, linear between nodes, for all points and element ends."""
        ca = casadi()
        value = ca.interpolant("bound", "linear", [self.padded], np.pad(b, 1, mode="edge"))
        return value.map(self.count + self.elements + 1)

    def bounds(self) -> dict[str, FloatArray]:
        """Bounds of unknowns and rows."""
        task, vehicle, n = self.task, self.task.vehicle, self.elements
        clock = self.duration * np.arange(n + 1)
        farthest = np.full(n + 1, self.station[-1])
        if task.behind:
            # The last station with an earliest time in the past.
            earliest = np.maximum.accumulate(task.earliest)
            farthest = np.minimum(farthest, np.interp(clock, earliest, self.station))
        nearest = np.zeros(n + 1)
        nearest[-1] = self.station[-1]
        farthest[0] = 0.0
        if farthest[-1] < nearest[-1]:
            raise PlanningError(
                f"the vehicle ahead blocks the road after a trip time of {task.time_max:.1f} s"
            )
        slowest = np.full(n + 1, np.sqrt(task.b_low.min()))
        fastest = np.full(n + 1, np.sqrt(task.b_high.max()))
        slowest[[0, -1]] = np.sqrt(task.b_low[[0, -1]])
        fastest[[0, -1]] = np.sqrt(task.b_high[[0, -1]])
        drag = np.full(self.count, -vehicle.power_drag)
        power = np.full(self.count, vehicle.power_max)
        inf, zero = np.full(self.count, np.inf), np.zeros(self.count)
        wide, none = np.full(self.count + n + 1, np.inf), np.zeros(self.count + n + 1)
        return {
            "lbx": np.concatenate([nearest / _S, slowest / _V, drag / _P]),
            "ubx": np.concatenate([farthest / _S, fastest / _V, power / _P]),
            "lbg": np.concatenate([zero, -inf, none, -wide]),
            "ubg": np.concatenate([inf, zero, wide, none]),
        }

    def start(self, guess: FloatArray) -> FloatArray:
        """Unknowns from speeds at the road's nodes."""
        clock = passing_times(guess, self.task.road)
        at = np.interp(np.linspace(0.0, clock[-1], self.elements + 1), clock, self.station)
        ends = np.concatenate([at / _S, np.interp(at, self.station, guess) / _V])
        need = np.asarray(self._need(np.concatenate([ends, np.zeros(self.count)]))).ravel()
        top = 0.95 * self.task.vehicle.power_max / _P
        power = np.clip(need / self.task.vehicle.efficiency / _P, 0.02 * top, top)
        return np.concatenate([ends, power])


def _at_ends(before: float, after: float, inside: int) -> FloatArray:
    return np.concatenate([[before], np.zeros(inside), [after]])


def _curve(spline: Any) -> Any:
    """A scipy spline as a CasADi function of one number.

    Its degree must be 3 or more: CasADi 3.8 writes out of bounds when the second derivative, then a
    step function, is evaluated at a knot.
    """
    ca = casadi()
    s = ca.MX.sym("s")
    used = spline.c[: spline.t.size - spline.k - 1]
    value = ca.bspline(s, ca.DM(used), [list(spline.t)], [spline.k], 1, {})
    return ca.Function("curve", [s], [value])


def _speed_over(
    station: FloatArray, speed: FloatArray, duration: float, wanted: FloatArray
) -> FloatArray:
    """Speeds at stations `wanted`, from the cubic elements."""
    table = basis(np.linspace(0.0, 1.0, _SAMPLES, endpoint=False))
    parts = np.array([station[:-1], speed[:-1] * duration, station[1:], speed[1:] * duration])
    s = np.append((parts.T @ table[0]).ravel(), station[-1])
    v = np.append((parts.T @ table[1]).ravel() / duration, speed[-1])
    return np.interp(wanted, s, v)
