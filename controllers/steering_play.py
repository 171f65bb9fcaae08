"""The play of the steering gear: how the wheel is turned so that the road wheels do as demanded.

The gear's output follows the steering wheel only while one of the two flanks of its play touches;
when the direction turns, the wheel has to cross the play first and the road wheels rest meanwhile.
Crossing at every small reversal makes the wheel jump to and fro in a long bend. So the wheel stays
on its flank until what is missing on the other side is worth it, and then crosses at a steady rate.
The inverse of play is that of Tao and Kokotovic (1996), with hysteresis and a bounded rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from iits_mj.parameters import Steering


@dataclass(frozen=True)
class PlayConfig:
    """When and how the play is crossed.

    Attributes:
      missing_acceleration: lateral acceleration that may be missing before a crossing [m/s2].
      missing_angle: the same as road wheel angle, at low speed [rad].
      crossing_rate: of the steering wheel [rad/s].
    """

    missing_acceleration: float = 0.03
    missing_angle: float = 1e-3
    crossing_rate: float = 0.35


class SteeringPlay:
    """Knows on which flank the gear stands; one call every control step.

    Args:
      steering: ratio and width of the play.
      config: see `PlayConfig`.
    """

    def __init__(self, steering: Steering, config: PlayConfig) -> None:
        self.steering = steering
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Knows nothing of the gear."""
        self._output: float | None = None
        self._flank = 1.0
        self._wheel = 0.0

    def follow(self, wheel: float, road_wheel: float) -> float:
        """The gear's output, seen from the wheel's side [rad].

        Dragged along by the measured wheel within the play; at the first call it is read from the
        road wheels, later their compliance would disturb it.

        Args:
          wheel: angle of the steering wheel as measured [rad].
          road_wheel: mean angle of the road wheels as measured [rad].
        """
        half = 0.5 * self.steering.dead_band
        if self._output is None:
            self._output = road_wheel * self.steering.ratio
            self._flank = math.copysign(1.0, wheel - self._output)
            self._wheel = wheel
        self._output = min(max(self._output, wheel - half), wheel + half)
        return self._output

    def turn(self, demand: float, gain: float, step: float) -> float:
        """Wheel angle [rad] that brings the gear's output to the demand.

        Args:
          demand: of the road wheels' angle [rad].
          gain: lateral acceleration by road wheel angle, steady [m/s2 per rad].
          step: since the last call [s].
        """
        config, ratio = self.config, self.steering.ratio
        half = 0.5 * self.steering.dead_band
        output = demand * ratio if self._output is None else self._output
        missing = demand * ratio - output
        bearable = min(config.missing_angle, config.missing_acceleration / max(gain, 1e-6))
        if missing * self._flank < -bearable * ratio:
            self._flank = -self._flank
        # Off its flank the wheel would only lose what it has.
        target = output + self._flank * (max(missing * self._flank, 0.0) + half)
        contact = output + self._flank * half
        reach = config.crossing_rate * step
        crossed = (contact - self._wheel) * self._flank
        if crossed > reach:
            self._wheel += self._flank * reach
        else:
            self._wheel = target
        most = self.steering.angle_max
        self._wheel = min(max(self._wheel, -most), most)
        return self._wheel
