"""The truck as a point mass on a road profile, and the constant-speed cruise to compare with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.pcc.fuel import FuelMap, Willans
from controllers.pcc.profile import RoadProfile
from iits_mj.errors import PlanningError
from iits_mj.parameters import TruckParameters
from iits_mj.units import GRAVITY

FloatArray = NDArray[np.float64]
_CRAWL = 2.0  # [m/s]


@dataclass(frozen=True)
class PointMass:
    """Longitudinal truck. SI units.

    Attributes:
      mass: gross; inertial_mass: with what turns; rolling: resistance coefficient.
      drag: 0.5 rho Cd A [kg/m]; efficiency: engine to wheels.
      power_max: of the engine, which some gear gives at every speed of the band [W].
      power_drag: of the overrunning engine, where the convex model's fuel is zero [W].
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
    brake_max: float
    fuel: Willans

    @classmethod
    def of(
        cls,
        parameters: TruckParameters,
        fuel_map: FuelMap,
        mass: float,
        v_min: float,
        v_max: float,
        deceleration_max: float = 1.5,
    ) -> PointMass:
        """The truck of given mass [kg] in a band of speeds [m/s]."""
        engine, tires = parameters.engine, parameters.tires
        turning = sum(
            2.0 * axle.wheel_inertia_spin / tires[axle.tire].rolling_radius ** 2
            for axle in parameters.axles
        )
        turning += engine.inertia * float(fuel_map.gear_speed[-1]) ** 2
        air = parameters.aerodynamics
        fuel = fuel_map.fit(v_min, v_max)
        return cls(
            mass=mass,
            inertial_mass=mass + turning,
            rolling=parameters.tire_common.rolling_resistance,
            drag=0.5 * air.density * air.drag_area,
            efficiency=fuel_map.efficiency,
            power_max=float(fuel_map.power_max(np.linspace(v_min, v_max, 60)).min()),
            power_drag=fuel.overrun_power,
            brake_max=mass * deceleration_max,
            fuel=fuel,
        )

    def slope_force(self, grade: FloatArray) -> FloatArray:
        """Force of grade and rolling resistance [N]."""
        angle = np.arctan(grade)
        return np.asarray(self.mass * GRAVITY * (np.sin(angle) + self.rolling * np.cos(angle)))

    def force_max(self, speed: float) -> float:
        """Greatest drive force at the wheels [N]."""
        return self.efficiency * self.power_max / max(speed, _CRAWL)

    def net_force(self, speed: FloatArray, road: RoadProfile) -> FloatArray:
        """Drive minus brake force [N] of the intervals, shape (n,), for node speeds (n + 1,)."""
        b = speed**2
        gain = np.diff(b) * self.inertial_mass / (2.0 * road.step)
        return gain + self.slope_force(road.grade) + 0.5 * self.drag * (b[1:] + b[:-1])

    def power(self, speed: FloatArray, road: RoadProfile) -> FloatArray:
        """Mean engine power of the intervals [W], shape (n,); at least that of overrun."""
        power = self.net_force(speed, road) * 0.5 * (speed[1:] + speed[:-1]) / self.efficiency
        return np.maximum(power, -self.power_drag)

    def fuel_of(self, speed: FloatArray, road: RoadProfile) -> FloatArray:
        """Fuel of the intervals by the convex model [kg], shape (n,)."""
        return self.fuel.rate(self.power(speed, road)) * durations(speed, road)


def durations(speed: FloatArray, road: RoadProfile) -> FloatArray:
    """Time of the intervals [s], exact for constant force: `2 ds / (v[k] + v[k+1])`."""
    return 2.0 * road.step / (speed[1:] + speed[:-1])


def full_power_speed(
    vehicle: PointMass, road: RoadProfile, v_start: float, cap: FloatArray
) -> FloatArray:
    """Greatest node speeds under a cap, with full power and brakes at most at their limit.

    Raises:
      PlanningError: full power does not carry the truck over a climb, or a cap can not be met.
    """
    slope = vehicle.slope_force(road.grade)
    twice = 2.0 * road.step / vehicle.inertial_mass
    # Backward: from which speed can the brakes still meet what comes?
    b_cap = np.minimum(cap, 1e3) ** 2
    for k in range(road.intervals - 1, -1, -1):
        b_cap[k] = min(b_cap[k], b_cap[k + 1] + twice * (vehicle.brake_max + slope[k]))
    speed = np.empty(road.station.size)
    speed[0] = v_start
    if v_start**2 > b_cap[0] + 1e-6:
        raise PlanningError(
            f"start speed {v_start:.2f} m/s is above the {math.sqrt(max(b_cap[0], 0.0)):.2f} m/s "
            "from which the limits ahead can be met"
        )
    for k in range(road.intervals):
        speed[k + 1] = _advance(vehicle, float(speed[k]), float(b_cap[k + 1]), slope[k], twice)
        if speed[k + 1] < _CRAWL:
            raise PlanningError(
                f"full power ({vehicle.power_max / 1e3:.0f} kW) does not carry {vehicle.mass:.0f} "
                f"kg over the {100 * road.grade[k]:.1f} % at station {road.station[k]:.0f} m"
            )
    return speed


def _advance(
    vehicle: PointMass, speed: float, b_wanted: float, slope: float, twice: float
) -> float:
    """Speed at the end of an interval: the wanted one, or what full power gives."""
    b = speed * speed
    # The power limit holds at the interval's mean speed, which depends on its end: iterate.
    mean = speed
    for _ in range(8):
        drag = 0.5 * vehicle.drag
        end = (b + twice * (vehicle.force_max(mean) - slope - drag * b)) / (1.0 + twice * drag)
        mean = 0.5 * (speed + math.sqrt(max(min(end, b_wanted), 0.0)))
    return math.sqrt(max(min(end, b_wanted), 0.0))


def cruise(vehicle: PointMass, road: RoadProfile, v_set: float, v_start: float) -> FloatArray:
    """Node speeds of a constant-speed cruise: slower on climbs beyond full power, braked downhill.

    The same engine, brakes and limits as the plan's; it slows down in time for lower limits.
    """
    return full_power_speed(vehicle, road, v_start, np.minimum(road.v_limit, v_set))
