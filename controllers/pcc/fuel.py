"""Fuel rate of the truck from the engine's map and gearbox, and the optimizer's convex fit of it.

The map gives the fuel rate over torque and speed. Below the lowest torque of a map of the specific
consumption the rate falls linearly to the idling engine's, in proportion to the speed, and then to
zero at the drag torque (overrun cut-off), as in `iits.powertrain`. Below that of a map of the rate
it falls to zero at once. Beyond the last row and columns the specific consumption of the edge
applies. For a wheel force and a speed the gear with the least fuel counts, of those whose speed and
full-load torque allow it. The engine's torque includes the losses of axle and gear, from their maps
if the truck has them, the drag of an empty retarder, and the auxiliaries.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic.wheel_force import input_torque, wheel_force
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import PlanningError
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.tables import Table2D

_SPEEDS = 16_000  # samples for the least power of all gears
_ENGINE_SPEED_MIN = 85.0  # [rad/s], 810 rpm: below it the gearbox shifts down


@dataclass(frozen=True)
class Willans:
    """Convex fuel rate over engine power P [W]: `f0 + f1 P + f2 P^2` [kg/s], all f >= 0.

    Attributes:
      f0, f1, f2: coefficients; error: root mean square of the fit, relative to the mean rate.
    """

    f0: float
    f1: float
    f2: float
    error: float

    def rate(self, power: FloatArray) -> FloatArray:
        """Returns fuel rates [kg/s] for powers [W] from overrun upward."""
        return self.f0 + self.f1 * power + self.f2 * power**2

    @property
    def overrun_power(self) -> float:
        """Drag power [W] at which the fuel rate reaches zero; below it the engine overruns.

        It agrees with the drag torque table, which the fit does not use, within about 10 %.
        """
        root = self.f1**2 - 4.0 * self.f0 * self.f2
        # 2 f0 / (f1 + sqrt(...)) is the root that stays finite when f2 is zero.
        return 2.0 * self.f0 / (self.f1 + math.sqrt(max(root, 0.0)))


class FuelMap:
    """The engine's fuel map over wheel force and vehicle speed, with the best gear.

    Attributes:
      efficiency: from engine to wheels; a mean where maps give the losses.
      gear_speed: of the engine over that of the vehicle [rad/m], by gear.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        engine, gearbox = parameters.engine, parameters.gearbox
        self._engine, self._parameters = engine, parameters
        self.efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        radius = parameters.tires[parameters.driven_axles[0].tire].rolling_radius
        self._has_maps = bool(
            gearbox.axle_loss.values.size or gearbox.loss_maps or parameters.retarder.drag_speed
        )
        self.gear_speed = gearbox.ratios * gearbox.final_drive / radius
        # Torque axis, speed axis, fuel rate [kg/s] of shape (torque, speed).
        table = engine.fuel_rate_map
        self._torque, self._speed, rate = table.columns, table.rows, table.values.T
        if not table.values.size:
            table = engine.fuel_map
            rate = table.values * table.rows[:, None] * table.columns[None, :]
            zero = engine.idle_fuel_rate / engine.idle_speed * table.columns
            self._torque, self._speed = np.concatenate([[0.0], table.rows]), table.columns
            rate = np.vstack([zero, rate])
        self._rate = Table2D(self._torque, self._speed, engine.fuel_factor * rate)

    def engine_rate(self, torque: FloatArray, speed: FloatArray) -> FloatArray:
        """Returns fuel rates [kg/s] for engine torques [N m] and speeds [rad/s] of one shape."""
        drag = np.interp(speed, self._engine.drag_speed, self._engine.drag_torque)
        lowest, top, last = self._torque[0], self._torque[-1], self._speed[-1]
        rate = self._rate.at(torque, speed)
        # Constant specific consumption beyond the map: the rate grows with power.
        rate = rate * np.maximum(torque / top, 1.0) * np.maximum(speed / last, 1.0)
        below = (torque - lowest) / np.maximum(lowest + drag, 1e-9)
        rate = np.where(torque >= lowest, rate, rate * np.clip(1.0 + below, 0.0, 1.0))
        return np.where(torque + drag > 0.0, rate, 0.0)

    def runs(self, speed: FloatArray) -> NDArray[np.bool_]:
        """Returns whether the gearbox lets the engine turn at speeds [rad/s]."""
        return (speed >= _ENGINE_SPEED_MIN) & (speed <= self._engine.governed_speed)

    def power_max(self, speed: FloatArray) -> FloatArray:
        """Returns the greatest engine power [W] of any gear at vehicle speeds [m/s].

        It is that at the gearbox: the auxiliaries have taken theirs.
        """
        omega = self.gear_speed[:, None] * np.asarray(speed, dtype=float)[None, :]
        full = self._engine.full_pedal_torque(omega)
        allowed = (omega >= self._engine.idle_speed) & (omega <= self._engine.governed_speed)
        left = np.maximum(full * omega - self._engine.auxiliary_power, 0.0)
        return np.asarray((np.where(allowed, left, 0.0)).max(axis=0))

    def overrun_force(self, speed: FloatArray) -> FloatArray:
        """Returns the braking force at the wheels [N] in overrun, in the highest gear that runs.

        It is that of the engine's drag, the auxiliaries and the driveline's losses at vehicle
        speeds [m/s], of shape (n,); it is 0 where no gear runs.
        """
        force = np.zeros(speed.size)
        for gear, turns in enumerate(self.gear_speed, start=1):
            omega = turns * speed
            runs = self.runs(omega)
            drag = np.interp(omega, self._engine.drag_speed, self._engine.drag_torque)
            drag = drag + self._engine.auxiliary_torque(omega)
            force = np.where(runs, -wheel_force(self._parameters, gear, -drag, omega), force)
        return force

    def full_power(self) -> float:
        """Returns the engine power [W] that some gear gives at every speed of the gears.

        The speeds range from that of greatest power in the lowest gear to that in the highest. The
        power falls between two gears, nearly equally at each step. It does not depend on the band
        of a plan: below these speeds the lowest gear's force holds 55 t on a grade of 37 %.
        """
        engine = self._engine
        peak = np.argmax(engine.full_load_speed * engine.full_load_torque)
        first, last = engine.full_load_speed[peak] / self.gear_speed[[0, -1]]
        return float(self.power_max(np.geomspace(first, last, _SPEEDS)).min())

    def rate(self, force: FloatArray, speed: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Returns fuel rate [kg/s] and gear (from 1) for wheel forces [N] at speeds [m/s].

        The engine's drag takes a negative force first, the brakes the rest. If no gear gives the
        force, the one with the most torque runs at full load.
        """
        omega = self.gear_speed[:, None] * speed[None, :]
        torque = self._input_torques(force, speed)
        torque = torque + self._engine.auxiliary_power / np.maximum(omega, _ENGINE_SPEED_MIN)
        full = self._engine.full_pedal_torque(omega)
        runs = self.runs(omega)
        fits = runs & (torque <= full * 1.001)
        rate = self.engine_rate(np.minimum(torque, full), omega)
        # Of gears with the same rate (overrun), the highest.
        order = np.arange(self.gear_speed.size)[:, None] * 1e-12
        best = np.where(fits, rate - order, np.inf).argmin(axis=0)
        strongest = np.where(runs, full * omega, -1.0).argmax(axis=0)
        gear = np.where(fits.any(axis=0), best, strongest)
        return rate[gear, np.arange(force.size)], gear + 1

    def _input_torques(self, force: FloatArray, speed: FloatArray) -> FloatArray:
        """Torques at the gearbox input [N m] for wheel forces at speeds, shape (gears, n)."""
        if not self._has_maps:
            loss = np.where(force > 0.0, 1.0 / self.efficiency, self.efficiency)
            return np.asarray((force * loss)[None, :] / self.gear_speed[:, None])
        return np.array(
            [
                input_torque(self._parameters, gear, force, turns * speed)
                for gear, turns in enumerate(self.gear_speed, start=1)
            ]
        )

    def fit(self, v_min: float, v_max: float) -> Willans:
        """Returns the least-squares fit over the engine's powers in a band of speeds [m/s]."""
        speed = np.repeat(np.linspace(v_min, v_max, 12), 41)
        share = np.tile(np.linspace(0.0, 1.0, 41), 12)
        power = share * self.power_max(speed)
        if power.max() <= 0.0:
            raise PlanningError(f"no gear runs between {v_min:.1f} and {v_max:.1f} m/s")
        rate, _ = self.rate(power * self.efficiency / speed, speed)
        unit = 1e5
        basis = np.column_stack([np.ones(power.size), power / unit, (power / unit) ** 2])
        coefficients = nonnegative_fit(basis, rate)
        error = float(np.sqrt(np.mean((basis @ coefficients - rate) ** 2)) / rate.mean())
        f0, f1, f2 = (float(c) for c in coefficients)
        return Willans(f0, f1 / unit, f2 / unit**2, error)


def nonnegative_fit(basis: FloatArray, value: FloatArray) -> FloatArray:
    """Returns least-squares coefficients >= 0 of a few columns: the best of all their subsets."""
    count = basis.shape[1]
    normal, right = basis.T @ basis, basis.T @ value
    best, least = np.zeros(count), 0.0
    for size in range(1, count + 1):
        for chosen in itertools.combinations(range(count), size):
            part = np.linalg.solve(normal[np.ix_(chosen, chosen)], right[list(chosen)])
            # Sum of squares of the residual minus that of the values.
            gain = -float(part @ right[list(chosen)])
            if (part >= 0.0).all() and gain < least:
                best, least = np.zeros(count), gain
                best[list(chosen)] = part
    return best
