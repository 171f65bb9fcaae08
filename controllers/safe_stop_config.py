"""Settings of the stop in lane, and its phases."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from controllers.lane_change import LaneChangeConfig
from controllers.lateral import LateralConfig
from controllers.stop_profile import StopLimits
from iits_mj.errors import InputError


class StopPhase(enum.Enum):
    """Where a stop stands."""

    BRAKING = "braking"
    STANDING = "standing"
    PARKED = "parked"


@dataclass(frozen=True)
class SafeStopConfig:
    """Settings of the stop.

    Attributes:
      limits: deceleration and jerk, see `StopLimits`.
      deceleration_max: where lane or road end too soon for that [m/s2].
      look_ahead: how long a sideways motion is followed to choose the lane [s].
      off_center: distance from the lane's middle that a curve of its own leads back from [m].
      stop_gap: left before the end of lane or road, from the front bumper [m].
      resync_speed: the plan's speed stays within this of the truck's [m/s].
      speed_gain: deceleration added for a speed above the plan's [1/s].
      lead_time: the planned deceleration is asked for this much earlier, for the brakes' lag [s].
      hold_demand: XBR demand at standstill [m/s2].
      neutral_speed: below it the driveline is opened, so that no gear change jolts the stop [m/s].
      standing_speed: below it the truck stands [m/s].
      standing_time: standing before the parking brake is set [s].
      parking_time: service brakes held beside the parking brake while its springs act [s].
      horizon: of the plan [s]; step: of its points [s]; plan_period: between plans [s].
      control_period: between commands [s], the step of `lateral`.
      preview: how far ahead lane and road are looked at [m].
      change: lateral limits of finding the lane's middle.
      lateral: settings of the path law.
    """

    limits: StopLimits = field(default_factory=StopLimits)
    deceleration_max: float = 4.0
    look_ahead: float = 1.0
    off_center: float = 0.2
    stop_gap: float = 3.0
    resync_speed: float = 0.5
    speed_gain: float = 0.5
    lead_time: float = 0.3
    hold_demand: float = 1.5
    neutral_speed: float = 6.0
    standing_speed: float = 0.05
    standing_time: float = 1.0
    parking_time: float = 2.0
    horizon: float = 4.0
    step: float = 0.1
    plan_period: float = 0.1
    control_period: float = 0.02
    preview: float = 500.0
    change: LaneChangeConfig = field(default_factory=LaneChangeConfig)
    lateral: LateralConfig = field(default_factory=LateralConfig)

    def __post_init__(self) -> None:
        if not self.limits.deceleration <= self.deceleration_max <= 10.0:
            raise InputError(
                f"deceleration_max = {self.deceleration_max!r} m/s2: allowed is the deceleration "
                f"{self.limits.deceleration:g} to 10"
            )
        for name in ("standing_time", "parking_time", "stop_gap", "off_center", "look_ahead"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} = {value!r}: a finite number, zero or more, is wanted")
