"""Merging from a lane that ends: the choice of a gap in the next lane, and the speed to reach it.

The search tries every gap between neighbors of the target lane with constant accelerations over the
coming seconds, while the others keep their speed. A gap fits if both ends are long enough then and
the truck has left its lane before it ends. The search takes the cheapest gap; the gap of the last
cycle has a bonus. The choice only bounds the speed: leaders and limits still apply.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.config import MergeConfig, SafetyConfig
from controllers.planning.road_preview import LanePath
from controllers.planning.safety import front_gap_needed, rear_gap_needed
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.messages import Scene
from iits_mj.core.neighbors import Neighbors

# Tried decelerations and accelerations as shares of the greatest, and times to the gap [s].
_BRAKING = (1.0, 0.7, 0.45, 0.25, 0.1, 0.05, 0.0)
_DRIVING = (0.5, 1.0)
_TIMES = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 25.0)


@dataclass(frozen=True)
class GapChoice:
    """A gap and the motion to reach it.

    Attributes:
      acceleration: until the truck is beside the gap [m/s2]; speed: then [m/s].
      ends: names of the vehicles ahead of and behind the gap, "" for none.
    """

    acceleration: float
    speed: float
    ends: tuple[str, str]

    def cap(self, path: LanePath, station: float, speed: float) -> FloatArray | None:
        """Bound on the speed to meet the gap, shape of path.station [m/s]; None for none.

        Args:
          path: of the truck's lane.
          station: of the truck [m].
          speed: of the truck [m/s].
        """
        if self.acceleration > 0.0:
            return None
        ahead = np.maximum(path.station - station, 0.0)
        square = np.maximum(speed**2 + 2.0 * self.acceleration * ahead, self.speed**2)
        return np.asarray(np.sqrt(square))


def choose_gap(
    scene: Scene,
    target: LanePath,
    end: float,
    acceleration_max: float,
    speed_max: float,
    safety: SafetyConfig,
    config: MergeConfig,
    last: GapChoice | None = None,
) -> GapChoice | None:
    """The gap to aim for, or None if the truck can reach none in time.

    Args:
      scene: the truck and the traffic.
      target: path of the lane to merge into.
      end: station of the front by which the truck must have left its lane [m].
      acceleration_max: that the engine's power allows now [m/s2].
      speed_max: [m/s].
      safety: gaps to be left.
      config: settings.
      last: the choice of the last cycle.
    """
    neighbors = scene.neighbors
    tries = _tries(scene, end, acceleration_max, speed_max, config)
    inside = np.flatnonzero(neighbors.along_path(target, safety.entering))
    ordered = inside[np.argsort(-neighbors.station[inside], kind="stable")].tolist()
    best, cost = None, math.inf
    for leader, follower in itertools.pairwise([None, *ordered, None]):
        if _too_short(neighbors, leader, follower, safety):
            continue
        fits = np.flatnonzero(_fits(neighbors, leader, follower, tries, safety))
        if not fits.size:
            continue
        row = int(fits[0])
        ahead, behind = ("" if i is None else neighbors.ids[i] for i in (leader, follower))
        price = float(tries.price[row])
        price -= config.keep if last is not None and last.ends == (ahead, behind) else 0.0
        if price < cost:
            acceleration, speed = float(tries.acceleration[row]), float(tries.speed[row])
            best, cost = GapChoice(acceleration, speed, (ahead, behind)), price
    return best


def _too_short(
    neighbors: Neighbors, leader: int | None, follower: int | None, safety: SafetyConfig
) -> bool:
    """Whether a gap is too short for the truck now and at the last time tried."""
    if leader is None or follower is None:
        return False
    station, speed, length = neighbors.station, neighbors.speed, neighbors.length
    free = station[leader] - station[follower] - 0.5 * (length[leader] + length[follower])
    later = free + (speed[leader] - speed[follower]) * _TIMES[-1]
    return bool(max(free, later) < neighbors.front - neighbors.rear + 2.0 * safety.margin)


@dataclass(frozen=True)
class _Tries:
    """Accelerations [m/s2] over times [s], distance [m] and speed [m/s] then, cheapest first."""

    price: FloatArray
    acceleration: FloatArray
    time: FloatArray
    way: FloatArray
    speed: FloatArray


def _tries(
    scene: Scene, end: float, acceleration_max: float, speed_max: float, config: MergeConfig
) -> _Tries:
    """All combinations with which the truck leaves its lane before the lane ends."""
    now = scene.ego.speed
    driving = max(acceleration_max, 0.0)
    a = np.array([-config.deceleration * x for x in _BRAKING] + [driving * x for x in _DRIVING])
    acceleration, time = (part.ravel() for part in np.meshgrid(a, np.array(_TIMES)))
    bound = np.where(acceleration > 0.0, max(speed_max, now), min(config.speed_min, now))
    # The speed changes until it reaches the bound.
    with np.errstate(divide="ignore", invalid="ignore"):
        reached = np.where(acceleration == 0.0, np.inf, (bound - now) / acceleration)
    until = np.minimum(time, reached)
    speed = now + acceleration * until
    way = 0.5 * (now + speed) * until + speed * (time - until)
    price = acceleration**2 + config.patience * time
    able = scene.neighbors.front + way + speed * config.crossing_time <= end
    order = np.flatnonzero(able)[np.argsort(price[able], kind="stable")]
    return _Tries(*(part[order] for part in (price, acceleration, time, way, speed)))


def _fits(
    neighbors: Neighbors,
    leader: int | None,
    follower: int | None,
    tries: _Tries,
    safety: SafetyConfig,
) -> BoolArray:
    """Whether the truck fits between two vehicles after each try, shape (n,)."""
    fits = np.ones(len(tries.time), dtype=bool)
    for index, side in ((leader, -1.0), (follower, 1.0)):
        if index is None or not fits.any():
            continue
        speed = neighbors.speed[index]
        place = neighbors.station[index] + speed * tries.time + side * 0.5 * neighbors.length[index]
        others = np.full_like(place, speed)
        if side < 0.0:
            gap = place - (neighbors.front + tries.way)
            fits &= gap >= front_gap_needed(tries.speed, others, safety)
        else:
            gap = neighbors.rear + tries.way - place
            fits &= gap >= rear_gap_needed(tries.speed, others, safety)
    return fits
