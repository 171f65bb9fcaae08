"""Speed, gear and coasting planned together, on the engine's own map.

The convex plan (`controllers.pcc.problem`) knows one power and one fuel curve for all gears. Here
each interval of the road has a gear, or neutral with the engine idling, and its fuel is that of the
map at the mean speed. States of the dynamic program are v^2 at the nodes and the gear in use:

    V[k](b, g) = min over gear h and b' of  change(g, h) + cost[k](b, b', h) + V[k+1](b', h)
    cost       = (rate(h, F, v) + price + k_a a^2) d,   d = 2 ds / (v + v'),  v the mean speed

with F, the wheel force, linear in b and b'. In gear h it lies between overrun and full load of that
gear; below overrun the brakes take the rest and no fuel burns. In neutral the force is the drag of
the open driveline, which is about zero. A change of gear costs the price of the time without
traction and the fuel of an idling engine. For a plan that a truck drives it also costs speed: b' is
at most that of full load, less the work of full pull during `lost_time`. V is kept at states
between the bounds of b at each node and is linear between them; b' is sought among states, full
load and overrun. The price of a second makes the trip time. All this runs in
`iits_mj/kernels/speed_gears.cc`.

Lower bound
-----------
With `lower_bound` no plan of this task burns less, whatever its gears and however often it changes
them. Let W be the interpolated values with free changes of gear, and `slack[k]` at least

    max over b of  W[k](b) - min over h and b' of (cost[k](b, b', h) + W[k+1](b'))

Along any drive, W[0](b0) <= sum of cost + sum of slack: add the inequality of every interval, W
cancels. So W[0](b0) - sum slack bounds fuel + price * time from below, and less price * T the fuel
of every drive that takes T at most (weak duality: the price is not negative). The best price gives
the best bound. Speeds from which full load does not meet the band ahead belong to no drive and are
left out: the values rise steeply there. The slack is the greatest of some places between any two
states; it comes from the curvature of V between them and falls with their distance squared.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controllers.pcc.fuel import FuelMap
from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, brakeable, durations
from iits_mj import kernels
from iits_mj.analytic.wheel_force import input_torque, wheel_force
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range
from iits_mj.core.errors import PlanningError
from iits_mj.core.messages import requests_of
from iits_mj.parameters import TruckParameters

NEUTRAL = 0
_SPEEDS, _LOADS = 60, 65  # of the tables
_SHORT_PRICE = 0.05  # of v^2 below the least one: some thirty times its worth [kg/(m2/s2)]
_HALVINGS = 30  # for the price of a second
_TIME = 2e-4  # relative shortfall of the trip time that ends the search
_ITERATIONS = 6  # for the force at the mean speed of an interval
_ROUNDING = 1e-5  # of v^2 below the slowest drive that is fast enough
_MARGIN = 2e-3  # of v^2 above the fastest drive
# Shares of v^2 by which the bound's drives may be slower where full power does not reach the band:
# there all drives are near the least speeds, and the values must not rise steeply.
_SLOWER = (0.1, 0.2)
_DEAREST = 0.2  # [kg/s], a price of a second at which every plan is the fastest one
_VALUES = kernels.function("iits_joint_values", None, *3 * [kernels.Address])
_BOUND = kernels.function(
    "iits_joint_bound", None, *2 * [kernels.Address], kernels.Integer, kernels.Address
)
_DRIVE = kernels.function(
    "iits_joint_drive",
    None,
    *3 * [kernels.Address],
    kernels.Integer,
    *2 * [kernels.Address],
)


@dataclass(frozen=True)
class GearTables:
    """Forces and fuel of the gears over vehicle speed, for the kernel.

    Attributes:
      gears: their numbers, from 1; the last is NEUTRAL if the plan may use it.
      speed: of the table, evenly spaced, shape (speeds,) [m/s].
      overrun, full: wheel force in overrun and at full load, (gears, speeds) [N]; NaN where the
        gear does not run.
      rate: fuel over speed and load, from 0 in overrun to 1 at full load, (gears, speeds, loads)
        [kg/s].
      idle_rate: fuel of the idling engine with its auxiliaries [kg/s].
      change_time: without traction in a change of gear [s].
      lost_time: a change of gear costs as much as full pull during this time [s], or 0.
    """

    gears: tuple[int, ...]
    speed: FloatArray
    overrun: FloatArray
    full: FloatArray
    rate: FloatArray
    idle_rate: float
    change_time: float
    lost_time: float = 0.0

    @classmethod
    def of(
        cls,
        parameters: TruckParameters,
        v_min: float,
        v_max: float,
        *,
        power_share: float = 1.0,
        neutral: bool = True,
        slows: bool = False,
    ) -> GearTables:
        """Returns the tables of a truck for speeds in a band [m/s].

        Args:
          parameters: of the truck.
          v_min: least speed.
          v_max: greatest speed.
          power_share: share of the full-load torque that plans use.
          neutral: whether plans may roll in neutral.
          slows: whether a change of gear at full load costs speed, as on the truck.

        Raises:
          PlanningError: no gear runs at some speed of the band.
        """
        fuel_map, engine = FuelMap(parameters), parameters.engine
        speed = np.linspace(max(v_min, 1.0), v_max, _SPEEDS)
        load = np.linspace(0.0, 1.0, _LOADS)
        rows: list[tuple[int, FloatArray, FloatArray, FloatArray]] = []
        for number, turns in enumerate(fuel_map.gear_speed, start=1):
            omega = turns * speed
            runs = fuel_map.runs(omega)
            if not runs.any():
                continue
            auxiliary = engine.auxiliary_torque(omega)
            most = power_share * engine.full_pedal_torque(omega)
            drag = np.interp(omega, engine.drag_speed, engine.drag_torque)
            overrun = wheel_force(parameters, number, -drag - auxiliary, omega)
            full = wheel_force(parameters, number, most - auxiliary, omega)
            force = overrun[:, None] + (full - overrun)[:, None] * load
            torque = np.stack(
                [input_torque(parameters, number, force[:, i], omega) for i in range(load.size)], 1
            )
            torque = torque + auxiliary[:, None]
            rate = fuel_map.engine_rate(
                np.clip(torque, -drag[:, None], most[:, None]), np.repeat(omega[:, None], _LOADS, 1)
            )
            rate[:, 0] = 0.0
            rows.append(
                (number, np.where(runs, overrun, np.nan), np.where(runs, full, np.nan), rate)
            )
        if not rows or np.isnan([row[1] for row in rows]).all(axis=0).any():
            raise PlanningError(f"no gear runs at every speed from {v_min:.1f} to {v_max:.1f} m/s")
        idle = np.array([engine.idle_speed])
        idle_rate = float(fuel_map.engine_rate(engine.auxiliary_torque(idle), idle)[0])
        if neutral:
            open_force = neutral_force(parameters, speed)
            rows.append((NEUTRAL, open_force, open_force, np.zeros((speed.size, _LOADS))))
        box = parameters.gearbox
        pause = box.shift_cut_time + box.synchronization_time + box.clutch_close_time
        return cls(
            tuple(row[0] for row in rows),
            speed,
            np.array([row[1] for row in rows]),
            np.array([row[2] for row in rows]),
            np.array([row[3] for row in rows]),
            idle_rate,
            pause,
            engine.lost_pull(pause) if slows else 0.0,
        )


def neutral_force(parameters: TruckParameters, speed: FloatArray) -> FloatArray:
    """Returns the wheel force in neutral, zero or less [N]: drag of final drive and retarder."""
    gearbox = parameters.gearbox
    radius = parameters.tires[parameters.driven_axles[0].tire].rolling_radius
    shaft = speed / radius * gearbox.final_drive
    torque = gearbox.final_drive_loss.after(-parameters.retarder.empty_drag(shaft), shaft)
    return np.asarray(np.minimum(torque, 0.0) * gearbox.final_drive / radius)


@dataclass(frozen=True)
class JointTask:
    """Speed and gear over a road at a price of a second.

    Attributes:
      vehicle: the truck; road: n intervals; tables: its gears.
      b_low, b_high: bounds of v^2 at the nodes, (n + 1,) [m2/s2], equal where v is fixed.
      price: of a second in each interval, (n,), or one for all [kg/s].
      k_a: weight of a^2 [kg/s per (m/s2)^2].
      states: of v^2 at each node.
      worth: of the last v^2 [kg/(m2/s2)].
    """

    vehicle: PointMass
    road: RoadProfile
    tables: GearTables
    b_low: FloatArray
    b_high: FloatArray
    price: FloatArray | float = 0.0
    k_a: float = 0.0
    states: int = 100
    worth: float = 0.0

    def __post_init__(self) -> None:
        in_range("joint plan: states", self.states, 2, 5_000)
        nodes = self.road.station.size
        for name in ("b_low", "b_high"):
            array = getattr(self, name)
            if array.shape != (nodes,) or not np.isfinite(array).all():
                raise PlanningError(f"joint plan: {name} must hold {nodes} finite numbers")
        if self.b_low.min() <= 0.0 or (self.b_low > self.b_high).any():
            raise PlanningError("joint plan: use 0 < b_low <= b_high at every node")
        if not (np.isfinite(self.price).all() and np.min(self.price) >= 0.0):
            raise PlanningError(f"joint plan: price {self.price!r} kg/s: use 0 or more")

    def at_price(self, price: float) -> JointTask:
        """Returns the task with one price of a second [kg/s]."""
        return replace(self, price=price)


@dataclass(frozen=True)
class JointPlan:
    """A plan of speed and gear.

    Attributes:
      speed: at the nodes, (n + 1,) [m/s]; gear: of the intervals, (n,), NEUTRAL for none.
      fuel: of the intervals by the engine's map, (n,) [kg]; price: of a second [kg/s].
      time: of the trip [s].
    """

    speed: FloatArray
    gear: NDArray[np.int64]
    fuel: FloatArray
    price: float
    time: float

    @property
    def transmission_mode(self) -> NDArray[np.int64]:
        """Request to the gearbox in each interval, (n,), see `TransmissionMode`."""
        return requests_of(self.gear)

    @property
    def changes(self) -> int:
        """Number of changes of gear, neutral included."""
        return int(np.count_nonzero(np.diff(self.gear)))


def _full_load(task: JointTask) -> tuple[Callable[[int, float, float], float], float]:
    """Returns v^2 that full load and grade add in an interval k from b to c, and the drag's share.

    Along a drive, `c (1 + drag) = b (1 - drag) + gain(k, b, c)`. The force is that of the strongest
    gear at the mean speed, as in the kernel.
    """
    vehicle, tables = task.vehicle, task.tables
    strongest = np.nanmax(tables.full, axis=0)
    lever = 2.0 * task.road.step / vehicle.inertial_mass
    slopes = vehicle.slope_force(task.road.grade).tolist()

    def gain(k: int, b: float, c: float) -> float:
        mean = 0.5 * (np.sqrt(b) + np.sqrt(c))
        return float(lever * (np.interp(mean, tables.speed, strongest) - slopes[k]))

    return gain, 0.5 * lever * vehicle.drag


def fastest_in_gears(task: JointTask) -> FloatArray:
    """Returns v^2 at the nodes of the fastest drive within the task's bounds, (n + 1,) [m2/s2].

    It has full load in the strongest gear of every speed; brakes are taken as strong enough.
    """
    gain, drag = _full_load(task)
    b = np.empty(task.road.station.size)
    b[0] = task.b_high[0]
    for k in range(task.road.intervals):
        end = b[k]
        for _ in range(_ITERATIONS):
            end = max((b[k] * (1.0 - drag) + gain(k, b[k], end)) / (1.0 + drag), 1.0)
        b[k + 1] = min(end, task.b_high[k + 1])
    return b


def tightened(task: JointTask) -> JointTask:
    """Returns the task without the speeds of no drive: its states lie closer together.

    These are the speeds above the fastest drive, and those from which engine and brakes do not meet
    the bounds ahead.
    """
    force = task.vehicle.brake_max - float(np.nanmin(task.tables.overrun))
    held = (1.0 + _MARGIN) * brakeable(task.vehicle, task.road, task.b_high, force)
    reached = (1.0 + _MARGIN) * fastest_in_gears(task)
    high = np.minimum(task.b_high, np.maximum(task.b_low, np.minimum(held, reached)))
    return replace(task, b_high=high)


def _fast_enough(task: JointTask) -> FloatArray:
    """Returns the least v^2 at the nodes from which full load meets the bounds ahead [m2/s2]."""
    gain, drag = _full_load(task)
    b = task.b_low.copy()
    for k in range(task.road.intervals - 1, -1, -1):
        # From below, so that too few iterations leave out no drive.
        start = b[k]
        for _ in range(_ITERATIONS):
            start = max((b[k + 1] * (1.0 + drag) - gain(k, start, b[k + 1])) / (1.0 - drag), 1.0)
        b[k] = max(b[k], (1.0 - _ROUNDING) * start)
    return np.minimum(b, task.b_high)


class _Packed:
    """The numbers of a task for the kernel, alive as long as their addresses are used."""

    def __init__(self, task: JointTask) -> None:
        vehicle, road, tables = task.vehicle, task.road, task.tables
        n = road.intervals
        self.setup = np.array(
            [
                *(n, road.step, vehicle.inertial_mass, 0.5 * vehicle.drag, vehicle.brake_max),
                *(task.k_a, task.states, len(tables.gears), float(tables.gears[-1] == NEUTRAL)),
                *(tables.speed.size, tables.speed[0], tables.speed[1] - tables.speed[0], _LOADS),
                *(tables.change_time, tables.idle_rate, _SHORT_PRICE, tables.lost_time),
            ],
            dtype=float,
        )
        arrays = (
            vehicle.slope_force(road.grade),
            np.broadcast_to(np.asarray(task.price, dtype=float), n),
            *(task.b_low, task.b_high, tables.overrun, tables.full, tables.rate),
        )
        self._arrays = [np.array(array, dtype=float, order="C") for array in arrays]
        addresses = [kernels.address(array) for array in self._arrays]
        self._pointers = (ctypes.c_void_p * len(addresses))(*addresses)
        self.addresses = kernels.address(self.setup), ctypes.addressof(self._pointers)


def joint_values(task: JointTask, last: FloatArray | None = None) -> FloatArray:
    """Returns the least cost to go, (n + 1, gears, states) [kg], of node, gear in use and state.

    `last` has the values after the end, (gears, states) at the last node's states; default: the
    worth of v^2.
    """
    gears, states = len(task.tables.gears), task.states
    values = np.zeros((task.road.station.size, gears, states))
    if last is None:
        b = np.linspace(task.b_low[-1], task.b_high[-1], states)
        last = np.broadcast_to(-task.worth * b, (gears, states))
    values[-1] = last
    packed = _Packed(task)
    _VALUES(*packed.addresses, kernels.address(values))
    return values


def joint_drive(task: JointTask, values: FloatArray, gear: int | None = None) -> JointPlan:
    """Returns the plan along the values, from the least v^2 of the first node on.

    `gear` is the one in use at the start; default: any.
    """
    gears, n = task.tables.gears, task.road.intervals
    b, used = np.empty(n + 1), np.empty(n)
    b[0] = task.b_low[0]
    first = int(values[0, :, 0].argmin()) if gear is None else gears.index(gear)
    packed = _Packed(task)
    _DRIVE(
        *packed.addresses,
        kernels.address(values),
        first,
        kernels.address(b),
        kernels.address(used),
    )
    rows = used.astype(np.int64)
    speed = np.sqrt(b)
    return JointPlan(
        speed,
        np.array(gears, dtype=np.int64)[rows],
        fuel_in_gears(task, speed, rows),
        float(np.mean(task.price)),
        float(durations(speed, task.road).sum()),
    )


def fuel_in_gears(task: JointTask, speed: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """Returns the fuel of the intervals, (n,) [kg], for speeds and rows of the tables."""
    tables, force = task.tables, task.vehicle.net_force(speed, task.road)
    mean, time = 0.5 * (speed[1:] + speed[:-1]), durations(speed, task.road)
    at = np.clip((mean - tables.speed[0]) / (tables.speed[1] - tables.speed[0]), 0.0, _SPEEDS - 1)
    row = np.minimum(at.astype(int), _SPEEDS - 2)
    share = at - row

    def between(table: FloatArray) -> FloatArray:
        low, high = table[rows, row], table[rows, row + 1]
        return low + share.reshape(-1, *[1] * (low.ndim - 1)) * (high - low)

    overrun, full, rate = (between(table) for table in (tables.overrun, tables.full, tables.rate))
    neutral = np.array(tables.gears)[rows] == NEUTRAL
    load = np.clip((force - overrun) / np.where(neutral, 1.0, full - overrun), 0.0, 1.0)
    at_load = load * (_LOADS - 1)
    column = np.minimum(at_load.astype(int), _LOADS - 2)
    every = np.arange(rows.size)
    low, high = rate[every, column], rate[every, column + 1]
    burnt = low + (at_load - column) * (high - low)
    return np.asarray(np.where(neutral, tables.idle_rate, burnt) * time)


def plan_at(task: JointTask) -> JointPlan:
    """Returns the optimal plan at the task's price."""
    return joint_drive(task, joint_values(task))


def plan_in_time(task: JointTask, time_max: float) -> JointPlan:
    """Returns the plan of least price that takes a time at most [s].

    Raises:
      PlanningError: no plan is fast enough.
    """
    low, high, task = 0.0, _DEAREST, tightened(task)
    best = plan_at(task.at_price(low))
    if best.time <= time_max:
        return best
    best = plan_at(task.at_price(high))
    if best.time > time_max:
        raise PlanningError(
            f"trip time {time_max:.1f} s is too short: the fastest plan takes {best.time:.1f} s"
        )
    for _ in range(_HALVINGS):
        # The price lies nearer to zero than to the greatest.
        price = 0.5 * (low + high) if low > 0.0 else 0.2 * high
        found = plan_at(task.at_price(price))
        if found.time > time_max:
            low = price
            continue
        high, best = price, found
        if found.time > time_max * (1.0 - _TIME):
            break
    return best


def gears_at(task: JointTask, speed: FloatArray) -> JointPlan:
    """Returns the best gears for given node speeds (n + 1,), at the task's price."""
    tables = replace(task.tables, lost_time=0.0)
    fixed = replace(task, b_low=speed**2, b_high=speed**2, states=2, tables=tables)
    return joint_drive(fixed, joint_values(fixed))


def lower_bound(task: JointTask, time_max: float, samples: int = 2) -> float:
    """Returns a lower bound on the fuel of every drive within a time [kg]; see the module.

    Args:
      task: its price is that of the bound.
      time_max: greatest trip time [s].
      samples: places between two states at which the bound is checked.
    """
    task = tightened(task)
    out_of_band = task.b_low < task.b_low[1:-1].max() * (1.0 - 1e-9)
    out_of_band[[0, -1]] = False
    bounds = []
    for share in _SLOWER if out_of_band.any() else _SLOWER[:1]:
        slower = replace(task, b_low=np.where(out_of_band, (1.0 - share) * task.b_low, task.b_low))
        slower = replace(slower, b_low=_fast_enough(slower))
        values = np.zeros((slower.road.station.size, slower.states))
        values[-1] = -slower.worth * np.linspace(slower.b_low[-1], slower.b_high[-1], slower.states)
        packed = _Packed(slower)
        _BOUND(*packed.addresses, samples, kernels.address(values))
        bounds.append(float(values[0, 0] - float(np.mean(slower.price)) * time_max))
    return max(bounds)
