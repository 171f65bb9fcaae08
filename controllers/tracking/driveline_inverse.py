"""Inverse powertrain: from force at the wheels to accelerator, engine brake, retarder and XBR."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters


def interpolate(x: float, places: Sequence[float], values: Sequence[float]) -> float:
    """Linear interpolation of one value; the same bits as `np.interp`, faster on lists.

    Args:
      x: a number; NaN gives NaN.
      places: rising, at least one.
      values: finite, one for each place; the first and last hold beyond the ends.
    """
    if math.isnan(x):
        return x
    row = bisect_right(places, x) - 1
    if row < 0:
        return values[0]
    low = places[row]
    if row == len(places) - 1 or low == x:
        return values[row]
    value = values[row]
    return (values[row + 1] - value) / (places[row + 1] - low) * (x - low) + value


class EnduranceForces(NamedTuple):
    """Greatest braking forces at the wheels without friction, zero or positive [N].

    Attributes:
      drag: of the engine while the accelerator is released; 0 in a gear change.
      engine_brake, retarder: at full request.
    """

    drag: float
    engine_brake: float
    retarder: float


class Retardation(NamedTuple):
    """A braking force divided between the brakes.

    Attributes:
      engine_brake, retarder: share of the greatest force of each, 0 to 1.
      short: remainder for friction [N].
    """

    engine_brake: float
    retarder: float
    short: float


def share_out(force: float, endurance: EnduranceForces) -> Retardation:
    """Divides a braking force: engine drag, engine brake, retarder, friction in this order.

    Args:
      force: wanted at the wheels, positive when it brakes [N].
      endurance: available forces.
    """
    rest = max(force - endurance.drag, 0.0)
    engine_brake, rest = _take(rest, endurance.engine_brake)
    retarder, rest = _take(rest, endurance.retarder)
    return Retardation(engine_brake, retarder, rest)


def _take(force: float, available: float) -> tuple[float, float]:
    """Share of a brake used for a force, and the remainder of the force."""
    if available <= 0.0:
        return 0.0, force
    share = min(force / available, 1.0)
    return share, max(force - available, 0.0)


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
    """Static inverse of engine and driveline, and the truck's resistances."""

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
        # Equivalent mass of engine and gearbox by gear [kg].
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
        """Greatest torque of the engine brake beyond the drag [N m]: a power law, 0 at idle."""
        engine = self.parameters.engine
        above = engine_speed - engine.engine_brake_speed_min
        if above <= 0.0:
            return 0.0
        rated = engine.engine_brake_power / engine.engine_brake_speed
        relative = engine_speed / engine.engine_brake_speed
        torque = rated * relative ** (engine.engine_brake_exponent - 1.0)
        return min(above / engine.engine_brake_fade, 1.0) * torque

    def retarder_torque(self, shaft_speed: float) -> float:
        """Greatest torque of the cold retarder at the propeller shaft [N m]."""
        retarder = self.parameters.retarder
        if shaft_speed <= 0.0:
            return 0.0
        rise = min(shaft_speed / retarder.full_torque_speed, 1.0)
        return min(retarder.torque_max * rise**2, retarder.power_max / shaft_speed)

    def endurance(
        self, speed: float, engine_speed: float, gear: int, engaged: bool
    ) -> EnduranceForces:
        """Forces of drag, engine brake and retarder at the wheels, increased by losses.

        Args:
          speed: of the truck [m/s].
          engine_speed: [rad/s].
          gear: engaged gear.
          engaged: whether the engine is coupled; False in a gear change.
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
        # Over the first travel of the pedal, overrun changes to traction.
        most, rising = -math.inf, []
        columns = self._map_torques[row], self._map_torques[row + 1], self._fade, self._rise
        for below, above, fade, rise in zip(*columns, strict=True):
            most = max(most, fade * (rest * below + share * above + drag) - drag)
            rising.append(most + rise)
            # Larger torques do not change the result.
            if rising[-1] > torque:
                break
        return interpolate(torque, rising, self._pedals)
