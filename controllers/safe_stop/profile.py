"""Speed over the coming seconds of a smooth stop: jerk-limited, eased at standstill."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError


@dataclass(frozen=True, slots=True)
class StopLimits:
    """How a stop is made; all positive.

    Attributes:
      deceleration: of the stop's middle part [m/s2].
      jerk: greatest change of the deceleration on the way there [m/s3].
      jerk_end: the same on the way to standstill, at most `jerk` [m/s3].
      deceleration_end: what is left of the deceleration when the truck comes to rest [m/s2].
    """

    deceleration: float = 1.5
    jerk: float = 1.0
    jerk_end: float = 0.8
    deceleration_end: float = 0.25

    def __post_init__(self) -> None:
        for name in ("deceleration", "jerk", "jerk_end", "deceleration_end"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 < value <= 10.0):
                raise InputError(f"stop limit {name} = {value!r}: allowed is above 0 to 10")
        if self.jerk_end > self.jerk:
            raise InputError(
                f"stop limit jerk_end = {self.jerk_end!r}: at most jerk = {self.jerk!r}"
            )
        if self.deceleration_end > self.deceleration:
            raise InputError(
                f"stop limit deceleration_end = {self.deceleration_end!r}: at most "
                f"deceleration = {self.deceleration!r}"
            )

    def wanted(self, speed: float) -> float:
        """Acceleration at a speed [m/s2], zero or negative.

        The end is at constant jerk: `a^2 = a_end^2 + 2 jerk_end v`.
        """
        eased = math.sqrt(self.deceleration_end**2 + 2.0 * self.jerk_end * max(speed, 0.0))
        return -min(self.deceleration, eased)


@dataclass(frozen=True, slots=True)
class StopStart:
    """Where a stop's plan begins: station [m], speed [m/s], acceleration [m/s2]."""

    station: float
    speed: float
    acceleration: float


def roll_to_stop(
    start: StopStart, limits: StopLimits, steps: int, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Station, speed and acceleration at steps + 1 instants, the first being now.

    Args:
      start: initial state; a speed below zero counts as standstill.
      limits: of the stop.
      steps: number of steps.
      step: [s].
    """
    station, speed, acceleration = (np.zeros(steps + 1) for _ in range(3))
    s, v, a = start.station, max(start.speed, 0.0), start.acceleration
    reach = limits.jerk * step
    for k in range(steps + 1):
        if k:
            # Standing still within the step: the way to the stop, not beyond.
            stays = v + a * step > 0.0
            s += v * step + 0.5 * a * step**2 if stays else 0.5 * v * step
            v = max(v + a * step, 0.0)
            a = min(max(limits.wanted(v), a - reach), a + reach)
        if v <= 0.0:
            a = 0.0
        station[k], speed[k], acceleration[k] = s, v, a
    return station, speed, acceleration


def stop_distance(speed: float, acceleration: float, limits: StopLimits) -> float:
    """Way to standstill [m] from a speed [m/s] and acceleration [m/s2]."""
    step = 0.05
    way, v, a = 0.0, max(speed, 0.0), acceleration
    reach = limits.jerk * step
    while v > 0.0:
        v_next = max(v + a * step, 0.0)
        way += 0.5 * (v + v_next) * step
        v = v_next
        a = min(max(limits.wanted(v), a - reach), a + reach)
    return way
