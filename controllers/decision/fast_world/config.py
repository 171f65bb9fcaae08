"""What the fast world's traffic is: kinds of vehicles, densities, and the IDM they follow by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Kind:
    """A kind of vehicle: share of the traffic, size [m], IDM's T [s], speed factor's spread."""

    name: str
    share: float
    length: float
    width: float
    height: float
    time_gap: float
    factor_mean: float
    factor_deviation: float
    factor_low: float


# Shares, sizes, gaps and speed factors are the SUMO traffic's, traffic_bridge/vehicles/types.toml.
KINDS = (
    Kind("car", 0.70, 4.7, 1.85, 1.5, 1.5, 0.95, 0.07, 0.75),
    Kind("van", 0.12, 6.0, 2.05, 2.6, 1.5, 0.92, 0.06, 0.75),
    Kind("truck", 0.08, 9.5, 2.50, 3.6, 2.0, 0.85, 0.05, 0.70),
    Kind("articulated", 0.10, 16.5, 2.55, 4.0, 2.0, 0.82, 0.05, 0.68),
)
SHARES = tuple(kind.share for kind in KINDS)


@dataclass(frozen=True)
class HighwayConfig:
    """The traffic of the fast world. SI units.

    Attributes:
      spawn_probability: of a vehicle appearing per lane and `spawn_period`.
      spawn_period: clock of the spawn probability [s].
      traffic_speed: speed limit of the traffic [m/s].
      window_behind, window_ahead: the simulated stretch about the truck [m].
      timestep: of the traffic and the truck [s].
      standstill_gap: IDM's s0 [m]; acceleration, deceleration: IDM's a and b [m/s2].
      politeness, change_threshold: MOBIL's p and threshold [m/s2].
      safe_deceleration: MOBIL's limit on what a change may ask of the follower [m/s2].
      keep_right_bias: MOBIL's bias to the right lane [m/s2].
    """

    spawn_probability: float = 0.05
    spawn_period: float = 1.0
    traffic_speed: float = 12.5
    window_behind: float = 250.0
    window_ahead: float = 450.0
    timestep: float = 0.2
    standstill_gap: float = 2.5
    acceleration: float = 1.2
    deceleration: float = 2.0
    politeness: float = 0.3
    change_threshold: float = 0.25
    safe_deceleration: float = 3.0
    keep_right_bias: float = 0.1

    def __post_init__(self) -> None:
        """Refuses values that are not finite or make no traffic."""
        for name in ("spawn_period", "traffic_speed", "timestep", "acceleration", "deceleration"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{name} = {value!r} is not allowed: use a number above 0")
        if not 0.0 <= self.spawn_probability <= 1.0:
            raise InputError(f"spawn_probability = {self.spawn_probability!r}: use 0 to 1")

    @property
    def mean_headway(self) -> float:
        """Mean distance between the fronts of vehicles of a lane [m]; inf without traffic."""
        rate = self.spawn_probability / self.spawn_period
        return self.traffic_speed / rate if rate > 0.0 else math.inf


@dataclass(frozen=True)
class Obstacle:
    """The truck as the traffic sees it, in one lane: front bumper, length, speed, lane."""

    front: float
    length: float
    speed: float
    lane: int


def idm_acceleration(
    speed: FloatArray,
    desired: FloatArray,
    gap: FloatArray,
    leader_speed: FloatArray,
    time_gap: FloatArray,
    config: HighwayConfig,
) -> FloatArray:
    """IDM acceleration [m/s2], Treiber et al. (2000) eq. 3; arrays of one shape, gap inf if free.

    Above the desired speed the free term is bounded at -b, which the original leaves unbounded.
    """
    a, b = config.acceleration, config.deceleration
    free = a * np.maximum(1.0 - (speed / desired) ** 4, -b / a)
    wanted = config.standstill_gap + np.maximum(
        0.0, speed * time_gap + speed * (speed - leader_speed) / (2.0 * math.sqrt(a * b))
    )
    interaction = a * (wanted / np.maximum(gap, 0.1)) ** 2
    return np.clip(free - interaction, -8.0, a)
