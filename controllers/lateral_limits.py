"""How much lateral acceleration the truck may be given: from its roll-over margin.

The threshold comes from the truck's parameters, its mass and the payload's height; the trailer
swings by the rearward amplification more than the tractor; the road takes its part by curvature
and cross-slope. What is left is the lane change's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.lateral_model import LateralModel
from controllers.roll_margin import rearward_amplification, roll_threshold
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters
from iits_mj.units import GRAVITY

_SPEEDS = np.array([3.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0])
_LAG = 0.1
# Masses are told apart by so much [kg]: an estimate may waver.
_MASS_STEP = 500.0


@dataclass(frozen=True)
class RollMargin:
    """What a truck of one mass can bear.

    Attributes:
      threshold: steady lateral acceleration at which it tips over [m/s2].
      amplification: of the trailer over the steer axle at `_SPEEDS`, shape (7,), 1 at least.
    """

    threshold: float
    amplification: FloatArray

    @classmethod
    def of(cls, parameters: TruckParameters, mass: float, frequency: float) -> RollMargin:
        """The margin at a gross mass [kg], for manoeuvres of a frequency [Hz]."""
        empty = parameters.gross_mass(0.0)
        payload = min(max(mass - empty, 0.0), parameters.payload.mass_max)
        model = LateralModel.of(parameters, empty + payload, _LAG)
        amplification = [rearward_amplification(model, float(v), frequency) for v in _SPEEDS]
        return cls(roll_threshold(parameters, payload), np.maximum(amplification, 1.0))

    def amplified(self, speed: float) -> float:
        """Rearward amplification at a speed [m/s], 1 at least."""
        return float(np.interp(speed, _SPEEDS, self.amplification))


class RollMargins:
    """Margins by mass, computed when first asked for.

    Args:
      parameters: of the truck, with the payload's height.
      frequency: of the quickest lane change [Hz].
    """

    def __init__(self, parameters: TruckParameters, frequency: float) -> None:
        self._parameters = parameters
        self._frequency = frequency
        self._known: dict[float, RollMargin] = {}

    def at(self, mass: float) -> RollMargin:
        """The margin at a gross mass [kg], to half a tonne."""
        step = _MASS_STEP * round(mass / _MASS_STEP)
        if step not in self._known:
            self._known[step] = RollMargin.of(self._parameters, step, self._frequency)
        return self._known[step]


def curve_speed_by_roll(
    curvature: FloatArray, superelevation: FloatArray, acceleration: float
) -> FloatArray:
    """Greatest speed at which a bend with its cross-slope gives so much, shape as curvature [m/s].

    `|v^2 kappa + g tan(superelevation)| <= a` on the side to which the bend presses.
    """
    room = acceleration - np.sign(curvature) * GRAVITY * np.tan(superelevation)
    return np.asarray(np.sqrt(np.maximum(room, 0.1) / np.maximum(np.abs(curvature), 1e-6)))
