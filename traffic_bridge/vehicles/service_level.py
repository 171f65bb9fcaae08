"""Levels of service A to F of the Highway Capacity Manual (HCM), and traffic of such a level.

The manual grades a motorway by its density in passenger cars. A heavy vehicle counts as two of them
(HCM 2016, exhibit 12-25, level terrain). The speed S falls with the flow v of passenger cars
(equation 12-1 with exhibit 12-6), with the free-flow speed FFS, the capacity c and the breakpoint
BP:

    S = FFS - (FFS - c / 45) (v - BP)^a / (c - BP)^a    if v > BP, else FFS

Drivers of the Intelligent Driver Model are slower than they desire behind a distant leader, too.
The manual's are not up to level C. A lower FFS (`FREE_SHARE`) spreads this difference over the
levels. Roads that are slower
than the manual's (45 mph) keep the shape of its slowest curve. HCM has no speed for level F: there
the speed is that at which the mean least distance of the drivers fills the road.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from traffic_bridge.vehicles.types import VehicleType

MILE = 1609.344  # [m]
MPH = MILE / 3600.0  # [m/s]
HEAVY_EQUIVALENT = 2.0  # passenger cars; from memory of the manual, not compared with its text
# Highest density of a level [passenger cars per mile and lane]: HCM 2016, exhibit 12-15.
BOUNDS = {"A": 11.0, "B": 18.0, "C": 26.0, "D": 35.0, "E": 45.0, "F": math.inf}
# Density of the simulated traffic of a level, likewise: about its middle; F: slow traffic.
TARGETS = {"A": 7.0, "B": 14.5, "C": 22.0, "D": 30.5, "E": 40.0, "F": 100.0}
CAPACITY_DENSITY = 45.0  # [passenger cars per mile and lane]
FREEWAY, SLOWEST = 55.0, 45.0  # [mph] lowest free-flow speeds of a freeway, and of the manual
# Free-flow speed over mean desired speed. It is fitted: with it, flow, density and speed of C and D
# are near the manual's as means of seeds 1 to 3 on 2 and 3 lanes at 80 and 130 km/h.
FREE_SHARE = 0.93
# Heavy vehicles on the right lane and on the others, over their mean share: most keep right.
HEAVY_ON_RIGHT, HEAVY_ON_OTHERS = 1.8, 0.2
FILL_SHARE = 0.95  # of the speed of the slowest type, with which vehicles are put on the road
BOTTLENECK_RATIO = 2.2  # speed limit at the end of the route over the speed of level F
BOTTLENECK = 300.0  # [m] at the end of the route with the speed of level F

Mix = Sequence[tuple[VehicleType, float]]  # types with their shares, whose sum is 1


@dataclass(frozen=True)
class SteadyFlow:
    """Density and mean speed of a steady flow, mean of the lanes.

    Attributes:
      density: [vehicles per m and lane]; speed: [m/s].
    """

    density: float
    speed: float

    @property
    def flow(self) -> float:
        """Vehicles per second and lane."""
        return self.density * self.speed


def heavy_share(mix: Mix) -> float:
    """Share of heavy vehicles."""
    return sum(share for kind, share in mix if kind.heavy)


def in_cars(density: float, heavy: float) -> float:
    """A density in passenger cars, for one in vehicles of which a share is heavy."""
    return density * (1.0 + heavy * (HEAVY_EQUIVALENT - 1.0))


def level_of(density: float) -> str:
    """The level of service at a density [passenger cars per m and lane]."""
    return next(name for name, bound in BOUNDS.items() if density * MILE <= bound)


def speed_at(density: float, free_speed: float) -> float:
    """Mean speed by the manual at a density [m/s].

    Args:
      density: [passenger cars per m and lane], from zero to that of the capacity.
      free_speed: free-flow speed [m/s].
    """
    free, wanted = free_speed / MPH, density * MILE
    if wanted == 0.0:
        return free_speed
    low, high = 0.0, free * wanted
    for _ in range(60):  # bisection: the speed falls as the flow rises
        flow = 0.5 * (low + high)
        low, high = (flow, high) if flow < wanted * _speed(flow, free) else (low, flow)
    return low / wanted * MPH


def _speed(flow: float, free: float) -> float:
    """HCM's speed [mph] at a flow [passenger cars per hour and lane] and free-flow speed [mph]."""
    curve = max(free, SLOWEST)
    if curve >= FREEWAY:
        capacity = min(2200.0 + 10.0 * (curve - 50.0), 2400.0)
        begin, exponent = 1000.0 + 40.0 * max(75.0 - curve, 0.0), 2.0
    else:  # a multilane highway
        capacity, begin, exponent = 1900.0 + 20.0 * (curve - 45.0), 1400.0, 1.31
    scale = free / curve
    share = max(flow / scale - begin, 0.0) / (capacity - begin)
    return scale * (curve - (curve - capacity / CAPACITY_DENSITY) * share**exponent)


def steady_flow(level: str, mix: Mix, speed_limit: float) -> SteadyFlow:
    """Density and speed of traffic of a level of service.

    Args:
      level: "A" to "F".
      mix: types and their shares.
      speed_limit: maximum speed of the traffic [m/s].
    """
    cars = TARGETS[level] / MILE
    density = cars / in_cars(1.0, heavy_share(mix))
    free = FREE_SHARE * sum(share * kind.mean_desired_speed(speed_limit) for kind, share in mix)
    if level != "F":
        return SteadyFlow(density, speed_at(cars, free))
    standing = _least_spacing(mix, 0.0)
    crawl = (1.0 / density - standing) / (_least_spacing(mix, 1.0) - standing)
    return SteadyFlow(density, min(max(crawl, 1.0), free))


def _least_spacing(mix: Mix, speed: float) -> float:
    """Mean distance of front bumpers if all drivers keep their least distance [m]."""
    return sum(
        share * (kind.length + kind.minimum_gap + kind.time_headway * speed) for kind, share in mix
    )


class LevelTraffic:
    """Draws vehicles and their places for a level of service.

    Args:
      mix: types and their shares.
      speed_limit: maximum speed of the traffic [m/s].
      steady: density and speed of the level.
    """

    def __init__(self, mix: Mix, speed_limit: float, steady: SteadyFlow) -> None:
        self._mix, self._limit, self._steady = mix, speed_limit, steady
        slowest = min(kind.mean_desired_speed(speed_limit) for kind, _ in mix)
        # Equal speeds of all, so that SUMO accepts the drivers' least distances.
        self.fill_speed = FILL_SHARE * min(steady.speed, slowest)
        self._shares = [_cumulative(mix, HEAVY_ON_RIGHT), _cumulative(mix, HEAVY_ON_OTHERS)]
        self._evenly = _cumulative(mix, 1.0)

    def draw(self, lane: int, lanes: int, rng: np.random.Generator) -> tuple[VehicleType, float]:
        """Draws a driver.

        Args:
          lane: index from the right.
          lanes: number of lanes of the road.
          rng: generator.

        Returns:
          The type with the driver's own time headway, and its desired speed [m/s].
        """
        shares = self._evenly if lanes == 1 else self._shares[min(lane, 1)]
        kind = self._mix[bisect_right(shares, rng.random())][0]
        driver = kind.sample_driver(rng)
        return driver, driver.sample_desired_speed(self._limit, rng)

    def along(
        self, lane: int, lanes: int, end: float, rng: np.random.Generator
    ) -> Iterator[tuple[float, VehicleType, float]]:
        """Draws the vehicles of a lane up to a position, at the density of the level.

        The distance of two vehicles is the least that the follower accepts, and an exponential
        rest.

        Args:
          lane: index from the right.
          lanes: number of lanes of the road.
          end: position [m].
          rng: generator.

        Yields:
          Position of the front bumper [m], driver, desired speed [m/s].
        """
        speed = self._steady.speed
        spacing = 1.0 / self._steady.density
        rest = max(spacing - _least_spacing(self._mix, speed), 0.0)
        position = spacing * float(rng.random())
        driver, desired = self.draw(lane, lanes, rng)
        while position < end:
            yield position, driver, desired
            gap = driver.minimum_gap + driver.time_headway * speed
            driver, desired = self.draw(lane, lanes, rng)
            position += gap + driver.length + rest * float(rng.exponential())


def _cumulative(mix: Mix, factor: float) -> list[float]:
    """Cumulative shares of the types when the heavy share is multiplied by a factor."""
    before = heavy_share(mix)
    after = min(before * factor, 1.0) if before < 1.0 else 1.0
    scale = {True: after / before if before else 0.0, False: 0.0}
    if before < 1.0:
        scale[False] = (1.0 - after) / (1.0 - before)
    total = np.cumsum([share * scale[kind.heavy] for kind, share in mix])
    return [float(value) for value in total / total[-1]]
