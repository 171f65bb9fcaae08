"""The schedule of a trip: clock, price of a second and worth of speed over station.

One optimization of the whole road gives all three. A short horizon needs them in place of the road
beyond its end: with them its plan is a part of the plan over the whole road (Bellman's principle,
to first order in the speed at the horizon's end). A lag behind the clock raises the price.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from controllers.pcc.leader_constraint import braking_speeds
from controllers.pcc.planner import PccConfig, lower_speeds
from controllers.pcc.profile import RoadProfile
from controllers.pcc.solver import solve
from controllers.pcc.task import Solution, SpeedTask
from controllers.pcc.vehicle import PointMass, cruise, durations, full_power_speed, passing_times
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError

# Factor on the least trip time: closer to it the cost of a second grows without bound [1].
_TIGHT = 1.01
# Greatest share of its wanted time by which a trip may end too early [1].
_EARLY = 1e-3
# Least price of a second over the idle fuel rate: at -1 a standstill would cost nothing [1].
_LEAST_PRICE = -0.9
_HALVINGS = 12
# Least and greatest mean speed after a lag, over that of the schedule [1].
_FASTER = (0.75, 1.35)
_GREATEST = kernels.function(
    "iits_greatest",
    kernels.Real,
    *(kernels.Integer, kernels.Address, kernels.Real, kernels.Real, kernels.Integer),
)


@dataclass(frozen=True)
class Schedule:
    """A planned trip over the nodes of its road; arrays of shape (n + 1,).

    Attributes:
      station: [m]; speed: [m/s]; clock: absolute time of passing [s].
      worth: fuel that v^2 saves later [kg/(m2/s2)].
      price: of a second [kg/s]; negative if the truck has to slow down for its appointment.
      late: time by which the wanted arrival is out of reach, else 0 [s].
      top: greatest speed of a truck that would be early otherwise [m/s].
    """

    station: FloatArray
    speed: FloatArray
    clock: FloatArray
    worth: FloatArray
    price: float
    late: float = 0.0
    top: float = math.inf

    @cached_property
    def end(self) -> float:
        """Last station [m]."""
        return float(self.station[-1])

    @cached_property
    def _begin(self) -> float:
        """Station a step before the first [m]."""
        return float(self.station[0] - (self.station[1] - self.station[0]))

    @cached_property
    def _table(self) -> tuple[FloatArray, int]:
        """Stations [m] and v^2 [m2/s2] of the nodes, shape (2, n + 1), and their address."""
        table = np.array([self.station, self.speed**2])
        return table, kernels.address(table)

    def __getstate__(self) -> dict[str, Any]:
        """Returns the attributes only: the table of a copy has another address."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def covers(self, station: float) -> bool:
        """Returns whether a station [m] is on the schedule or within a step before its start."""
        return self._begin <= station <= self.end

    def due(self, station: float) -> float:
        """Returns the planned time of passing a station [s]; v^2 is linear between nodes."""
        k = min(max(int(self.station.searchsorted(station)) - 1, 0), self.station.size - 2)
        sums = float(self.speed[k]) + self.fastest(station)
        return float(self.clock[k]) + 2.0 * (station - float(self.station[k])) / sums

    def speed_at(self, station: float | FloatArray) -> FloatArray:
        """Returns the planned speed [m/s]."""
        return np.asarray(np.sqrt(np.interp(station, self.station, self.speed**2)))

    def fastest(self, station: float, spacing: float = 0.0, count: int = 1) -> float:
        """Returns the greatest planned speed at stations with a spacing [m/s]."""
        greatest = _GREATEST(self.station.size, self._table[1], station, spacing, count)
        return math.sqrt(greatest)

    def worth_at(self, station: float) -> float:
        """Returns the worth of v^2 [kg/(m2/s2)]."""
        return float(np.interp(station, self.station, self.worth))

    def lag(self, station: float, time: float) -> float:
        """Returns the seconds behind the clock, negative when early."""
        return time - self.due(station)

    def price_at(self, vehicle: PointMass, station: float, time: float) -> float:
        """Returns the price of a second for a truck at a station and time [kg/s].

        The rest of the trip must be faster by the share of its time that was lost; the price
        changes by as much as on a level road between these two mean speeds.
        """
        planned = max(float(self.clock[-1]) - self.due(station), 1e-3)
        left = max(float(self.clock[-1]) - self.late - time, 1e-3)
        mean = (self.end - station) / planned
        slowest, fastest = _FASTER
        faster = mean * min(max(planned / left, slowest), fastest)
        change = level_price(vehicle, faster) - level_price(vehicle, mean)
        return max(self.price + change, least_price(vehicle))


def least_price(vehicle: PointMass) -> float:
    """Returns the least price of a second for which the problem is convex [kg/s]."""
    return _LEAST_PRICE * vehicle.fuel.f0


def level_price(vehicle: PointMass, speed: float) -> float:
    """Returns the price of a second that makes a speed optimal on the level [kg/s].

    It is negative for a very low speed.

    The cost of a meter is `f0/v + f1 R/eta + f2 R^2 v/eta^2 + price/v` with R = m g c + k v^2; its
    derivative by v is zero at the best speed.
    """
    fuel, eta, k = vehicle.fuel, vehicle.efficiency, vehicle.drag
    resistance = vehicle.level_force + k * speed**2
    slope = fuel.f1 * 2.0 * k * speed / eta
    slope += fuel.f2 * (resistance**2 + 4.0 * k * speed**2 * resistance) / eta**2
    return slope * speed**2 - fuel.f0


def level_worth(vehicle: PointMass, speed: float) -> float:
    """Returns the worth of v^2 on the level [kg/(m2/s2)]: the fuel that more force costs.

    From the optimality condition on the engine's force: `f1/eta + 2 f2 R v/eta^2` per joule.
    """
    resistance = vehicle.level_force + vehicle.drag * speed**2
    joule = vehicle.fuel.f1 / vehicle.efficiency
    joule += 2.0 * vehicle.fuel.f2 * resistance * speed / vehicle.efficiency**2
    return 0.5 * vehicle.inertial_mass * joule


@dataclass(frozen=True)
class Bounds:
    """Least and greatest v^2 of a plan and the speed of the fastest drive, each (n + 1,)."""

    low: FloatArray
    high: FloatArray
    fastest: FloatArray


def bounds_of(vehicle: PointMass, road: RoadProfile, speed: float, config: PccConfig) -> Bounds:
    """Returns the bounds of a plan from a speed [m/s]; above the limits the truck brakes.

    Raises:
      PlanningError: full power is not enough for a climb.
    """
    cap = np.minimum(road.v_limit, config.v_max)
    if speed > cap.min():
        cap = np.maximum(cap, braking_speeds(vehicle, road, speed))
    fastest = full_power_speed(vehicle, road, speed, cap)
    low = np.minimum(lower_speeds(fastest, config.v_min), cap)
    b_low, b_high = low**2, cap**2
    b_low[0] = b_high[0] = speed**2
    return Bounds(b_low, b_high, fastest)


def make_schedule(
    vehicle: PointMass,
    road: RoadProfile,
    config: PccConfig,
    speed: float,
    time: float,
    arrival: float | None = None,
    slack: float = 0.0,
    end_speed: float | None = None,
) -> Schedule:
    """Plans a trip over a whole road.

    Args:
      vehicle: the truck.
      road: from the truck to its destination.
      config: set speed and band.
      speed: now [m/s].
      time: now [s].
      arrival: wanted time at the road's end, met exactly if the band allows it [s]; default: that
        of a cruise at v_ref, or earlier if that saves fuel.
      slack: of the cruise's time, without `arrival` [1].
      end_speed: wanted at the end [m/s]; default: free, with the worth of v^2 on the level.

    Raises:
      PlanningError: full power is not enough for a climb, or the optimization fails.
    """
    slowest = braking_speeds(vehicle, road, speed)
    held = cruise(vehicle, road, config.v_ref, speed, slowest)
    wanted = float(durations(held, road).sum()) * (1.0 + slack)
    if arrival is not None:
        wanted = arrival - time
    late = 0.0

    def planned(price: float | None, top: float) -> tuple[Solution, float]:
        """Returns plan and time for a price of time (None: wanted time) and a top speed."""
        nonlocal late
        bounds = bounds_of(vehicle, road.below(top), speed, config)
        b_low, b_high = bounds.low, bounds.high
        if end_speed is not None:
            b_low[-1] = b_high[-1] = min(end_speed**2, float(bounds.fastest[-1]) ** 2)
        limit = math.inf
        if price is None:
            least = float(durations(bounds.fastest, road).sum()) * _TIGHT
            limit, late = max(wanted, least), max(least - wanted, 0.0)
        task = SpeedTask(
            vehicle,
            road,
            b_low,
            b_high,
            limit,
            k_a=1e-3 * config.k_a,
            price_time=price or 0.0,
            price_energy=level_worth(vehicle, config.v_ref) if end_speed is None else 0.0,
        )
        guess = np.clip(held, np.sqrt(b_low), np.sqrt(b_high))
        found = solve(task, guess, time_limit=math.inf)
        if not np.isfinite(found.speed).all():
            raise PlanningError("the schedule's optimization gave speeds that are not finite")
        return found, float(durations(found.speed, road).sum())

    found, took = planned(None, math.inf)
    price, top = found.time_price, math.inf
    if arrival is not None and took < wanted * (1.0 - _EARLY):
        found, price, top = _held_back(planned, wanted, least_price(vehicle), config)
    clock = time + passing_times(found.speed, road)
    return Schedule(road.station, found.speed, clock, found.costate, price, late, top)


def _held_back(
    planned: Callable[[float, float], tuple[Solution, float]],
    wanted: float,
    least: float,
    config: PccConfig,
) -> tuple[Solution, float, float]:
    """Returns a plan slower than the cheapest, for the wanted time [s], with its price and top.

    A negative price of a second slows the truck down. The cost of a meter is `(f0 + price) / v`
    plus the engine's work: convex while `f0 + price` is positive. If the least price is not enough,
    as where the truck rolls fast downhill, a top speed is.
    """
    found, took = planned(least, math.inf)
    by_top = took < wanted
    low, high = (config.v_min, config.v_max) if by_top else (least, 0.0)
    price, top = least, math.inf
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        price, top = (least, middle) if by_top else (middle, math.inf)
        found, took = planned(price, top)
        if abs(took - wanted) <= _EARLY * wanted:
            break
        # A higher price and a higher top speed both make the plan faster.
        low, high = (low, middle) if took < wanted else (middle, high)
    return found, price, top
