"""What the speed controller sees of a trajectory: planned speed and acceleration over time."""

from __future__ import annotations

from controllers.interpolation import interpolate
from iits_mj.messages import Trajectory


class SpeedView:
    """A trajectory made ready for many looks at it.

    Attributes:
      trajectory: planned.
      greatest: speed in it [m/s].
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.greatest = float(trajectory.speed.max())
        self._time = trajectory.time.tolist()
        self._speed = trajectory.speed.tolist()
        self._acceleration = trajectory.acceleration.tolist()

    def speed(self, time: float) -> float:
        """Planned speed at a time [m/s]."""
        return interpolate(time, self._time, self._speed)

    def acceleration(self, time: float) -> float:
        """Planned acceleration at a time [m/s2]."""
        return interpolate(time, self._time, self._acceleration)
