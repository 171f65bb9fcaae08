"""Maneuvers of the Performance-Based Standards.

Source: the Rules named in `limits`, with ISO 14791 (pulse steer) and SAE J2179 (single lane
change), grade L. The lane change has a lateral acceleration of one sine at the steer axle: 0.15 g
at 0.4 Hz, which moves the truck by `a T^2 / (2 pi)` = 1.46 m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY, KMH

# Distance of the acceleration capability, from rest [m].
FROM_REST = 100.0


@dataclass(frozen=True)
class LaneChange:
    """Single lane change.

    Attributes:
      speed: [m/s]; period: of the sine [s]; peak: lateral acceleration [m/s2].
    """

    speed: float = 88.0 * KMH
    period: float = 2.5
    peak: float = 0.15 * GRAVITY

    @property
    def offset(self) -> float:
        """Lateral displacement [m]."""
        return self.peak * self.period**2 / (2.0 * np.pi)

    def path(self, station: FloatArray) -> FloatArray:
        """Lateral position of the steer axle [m] at stations from its beginning [m], any shape."""
        rate = 2.0 * np.pi / self.period
        phase = rate * np.clip(station / self.speed, 0.0, self.period)
        return np.asarray(self.peak / rate**2 * (phase - np.sin(phase)))


@dataclass(frozen=True)
class StraightPath:
    """Straight road with cross slope and unevenness.

    Attributes:
      speed: [m/s]; length: [m]; cross_slope: [1]; roughness: IRI [m/km].
    """

    speed: float = 90.0 * KMH
    length: float = 1000.0
    cross_slope: float = 0.03
    roughness: float = 3.8


@dataclass(frozen=True)
class LowSpeedTurn:
    """Turn of 90 degrees; the outer wall of the outer steer tire follows the arc.

    Attributes:
      speed: [m/s], at most; radius: [m]; angle: [rad].
    """

    speed: float = 5.0 * KMH
    radius: float = 12.5
    angle: float = 0.5 * np.pi


@dataclass(frozen=True)
class PulseSteer:
    """Pulse at the steering wheel, after which it is held straight.

    Attributes:
      speed: [m/s]; rise: time to the peak, and back [s]; peak: lateral acceleration of the steer
        axle [m/s2].
    """

    speed: float = 80.0 * KMH
    rise: float = 0.2
    peak: float = 2.0

    def steer(self, time: FloatArray) -> FloatArray:
        """The pulse with height 1 at times from its beginning [s], any shape."""
        return np.maximum(1.0 - np.abs(time / self.rise - 1.0), 0.0)
