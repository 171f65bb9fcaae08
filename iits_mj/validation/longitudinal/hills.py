"""Straight roads with ramps and hills, and a driver who holds a speed on them."""

from __future__ import annotations

import numpy as np

from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.road import Route
from iits_mj.road.design import Design
from iits_mj.validation.harness.recorder import PERIOD

# (station of the change [m], grade after it, length of the parabola [m]).
Grade = tuple[float, float, float]
_HILLS: tuple[Grade, ...] = (
    (250.0, 0.03, 200.0),
    (700.0, -0.02, 250.0),
    (1100.0, 0.04, 250.0),
    (1600.0, -0.045, 300.0),
    (2050.0, 0.02, 300.0),
    (2700.0, 0.0, 200.0),
)
HILLS_LENGTH = 3000.0


def sloping(length: float, initial: float, grades: tuple[Grade, ...]) -> Route:
    """A straight road along x that begins with grade `initial` (dz/ds).

    Raises:
      InputError: two changes of grade overlap.
    """
    return Design(
        name="slopes",
        alignment=((length, 0.0, 0.0, 0.0, 0.0),),
        initial_grade=initial,
        grades=grades,
    ).route()


def hills() -> Route:
    """3 km of hills with grades from -4.5 to +4 %; they end 18 m above their start."""
    return sloping(HILLS_LENGTH, 0.0, _HILLS)


# Gains of the controller: share per speed error [s/m], and per its integral [1/m].
_GAIN = 1.0
_INTEGRAL = 0.08
# The service brake works from the first to the second excess of speed [m/s].
_TOO_FAST, _BACK = 1.0, 0.2
_DECELERATION = 0.8


class SpeedKeeper:
    """Keeps a speed by pedal, then engine brake, then retarder, then the service brake.

    A PI controller of the speed gives a share: above 0 it is the accelerator pedal, 0 to -1 the
    engine brake, -1 to -2 the retarder. The service brake works from an excess of 1 m/s until the
    excess is 0.2 m/s. Call `command` every 10 ms.
    """

    def __init__(self, share: float = 0.0) -> None:
        """`share`: of the controller at the start, -2 to 1."""
        self._integral = share
        self.braking = False

    def command(self, speed: float, target: float) -> VehicleCommand:
        """The command at a speed, for a target speed [m/s]."""
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
