"""A small planar truck for the tests of tracking: no MuJoCo, and not the controller's own model.

Lateral: the single-track model of the units with stiffnesses scaled away from the controller's,
steering play and lag, and a cross-slope. Longitudinal: pedal map, torque ramp, gear by speed,
engine brake, retarder, brakes with lag that follow XBR as brake control does.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.messages import EgoState, VehicleCommand, XbrEbiMode
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from tests.controllers.tracking.reference import Powertrain, share_out

STEP = 0.005
_GEAR_SPEED = np.array([0.0, 1.0, 2.0, 2.8, 3.8, 5.0, 6.5, 8.5, 11.0, 14.0, 17.0, 21.0])


def softened(model: LateralModel, factor: float) -> LateralModel:
    """The model with a multiple of all cornering stiffnesses."""
    plane = dataclasses.replace(model.plane, cornering=factor * model.plane.cornering)
    return dataclasses.replace(model, plane=plane)


class PlanarTruck:
    """Steps 20 ms at a time; `ego` is its state."""

    def __init__(
        self, route, mass=55_000.0, station=100.0, offset=0.0, speed=16.0, stiffness=0.85, bank=0.0
    ):
        self.route, self.mass, self.bank = route, mass, bank
        self.parameters = TruckParameters.load()
        self.inverse = Powertrain(self.parameters)
        model = LateralModel.of(self.parameters, mass, 0.1)
        self.model = softened(model, stiffness)
        point = route.evaluate(station, offset)
        self.x, self.y, self.yaw = float(point.x), float(point.y), float(point.heading)
        self.w = self.r = self.r_t = self.articulation = 0.0
        self.speed, self.acceleration = speed, 0.0
        self.wheel = self.output = self.torque = self.brake = self.time = 0.0
        self.retarder = self.trim = self.friction = 0.0
        self.station, self.offset = station, offset

    def step(self, command: VehicleCommand) -> None:
        self._pedal_row = self._engine_row()
        self._resistance = self.inverse.resistance(
            self.mass, self.speed, float(self.route.smoothed_grade(self.station - 8.0))
        )
        self._lateral, _, _ = self.model.matrices(max(self.speed, 0.5))
        for _ in range(4):
            self._steer(command.steering_wheel_angle)
            self._drive(command)
            self._turn()
            self.time += STEP
        self.station, self.offset = self.route.locate(self.x, self.y, self.station)

    @property
    def gear(self) -> int:
        return max(2, int(np.searchsorted(_GEAR_SPEED, self.speed, side="right")))

    @property
    def engine_speed(self) -> float:
        turning = self.speed / self.inverse.radius * self.inverse.ratio(self.gear)
        return max(self.parameters.engine.idle_speed, turning)

    def _engine_row(self):
        table = self.parameters.engine.pedal_map
        return np.array([np.interp(self.engine_speed, table.rows, c) for c in table.values.T])

    def _steer(self, demand: float) -> None:
        steering = self.parameters.steering
        change = (demand - self.wheel) * STEP / steering.time_constant
        limit = steering.rate_max * STEP
        self.wheel += min(max(change, -limit), limit)
        half = 0.5 * steering.dead_band
        self.output = min(max(self.output, self.wheel - half), self.wheel + half)

    def _drive(self, command: VehicleCommand) -> None:
        table, inverse = self.parameters.engine.pedal_map, self.inverse
        engine_speed, row = self.engine_speed, self._pedal_row
        available = inverse.endurance(self.speed, engine_speed, self.gear, engaged=True)
        level = self.brake + self.trim
        wanted_force = self.mass * (level - GRAVITY * inverse.rolling)
        engine_brake, retarder = command.engine_brake, command.retarder
        if command.xbr_ebi_mode is XbrEbiMode.INTEGRATION and command.xbr_demand < 0.0:
            asked = share_out(wanted_force, available)
            engine_brake = max(engine_brake, asked.engine_brake)
            retarder = max(retarder, asked.retarder)
        drag = inverse.drag_torque(engine_speed)
        wanted = float(np.interp(command.accelerator_pedal, table.columns, row))
        up = command.accelerator_pedal < 0.02
        if up and self.speed > 1.0:
            wanted = -drag - engine_brake * inverse.engine_brake_torque(engine_speed)
        self.torque += min(max(wanted - self.torque, -2000.0 * STEP), 600.0 * STEP)
        filled = retarder * available.retarder if up else 0.0
        self.retarder += (filled - self.retarder) * STEP / 0.3
        ratio = inverse.ratio(self.gear) / inverse.radius
        drive = self.torque * ratio
        drive *= inverse.efficiency if drive > 0.0 else 1.0 / inverse.efficiency
        drive -= self.retarder
        self._follow(-command.xbr_demand)
        self.friction = max(wanted_force + min(drive, 0.0), 0.0) if level > 1e-3 else 0.0
        force = drive - self._resistance
        if self.speed <= 0.0 and abs(force) < self.friction:
            force = 0.0
        else:
            force -= math.copysign(self.friction, self.speed if self.speed != 0.0 else force)
        before = self.speed
        self.acceleration = force / self.mass
        self.speed += self.acceleration * STEP
        if before > 0.0 > self.speed and self.brake > 0.2:
            self.speed = 0.0

    def _follow(self, demand: float) -> None:
        """Brake control: the demand with a lag, corrected by the measured deceleration."""
        brake = self.parameters.air_brake
        self.brake += (demand - self.brake) * STEP / 0.3
        error = self.brake + self.acceleration if self.speed > brake.trim_speed_min else 0.0
        bound = min(brake.trim_max + brake.trim_share * demand, demand)
        self.trim = min(max(self.trim + brake.trim_gain * error * STEP, -bound), bound)

    def _turn(self) -> None:
        a = self._lateral
        delta = self.output / self.parameters.steering.ratio
        state = np.array([self.w, self.r, self.r_t, self.articulation, 0, 0, delta, delta, 0])
        # Implicit in the fast lateral states: stiff at low speed.
        fast = a[:4, :4]
        push = a[:4, 6] * delta
        push[0] -= GRAVITY * self.bank
        solved = np.linalg.solve(np.eye(4) - STEP * fast, state[:4] + STEP * push)
        self.w, self.r, self.r_t, self.articulation = (float(value) for value in solved)
        if self.speed > 0.01:
            self.x += STEP * (self.speed * math.cos(self.yaw) - self.w * math.sin(self.yaw))
            self.y += STEP * (self.speed * math.sin(self.yaw) + self.w * math.cos(self.yaw))
            self.yaw += STEP * self.r

    @property
    def ego(self) -> EgoState:
        return EgoState(
            time=round(self.time, 6),
            x=self.x,
            y=self.y,
            yaw=self.yaw,
            speed=self.speed,
            lateral_speed=self.w,
            acceleration=self.acceleration,
            yaw_rate=self.r,
            trailer_yaw_rate=self.r_t,
            articulation=self.articulation,
            articulation_rate=self.r - self.r_t,
            steering_wheel_angle=self.wheel,
            road_wheel_angle=self.output / self.parameters.steering.ratio,
            mass=self.mass,
            station=self.station,
            offset=self.offset,
            gear=self.gear,
            engine_speed=self.engine_speed,
            engine_torque=self.torque,
        )
