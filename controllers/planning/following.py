"""Car following, and bounds on the speed by limits ahead.

Car following is the Intelligent Driver Model in its improved form (Treiber and Kesting, Traffic
Flow Dynamics, 2013, ch. 11.3.7) with the constant-acceleration heuristic of their ACC model: the
truck does not brake when the leader is faster, far, or has cut in without danger. Limits ahead
(speed limits, curves, ends) become one profile by a backward pass at a comfortable deceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.config import FollowingConfig
from iits_mj.core.arrays import FloatArray
from iits_mj.core.neighbors import Neighbor


@dataclass(frozen=True, slots=True)
class Lead:
    """A vehicle to follow; its acceleration fades over 2 s and ends when it stops.

    Attributes:
      gap: bumper to bumper now [m]; speed: [m/s]; acceleration: [m/s2].
      until: time from now after which it no longer counts [s].
    """

    gap: float
    speed: float
    acceleration: float = 0.0
    until: float = math.inf

    @classmethod
    def of(cls, neighbor: Neighbor, until: float = math.inf) -> Lead:
        """The lead for a vehicle ahead."""
        return cls(neighbor.gap, max(neighbor.speed, 0.0), neighbor.acceleration, until)

    def at(self, time: float) -> tuple[float, float]:
        """Distance driven since now [m] and speed [m/s], by `a(t) = a exp(-t / 2 s)`."""
        fade = 2.0 * (1.0 - math.exp(-0.5 * time))
        speed = self.speed + self.acceleration * fade
        if speed <= 0.0 < -self.acceleration:
            return self.speed**2 / max(-2.0 * self.acceleration, 1e-3), 0.0
        way = self.speed * time + self.acceleration * 2.0 * (time - fade)
        return max(way, 0.0), max(speed, 0.0)


def idm_acceleration(
    speed: float, desired: float, gap: float, lead_speed: float, config: FollowingConfig
) -> float:
    """Acceleration of the improved IDM [m/s2]: its free term falls to -b above the desired speed.

    Args:
      speed: own [m/s].
      desired: speed on the free road [m/s], positive.
      gap: [m]; infinite on the free road.
      lead_speed: [m/s].
      config: parameters.
    """
    a, b = config.acceleration_max, config.deceleration
    desired = max(desired, 0.1)
    if speed <= desired:
        free = a * (1.0 - (speed / desired) ** config.exponent)
    else:
        free = -b * (1.0 - (desired / speed) ** (a * config.exponent / b))
    wanted = config.standstill_gap + max(
        0.0,
        speed * config.time_gap + speed * (speed - lead_speed) / (2.0 * math.sqrt(a * b)),
    )
    ratio = wanted / max(gap, 0.1)
    if ratio >= 1.0:
        return a * (1.0 - ratio**2) + min(free, 0.0)
    if speed > desired or free <= 1e-6:
        return free
    return free * (1.0 - ratio ** (2.0 * a / free))


def follow_acceleration(
    speed: float,
    desired: float,
    gap: float,
    lead_speed: float,
    lead_acceleration: float,
    config: FollowingConfig,
) -> float:
    """Acceleration of the ACC model [m/s2]: IDM with the constant-acceleration heuristic.

    Source: Kesting, Treiber and Helbing, Phil. Trans. R. Soc. A 368 (2010), equations 2.6 to 2.8.
    """
    idm = idm_acceleration(speed, desired, gap, lead_speed, config)
    if not math.isfinite(gap):
        return idm
    # The heuristic stops at the standstill gap, too: the source has the bare gap.
    gap = max(gap - config.standstill_gap, 0.1)
    lead = min(lead_acceleration, config.acceleration_max)
    closing = speed - lead_speed
    if lead < 0.0 and lead_speed * closing <= -2.0 * gap * lead:
        heuristic = speed**2 * lead / (lead_speed**2 - 2.0 * gap * lead)
    else:
        heuristic = lead - max(closing, 0.0) ** 2 / (2.0 * gap)
    if idm >= heuristic:
        return idm
    regain = config.regain_deceleration
    tempered = heuristic + regain * math.tanh((idm - heuristic) / regain)
    return (1.0 - config.coolness) * idm + config.coolness * tempered


def braking_profile(station: FloatArray, limit: FloatArray, deceleration: float) -> FloatArray:
    """Greatest speed that meets every limit ahead at a deceleration, shape as station [m/s].

    `v(s)^2 = min over s' >= s of limit(s')^2 + 2 b (s' - s)`.
    """
    lifted = np.minimum(limit, 100.0) ** 2 + 2.0 * deceleration * station
    ahead = np.minimum.accumulate(lifted[::-1])[::-1]
    return np.sqrt(np.maximum(ahead - 2.0 * deceleration * station, 0.0))


def curve_speed(curvature: FloatArray, lateral_acceleration: float) -> FloatArray:
    """Greatest speed at a lateral acceleration, `sqrt(a / |kappa|)`, shape as curvature [m/s]."""
    return np.asarray(np.sqrt(lateral_acceleration / np.maximum(np.abs(curvature), 1e-6)))


def required_deceleration(gap: float, speed: float, lead_speed: float, margin: float) -> float:
    """Constant deceleration that just avoids closing the gap to `margin`, positive [m/s2]."""
    closing = speed - lead_speed
    if closing <= 0.0:
        return 0.0
    return closing**2 / (2.0 * max(gap - margin, 0.1))
