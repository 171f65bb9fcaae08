"""The truck as a point mass: pull of the engine against rolling, grade and air resistance.

    (m + J / r^2) v' = T i eta / r - m g (sin(theta) + f cos(theta)) - 0.5 rho CdA v^2

with engine torque T, overall ratio i with its efficiency eta (Wong, Theory of Ground Vehicles, 4th
ed., chapter 3). It uses the parameters of the truck only, not the simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model.powertrain import full_load
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import (
    Inertial,
    group_center,
    laden_units,
    rolling_resistance,
    wheel_mass,
)
from iits_mj.parameters.tire_law import friction
from iits_mj.road.elements import DEFAULT_FRICTION

_STEEPEST = 0.6


@dataclass(frozen=True)
class ForceBalance:
    """Forces along the road of a truck with this payload [kg]; grades are dz/ds of the road."""

    parameters: TruckParameters
    payload: float

    @property
    def mass(self) -> float:
        """Gross mass [kg]."""
        return self.parameters.gross_mass(self.payload)

    @property
    def rolling(self) -> float:
        """Rolling resistance over the weight."""
        return rolling_resistance(self.parameters, self.payload)

    @property
    def wheel_radius(self) -> float:
        """Rolling radius of the driven wheels [m]."""
        return self.parameters.tires[self.parameters.driven_axles[0].tire].rolling_radius

    @property
    def wheel_mass(self) -> float:
        """Equivalent mass of the turning wheels [kg]."""
        return wheel_mass(self.parameters)

    def reduction(self, gear: ArrayLike) -> FloatArray:
        """Engine speed over vehicle speed [rad/m] in forward gears, 0 in neutral; any shape."""
        number = np.asarray(gear).astype(int)
        ratios = np.concatenate([[0.0], self.parameters.gearbox.ratios])
        overall = ratios[np.maximum(number, 0)] * self.parameters.gearbox.final_drive
        return np.asarray(overall / self.wheel_radius)

    def rotating_mass(self, gear: ArrayLike) -> FloatArray:
        """Equivalent mass of turning engine, gearbox and wheels, clutch closed [kg]."""
        parameters, number = self.parameters, np.maximum(np.asarray(gear).astype(int), 0)
        inertia = parameters.engine.inertia + np.concatenate([[0.0], parameters.gearbox.inertias])
        return np.asarray(self.wheel_mass + inertia[number] * self.reduction(gear) ** 2)

    def pull(self, torque: ArrayLike, gear: ArrayLike) -> FloatArray:
        """Force at the driven wheels [N] of a torque at the gearbox input [N m]."""
        gearbox, torque = self.parameters.gearbox, np.asarray(torque, dtype=float)
        efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        return np.asarray(
            torque * self.reduction(gear) * np.where(torque >= 0.0, efficiency, 1.0 / efficiency)
        )

    def resistance(self, speed: ArrayLike, grade: ArrayLike = 0.0) -> FloatArray:
        """Rolling, grade and air resistance [N] while the truck moves forward."""
        air, speed = self.parameters.aerodynamics, np.asarray(speed, dtype=float)
        angle = np.arctan(grade)
        rolling = self.rolling * np.cos(angle)
        weight = self.mass * GRAVITY * (np.sin(angle) + rolling)
        return np.asarray(weight + 0.5 * air.density * air.drag_area * speed**2)

    def full_torque(self, engine_speed: ArrayLike) -> FloatArray:
        """Torque at full pedal, limited by full load [N m]; zero beyond the governor."""
        engine, speed = self.parameters.engine, np.asarray(engine_speed, dtype=float)
        table = engine.pedal_map
        floored = np.array([np.interp(1.0, table.columns, row) for row in table.values])
        full = np.interp(speed, *full_load(self.parameters))
        torque = np.minimum(np.interp(speed, table.rows, floored), full)
        return np.asarray(np.where(speed > engine.governed_speed, 0.0, torque))

    @property
    def launch_speed(self) -> float:
        """Engine speed [rad/s] at which the slipping clutch carries the torque of full pedal.

        The engine settles where its torque equals that of the clutch.
        """
        idle, spread = self.parameters.engine.idle_speed, self.parameters.clutch.launch_range

        def surplus(speed: float) -> float:
            return self.carrying_speed(float(self.full_torque(speed))) - speed

        return float(brentq(surplus, idle, idle + spread))

    def carrying_speed(self, torque: float) -> float:
        """Engine speed [rad/s] at which the slipping clutch carries a torque [N m].

        The clutch control closes in proportion to engine speed above idle, up to the reference
        torque.
        """
        engine = self.parameters.engine
        spread = self.parameters.clutch.launch_range
        return engine.idle_speed + torque / engine.reference_torque * spread

    def steady_speed(self, gear: int, grade: float) -> float:
        """Speed at which full load and resistances balance in this gear [m/s]; nan without one.

        Of several such speeds it is the greatest, which is stable.
        """
        reduction = float(self.reduction(gear))
        engine = self.parameters.engine
        speeds = np.linspace(engine.idle_speed, engine.governed_speed, 400) / reduction

        def surplus(speed: float) -> float:
            pull = self.pull(self.full_torque(speed * reduction), gear)
            return float(pull - self.resistance(speed, grade))

        values = np.array([surplus(speed) for speed in speeds])
        if values[-1] >= 0.0:
            return float(speeds[-1])
        falling = np.flatnonzero((values[:-1] >= 0.0) & (values[1:] < 0.0))
        if not len(falling):
            return float("nan")
        k = falling[-1]
        return float(brentq(surplus, speeds[k], speeds[k + 1]))

    def best_speed(self, grade: float) -> float:
        """Greatest steady speed of all gears on this grade [m/s]."""
        gears = range(1, len(self.parameters.gearbox.ratios) + 1)
        return float(np.nanmax([self.steady_speed(gear, grade) for gear in gears]))

    def grade_for(self, force: float) -> float:
        """Steepest grade on which this force at the wheels [N] moves the truck slowly."""
        return float(
            brentq(lambda grade: force - float(self.resistance(0.0, grade)), -0.1, _STEEPEST)
        )

    def drive_axle_load(self, grade: float) -> float:
        """Load on the drive axles in a steady climb on this grade [N].

        Statics of both units in the frame of the road: grade force and pull at the fifth wheel act
        at their heights, the drive force at the ground.
        """
        p = self.parameters
        angle = math.atan(grade)
        sine, cosine = math.sin(angle), math.cos(angle)
        trailer, tractor = laden_units(p, self.payload)[1], p.lead
        front, *drive = tractor.axles
        length = group_center(p.units[1].axles)
        fifth = p.couplings[0]
        weight = trailer.mass * GRAVITY
        kingpin, pull = self._kingpin(trailer, weight * cosine, weight * sine, length)
        own = tractor.mass * GRAVITY
        moment = own * (cosine * (tractor.cg_position - front.position) + sine * tractor.cg_height)
        moment += kingpin * (fifth.position - front.position) + pull * fifth.height
        return moment / (group_center(tuple(drive)) - front.position)

    def traction(self, grade: float, surface: float = DEFAULT_FRICTION) -> float:
        """Greatest drive force on a road of this friction [N]."""
        axles = [axle for axle in self.parameters.axles if axle.tire == "drive"]
        count = sum(2 * self.parameters.tires[axle.tire].count for axle in axles)
        load, common = self.drive_axle_load(grade), self.parameters.tire_common
        grip = float(friction(load / count, common.friction_longitudinal, common))
        return grip * surface / DEFAULT_FRICTION * load

    def traction_grade(self, surface: float = DEFAULT_FRICTION) -> float:
        """Steepest grade that the grip of the drive axles allows, at most 0.6.

        The needed force includes the rolling resistance of steer axle and trailer.
        """

        def surplus(grade: float) -> float:
            return self.traction(grade, surface) - float(self.resistance(0.0, grade))

        return _STEEPEST if surplus(_STEEPEST) > 0.0 else float(brentq(surplus, 0.0, _STEEPEST))

    def _kingpin(
        self, trailer: Inertial, normal: float, along: float, length: float
    ) -> tuple[float, float]:
        """Load on the kingpin and pull at it [N]; the trailer's axles roll."""
        p = self.parameters
        height, rolling = p.couplings[0].height, self.rolling
        # Moments about the ground below the axle group; the pull also moves the axles' share.
        load = normal * (1.0 - trailer.cg_position / length) - along * trailer.cg_height / length
        load += height / length * (along + rolling * normal)
        load /= 1.0 + rolling * height / length
        return load, along + rolling * (normal - load)
