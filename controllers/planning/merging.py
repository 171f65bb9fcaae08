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

from controllers.planning.road_preview import LanePath
from controllers.planning.safety import SafetyConfig, front_gap_needed, rear_gap_needed
from controllers.planning.surroundings import Neighbor, Surroundings
from iits_mj.core.arrays import FloatArray

# Tried: braking as shares of the most allowed, and seconds until the truck is beside the gap.
_BRAKING = (1.0, 0.7, 0.45, 0.25, 0.1, 0.05, 0.0)
_DRIVING = (0.5, 1.0)
_TIMES = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 25.0)


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
    tries = _tries(surroundings, end, acceleration_max, speed_max, config)
    ordered = sorted(surroundings.in_lane(target, safety.entering), key=_station, reverse=True)
    ends: list[Neighbor | None] = [None, *ordered, None]
    best, cost = None, math.inf
    for leader, follower in itertools.pairwise(ends):
        if _never(surroundings, leader, follower, safety):
            continue
        fits = np.flatnonzero(_fits(surroundings, leader, follower, tries, safety))
        if not fits.size:
            continue
        row = int(fits[0])
        names = (_name(leader), _name(follower))
        price = float(tries.price[row])
        price -= config.keep if last is not None and last.ends == names else 0.0
        if price < cost:
            acceleration, speed = float(tries.acceleration[row]), float(tries.speed[row])
            best, cost = GapChoice(acceleration, speed, float(tries.time[row]), names), price
    return best


def _name(neighbor: Neighbor | None) -> str:
    """Name of a vehicle, "" for nobody."""
    return "" if neighbor is None else neighbor.vehicle.id


def _station(neighbor: Neighbor) -> float:
    return neighbor.vehicle.station


def _never(
    surroundings: Surroundings,
    leader: Neighbor | None,
    follower: Neighbor | None,
    safety: SafetyConfig,
) -> bool:
    """True for a gap that is too short for the truck now and at the last time tried."""
    if leader is None or follower is None:
        return False
    ahead, behind = leader.vehicle, follower.vehicle
    free = ahead.station - behind.station - 0.5 * (ahead.length + behind.length)
    later = free + (ahead.speed - behind.speed) * _TIMES[-1]
    return max(free, later) < surroundings.front - surroundings.rear + 2.0 * safety.margin


@dataclass(frozen=True)
class _Tries:
    """Accelerations [m/s2] and times [s], way [m] and speed [m/s] then, cheapest first, (n,)."""

    price: FloatArray
    acceleration: FloatArray
    time: FloatArray
    way: FloatArray
    speed: FloatArray


def _tries(
    surroundings: Surroundings,
    end: float,
    acceleration_max: float,
    speed_max: float,
    config: MergeConfig,
) -> _Tries:
    """What can be done before the lane ends."""
    now = surroundings.scene.ego.speed
    driving = max(acceleration_max, 0.0)
    a = np.array([-config.deceleration * x for x in _BRAKING] + [driving * x for x in _DRIVING])
    acceleration, time = (part.ravel() for part in np.meshgrid(a, np.array(_TIMES)))
    bound = np.where(acceleration > 0.0, max(speed_max, now), min(config.speed_min, now))
    # Until the bound is reached the speed changes, then it stays.
    with np.errstate(divide="ignore", invalid="ignore"):
        reached = np.where(acceleration == 0.0, np.inf, (bound - now) / acceleration)
    until = np.minimum(time, reached)
    speed = now + acceleration * until
    way = 0.5 * (now + speed) * until + speed * (time - until)
    price = acceleration**2 + config.patience * time
    able = surroundings.front + way + speed * config.crossing_time <= end
    order = np.flatnonzero(able)[np.argsort(price[able], kind="stable")]
    return _Tries(*(part[order] for part in (price, acceleration, time, way, speed)))


def _fits(
    surroundings: Surroundings,
    leader: Neighbor | None,
    follower: Neighbor | None,
    tries: _Tries,
    safety: SafetyConfig,
) -> NDArray[np.bool_]:
    """Whether the truck is then between the two with enough room at both ends, shape (n,)."""
    fits = np.ones(len(tries.time), dtype=bool)
    if leader is not None:
        other = leader.vehicle
        place = other.station + other.speed * tries.time - 0.5 * other.length
        gap = place - (surroundings.front + tries.way)
        fits &= gap >= front_gap_needed(tries.speed, np.full_like(gap, other.speed), safety)
    if follower is not None and fits.any():
        other = follower.vehicle
        place = other.station + other.speed * tries.time + 0.5 * other.length
        gap = surroundings.rear + tries.way - place
        fits &= gap >= rear_gap_needed(tries.speed, np.full_like(gap, other.speed), safety)
    return fits
