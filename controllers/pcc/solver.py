"""The optimal control problem in the distance domain: task, answer, and who solves it.

The interior-point method of our own (`interior_point.py`) needs no set-up and a time linear in the
number of intervals. IPOPT (`ipopt.py`) solves the same problem for comparison, and where our own
method should not converge. The problem itself stands in `problem.py`.

The cost is the paper's (section on the fuel-efficient speed planner) in the distance domain; its
fence `s <= s_fence(t)` becomes an earliest time of passing each station.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from controllers.pcc.feasibility import require_feasible
from controllers.pcc.interior_point import Optimum, Settings, minimize
from controllers.pcc.problem import Problem
from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.units import GRAVITY

if TYPE_CHECKING:
    from controllers.pcc.ipopt import Ipopt

METHODS = ("interior_point", "ipopt")
_PATIENCE = 2.0  # [s] left, from which IPOPT may take over: CasADi alone takes a second to load
_SPEED = 20.0  # [m/s], unit inside the problem
_B_MAX = 1e4  # [m2/s2], in place of no speed limit at all
# Relative room in power and trip time: where only one drive is possible its multipliers would have
# no bound without it.
_ROOM = 1e-7
_ROOM_BRAKE = 1e-4  # of the force of full power at 20 m/s: a newton or two
# After a long climb at full power the end speed is the same, but for less and less, whatever was
# done before: to hold it exactly would take multipliers without bound. There the end speed is worth
# so many times what full power burns for it, and may be missed by so little [m/s].
_END_WORTH = 20.0
_END_ITERATIONS = 40  # with the end speed as a bound, before that
_END_SHORT = 0.02
_END_EXACT = 1e-6  # of v^2, within which the end speed is what was asked for
_END_NEAR = 1e-3  # of v^2: how near the end speed is to the greatest possible one there


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
    """The optimum.

    Attributes:
      speed: at the nodes, shape (n + 1,) [m/s]; the last may miss its bound by 0.02 m/s
        after a long climb at full power.
      time_price: what a second of the trip time costs [kg/s].
      iterations: of the solver; wall_time: of the whole solve [s].
      costate: how much less is burnt after a node for a little more v^2 there, shape (n + 1,)
        [kg/(m2/s2)]; at the last node, what v^2 there costs before it.
      interval_price: what a second in an interval costs by trip time and fences, shape (n,) [kg/s],
        without the task's own price.
      method: that solved it.
    """

    speed: FloatArray
    time_price: float
    iterations: int
    wall_time: float
    costate: FloatArray
    interval_price: FloatArray
    method: str


@dataclass(frozen=True)
class Units:
    """Units of a `Problem`: b [m2/s2], force over mass [m/s2], time [s], fuel [kg]."""

    b: float
    force: float
    time: float
    fuel: float


class Solver:
    """Solves tasks on grids of one size. `build_time`: of setting up, in seconds.

    `fenced` says whether tasks may hold fences; `method` is one of METHODS; `tolerance` is that of
    our own method, in its units of about 1: the default makes the multipliers exact, 1e-6 gives
    speeds within 5 mm/s in three quarters of the time.
    """

    def __init__(
        self,
        vehicle: PointMass,
        intervals: int,
        step: float,
        fenced: bool = False,
        time_limit: float = 20.0,
        method: str = "interior_point",
        tolerance: float = 1e-8,
    ) -> None:
        if method not in METHODS:
            raise InputError(f"method {method!r} is not known: use one of {', '.join(METHODS)}")
        if not 1e-12 <= tolerance <= 1e-2:
            raise InputError(f"tolerance = {tolerance!r} is not allowed: use 1e-12 to 1e-2")
        began = time.perf_counter()
        self.vehicle, self.intervals, self.step, self.fenced = vehicle, intervals, step, fenced
        self.time_limit, self.method, self.tolerance = time_limit, method, tolerance
        self._ipopt: Ipopt | None = None
        if method == "ipopt":
            self._make_ipopt()
        self.build_time = time.perf_counter() - began

    def solve(self, task: Task, guess: FloatArray) -> Answer:
        """Solves from a guess of the node speeds, shape (n + 1,).

        Raises:
          PlanningError: there is no such drive, with the reason; or no solver ends in time.
        """
        began = time.perf_counter()
        self._check(task, guess)
        fastest = require_feasible(self.vehicle, task)
        spent = bool(fastest[-1] ** 2 < task.b_low[-1] * (1.0 + _END_NEAR))
        problem, units = scaled(self.vehicle, task)
        own = None
        if self.method == "interior_point":
            own = self._own(task, problem, guess**2 / units.b, spent)
        left = self.time_limit - (time.perf_counter() - began)
        if own is None or (not own.converged and left > _PATIENCE):
            optimum, method = self._make_ipopt().solve(task, guess, problem, units), "ipopt"
        else:
            optimum, method = own, "interior_point"
        short = math.sqrt(task.b_low[-1]) - math.sqrt(optimum.b[-1] * units.b)
        if optimum.converged and short > _END_SHORT:
            note = f"the end speed is missed by {short:.2f} m/s"
            optimum = replace(optimum, converged=False, note=note)
        if not optimum.converged:
            raise PlanningError(
                f"the speed optimization over {task.road.length:.0f} m has no result: "
                f"{optimum.note}"
            )
        return _answer(task, optimum, units, time.perf_counter() - began, method)

    def _own(self, task: Task, problem: Problem, guess: FloatArray, spent: bool) -> Optimum:
        """By the interior-point method; with a soft end speed where that is `spent` and hard."""
        settings = Settings(
            tolerance=self.tolerance,
            dual_tolerance=100.0 * self.tolerance,
            polish=2 if self.tolerance <= 1e-8 else 0,
            time_limit=self.time_limit,
        )
        if not spent:
            return minimize(problem, guess, settings)
        short = replace(settings, iterations=_END_ITERATIONS, time_limit=0.5 * self.time_limit)
        own = minimize(problem, guess, replace(short, fallback=False))
        if own.converged:
            return own
        soft, _ = scaled(self.vehicle, task, soft_end=True)
        return minimize(soft, guess, replace(settings, time_limit=0.5 * self.time_limit))

    def _make_ipopt(self) -> Ipopt:
        """IPOPT for this grid, built when first needed: CasADi takes a second to load."""
        if self._ipopt is None:
            from controllers.pcc.ipopt import Ipopt

            self._ipopt = Ipopt(
                self.vehicle, self.intervals, self.step, self.fenced, self.time_limit
            )
        return self._ipopt

    def _check(self, task: Task, guess: FloatArray) -> None:
        road, nodes = task.road, self.intervals + 1
        if road.intervals != self.intervals or abs(road.step - self.step) > 1e-6:
            raise PlanningError(
                f"the solver is for {self.intervals} intervals of {self.step:g} m, the road has "
                f"{road.intervals} of {road.step:g} m"
            )
        for name, array in (
            ("b_low", task.b_low),
            ("b_high", task.b_high),
            ("fence", task.fence),
            ("guess", guess),
        ):
            if np.shape(array) != (nodes,) or np.isnan(array).any():
                raise PlanningError(
                    f"{name} of the task must hold {nodes} numbers, not {np.shape(array)} or NaN"
                )
        for name in ("time_max", "k_a", "price_time", "price_energy"):
            value = getattr(task, name)
            if math.isnan(value) or (name != "time_max" and math.isinf(value)):
                raise PlanningError(f"{name} = {value!r} of the task is not allowed")
        if task.k_a < 0.0:
            raise PlanningError(f"k_a = {task.k_a!r} of the task is not allowed: use 0 or more")
        if task.b_low.min() <= 0.0:
            raise PlanningError("the least speeds of the task must be above 0")
        if task.fence.max() > 0.0 and not self.fenced:
            raise PlanningError("the task holds fences; the solver was made without: fenced=True")


def with_room(vehicle: PointMass, task: Task) -> tuple[PointMass, Task]:
    """Vehicle and task with the room in power, brakes and trip time that the solver takes."""
    power, newton = vehicle.power_max, vehicle.efficiency * vehicle.power_max / _SPEED
    more = replace(
        vehicle,
        power_max=power * (1.0 + _ROOM),
        brake_max=vehicle.brake_max + _ROOM_BRAKE * newton,
    )
    return more, replace(task, time_max=task.time_max * (1.0 + _ROOM))


def scaled(vehicle: PointMass, task: Task, soft_end: bool = False) -> tuple[Problem, Units]:
    """The task in the units in which it is solved; a soft end speed has a worth, not a bound."""
    fuel, power, step = vehicle.fuel, vehicle.power_max, task.road.step
    mass = vehicle.inertial_mass
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
        fence=np.maximum(task.fence[1:], 0.0) / units.time,
    )
    return problem, units


def _answer(task: Task, optimum: Optimum, units: Units, wall_time: float, method: str) -> Answer:
    per_second = units.fuel / units.time
    b = np.clip(optimum.b * units.b, task.b_low, task.b_high)
    reached = optimum.b[-1] * units.b
    if reached < task.b_low[-1] * (1.0 - _END_EXACT):
        b[-1] = reached
    return Answer(
        speed=np.sqrt(b),
        time_price=max(optimum.time_price, 0.0) * per_second,
        iterations=optimum.iterations,
        wall_time=wall_time,
        costate=optimum.costate * (units.fuel / units.b),
        interval_price=optimum.prices * per_second,
        method=method,
    )


# --- A plan between its nodes: what its constant forces do on a road that is known more finely ---
# A plan states one force for each interval. Drawn as straight lines of v^2 over a road that is
# rough within the intervals it would ask for forces that swing with every bump, up into the brakes:
# on the paper's road a 50 m plan followed so burns 0.8 % more than planned. With the force held,
# kinetic and potential energy change places there, and it burns what was planned.


def on_finer_road(
    vehicle: PointMass,
    road: RoadProfile,
    speed: FloatArray,
    fine: RoadProfile,
    v_max: float = np.inf,
) -> FloatArray:
    """Speeds at the nodes of a finer profile of the same road, shape of its stations [m/s].

    With force, rolling resistance and drag as at the mean of the interval, `m_e v^2 / 2 + m g z`
    is linear in the station between two nodes of the plan. The fine road's limits and
    the band are kept as well as between the plan's nodes.

    Args:
      vehicle: that the plan was made for.
      road: on whose grid the plan stands.
      speed: of the plan at its nodes, shape (n + 1,) [m/s].
      fine: the same road with closer nodes, within the stations of `road`.
      v_max: of the band [m/s].

    Raises:
      InputError: the fine profile leaves the road, or speeds are not those of its nodes.
    """
    if speed.shape != road.station.shape or not np.isfinite(speed).all():
        raise InputError(f"a plan over {road.name!r} wants {road.station.size} finite speeds")
    first, last = road.station[[0, -1]]
    if fine.station[0] < first - 1e-6 or fine.station[-1] > last + 1e-6:
        raise InputError(
            f"fine profile {fine.name!r} from {fine.station[0]:.0f} to {fine.station[-1]:.0f} m "
            f"leaves the plan's {first:.0f} to {last:.0f} m"
        )
    line = np.interp(fine.station, road.station, speed**2)
    above = fine.height - np.interp(fine.station, road.station, road.height)
    b = line - 2.0 * GRAVITY * vehicle.mass / vehicle.inertial_mass * above
    # A dip deeper than the kinetic energy is no road; half the planned energy is kept.
    b = np.maximum(b, 0.5 * line)
    cap = np.maximum(np.minimum(fine.v_limit, v_max), np.sqrt(line))
    return np.asarray(np.minimum(np.sqrt(b), cap))
