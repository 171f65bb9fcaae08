"""The truck of the fast world: a point mass on the grade with the engine's full-load power."""

from __future__ import annotations

import math

from controllers.following import FollowingConfig, follow_acceleration
from iits_mj.parameters import TruckParameters
from iits_mj.units import GRAVITY


class HighwayTruck:
    """Longitudinal motion of the laden truck; `front` is the front bumper's station [m].

    It follows as the planner does (`controllers.following`) and is held to the engine's power
    through the driveline, rolling resistance, air drag and the grade. No gears, no brake lag.
    """

    def __init__(
        self,
        parameters: TruckParameters,
        payload: float,
        following: FollowingConfig | None = None,
    ) -> None:
        engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
        self.mass = parameters.gross_mass(payload)
        self.following = following or FollowingConfig()
        efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        self._power = float((engine.full_load_speed * engine.full_load_torque).max()) * efficiency
        self._drag = 0.5 * air.density * air.drag_area
        self._rolling = parameters.tire_common.rolling_resistance
        self.front = 0.0
        self.speed = 0.0
        self.acceleration = 0.0

    def power_limit(self, grade: float) -> float:
        """Greatest acceleration [m/s2] at full power on a grade."""
        slope = GRAVITY * (math.sin(math.atan(grade)) + self._rolling)
        drive = self._power / max(self.speed, 4.0)
        return (drive - self._drag * self.speed**2) / self.mass - slope

    def step(
        self,
        dt: float,
        reference: float,
        leaders: list[tuple[float, float, float]],
        grade: float,
    ) -> None:
        """Advances by dt [s]; leaders are (gap [m], speed [m/s], acceleration [m/s2])."""
        config = self.following
        wanted = follow_acceleration(self.speed, reference, math.inf, 0.0, 0.0, config)
        for gap, speed, acceleration in leaders:
            wanted = min(
                wanted,
                follow_acceleration(self.speed, reference, gap, speed, acceleration, config),
            )
        wanted = min(wanted, self.power_limit(grade))
        # A full service brake application of a laden truck; the last layer of the planner.
        wanted = max(wanted, -6.0)
        speed = max(0.0, self.speed + wanted * dt)
        self.front += 0.5 * (self.speed + speed) * dt
        self.acceleration = (speed - self.speed) / dt
        self.speed = speed
