"""The speed task as a scaled nonlinear program: values, gradients, curvature, inequalities.

Nodes k = 0..n, intervals of length ds between them. Variables: b = v^2 at the nodes and y, the
brake force, in the intervals. With the net force N of the motion, linear in b, the engine's force
at the wheels is F = N + y. The duration of an interval is d = 2 ds / (v0 + v1): exact for constant
force, and convex in b.

    minimize   sum [f0 d + f1 F ds/eta + f2 (F ds/eta)^2 / d + k_a a^2 d] - worth b[n]
    subject to 0 <= y <= B_max,  -P_drag d <= F ds/eta <= P_max d,  b within bounds,
               t[n] <= T,  t[k] >= earliest[k]  with  t[k] = d[0] + ... + d[k-1]

The fuel is jointly convex in (F, d). Its curvature in b is a sum of squares and m d'' with m the
Lagrangian's derivative by d: where m >= 0 the problem is convex there.

Units of the program: b in 400 m2/s2, force in that of full power at 20 m/s, time in ds / 20 m/s,
fuel in that of full power during this time. All variables and multipliers are then of order 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from controllers.pcc.task import SpeedTask
from iits_mj.core.arrays import FloatArray

_SPEED = 20.0  # [m/s], unit
_B_MAX = 1e4  # [m2/s2], in place of an infinite speed limit
# Relative room in power and trip time: without it, multipliers have no bound if only one drive is
# possible.
_ROOM = 1e-7
_ROOM_BRAKE = 1e-4  # of the force of full power at 20 m/s: a newton or two
# Worth of a soft end speed over the fuel that full power burns for it.
_END_WORTH = 20.0
_PINNED = 1e-9  # difference of the bounds of b below which b is fixed


@dataclass(frozen=True)
class Problem:
    """The program of n intervals in its own units; see the module.

    Attributes:
      inertia: net force per difference of b; air: per mean of b; resistance: of grade and tires,
        shape (n,).
      fuel: coefficients of d, F and F^2 / d; calm: of (b1 - b0)^2 d; worth: of the last b.
      overrun: P_drag / P_max; full: 1, or a little more so that there is room inside; brake:
        greatest y.
      low, high: bounds of b, shape (n + 1,), equal where fixed.
      time_max: greatest t[n], inf for none.
      earliest: least t at nodes 1..n behind a vehicle, shape (n,), 0 for none.
    """

    inertia: float
    air: float
    resistance: FloatArray
    fuel: tuple[float, float, float]
    calm: float
    worth: float
    overrun: float
    full: float
    brake: float
    low: FloatArray
    high: FloatArray
    time_max: float
    earliest: FloatArray

    @property
    def intervals(self) -> int:
        """Number of intervals n."""
        return self.resistance.size

    @property
    def slope(self) -> tuple[float, float]:
        """Derivatives of the net force by b at the start and at the end of an interval."""
        return 0.5 * self.air - self.inertia, 0.5 * self.air + self.inertia

    def net(self, b: FloatArray) -> FloatArray:
        """Returns the net force of the intervals, shape (n,)."""
        first, last = self.slope
        return first * b[:-1] + last * b[1:] + self.resistance


@dataclass(frozen=True)
class Units:
    """Units of a `Problem`: b [m2/s2], force over mass [m/s2], time [s], fuel [kg]."""

    b: float
    force: float
    time: float
    fuel: float


def with_room(task: SpeedTask) -> SpeedTask:
    """Returns the task with the room in power, brakes and trip time that `scaled` adds."""
    vehicle = task.vehicle
    newton = vehicle.efficiency * vehicle.power_max / _SPEED
    more = replace(
        vehicle,
        power_max=vehicle.power_max * (1.0 + _ROOM),
        brake_max=vehicle.brake_max + _ROOM_BRAKE * newton,
    )
    return replace(task, vehicle=more, time_max=task.time_max * (1.0 + _ROOM))


def scaled(task: SpeedTask, soft_end: bool = False) -> tuple[Problem, Units]:
    """Returns a task's program and its units; a soft end speed has a worth, not a bound."""
    vehicle, step = task.vehicle, task.road.step
    fuel, power, mass = vehicle.fuel, vehicle.power_max, vehicle.inertial_mass
    full = fuel.f0 + fuel.f1 * power + fuel.f2 * power**2
    duration = step / _SPEED
    units = Units(
        b=_SPEED**2,
        force=vehicle.efficiency * power / (mass * _SPEED),
        time=duration,
        fuel=full * duration,
    )
    to_acceleration = units.b / (2.0 * step)
    high = np.minimum(task.b_high, _B_MAX)
    low = np.minimum(task.b_low, high)
    inertia = to_acceleration / units.force
    coefficients = (
        (fuel.f0 + task.price_time) / full,
        fuel.f1 * power / full,
        fuel.f2 * power**2 / full,
    )
    worth = task.price_energy * units.b / units.fuel
    if soft_end:
        low[-1] *= 0.9
        worth += _END_WORTH * inertia * (coefficients[1] + 2.0 * coefficients[2])
    problem = Problem(
        inertia=inertia,
        air=vehicle.drag / mass * units.b / units.force,
        resistance=vehicle.slope_force(task.road.grade) / (mass * units.force),
        fuel=coefficients,
        calm=task.k_a * to_acceleration**2 / full,
        worth=worth,
        overrun=vehicle.power_drag / power,
        full=1.0 + _ROOM,
        brake=vehicle.brake_max / (mass * units.force) + _ROOM_BRAKE,
        low=low / units.b,
        high=high / units.b,
        time_max=task.time_max * (1.0 + 0.1 * _ROOM) / units.time,
        earliest=np.maximum(task.earliest[1:], 0.0) / units.time,
    )
    return problem, units


class Point:
    """Problem at b (n + 1,) and y (n,): durations with derivatives, force, times, cost."""

    def __init__(self, problem: Problem, b: FloatArray, y: FloatArray) -> None:
        self.problem, self.b, self.y = problem, b, y
        v = np.sqrt(b)
        self._v0, self._v1 = v[:-1], v[1:]
        self._total = self._v0 + self._v1
        self.duration = 2.0 / self._total
        square = -1.0 / (self._total * self._total)
        # Derivatives of the duration by b at both ends.
        self.d0, self.d1 = square / self._v0, square / self._v1
        self.force = problem.net(b) + y
        self.pull = self.force / self.duration  # power over full power
        self.time = np.cumsum(self.duration)  # at nodes 1..n
        self.change = np.diff(b)

    def cost(self) -> float:
        """Returns the cost of the whole drive."""
        p = self.problem
        c0, c1, c2 = p.fuel
        rate = c0 + c1 * self.pull + c2 * self.pull**2 + p.calm * self.change**2
        return float(np.sum(rate * self.duration)) - p.worth * float(self.b[-1])

    @cached_property
    def cost_slope(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives of an interval's cost by force, duration and change of b, each (n,)."""
        (c0, c1, c2), calm = self.problem.fuel, self.problem.calm
        return (
            c1 + 2.0 * c2 * self.pull,
            c0 - c2 * self.pull**2 + calm * self.change**2,
            2.0 * calm * self.change * self.duration,
        )

    def to_nodes(
        self, by_force: FloatArray, by_duration: FloatArray, by_change: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Returns derivatives by b at start and end of each interval, y fixed; each (n,)."""
        first, last = self.problem.slope
        start = first * by_force + self.d0 * by_duration - by_change
        end = last * by_force + self.d1 * by_duration + by_change
        return start, end

    def curvature(
        self,
        weights: tuple[FloatArray, FloatArray, FloatArray],
        by_duration: FloatArray,
        convex: bool = False,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Returns second derivatives with y eliminated, and the coefficients that give y.

        By y and b an interval has the squares `w_i (dy + u_i . db)^2`: of the brake's bounds (u =
        0), of overrun, of full power and of the fuel. Their least over dy is
        `sum_i<j w_i w_j ((u_i - u_j) . db)^2 / sum w`, without cancellation even for large weights
        of active bounds.

        Args:
          weights: multiplier over slack of the brake's bounds (both together), of overrun and of
            full power, each (n,).
          by_duration: derivative of the Lagrangian by the durations, (n,).
          convex: True omits terms that may be negative, so that the result is positive
            semidefinite.

        Returns:
          Curvature by b at (start, start), (start, end), (end, end); the sum of weights; the mean u
          at start and end. Each (n,).
        """
        p = self.problem
        first, last = p.slope
        brake, overrun, full = weights
        d, d0, d1, pull = self.duration, self.d0, self.d1, self.pull
        fuel = 2.0 * p.fuel[2] / d
        weight = brake + overrun + full + fuel
        # u_i = slope + x_i grad d; x: the pull of overrun, less that of full power, less its own.
        shares = (overrun / weight, full / weight, fuel / weight)
        mass = shares[0] + shares[1] + shares[2]
        mean = shares[0] * p.overrun - shares[1] * p.full - shares[2] * pull
        along = brake * mass
        cross = brake * mean
        across = shares[0] * p.overrun**2 + shares[1] * p.full**2 + shares[2] * pull**2
        across = brake * across + overrun * shares[1] * (p.overrun + p.full) ** 2
        across += overrun * shares[2] * (p.overrun + pull) ** 2
        across += full * shares[2] * (p.full - pull) ** 2
        h00 = along * first * first + 2.0 * cross * first * d0 + across * d0 * d0
        h01 = along * first * last + cross * (first * d1 + last * d0) + across * d0 * d1
        h11 = along * last * last + 2.0 * cross * last * d1 + across * d1 * d1
        # Curvature of the durations.
        v0, v1, total = self._v0, self._v1, self._total
        if convex:
            by_duration = np.maximum(by_duration, 0.0)
        cube, square = by_duration / total**3, 0.5 * by_duration / total**2
        h00 += (cube + square / v0) / v0**2
        h01 += cube / (v0 * v1)
        h11 += (cube + square / v1) / v1**2
        if p.calm:
            twist = 2.0 * p.calm * (np.zeros_like(d) if convex else self.change)
            own = 2.0 * p.calm * d
            h00 += own - 2.0 * twist * d0
            h01 += twist * (d0 - d1) - own
            h11 += own + 2.0 * twist * d1
        return h00, h01, h11, weight, mass * first + mean * d0, mass * last + mean * d1


class Inequalities:
    """All inequalities g(x) >= 0 of a problem in one vector of shape (m,), and its Lagrangian.

    Order: 4 n of the intervals (brake force, room of the brake, overrun, full power), 2 (n + 1) of
    the nodes (above the low bound, below the high one), n earliest times if there are any, the trip
    time. An inequality that does not apply (at pinned nodes, at free nodes, without a trip time)
    has `present` 0 and no multiplier.

    Attributes:
      pinned: nodes whose b is fixed, shape (n + 1,); behind: whether any earliest time applies.
      present: 1 where an inequality applies, else 0, shape (m,); count: their number.
      nodes: the slice of the bounds of b in the vector.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        n = self._n = problem.intervals
        self.pinned = problem.high - problem.low < _PINNED
        self.behind = bool((problem.earliest > 0.0).any())
        self.timed = bool(np.isfinite(problem.time_max))
        present = [np.ones(4 * n), np.tile(~self.pinned, 2)]
        if self.behind:
            present.append(problem.earliest > 0.0)
        present.append(np.array([self.timed]))
        self.present = np.concatenate(present).astype(float)
        self.count = float(self.present.sum())
        self.nodes = slice(4 * n, 6 * n + 2)

    def values(self, at: Point) -> FloatArray:
        """Returns all g(x); 1 in place of a trip time that does not apply."""
        p = self.problem
        free = p.time_max - at.time[-1] if self.timed else 1.0
        parts = [
            at.y,
            p.brake - at.y,
            at.force + p.overrun * at.duration,
            p.full * at.duration - at.force,
            at.b - p.low,
            p.high - at.b,
        ]
        if self.behind:
            parts.append(at.time - p.earliest)
        return np.concatenate([*parts, np.array([free])])

    def change(self, at: Point, db: FloatArray, dy: FloatArray) -> FloatArray:
        """Returns the first-order change of all g(x) for steps of b (n + 1,) and y (n,)."""
        p = self.problem
        first, last = p.slope
        duration = at.d0 * db[:-1] + at.d1 * db[1:]
        force = first * db[:-1] + last * db[1:] + dy
        time = np.cumsum(duration)
        parts = [dy, -dy, force + p.overrun * duration, p.full * duration - force]
        parts += [db, -db]
        if self.behind:
            parts.append(time)
        return np.concatenate([*parts, -time[-1:]])

    def prices(self, z: FloatArray) -> FloatArray:
        """Returns each interval's price of duration by trip time and earliest times, (n,)."""
        n = self._n
        price = np.full(n, z[-1])
        if self.behind:
            # Every duration before a node helps to reach its earliest time.
            price -= np.cumsum(z[6 * n + 2 : 7 * n + 2][::-1])[::-1]
        return price

    def slopes(self, at: Point, z: FloatArray) -> tuple[FloatArray, ...]:
        """Returns derivatives of `cost - z g` by force, duration, change of b and y, (n,)."""
        brake, room, overrun, full = z[: 4 * self._n].reshape(4, self._n)
        by_force, by_duration, by_change = at.cost_slope
        by_force = by_force - overrun + full
        by_duration = by_duration + self.prices(z)
        by_duration -= self.problem.overrun * overrun + self.problem.full * full
        return by_force, by_duration, by_change, by_force - brake + room

    def gradient(self, at: Point, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the gradient of `cost - z g` by b, zero where pinned, and by y."""
        n = self._n
        by_force, by_duration, by_change, by_brake = self.slopes(at, z)
        start, end = at.to_nodes(by_force, by_duration, by_change)
        above, below = z[self.nodes].reshape(2, n + 1)
        gradient = below - above
        gradient[:-1] += start
        gradient[1:] += end
        gradient[-1] -= self.problem.worth
        gradient[self.pinned] = 0.0
        return gradient, by_brake

    def weights(
        self, ratio: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray, FloatArray]:
        """Returns multipliers over slacks as weights of intervals, nodes and times at 1..n."""
        n = self._n
        brake, room, overrun, full = ratio[: 4 * n].reshape(4, n)
        times = np.zeros(n)
        if self.behind:
            times += ratio[6 * n + 2 : 7 * n + 2]
        times[-1] += ratio[-1]
        return (brake + room, overrun, full), ratio[self.nodes].reshape(2, n + 1).sum(axis=0), times
