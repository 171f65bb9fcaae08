"""From wanted force at the wheels to accelerator, engine brake and retarder: inverse powertrain."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left

import numpy as np

from controllers.interpolation import interpolate
from controllers.retardation import EnduranceForces
from iits_mj.parameters import TruckParameters
from iits_mj.units import GRAVITY


class DrivelineInverse:
    """Static inverse of engine and driveline, and the truck's resistances.

    Args:
      parameters: of the truck.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        self.parameters = parameters
        tires = parameters.tires
        self.radius = tires[parameters.tractor.axles[-1].tire].rolling_radius
        self.rolling = parameters.tire_common.rolling_resistance
        air = parameters.aerodynamics
        self.drag = 0.5 * air.density * air.drag_area
        self.wheel_mass = sum(
            2.0 * axle.wheel_inertia_spin / tires[axle.tire].rolling_radius ** 2
            for axle in parameters.axles
        )
        gearbox, engine = parameters.gearbox, parameters.engine
        self.efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        self._ratios = [float(ratio) * gearbox.final_drive for ratio in gearbox.ratios]
        # Mass of wheels, engine and gearbox by gear [kg], beside the truck's own.
        self._spins = [
            (engine.inertia + float(inertia)) * ratio**2 / self.radius**2
            for inertia, ratio in zip(gearbox.inertias, self._ratios, strict=True)
        ]
        table = engine.pedal_map
        self._map_speeds, self._pedals = table.rows.tolist(), table.columns.tolist()
        self._map_torques = table.values.tolist()
        self._fade = np.minimum(1.0, table.columns / engine.pedal_fade).tolist()
        self._rise = (1e-6 * np.arange(len(self._pedals))).tolist()

    def ratio(self, gear: int) -> float:
        """Overall ratio engine to wheel in a forward gear."""
        return self._ratios[self._row(gear)]

    def _row(self, gear: int) -> int:
        return min(max(gear, 1), len(self._ratios)) - 1

    def resistance(self, mass: float, speed: float, grade: float) -> float:
        """Rolling, air and grade resistance [N] at a grade (rise over run)."""
        slope = math.atan(grade)
        rolling = self.rolling * math.cos(slope) if speed > 0.05 else 0.0
        return mass * GRAVITY * (math.sin(slope) + rolling) + self.drag * speed * abs(speed)

    def effective_mass(self, mass: float, gear: int) -> float:
        """Mass with the rotating parts of wheels, engine and gearbox [kg]."""
        return mass + self.wheel_mass + self._spins[self._row(gear)]

    def engine_torque(self, force: float, gear: int) -> float:
        """Torque at the crankshaft [N m] for a force at the wheels [N]."""
        bare = force * self.radius / self.ratio(gear)
        return bare / self.efficiency if bare > 0.0 else bare * self.efficiency

    def drag_torque(self, engine_speed: float) -> float:
        """Drag of the engine on overrun [N m], positive."""
        engine = self.parameters.engine
        return interpolate(engine_speed, engine.drag_speed, engine.drag_torque)

    def engine_brake_torque(self, engine_speed: float) -> float:
        """Greatest torque of the engine brake [N m], beyond the drag: a power law, none at idle."""
        engine = self.parameters.engine
        above = engine_speed - engine.engine_brake_speed_min
        if above <= 0.0:
            return 0.0
        rated = engine.engine_brake_power / engine.engine_brake_speed
        relative = engine_speed / engine.engine_brake_speed
        torque = rated * relative ** (engine.engine_brake_exponent - 1.0)
        return min(above / engine.engine_brake_fade, 1.0) * torque

    def retarder_torque(self, shaft_speed: float) -> float:
        """Greatest torque of the cold retarder at the propeller shaft [N m]; hot it gives less."""
        retarder = self.parameters.retarder
        if shaft_speed <= 0.0:
            return 0.0
        rise = min(shaft_speed / retarder.full_torque_speed, 1.0)
        return min(retarder.torque_max * rise**2, retarder.power_max / shaft_speed)

    def endurance(
        self, speed: float, engine_speed: float, gear: int, engaged: bool
    ) -> EnduranceForces:
        """What drag, engine brake and retarder can do at the wheels; losses help to brake.

        Args:
          speed: of the truck [m/s].
          engine_speed: [rad/s].
          gear: that is in.
          engaged: whether the engine is coupled; in a gear change it is not.
        """
        gearbox = self.parameters.gearbox
        shaft = gearbox.final_drive / self.radius
        retarder = self.retarder_torque(speed * shaft) * shaft / gearbox.driveline_efficiency
        if not engaged:
            return EnduranceForces(0.0, 0.0, retarder)
        factor = self.ratio(gear) / self.radius / self.efficiency
        return EnduranceForces(
            factor * self.drag_torque(engine_speed),
            factor * self.engine_brake_torque(engine_speed),
            retarder,
        )

    def pedal(self, torque: float, engine_speed: float) -> float:
        """Accelerator pedal, 0 to 1, that gives a torque at the crankshaft [N m]."""
        speeds = self._map_speeds
        row = min(max(bisect_left(speeds, engine_speed) - 1, 0), len(speeds) - 2)
        low, high = speeds[row], speeds[row + 1]
        share = min(max((engine_speed - low) / (high - low), 0.0), 1.0)
        rest, drag = 1.0 - share, self.drag_torque(engine_speed)
        # Over the first travel of the pedal the overrun turns into traction.
        torques = [
            fade * (rest * below + share * above + drag) - drag
            for fade, below, above in zip(
                self._fade, self._map_torques[row], self._map_torques[row + 1], strict=True
            )
        ]
        rising = [
            most + rise
            for most, rise in zip(itertools.accumulate(torques, max), self._rise, strict=True)
        ]
        return interpolate(torque, rising, self._pedals)
