"""A lane that ends: which gap of the lane beside to aim for, and how fast to drive for it.

Every gap between neighbors of the target lane is tried with constant accelerations over the coming
seconds, all others going on at constant speed. A gap will do when both ends are long enough at
that moment and the truck is across before its lane ends. The gentlest wins; the one that was aimed
for last has a bonus. Speed is then only bounded: leaders and limits still rule.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.road_preview import LanePath
from controllers.safety import SafetyConfig, front_gap_needed, rear_gap_needed
from controllers.surroundings import Neighbor, Surroundings

FloatArray = NDArray[np.float64]

# Tried: braking as shares of the most allowed, and seconds until the truck is beside the gap.
_BRAKING = (1.0, 0.7, 0.45, 0.25, 0.1, 0.0)
_DRIVING = (0.5, 1.0)
_TIMES = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 13.0, 16.0)


@dataclass(frozen=True)
class MergeConfig:
    """How gaps are sought.

    Attributes:
      deceleration: at most, to let a gap come, positive [m/s2].
      speed_min: the truck does not go slower for a gap [m/s].
      crossing_time: from the change's begin until the truck has left its lane [s].
      room: kept before the end of the lane, in which a change from standstill is possible [m].
      stop_deceleration: towards that place when no gap opens, positive [m/s2].
      keep: bonus of the gap aimed for, in squares of acceleration.
      patience: cost of a second, in squares of acceleration.
    """

    deceleration: float = 1.5
    speed_min: float = 2.0
    crossing_time: float = 3.5
    room: float = 30.0
    stop_deceleration: float = 1.2
    keep: float = 0.2
    patience: float = 0.04


@dataclass(frozen=True)
class GapChoice:
    """A gap and the way to it.

    Attributes:
      acceleration: until the gap is reached [m/s2]; speed: then [m/s]; time: until then [s].
      ends: names of who is ahead of and behind the gap, "" for nobody.
    """

    acceleration: float
    speed: float
    time: float
    ends: tuple[str, str]

    def cap(self, path: LanePath, station: float, speed: float) -> FloatArray | None:
        """Bound on the speed that leads to the gap, shape of path.station [m/s]; None for none.

        Args:
          path: of the lane being driven.
          station: of the truck [m].
          speed: of the truck [m/s].
        """
        if self.acceleration > 0.0:
            return None
        ahead = np.maximum(path.station - station, 0.0)
        square = np.maximum(speed**2 + 2.0 * self.acceleration * ahead, self.speed**2)
        return np.asarray(np.sqrt(square))


def choose_gap(
    surroundings: Surroundings,
    target: LanePath,
    end: float,
    acceleration_max: float,
    speed_max: float,
    safety: SafetyConfig,
    config: MergeConfig,
    last: GapChoice | None = None,
) -> GapChoice | None:
    """The gap to aim for, or None where none can be reached in time.

    Args:
      surroundings: the traffic.
      target: lane to get into.
      end: station at which the truck's front must have left its lane [m].
      acceleration_max: that the truck has left now [m/s2].
      speed_max: not to be exceeded [m/s].
      safety: gaps to be left.
      config: settings.
      last: the choice of the last cycle.
    """
    speed = surroundings.scene.ego.speed
    ordered = sorted(surroundings.in_lane(target, safety.entering), key=_station, reverse=True)
    ends: list[Neighbor | None] = [None, *ordered, None]
    accelerations = [-config.deceleration * share for share in _BRAKING]
    accelerations += [max(acceleration_max, 0.0) * share for share in _DRIVING]
    best, cost = None, math.inf
    for leader, follower in itertools.pairwise(ends):
        names = tuple("" if one is None else one.vehicle.id for one in (leader, follower))
        bonus = config.keep if last is not None and last.ends == names else 0.0
        for acceleration in accelerations:
            for time in _TIMES:
                price = acceleration**2 + config.patience * time - bonus
                if price >= cost:
                    break
                way, reached = _motion(speed, acceleration, time, config.speed_min, speed_max)
                last_place = surroundings.front + way + reached * config.crossing_time
                if last_place > end:
                    break
                if _fits(surroundings, leader, follower, way, reached, time, safety):
                    best, cost = GapChoice(acceleration, reached, time, (names[0], names[1])), price
                    break
    return best


def _station(neighbor: Neighbor) -> float:
    return neighbor.vehicle.station


def _motion(
    speed: float, acceleration: float, time: float, low: float, high: float
) -> tuple[float, float]:
    """Way [m] and speed [m/s] after a time at an acceleration, the speed kept within bounds."""
    bound = max(high, speed) if acceleration > 0.0 else min(low, speed)
    if acceleration == 0.0 or (bound - speed) / acceleration >= time:
        return speed * time + 0.5 * acceleration * time**2, speed + acceleration * time
    until = (bound - speed) / acceleration
    return 0.5 * (speed + bound) * until + bound * (time - until), bound


def _fits(
    surroundings: Surroundings,
    leader: Neighbor | None,
    follower: Neighbor | None,
    way: float,
    speed: float,
    time: float,
    safety: SafetyConfig,
) -> bool:
    """Whether the truck, moved on by `way`, is between the two with enough room at both ends."""
    if leader is not None:
        other = leader.vehicle
        place = other.station + other.speed * time - 0.5 * other.length
        gap = place - (surroundings.front + way)
        if gap < front_gap_needed(speed, other.speed, safety):
            return False
    if follower is not None:
        other = follower.vehicle
        place = other.station + other.speed * time + 0.5 * other.length
        gap = surroundings.rear + way - place
        if gap < rear_gap_needed(speed, other.speed, safety):
            return False
    return True
