"""The truck as a point mass on a road profile, and the cruise at a set speed as baseline."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.pcc.fuel import Willans
from controllers.pcc.profile import RoadProfile
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError
from iits_mj.core.units import GRAVITY

_CRAWL = 2.0  # [m/s]
_BRAKEABLE = kernels.function(
    "iits_brakeable", None, kernels.Integer, kernels.Real, kernels.Address, kernels.Address
)
_FASTEST = kernels.function(
    "iits_fastest", None, kernels.Integer, *4 * [kernels.Real], *2 * [kernels.Address]
)
_ROLLING = kernels.function(
    "iits_rolling", None, kernels.Integer, *5 * [kernels.Real], *3 * [kernels.Address]
)


@dataclass(frozen=True)
class PointMass:
    """Longitudinal model of the truck. SI units.

    Attributes:
      mass: gross; inertial_mass: with the rotating parts; rolling: resistance coefficient, with
        the constant part of a wind's drag.
      drag: 0.5 rho Cd A in calm [kg/m]; efficiency: engine to wheels.
      power_max: of the engine in the best gear at every speed, see `FuelMap.full_power` [W].
      power_drag: of the overrunning engine, where the convex model's fuel is zero [W].
      power_overrun: braking power at the wheels of the overrunning engine in the highest gear, by
        its drag torque, between set speed and top of the band [W].
      brake_max: greatest braking force of a planned drive [N].
      fuel: the convex fuel model.
    """

    mass: float
    inertial_mass: float
    rolling: float
    drag: float
    efficiency: float
    power_max: float
    power_drag: float
    power_overrun: float
    brake_max: float
    fuel: Willans

    def slope_force(self, grade: FloatArray) -> FloatArray:
        """Returns the work of grade and tires per meter of station [N].

        Stations are horizontal and `grade` is dz/ds: the weight does exactly m g dz; the tires,
        with m g cos on a road of ds / cos, exactly m g c ds. Neglecting the cosine of inertia and
        air drag gives an error of 0.1 % on a grade of 5 %.
        """
        return np.asarray(self.mass * GRAVITY * (grade + self.rolling))

    @property
    def level_force(self) -> float:
        """Resistance of the tires on the level [N]."""
        return self.mass * GRAVITY * self.rolling

    def net_force(self, speed: FloatArray, road: RoadProfile) -> FloatArray:
        """Returns drive minus brake force [N] of the intervals, (n,), for node speeds (n + 1,)."""
        b = speed**2
        gain = np.diff(b) * self.inertial_mass / (2.0 * road.step)
        return gain + self.slope_force(road.grade) + 0.5 * self.drag * (b[1:] + b[:-1])

    def power(self, speed: FloatArray, road: RoadProfile) -> FloatArray:
        """Returns the intervals' mean engine power [W], shape (n,); at least overrun power."""
        power = self.net_force(speed, road) * 0.5 * (speed[1:] + speed[:-1]) / self.efficiency
        return np.maximum(power, -self.power_drag)

    def fuel_of(self, speed: FloatArray, road: RoadProfile) -> FloatArray:
        """Returns the fuel of the intervals by the convex model [kg], shape (n,)."""
        return self.fuel.rate(self.power(speed, road)) * durations(speed, road)


def durations(speed: FloatArray, road: RoadProfile) -> FloatArray:
    """Returns the times of the intervals [s], exact for constant force: `2 ds / (v0 + v1)`."""
    return 2.0 * road.step / (speed[1:] + speed[:-1])


def passing_times(speed: FloatArray, road: RoadProfile) -> FloatArray:
    """Returns the time from the first node to each node [s], (n + 1,), as the node speeds."""
    return np.concatenate([[0.0], np.cumsum(durations(speed, road))])


def full_power_speed(
    vehicle: PointMass, road: RoadProfile, v_start: float, cap: FloatArray
) -> FloatArray:
    """Returns the greatest node speeds under a cap, with full power and limited brakes.

    Raises:
      PlanningError: full power is not enough for a climb, or a cap cannot be met.
    """
    b_cap = _held(vehicle, road, v_start, cap)
    b_cap[0] = v_start**2
    speed = fastest_below(vehicle, road, b_cap)
    _require_climbed(vehicle, road, speed, b_cap)
    return speed


def rolling_speed(
    vehicle: PointMass, road: RoadProfile, v_start: float, cap: FloatArray, top: FloatArray
) -> FloatArray:
    """Returns the node speeds of a truck that keeps a cap, but rolls above it without braking.

    Where the overrunning engine does not hold the cap the truck is faster, at most `top`, which the
    brakes hold. The first speed is `v_start`; all arrays have shape (n + 1,) [m/s].

    Raises:
      PlanningError: full power is not enough for a climb, or `top` cannot be met.
    """
    held = np.sqrt(_held(vehicle, road, v_start, top))
    speed = np.minimum(cap, held)
    b_cap = speed**2
    speed[0] = v_start
    slope = vehicle.slope_force(road.grade)
    _ROLLING(
        road.intervals,
        vehicle.inertial_mass,
        road.step,
        0.5 * vehicle.drag,
        vehicle.efficiency * vehicle.power_max,
        vehicle.power_overrun,
        *(kernels.address(array) for array in (slope, held, speed)),
    )
    _require_climbed(vehicle, road, speed, b_cap)
    return speed


def _held(vehicle: PointMass, road: RoadProfile, v_start: float, cap: FloatArray) -> FloatArray:
    """Returns the greatest v^2 (n + 1,) from which the brakes meet a cap ahead [m/s].

    Raises:
      PlanningError: the brakes do not hold the truck on a descent, or its start is too fast.
    """
    b_cap = brakeable(vehicle, road, np.minimum(cap, 1e3) ** 2, vehicle.brake_max)
    if b_cap.min() <= 0.0:
        k = int(np.flatnonzero(b_cap > 0.0)[0]) - 1 if b_cap[0] <= 0.0 else int(b_cap.argmin())
        raise PlanningError(
            f"the brakes ({vehicle.brake_max / 1e3:.0f} kN) do not hold {vehicle.mass:.0f} kg on "
            f"the {-100 * road.grade[k]:.1f} % descent at station {road.station[k]:.0f} m"
        )
    if v_start**2 > b_cap[0] + 1e-6:
        raise PlanningError(
            f"start speed {v_start:.2f} m/s is above the {math.sqrt(max(b_cap[0], 0.0)):.2f} m/s "
            "from which the limits ahead can be met"
        )
    return b_cap


def _require_climbed(
    vehicle: PointMass, road: RoadProfile, speed: FloatArray, b_cap: FloatArray
) -> None:
    """Raises PlanningError if full power does not carry the truck over a climb."""
    # Crawling below a limit is not a lack of power.
    if speed.min() < _CRAWL:
        slow = speed[1:] < np.minimum(_CRAWL, 0.99 * np.sqrt(b_cap[1:]))
        if slow.any():
            k = int(slow.argmax())
            raise PlanningError(
                f"full power ({vehicle.power_max / 1e3:.0f} kW) does not carry {vehicle.mass:.0f} "
                f"kg over the {100 * road.grade[k]:.1f} % at station {road.station[k]:.0f} m"
            )


def brakeable(vehicle: PointMass, road: RoadProfile, cap: FloatArray, force: float) -> FloatArray:
    """Returns the greatest v^2 (n + 1,) under a cap from which the brakes meet all caps ahead."""
    twice = 2.0 * road.step / vehicle.inertial_mass
    half = 0.5 * vehicle.drag * twice
    fall = twice * (force + vehicle.slope_force(road.grade))
    b = np.empty(road.station.size)
    b[:] = cap
    _BRAKEABLE(road.intervals, half, kernels.address(fall), kernels.address(b))
    return b


def fastest_below(vehicle: PointMass, road: RoadProfile, cap: FloatArray) -> FloatArray:
    """Returns the greatest node speeds (n + 1,) that full power reaches under a cap of v^2.

    The drive begins with the cap's first speed; after a stall the speed is 0. The brakes must be
    able to meet the cap.
    """
    speed = np.sqrt(np.maximum(cap, 0.0), out=np.empty(road.station.size))
    slope = vehicle.slope_force(road.grade)
    _FASTEST(
        road.intervals,
        vehicle.inertial_mass,
        road.step,
        0.5 * vehicle.drag,
        vehicle.efficiency * vehicle.power_max,
        kernels.address(slope),
        kernels.address(speed),
    )
    return speed


def cruise(
    vehicle: PointMass,
    road: RoadProfile,
    v_set: float,
    v_start: float,
    slowest: FloatArray | float = 0.0,
    top: float | None = None,
) -> FloatArray:
    """Returns node speeds of a cruise at a set speed: slower on steep climbs.

    It has the plan's engine, brakes and limits and slows down in time for lower limits. A start
    above the limits needs `slowest`, the speeds of braking from there.

    With `top` [m/s] it is the cruise control of today's trucks: on a descent the engine overruns
    and the truck rolls above the set speed; the brakes hold `top`. Without, it is the paper's: the
    brakes hold the set speed.

    Raises:
      PlanningError: full power is not enough for a climb, or a limit cannot be met.
    """
    cap = np.maximum(np.minimum(road.v_limit, v_set), slowest)
    if top is None or top <= v_set:
        return full_power_speed(vehicle, road, v_start, cap)
    lawful = np.maximum(np.minimum(road.v_limit, top), slowest)
    return rolling_speed(vehicle, road, v_start, cap, lawful)
