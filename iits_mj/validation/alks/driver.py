"""The careful driver of UN R157 with a truck's brakes.

The regulation's driver brakes 0.4 s + 0.75 s after a risk, with 12.65 m/s3 up to 0.774 g, which a
car can. A truck takes longer and brakes less. Its brakes are measured here, and the driver's two
limits of a risk are derived again, so that the truck's driver is as careful as the car's:

- The time to collision of a risk is 2 s for the car, with which its driver avoids a vehicle that is
  slower by 2 a (2 s - 0.4 s - 0.75 s - 0.3 s) = 8.3 m/s. The truck's driver looks so far ahead that
  he avoids the same: 0.4 s + 0.75 s + lag + 8.3 m/s / (2 a).
- A vehicle ahead is a risk if it brakes with more than the same share of the own deceleration,
  5 m/s2 of 0.774 g.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.timing import TIMESTEP
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig
from iits_mj.validation.aeb.drives import (
    DECELERATION,
    DELAY,
    JERK,
    NEAR,
    PERCEPTION,
    RISKY_BRAKING,
    CarefulDriver,
    at,
    drive,
)
from iits_mj.validation.longitudinal import braking

# Lag of the car's brakes: half of the build-up [s].
CAR_LAG = 0.5 * DECELERATION / JERK
# Speed difference that the car's driver avoids, who perceives it at a time to collision of 2 s
# [m/s].
AVOIDED = 2.0 * DECELERATION * (NEAR - PERCEPTION - DELAY - CAR_LAG)
# Risk that begins the measured braking [s].
_BEGINS = 0.5


@dataclass(frozen=True)
class Brakes:
    """Brakes as a delay and a constant deceleration.

    Attributes:
      deceleration: mean fully developed one [m/s2].
      lag: at constant speed before it, with which the way to stop is the measured one [s].
    """

    deceleration: float
    lag: float

    @property
    def near(self) -> float:
        """Time to collision at which a risk begins for the driver [s]."""
        return PERCEPTION + DELAY + self.lag + AVOIDED / (2.0 * self.deceleration)

    @property
    def risky(self) -> float:
        """Deceleration of a vehicle ahead that is a risk, positive [m/s2]."""
        return RISKY_BRAKING * self.deceleration / DECELERATION

    def driver(self) -> CarefulDriver:
        """The careful driver with these brakes."""
        return CarefulDriver(self.near, self.risky)

    def gap_needed(self, slower: float, seen: float) -> float:
        """Least gap at which the driver avoids a vehicle that cuts in [m], inf if at none.

        Args:
          slower: speed difference [m/s].
          seen: time from the begin of its lane change until the driver perceives it [s].
        """
        if slower > AVOIDED:
            return math.inf  # From afar, too: the driver perceives it too late.
        wait = seen + PERCEPTION + DELAY + self.lag
        return slower * wait + 0.5 * slower**2 / self.deceleration


CAR = Brakes(DECELERATION, CAR_LAG)


def measure(config: DriveConfig, speed_kmh: float, road: Route, step: float = TIMESTEP) -> Brakes:
    """Measures the driver's full braking from a speed [km/h] on a road.

    Args:
      config: of the drive: truck and load.
      speed_kmh: [km/h].
      road: with its friction and grade.
      step: of the physics [s].
    """
    made = drive(
        at(config, speed_kmh, 60.0), (), road, guard=CarefulDriver(at_time=_BEGINS), timestep=step
    )
    braked = made.time >= made.time[np.flatnonzero(made.demand < 0.0)[0]]
    columns = ("time", "station", "speed")
    stop = dataclasses.replace(made, **{name: getattr(made, name)[braked] for name in columns})
    deceleration, speed = braking.fully_developed(stop), float(stop.speed[0])
    return Brakes(deceleration, braking.distance(stop) / speed - 0.5 * speed / deceleration)
