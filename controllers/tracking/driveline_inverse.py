"""Inverse powertrain: from force at the wheels to accelerator, engine brake, retarder and XBR."""

from __future__ import annotations

import ctypes
import math

import numpy as np

from iits_mj import kernels
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters


class Actuation(ctypes.Structure):
    """What each actuator does for a force at the wheels.

    The engine's drag brakes first, then the engine brake, the retarder, and friction.

    Attributes:
      torque: at the crankshaft [N m].
      drag: torque of the engine's drag on overrun, positive [N m].
      pedal: accelerator pedal that gives the torque, 0 to 1.
      beyond: braking force beyond the engine's drag [N].
      engine_brake, retarder: share of the greatest force of each, 0 to 1.
      lacking: braking force beyond all of them, now or once friction has built up [N].
    """

    _fields_ = [
        (name, kernels.Real)
        for name in ("torque", "drag", "pedal", "beyond", "engine_brake", "retarder", "lacking")
    ]


def xbr_deceleration(
    deceleration: float, level: float, correction_max: float, correction_share: float
) -> float:
    """XBR demand with which the brakes reach a braking level [m/s2].

    The demand is the deceleration of the truck, as SPN 2920 defines it. Brake control applies it
    as on a level road and corrects it by the measured deceleration, by at most
    `correction_max + correction_share * demand` and at most by the demand itself. On a descent,
    where braking only holds the speed, this is not enough for a demand near zero: the demand is
    then the least one whose correction reaches the level.

    Args:
      deceleration: of the truck along the road, positive when it slows down [m/s2].
      level: deceleration by the whole braking force on a level road [m/s2].
      correction_max: bound of brake control's correction [m/s2].
      correction_share: increase of that bound by the demand [1].
    """
    least = max(0.5 * level, (level - correction_max) / (1.0 + correction_share))
    return max(deceleration, least, 0.0)


class DrivelineInverse:
    """Static inverse of engine and driveline, and the truck's resistances.

    Braking forces at the wheels are increased by losses. The engine brake's greatest torque beyond
    the drag is a power law of the engine speed, 0 at idle; the retarder, assumed to be cold, has a
    rise, a greatest torque and a greatest power; both brake less as the truck slows down.
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
        self._ratios = [float(ratio) * gearbox.final_drive for ratio in gearbox.ratios]
        # Equivalent mass of wheels, engine and gearbox by gear [kg].
        self._spins = [
            (engine.inertia + float(inertia)) * ratio**2 / self.radius**2
            for inertia, ratio in zip(gearbox.inertias, self._ratios, strict=True)
        ]
        self._constants = self._packed()

    def _packed(self) -> bytes:
        """The kernel's `Powertrain` and its tables."""
        p = self.parameters
        gearbox, engine, retarder, table = p.gearbox, p.engine, p.retarder, p.engine.pedal_map
        numbers = (
            self.radius,
            gearbox.efficiency * gearbox.driveline_efficiency,
            gearbox.final_drive / self.radius,
            gearbox.driveline_efficiency,
            engine.engine_brake_speed_min,
            engine.engine_brake_speed,
            engine.engine_brake_power / engine.engine_brake_speed,
            engine.engine_brake_exponent - 1.0,
            engine.engine_brake_fade,
            retarder.full_torque_speed,
            retarder.torque_max,
            retarder.power_max,
            len(engine.drag_speed),
            len(table.rows),
            len(table.columns),
        )
        tables = (
            engine.drag_speed,
            engine.drag_torque,
            table.rows,
            table.columns,
            np.minimum(1.0, table.columns / engine.pedal_fade),
            np.ravel(table.values),
        )
        return np.concatenate([numbers, *tables], dtype=float).tobytes()

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

    def actuation(
        self,
        force: float,
        speed: float,
        engine_speed: float,
        gear: int,
        engaged: bool,
        speed_soon: float,
    ) -> Actuation:
        """What each actuator does for a force at the wheels.

        Args:
          force: negative when it brakes [N].
          speed: of the truck [m/s].
          engine_speed: [rad/s].
          gear: engaged or last engaged one, forward.
          engaged: whether the engine is coupled; False in a gear change.
          speed_soon: speed once friction has built up [m/s].
        """
        found, ratio = Actuation(), self._ratios[self._row(gear)]
        _invert(self._constants, force, speed, engine_speed, ratio, engaged, speed_soon, found)
        return found


_invert = kernels.function(
    "iits_driveline_inverse",
    None,
    kernels.Address,
    *4 * [kernels.Real],
    kernels.Integer,
    kernels.Real,
    ctypes.POINTER(Actuation),
)
