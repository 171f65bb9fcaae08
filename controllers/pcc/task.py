"""The speed-planning problem of one road, its solution, and the reason if there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, brakeable, durations, fastest_below, passing_times
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError

_SLACK = 1e-6  # [m2/s2] and relative: rounding of the passes themselves


@dataclass(frozen=True)
class SpeedTask:
    """Problem to find the speed over a road that costs least, in the distance domain.

    The cost is the paper's (section on the fuel-efficient speed planner), with prices of trip time
    and end speed. The paper's limit `s <= s_leader(t)` becomes an earliest time at each node.

    Attributes:
      vehicle: the truck.
      road: grid of n intervals.
      b_low, b_high: bounds of v^2 at the nodes, shape (n + 1,) [m2/s2], equal where v is fixed.
      time_max: greatest trip time [s], inf for none.
      earliest: earliest times at the nodes behind a vehicle, shape (n + 1,) [s]; 0 where free.
      k_a: weight of a^2 [kg/s per (m/s2)^2].
      price_time: cost of a second [kg/s]; price_energy: worth of the last v^2 [kg/(m2/s2)].

    Raises:
      PlanningError: an array has another shape or holds NaN, or a number is not allowed.
    """

    vehicle: PointMass
    road: RoadProfile
    b_low: FloatArray
    b_high: FloatArray
    time_max: float = math.inf
    earliest: FloatArray = field(default_factory=lambda: np.zeros(0))
    k_a: float = 0.0
    price_time: float = 0.0
    price_energy: float = 0.0

    def __post_init__(self) -> None:
        if self.earliest.size == 0:
            object.__setattr__(self, "earliest", np.zeros(self.road.station.size))
        for name in ("b_low", "b_high", "earliest"):
            self.check_nodes(name, getattr(self, name))
        for name in ("time_max", "k_a", "price_time", "price_energy"):
            value = getattr(self, name)
            if math.isnan(value) or (name != "time_max" and math.isinf(value)):
                raise PlanningError(f"speed task: {name} = {value!r} is not allowed")
        if self.k_a < 0.0:
            raise PlanningError(f"speed task: k_a = {self.k_a!r} is not allowed; use 0 or more")
        if self.b_low.min() <= 0.0:
            raise PlanningError("speed task: the least speeds must be above 0")

    def check_nodes(self, name: str, array: FloatArray) -> None:
        """Raises PlanningError unless an array has a number for each node."""
        nodes = self.road.station.size
        if np.shape(array) != (nodes,) or math.isnan(array.min()):
            raise PlanningError(
                f"speed task: {name} must hold {nodes} numbers, not {np.shape(array)} or NaN"
            )

    @property
    def behind(self) -> bool:
        """Whether a vehicle ahead constrains the plan."""
        return bool(self.earliest.max() > 0.0)

    def cost(self, speed: FloatArray) -> float:
        """Returns the cost of node speeds (n + 1,) [kg]."""
        time = durations(speed, self.road)
        acceleration = np.diff(speed**2) / (2.0 * self.road.step)
        calm = float(acceleration**2 @ time)
        total = float(self.vehicle.fuel_of(speed, self.road).sum()) + self.k_a * calm
        total += self.price_time * float(time.sum())
        return total - self.price_energy * float(speed[-1] ** 2)


@dataclass(frozen=True)
class Solution:
    """The optimal speed of a task.

    Attributes:
      speed: at the nodes, shape (n + 1,) [m/s]; the last may miss its bound by 0.02 m/s after a
        long climb at full power.
      method: that found it.
      iterations: of the method; solve_time: wall time with set-up [s].
      time_price: multiplier of the trip time [kg/s]; this and the arrays below are NaN if the
        method is not in the distance domain.
      costate: fuel saved after a node per v^2 there, shape (n + 1,) [kg/(m2/s2)]; at the last node,
        fuel burnt before it.
      interval_price: cost of a second in an interval by trip time and vehicle ahead, shape (n,)
        [kg/s], without the task's own price.
    """

    speed: FloatArray
    method: str
    iterations: int
    solve_time: float
    time_price: float
    costate: FloatArray
    interval_price: FloatArray


def require_feasible(task: SpeedTask) -> FloatArray:
    """Returns the greatest node speeds (n + 1,) that any drive of the task can have.

    Checks necessary conditions, each in one pass over the nodes.

    Raises:
      PlanningError: no drive keeps the task's limits; the message gives the reason.
    """
    vehicle, road, low = task.vehicle, task.road, task.b_low
    high = np.minimum(task.b_high, 1e4)
    empty = low > high + 1e-9
    if empty.any():
        k = int(empty.argmax())
        raise PlanningError(
            f"at station {road.station[k]:.0f} m the least speed {math.sqrt(low[k]):.2f} m/s is "
            f"above the greatest {math.sqrt(max(high[k], 0.0)):.2f} m/s"
        )
    # The engine's drag helps the brakes.
    drag = vehicle.power_drag * vehicle.efficiency / math.sqrt(float(low.min()))
    cap = brakeable(vehicle, road, high, vehicle.brake_max + drag)
    steep = low > cap + _SLACK
    if steep.any():
        k = int(np.flatnonzero(steep)[-1])
        ahead = k + int(np.flatnonzero(high[k:] - cap[k:] <= _SLACK)[0])
        raise PlanningError(
            f"the brakes ({vehicle.brake_max / 1e3:.0f} kN) cannot take the least speed "
            f"{math.sqrt(low[k]):.2f} m/s at station {road.station[k]:.0f} m down to the "
            f"{math.sqrt(high[ahead]):.2f} m/s allowed at station {road.station[ahead]:.0f} m"
        )
    fastest = fastest_below(vehicle, road, cap)
    slow = fastest**2 < low * (1.0 - _SLACK) - _SLACK
    if slow.any():
        k = int(slow.argmax())
        where = "the end speed" if k == road.intervals else "the least speed"
        raise PlanningError(
            f"{where} {math.sqrt(low[k]):.2f} m/s at station {road.station[k]:.0f} m is out of "
            f"reach: full power ({vehicle.power_max / 1e3:.0f} kW) brings {vehicle.mass:.0f} kg to "
            f"{fastest[k]:.2f} m/s there"
        )
    _require_time(task, high, fastest)
    return fastest


def _require_time(task: SpeedTask, high: FloatArray, fastest: FloatArray) -> None:
    road = task.road
    if math.isfinite(task.time_max):
        shortest = float(durations(fastest, road).sum())
        if shortest > task.time_max * (1.0 + 1e-9):
            lawful = float(durations(np.sqrt(high), road).sum())
            cause = f"even at the speed limits the road takes {lawful:.1f} s"
            if lawful <= task.time_max:
                cause = f"at full power within the limits the road takes {shortest:.1f} s"
            raise PlanningError(f"trip time {task.time_max:.1f} s is too short: {cause}")
    if not task.behind:
        return
    slow = passing_times(_slowest(task), road)[1:]
    early = np.flatnonzero(slow < task.earliest[1:] - 1e-6)
    if early.size:
        k = int(early[0])
        raise PlanningError(
            f"the vehicle ahead leaves station {road.station[k + 1]:.0f} m at "
            f"{task.earliest[k + 1]:.1f} s; even with full brakes the truck is there at "
            f"{slow[k]:.1f} s"
        )
    if math.isfinite(task.time_max) and task.earliest.max() > task.time_max:
        raise PlanningError(
            f"trip time {task.time_max:.1f} s is too short: the vehicle ahead is in the way until "
            f"{task.earliest.max():.1f} s"
        )


def _slowest(task: SpeedTask) -> FloatArray:
    """Returns the least node speeds (n + 1,) of any drive: full brakes to the least speeds."""
    vehicle, road = task.vehicle, task.road
    twice = 2.0 * road.step / vehicle.inertial_mass
    half = 0.5 * vehicle.drag * twice
    drag = twice * vehicle.power_drag * vehicle.efficiency * 2.0
    fall = (twice * (vehicle.brake_max + vehicle.slope_force(road.grade))).tolist()
    v = math.sqrt(task.b_low[0])
    speeds = [v]
    for k, least in enumerate(np.sqrt(task.b_low[1:]).tolist()):
        end = least
        # The engine's drag decreases with the end speed, so the iteration converges from below.
        for _ in range(4):
            b = (v * v * (1.0 - half) - fall[k] - drag / (v + end)) / (1.0 + half)
            end = max(least, math.sqrt(max(b, 0.0)))
        v = end
        speeds.append(v)
    return np.array(speeds)
