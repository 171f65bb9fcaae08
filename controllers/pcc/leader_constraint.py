"""The vehicle ahead as a fence: the earliest time at which each station may be passed."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, durations, full_power_speed
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError

LEAST_PACE = 0.5  # [m/s] of a leader that stands: it is to be met, not waited for
_CRAWL = 1.2  # [m/s] that braking ends at: above the 1 m/s of plans behind a leader
_BRAKE_SHARE = 0.8  # of the planned braking force, so that the fence leaves the optimizer room


@dataclass(frozen=True)
class Leader:
    """The vehicle ahead.

    Attributes:
      rear: station at which the truck's reference point is when its bumper touches the leader [m].
      speed: [m/s]; acceleration: [m/s2]; it is taken to fade over a second.
    """

    rear: float
    speed: float
    acceleration: float = 0.0

    def __post_init__(self) -> None:
        """Refuses numbers that are not finite."""
        for name in ("rear", "speed", "acceleration"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise InputError(f"leader: {name} is {value!r}: must be finite")

    @property
    def pace(self) -> float:
        """Speed that it is taken to go on at [m/s]."""
        return max(self.speed + self.acceleration, LEAST_PACE)


@dataclass(frozen=True)
class FenceConfig:
    """What is kept to the vehicle ahead.

    The gaps are a little less than those of the trajectory planner's car following, which rules
    when the truck is near: who plans to stay farther behind never comes near enough to pass.

    Attributes:
      time_gap: [s]; standstill_gap: further distance to it [m].
      regain: time in which a gap that is too short is won back to a third [s].
      deceleration: greatest that a plan has for a vehicle's sake [m/s2].
      slower: greatest difference to its speed while falling back [m/s].
      hold: for so long it is predicted to go on; after that it is out of the way, or passed [s].
      horizon: of plans behind a vehicle [m].
      jam: behind vehicles slower than this nothing is optimized [m/s].
    """

    time_gap: float = 1.2
    standstill_gap: float = 4.0
    regain: float = 30.0
    deceleration: float = 0.5
    slower: float = 1.5
    hold: float = 12.0
    horizon: float = 2_000.0
    jam: float = 4.0

    def __post_init__(self) -> None:
        """Refuses numbers that are not finite or not above 0."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{field.name} = {value!r} is not allowed: use a number above 0")

    def clear(self, leader: Leader) -> float:
        """Station up to which a standing truck might roll [m]."""
        return leader.rear - self.standstill_gap


@dataclass(frozen=True)
class Fence:
    """The vehicle ahead in a plan; both of shape (n + 1,).

    Attributes:
      time: earliest time from now at which each node may be passed [s].
      slowest: least speeds that the plan may have to that end [m/s].
    """

    time: FloatArray
    slowest: FloatArray

    def kept(self, road: RoadProfile, speed: FloatArray, early: float = 0.0) -> bool:
        """Whether node speeds stay behind it, or pass it by at most `early` seconds too soon."""
        return bool((_clock(road, speed) >= self.time - early - 1e-6).all())


def fence_of(
    vehicle: PointMass, road: RoadProfile, speed: float, leader: Leader, config: FenceConfig
) -> Fence:
    """The fence of a vehicle that goes on at its speed for a while.

    Not for long: who plans to stay behind a slow vehicle two kilometers on slows down now, and
    hangs back to be fast when it should be gone. A gap that is too short now, as after a cut-in,
    is won back over some time, and no more is asked for than comfortable braking can do: no fence
    makes a problem infeasible, and what braking it takes beyond that is the trajectory planner's.

    Args:
      vehicle: the truck.
      road: ahead, from where it is.
      speed: of the truck [m/s].
      leader: the vehicle.
      config: gaps.

    Raises:
      PlanningError: a climb is beyond full power.
    """
    pace = leader.pace
    way = road.station - road.station[0]
    floor = min(max(pace - config.slower, 0.5 * pace), speed)
    braked = easing_speeds(road, speed, floor, config.deceleration)
    # On a climb it may be slower still: as slow as full power makes who arrives there so slowly.
    slowest = 0.99 * full_power_speed(vehicle, road, speed, braked)
    slowest[0] = speed
    passing = (road.station - config.clear(leader)) / pace + config.time_gap
    lost = max(speed - pace, 0.0) ** 2 / (2.0 * config.deceleration) / pace
    missing = max(float(passing[0]) + lost, 0.0)
    passing = passing - missing * np.exp(-way / (config.regain * max(speed, LEAST_PACE)))
    # Once the vehicle is gone nothing is in the way: nobody needs to pass later than that.
    passing = np.clip(passing, 0.0, config.hold)
    return Fence(np.minimum(passing, 0.98 * _clock(road, slowest)), slowest)


def _clock(road: RoadProfile, speed: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(durations(speed, road))])


def approach_speeds(
    road: RoadProfile, speed: float, leader: Leader, config: FenceConfig
) -> FloatArray:
    """Node speeds (n + 1,) that come down to a leader's at the deceleration of the settings.

    The trajectory planner does the following itself; this only saves driving up to a jam.
    """
    end = max(leader.pace, config.jam)
    way = np.maximum(config.clear(leader) - road.station, 0.0)
    wanted = np.sqrt(end**2 + 2.0 * config.deceleration * way)
    return np.asarray(np.maximum(wanted, easing_speeds(road, speed, end, config.deceleration)))


def easing_speeds(road: RoadProfile, speed: float, end: float, deceleration: float) -> FloatArray:
    """Node speeds (n + 1,) that come down to an end speed [m/s] at a deceleration [m/s2]."""
    way = road.station - road.station[0]
    return np.asarray(np.sqrt(np.maximum(speed**2 - 2.0 * deceleration * way, end**2)))


def braking_speeds(vehicle: PointMass, road: RoadProfile, speed: float) -> FloatArray:
    """Node speeds (n + 1,) of braking from a speed [m/s] to a crawl, within the brakes."""
    slope = vehicle.slope_force(road.grade)
    loss = 2.0 * road.step * _BRAKE_SHARE * (vehicle.brake_max + slope) / vehicle.inertial_mass
    b = speed**2 - np.concatenate([[0.0], np.cumsum(np.maximum(loss, 0.0))])
    return np.asarray(np.sqrt(np.maximum(b, min(_CRAWL, speed) ** 2)))
