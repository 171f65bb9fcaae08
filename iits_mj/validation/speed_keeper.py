"""A driver who keeps a speed: pedal, then engine brake, then retarder, then the service brake.

One PI controller on the speed asks for a share: positive is accelerator pedal, 0 to -1 engine
brake, -1 to -2 retarder. The service brake comes in when the truck is 1 m/s too fast all the same,
and stays until the speed is back.
"""

from __future__ import annotations

import numpy as np

from iits_mj.messages import VehicleCommand, XbrMode
from iits_mj.validation.recorder import PERIOD

# Share per speed error [s/m], and its integral [1/m].
_GAIN = 1.0
_INTEGRAL = 0.08
_TOO_FAST, _BACK = 1.0, 0.2
_DECELERATION = 0.8


class SpeedKeeper:
    """Call `command` every 10 ms; remembers its integral and whether it brakes."""

    def __init__(self, share: float = 0.0) -> None:
        """`share`: what the controller begins with, -2 to 1."""
        self._integral = share
        self.braking = False

    def command(self, speed: float, target: float) -> VehicleCommand:
        """What to command at a speed when another is wanted [m/s]."""
        error = target - speed
        share = _GAIN * error + self._integral
        if -2.0 < share < 1.0:  # no wind-up at the ends
            self._integral += _INTEGRAL * error * PERIOD
        self.braking = -error > (_BACK if self.braking else _TOO_FAST)
        return VehicleCommand(
            accelerator_pedal=float(np.clip(share, 0.0, 1.0)),
            engine_brake=float(np.clip(-share, 0.0, 1.0)),
            retarder=float(np.clip(-share - 1.0, 0.0, 1.0)),
            xbr_mode=XbrMode.MAXIMUM if self.braking else XbrMode.OFF,
            xbr_demand=-_DECELERATION if self.braking else 0.0,
        )
