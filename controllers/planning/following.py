"""Car following, and bounds on the speed by limits ahead.

Car following is the Intelligent Driver Model in its improved form (Treiber and Kesting, Traffic
Flow Dynamics, 2013, ch. 11.3.7) with the constant-acceleration heuristic of their ACC model: the
truck does not brake when the leader is faster, far, or has cut in without danger. Limits ahead
(speed limits, curves, ends) become one profile by a backward pass at a comfortable deceleration.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.planning.config import FollowingConfig
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.neighbors import Neighbor
from iits_mj.kernels import Address, Real

_idm = kernels.function("iits_idm_acceleration", Real, Address, *4 * [Real])
_follow = kernels.function("iits_follow_acceleration", Real, Address, *5 * [Real])
_lead_at = kernels.function("iits_lead_at", None, *3 * [Real], Address)
_Place = Real * 2


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
        found = _Place()
        _lead_at(self.speed, self.acceleration, time, found)
        return found[0], found[1]


def lead_table(leads: Sequence[Lead]) -> ctypes.Array[ctypes.c_double]:
    """The fields of leads one after the other, for the compiled functions."""
    numbers = [x for lead in leads for x in (lead.gap, lead.speed, lead.acceleration, lead.until)]
    return (Real * len(numbers))(*numbers)


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
    return float(_idm(config.table.address, speed, desired, gap, lead_speed))


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
    table = config.table.address
    return float(_follow(table, speed, desired, gap, lead_speed, lead_acceleration))


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
