"""The vehicle ahead as a constraint: the earliest time at which each station may be passed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, full_power_speed, passing_times
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError

_LEAST_PACE = 0.5  # [m/s] assumed of a stopped leader, so that passing times stay finite
_CRAWL = 1.2  # [m/s] at which braking ends: above the 1 m/s at which plans may begin
_BRAKE_SHARE = 0.8  # of the planned braking force, to leave the optimizer some freedom


@dataclass(frozen=True)
class Leader:
    """The vehicle ahead.

    Attributes:
      rear: station of the truck's reference point when its bumper touches the leader [m].
      speed: [m/s]; acceleration: [m/s2], assumed to last for a second.
    """

    rear: float
    speed: float
    acceleration: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rear", "speed", "acceleration"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise InputError(f"leader: {name} is {value!r}: must be finite")

    @property
    def pace(self) -> float:
        """Speed at which the leader is assumed to continue [m/s]."""
        return max(self.speed + self.acceleration, _LEAST_PACE)


@dataclass(frozen=True)
class LeaderConfig:
    """Gaps and speeds of plans behind a vehicle.

    The gaps are a little smaller than those of the trajectory planner's car following: with larger
    ones the truck would never come close enough to pass.

    Attributes:
      time_gap: [s]; standstill_gap: added to the distance of the time gap [m].
      regain: time constant with which a gap that is too short grows [s].
      deceleration: greatest planned deceleration behind a vehicle [m/s2].
      slower: greatest difference to its speed while the gap grows [m/s].
      hold: time for which the leader is predicted; later it counts as gone or passed [s].
      horizon: of plans behind a vehicle [m].
      jam: speed of a leader below which plans are not optimized [m/s].
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
        require_positive(self, *vars(self))

    def clear(self, leader: Leader) -> float:
        """Returns the greatest station of the truck at standstill [m]."""
        return leader.rear - self.standstill_gap


@dataclass(frozen=True)
class LeaderConstraint:
    """Constraint of a vehicle ahead on a plan; both arrays of shape (n + 1,).

    Attributes:
      earliest: times from now before which the nodes must not be passed [s].
      slowest: least speeds that the plan may use for that [m/s].
    """

    earliest: FloatArray
    slowest: FloatArray

    def kept(self, road: RoadProfile, speed: FloatArray, early: float = 0.0) -> bool:
        """Returns whether node speeds pass no node more than `early` seconds too early."""
        return bool((passing_times(speed, road) >= self.earliest - early - 1e-6).all())


def constraint_behind(
    leader: Leader, vehicle: PointMass, road: RoadProfile, speed: float, config: LeaderConfig
) -> LeaderConstraint:
    """Returns the constraint of a leader that continues at its speed for a short time.

    The time is short because a plan behind a slow vehicle for two kilometers would slow down at
    once and leave a large gap. A gap that is too short, as after a cut-in, grows over some time and
    with comfortable braking only: the constraint never makes a problem infeasible, and the
    trajectory planner brakes harder if necessary.

    The road begins at the truck's station; speed is the truck's [m/s].

    Raises:
      PlanningError: full power is not enough for a climb.
    """
    pace = leader.pace
    way = road.station - road.station[0]
    floor = min(max(pace - config.slower, 0.5 * pace), speed)
    braked = easing_speeds(road, speed, floor, config.deceleration)
    # On a climb full power may not even hold that speed.
    slowest = 0.99 * full_power_speed(vehicle, road, speed, braked)
    slowest[0] = speed
    passing = (road.station - config.clear(leader)) / pace + config.time_gap
    lost = max(speed - pace, 0.0) ** 2 / (2.0 * config.deceleration) / pace
    missing = max(float(passing[0]) + lost, 0.0)
    passing = passing - missing * np.exp(-way / (config.regain * max(speed, _LEAST_PACE)))
    # After `hold` the vehicle counts as gone and constrains no node.
    passing = np.clip(passing, 0.0, config.hold)
    earliest = np.minimum(passing, 0.98 * passing_times(slowest, road))
    return LeaderConstraint(earliest, slowest)


def approach_speeds(
    road: RoadProfile, speed: float, leader: Leader, config: LeaderConfig
) -> FloatArray:
    """Returns node speeds (n + 1,) that fall to a leader's speed at the settings' deceleration.

    The trajectory planner does the car following; this avoids a fast approach to a jam.
    """
    end = max(leader.pace, config.jam)
    way = np.maximum(config.clear(leader) - road.station, 0.0)
    wanted = np.sqrt(end**2 + 2.0 * config.deceleration * way)
    return np.asarray(np.maximum(wanted, easing_speeds(road, speed, end, config.deceleration)))


def easing_speeds(road: RoadProfile, speed: float, end: float, deceleration: float) -> FloatArray:
    """Returns node speeds (n + 1,) that fall to an end speed [m/s] at a deceleration [m/s2]."""
    way = road.station - road.station[0]
    return np.asarray(np.sqrt(np.maximum(speed**2 - 2.0 * deceleration * way, end**2)))


def braking_speeds(vehicle: PointMass, road: RoadProfile, speed: float) -> FloatArray:
    """Returns node speeds (n + 1,) of braking from a speed [m/s] to a crawl with the brakes."""
    slope = vehicle.slope_force(road.grade)
    loss = 2.0 * road.step * _BRAKE_SHARE * (vehicle.brake_max + slope) / vehicle.inertial_mass
    b = speed**2 - np.concatenate([[0.0], np.cumsum(np.maximum(loss, 0.0))])
    return np.asarray(np.sqrt(np.maximum(b, min(_CRAWL, speed) ** 2)))
