"""What the gearbox takes for a kick-down: the pedal near the floor, much above where it was."""

from __future__ import annotations

from iits_mj.parameters import TruckParameters

# Of the gearbox's thresholds: what stays surely below them [1].
_SURELY = 0.99


class KickDown:
    """Follows the accelerator as the gearbox does, call by call.

    Args:
      parameters: of the truck.
      step: between two calls [s].
    """

    def __init__(self, parameters: TruckParameters, step: float) -> None:
        shifting = parameters.gearbox.shifting
        self._near_floor = _SURELY * shifting.kick_down_pedal
        self._rise = _SURELY * shifting.kick_down_rise
        self._share = min(step / shifting.pedal_lag, 1.0)
        self.reset()

    def reset(self) -> None:
        """The pedal was up for long."""
        self._slow_pedal = 0.0

    def follow(self, pedal: float) -> None:
        """Hears the pedal of this call, 0 to 1."""
        self._slow_pedal += self._share * (pedal - self._slow_pedal)

    @property
    def greatest_pedal(self) -> float:
        """Position, 0 to 1, to which the pedal may be pressed now without a kick-down."""
        return min(max(self._near_floor, self._slow_pedal + self._rise), 1.0)
