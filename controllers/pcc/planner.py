"""Offline plan: the fuel-optimal speed over a whole road, against a cruise at a set speed.

There are two cruises. The rolling one is a fleet's alternative: as in trucks of the last 15 years,
it may roll up to the top of the plan's band on descents. The braking one is the paper's: it brakes
at the set speed, so that a plan saves two to three times as much against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.pcc.fuel import FuelMap
from controllers.pcc.profile import RoadProfile
from controllers.pcc.solver import solve
from controllers.pcc.task import Solution, SpeedTask
from controllers.pcc.vehicle import (
    PointMass,
    brakeable,
    cruise,
    durations,
    full_power_speed,
    passing_times,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range, require_positive
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import payload_of, rolling_resistance, wheel_mass


@dataclass(frozen=True)
class PccConfig:
    """Set speed, band and weights of a plan.

    Attributes:
      v_ref: set speed of the cruise [m/s]; 20 m/s is the paper's 72 km/h.
      v_min, v_max: band of the plan [m/s]; slower only where full power does not reach v_min. A
        heavy truck's speed limiter acts at 25 m/s (directive 92/6/EEC); the road's limits also
        apply.
      mean_speed: True finds the set speed for which the *mean* of the cruise is v_ref.
      k_a: the paper's weight of a^2, for a fuel rate in g/s: [g/s per (m/s2)^2].
      deceleration_max: of planned braking [m/s2].
      rolls: whether the cruise may roll up to v_max downhill; False: it brakes at v_ref, as the
        paper's.
      head_wind: steady wind along the road against the truck, negative from behind [m/s].
    """

    v_ref: float = 20.0
    v_min: float = 12.5
    v_max: float = 25.0
    mean_speed: bool = False
    k_a: float = 0.5
    deceleration_max: float = 1.5
    rolls: bool = True
    head_wind: float = 0.0

    def __post_init__(self) -> None:
        require_positive(self, "v_ref", "v_min", "v_max", "k_a", "deceleration_max", zero=True)
        in_range("head_wind [m/s]", self.head_wind, -20.0, 20.0)
        if not 1.0 <= self.v_min <= self.v_ref <= self.v_max <= 60.0:
            raise InputError(
                f"band {self.v_min:g} to {self.v_max:g} m/s with v_ref {self.v_ref:g} m/s: "
                "use 1 <= v_min <= v_ref <= v_max <= 60"
            )


@dataclass(frozen=True)
class Drive:
    """A drive over a profile: speed and clock at the nodes (n + 1,), the rest per interval (n,).

    Attributes:
      speed: [m/s]; power: of the engine [W]; fuel: by the convex model [kg].
      map_fuel: by the engine's map with the best gear and overrun cut-off [kg]; gear: from 1.
      clock: time since the start at the nodes, shape (n + 1,) [s].
    """

    speed: FloatArray
    power: FloatArray
    fuel: FloatArray
    map_fuel: FloatArray
    gear: NDArray[np.int64]
    clock: FloatArray

    @property
    def time(self) -> float:
        """Duration of the whole drive [s]."""
        return float(self.clock[-1])


@dataclass(frozen=True)
class PccComparison:
    """Plan and cruise over the same road, in equal time, to the same end speed.

    Attributes:
      task, optimum: the problem and its solution.
      plan, baseline: both drives; v_set: set speed of the cruise [m/s].
    """

    task: SpeedTask
    optimum: Solution
    plan: Drive
    baseline: Drive
    v_set: float

    @property
    def road(self) -> RoadProfile:
        """The road."""
        return self.task.road

    @property
    def time_price(self) -> float:
        """Cost of a second of trip time at the optimum [kg/s]."""
        return self.optimum.time_price

    @property
    def fuel(self) -> float:
        """Fuel of the plan by the optimizer's model [kg]."""
        return float(self.plan.fuel.sum())

    @property
    def baseline_fuel(self) -> float:
        """Fuel of the cruise by the optimizer's model [kg]."""
        return float(self.baseline.fuel.sum())

    @property
    def saving_percent(self) -> float:
        """Saving by the optimizer's model [%]."""
        return 100.0 * (1.0 - self.fuel / self.baseline_fuel)

    @property
    def map_saving_percent(self) -> float:
        """Saving by the engine's map with gears and overrun cut-off [%]."""
        return 100.0 * (1.0 - float(self.plan.map_fuel.sum()) / float(self.baseline.map_fuel.sum()))


def plan(
    road: RoadProfile,
    parameters: TruckParameters | None = None,
    mass: float = 55_000.0,
    config: PccConfig | None = None,
    method: str = "interior_point",
) -> PccComparison:
    """Plans the whole road and compares the plan with the cruise of the settings.

    Both start and end at the cruise's speeds; the plan takes no longer than the cruise.

    Args:
      road: driven from end to end.
      parameters: of the truck; default: the packaged ones.
      mass: of the combination [kg].
      config: set speed, band and weights.
      method: of `controllers.pcc.solver.solve`.

    Raises:
      InputError: the mass is not that of a truck, or the method is not known.
      PlanningError: full power is not enough for a climb, limits contradict, or there is no
        solution.
    """
    config = config or PccConfig()
    parameters = parameters or TruckParameters.load()
    fuel_map = FuelMap(parameters)
    vehicle = make_vehicle(parameters, fuel_map, mass, config)
    v_set, base = _cruise(vehicle, road, config)
    cap = np.minimum(road.v_limit, max(config.v_max, v_set))
    low = _least_speeds(full_power_speed(vehicle, road, float(base[0]), cap), base, config.v_min)
    # Where full power does not reach the band, the plan is free up to the greatest speed.
    b_low, b_high = low**2, np.maximum(cap, low) ** 2
    b_low[[0, -1]] = b_high[[0, -1]] = base[[0, -1]] ** 2
    total = float(durations(base, road).sum())
    task = SpeedTask(vehicle, road, b_low, b_high, total, k_a=1e-3 * config.k_a)
    optimum = solve(task, base, method)
    drive, baseline = (evaluate(vehicle, fuel_map, road, v) for v in (optimum.speed, base))
    return PccComparison(task, optimum, drive, baseline, v_set)


def make_vehicle(
    parameters: TruckParameters, fuel_map: FuelMap, mass: float, config: PccConfig
) -> PointMass:
    """Returns the truck of a mass [kg] as a point mass for the band of a plan.

    Raises:
      InputError: the mass is not that of a truck.
      PlanningError: no gear covers some speed of the band.
    """
    most = max(80_000.0, 1.5 * parameters.gross_mass(parameters.payload_max))
    in_range("mass [kg]", mass, 5_000.0, most)
    air = parameters.aerodynamics
    turning = wheel_mass(parameters)
    turning += parameters.engine.inertia * float(fuel_map.gear_speed[-1]) ** 2
    band = np.linspace(config.v_min, config.v_max, 60)
    powers = fuel_map.power_max(band)
    if powers.min() <= 0.0:
        v = float(band[int(powers.argmin())])
        raise PlanningError(f"no gear runs at {v:.1f} m/s: change v_min or v_max of the band")
    fuel = fuel_map.fit(config.v_min, config.v_max)
    rolling = 0.5 * (config.v_ref + config.v_max)
    # The air drag k (v + w)^2 with its term 2 k w v as a straight line in v^2 through v_ref.
    drag, wind = 0.5 * air.density * air.mean_drag_area(), config.head_wind
    blown = drag * wind * (config.v_ref + wind) / (mass * GRAVITY)
    return PointMass(
        mass=mass,
        inertial_mass=mass + turning,
        rolling=rolling_resistance(parameters, payload_of(parameters, mass)) + blown,
        drag=drag * (1.0 + wind / config.v_ref),
        efficiency=fuel_map.efficiency,
        power_max=fuel_map.full_power(),
        power_drag=fuel.overrun_power,
        power_overrun=rolling * float(fuel_map.overrun_force(np.array([rolling]))[0]),
        brake_max=mass * config.deceleration_max,
        fuel=fuel,
    )


def lower_speeds(fastest: FloatArray, v_min: float) -> FloatArray:
    """Returns least speeds: v_min where it can be reached, else 0.999 times the fastest possible.

    This leaves more than one drive, and the least speeds are continuous along the road.
    """
    return np.asarray(np.minimum(v_min, 0.999 * fastest))


def _least_speeds(fastest: FloatArray, cruise: FloatArray, v_min: float) -> FloatArray:
    """Returns least speeds of a plan that ends at the cruise's speed, even if below v_min."""
    low = lower_speeds(fastest, v_min)
    in_band = np.flatnonzero(cruise >= v_min)
    last = int(in_band[-1]) + 1 if in_band.size else 0
    low[last:] = np.minimum(low[last:], cruise[last:])
    return low


def evaluate(vehicle: PointMass, fuel_map: FuelMap, road: RoadProfile, speed: FloatArray) -> Drive:
    """Returns the drive of node speeds (n + 1,): power, fuel by both models, gears."""
    time = durations(speed, road)
    mean = 0.5 * (speed[1:] + speed[:-1])
    rate, gear = fuel_map.rate(vehicle.net_force(speed, road), mean)
    return Drive(
        speed,
        vehicle.power(speed, road),
        vehicle.fuel_of(speed, road),
        rate * time,
        gear,
        passing_times(speed, road),
    )


def _cruise(vehicle: PointMass, road: RoadProfile, config: PccConfig) -> tuple[float, FloatArray]:
    """Returns set speed and node speeds of the cruise, which starts at its set speed."""
    # The greatest first speed from which the limits ahead can be met.
    b = brakeable(vehicle, road, np.minimum(road.v_limit, 1e3) ** 2, vehicle.brake_max)
    start = math.sqrt(float(b[0]))

    top = config.v_max if config.rolls else None

    def drive(v_set: float) -> FloatArray:
        return cruise(vehicle, road, v_set, min(v_set, start), top=top)

    speed = drive(config.v_ref)
    if not config.mean_speed:
        return config.v_ref, speed
    wanted = road.length / config.v_ref

    def late(v_set: float) -> float:
        return float(durations(drive(v_set), road).sum()) - wanted

    high = config.v_max
    if late(high) > 0.0:
        raise PlanningError(
            f"a mean of {config.v_ref:.2f} m/s is out of reach: the cruise at {high:.2f} m/s "
            f"averages {road.length / (wanted + late(high)):.2f} m/s on this road; lower v_ref or "
            "use the set speed"
        )
    low = config.v_ref
    if late(low) <= 0.0:
        # A cruise that rolls downhill may be faster than its set speed on the whole.
        low, high = config.v_min, config.v_ref
        if not config.rolls or late(low) <= 0.0:
            return high, speed
    v_set = _root(late, low, high)
    return v_set, drive(v_set)


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """Returns a zero of a decreasing function from above, between bounds (Illinois method)."""
    above, below = function(low), function(high)
    for _ in range(100):
        if high - low < 1e-10:
            break
        middle = low + (high - low) * above / (above - below)
        middle = min(max(middle, low + 1e-3 * (high - low)), high - 1e-3 * (high - low))
        value = function(middle)
        if value > 0.0:
            low, above, below = middle, value, 0.5 * below
        else:
            high, below, above = middle, value, 0.5 * above
        if -1e-9 < value <= 0.0:
            break
    return high
