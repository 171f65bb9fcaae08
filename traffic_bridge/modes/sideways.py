"""One lane change as it is shown: a quintic in its own time, slower where the vehicle is slow."""

from __future__ import annotations

from dataclasses import dataclass

SLOW = 5.0  # [m/s] below which a lane change takes longer, in proportion: nobody slides sideways
URGENT_PACE = 0.5
PACE_RATE = 1.0  # [1/s]
# Nobody goes sideways faster than this and the speed forward times that.
SIDE_SPEED, STEEPEST = 0.5, 0.7


def quintic(
    position: float, speed: float, acceleration: float, duration: float
) -> tuple[float, float, float, float, float, float]:
    """Coefficients c0..c5 of the polynomial from a given state to rest at zero.

    Takahashi, Hongo, Ninomiya and Sugimoto, "Local path planning and motion control for AGV in
    positioning", IROS 1989: the quintic minimises the integral of jerk squared.

    Args:
      position: at the beginning [m].
      speed: at the beginning [m/s].
      acceleration: at the beginning [m/s2].
      duration: until rest at zero [s].
    """
    t = duration
    c2 = 0.5 * acceleration
    end = -(position + speed * t + c2 * t**2)
    rate = -(speed + 2.0 * c2 * t)
    bend = -2.0 * c2
    c3 = (10.0 * end - 4.0 * rate * t + 0.5 * bend * t**2) / t**3
    c4 = (-15.0 * end + 7.0 * rate * t - bend * t**2) / t**4
    c5 = (6.0 * end - 3.0 * rate * t + 0.5 * bend * t**2) / t**5
    return position, speed, c2, c3, c4, c5


@dataclass
class SidewaysMotion:
    """A residual on its way to zero: polynomial, its age and its duration in its own time [s].

    `pace` is how fast that time goes now.
    """

    coefficients: tuple[float, float, float, float, float, float]
    duration: float
    age: float = 0.0
    pace: float | None = None

    def go_on(self, dt: float, speed: float, urgent: bool) -> float:
        """Ages the change by a step; how fast its own time goes, 0 to 1.

        Slow vehicles change slowly; who stands in somebody's way goes on, however slowly it drives.
        The pace itself is continuous, and nobody slides much faster sideways than it drives.
        """
        wanted = max(min(1.0, speed / SLOW), URGENT_PACE if urgent else 0.0)
        if self.pace is None:
            self.pace = wanted
        step = PACE_RATE * dt
        self.pace = min(max(wanted, self.pace - step), self.pace + step)
        rate = abs(self.state()[1])
        if rate > 0.0:
            self.pace = min(self.pace, (SIDE_SPEED + STEEPEST * speed) / rate)
        self.age += dt * self.pace
        return self.pace

    def state(self) -> tuple[float, float, float]:
        """Residual and its first two derivatives by the change's own time [m], [m/s], [m/s2]."""
        c0, c1, c2, c3, c4, c5 = self.coefficients
        t = self.age
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        )
