"""The truck as a point mass: pull of the engine against rolling, grade and air resistance.

    (m + J / r^2) v' = F - m g (sin(theta) + f cos(theta)) - 0.5 rho CdA v^2

with the pull F of the engine behind all losses (`analytic/wheel_force.py`; Wong, Theory of Ground
Vehicles, 4th ed., chapter 3). It uses the parameters of the truck only, not the simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from iits_mj.analytic.wheel_force import input_torque, wheel_force
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model.powertrain import full_load
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import (
    group_center,
    group_shares,
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

    @cached_property
    def mass(self) -> float:
        """Gross mass [kg]."""
        return self.parameters.gross_mass(self.payload)

    @cached_property
    def rolling(self) -> float:
        """Rolling resistance over the weight."""
        return rolling_resistance(self.parameters, self.payload)

    @property
    def wheel_radius(self) -> float:
        """Rolling radius of the driven wheels [m]."""
        return self.parameters.tires[self.parameters.driven_axles[0].tire].rolling_radius

    @cached_property
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

    def pull(self, torque: ArrayLike, gear: ArrayLike, speed: ArrayLike) -> FloatArray:
        """Force at the driven wheels [N] of torques of the engine, 0 in neutral.

        Args:
          torque: less that of the engine's inertia [N m].
          gear: engaged.
          speed: of the engine [rad/s]; the shapes broadcast.
        """
        numbers, turns = np.asarray(gear).astype(int), np.asarray(speed, dtype=float)
        left = np.asarray(torque, dtype=float) - self.parameters.engine.auxiliary_torque(turns)
        force = np.zeros(np.broadcast_shapes(left.shape, numbers.shape))
        for number in np.unique(numbers[numbers > 0]).tolist():
            force = np.where(
                numbers == number, wheel_force(self.parameters, number, left, turns), force
            )
        return force

    def needed_torque(self, force: float, gear: int, speed: float) -> float:
        """Torque of the engine [N m] for a force at the wheels [N]: the inverse of `pull`."""
        torque = input_torque(self.parameters, gear, np.asarray(force), np.asarray(speed))
        return float(torque + self.parameters.engine.auxiliary_torque(speed))

    def pedal(self, torque: float, speed: float) -> float:
        """Accelerator pedal that requests a torque [N m] at an engine speed [rad/s]."""
        table = self.parameters.engine.pedal_map
        asked = [np.interp(speed, table.rows, column) for column in table.values.T]
        return float(np.interp(torque, asked, table.columns))

    def resistance(self, speed: ArrayLike, grade: ArrayLike = 0.0) -> FloatArray:
        """Rolling, grade and air resistance [N] while the truck moves forward."""
        angle = np.arctan(grade)
        rolling = self.rolling * np.cos(angle)
        weight = self.mass * GRAVITY * (np.sin(angle) + rolling)
        return np.asarray(weight + self.air(speed))

    def air(self, speed: ArrayLike) -> FloatArray:
        """Drag of the air [N] at speeds [m/s], in the mean wind."""
        air, speed = self.parameters.aerodynamics, np.asarray(speed, dtype=float)
        if not air.mean_wind:
            return np.asarray(0.5 * air.density * air.drag_area * speed**2)
        return np.asarray(np.interp(speed, *self._drag))

    @cached_property
    def _drag(self) -> tuple[FloatArray, FloatArray]:
        """Speeds [m/s] and drag in the mean wind [N]."""
        air, speeds = self.parameters.aerodynamics, np.arange(0.5, 60.0, 0.5)
        areas = np.array([air.mean_drag_area(v) for v in speeds.tolist()])
        return speeds, 0.5 * air.density * areas * speeds**2

    def full_torque(self, engine_speed: ArrayLike) -> FloatArray:
        """Torque at full pedal, limited by full load [N m]; zero beyond the governor."""
        engine, speed = self.parameters.engine, np.asarray(engine_speed, dtype=float)
        floored = np.interp(speed, engine.pedal_map.rows, engine.pedal_map.column(1.0))
        torque = np.minimum(floored, np.interp(speed, *full_load(self.parameters)))
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
            turns = speed * reduction
            pull = self.pull(self.full_torque(turns), gear, turns)
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
        """Steepest grade, at most 0.6, on which this force at the wheels [N] moves the truck."""

        def surplus(grade: float) -> float:
            return force - float(self.resistance(0.0, grade))

        return _STEEPEST if surplus(_STEEPEST) > 0.0 else float(brentq(surplus, -0.1, _STEEPEST))

    def drive_axle_load(self, grade: float) -> float:
        """Load on the driven axles in a steady climb on this grade [N].

        Statics of the units in the frame of the road, from the last forward: grade forces and the
        pulls at the couplings act at their heights, the drive force at the ground.
        """
        p, angle = self.parameters, math.atan(grade)
        sine, cosine = math.sin(angle), math.cos(angle)
        # Of the unit behind: its load on the coupling, how it pulls backward, and where.
        load, pull, place, raised = 0.0, 0.0, 0.0, 0.0
        for unit, body in reversed(list(zip(p.units, laden_units(p, self.payload), strict=True))):
            normal, along = body.mass * GRAVITY * cosine, body.mass * GRAVITY * sine
            # Moment about the ground below the unit's origin.
            moment = normal * body.cg_position + along * body.cg_height + load * place
            moment += pull * raised
            if unit.coupling is None:
                break
            # The unit hangs at its coupling; its axles roll.
            length, height = group_center(unit.groups(self.payload)[0]), unit.coupling.height
            rear = moment - height * (along + pull)
            on_axles = rear / (length + self.rolling * height)
            load, pull = normal + load - on_axles, along + pull + self.rolling * on_axles
            place, raised = unit.coupling.position, height
        front, rear_group = unit.groups(self.payload)
        origin = group_center(front)
        on_rear = (moment - origin * (normal + load)) / (group_center(rear_group) - origin)
        shares = zip(rear_group, group_shares(rear_group), strict=True)
        return on_rear * sum(share for axle, share in shares if axle.driven)

    def traction(self, grade: float, surface: float = DEFAULT_FRICTION) -> float:
        """Greatest drive force on a road of this friction [N]."""
        p = self.parameters
        count = sum(2 * p.tires[axle.tire].count for axle in p.driven_axles)
        load, common = self.drive_axle_load(grade), p.tire_common
        grip = float(friction(load / count, common.friction_longitudinal, common))
        return grip * surface / DEFAULT_FRICTION * load

    def traction_grade(self, surface: float = DEFAULT_FRICTION) -> float:
        """Steepest grade that the grip of the drive axles allows, at most 0.6.

        The needed force includes the rolling resistance of steer axle and trailer.
        """

        def surplus(grade: float) -> float:
            return self.traction(grade, surface) - float(self.resistance(0.0, grade))

        return _STEEPEST if surplus(_STEEPEST) > 0.0 else float(brentq(surplus, 0.0, _STEEPEST))
