"""Is the neighbor lane free? Gaps by time and closing speed, for the whole 16.5 m of truck.

Two judgments, and the greater gap counts. Responsibility-sensitive safety (Shalev-Shwartz, Shammah
and Shashua, On a formal model of safe and scalable self-driving cars, 2017, definition 1): if
whoever is in front brakes as hard as it can, whoever is behind stands before it, after a reaction
time. And comfort: a time gap, and room to take away the closing speed without hard braking.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.planning.road_preview import LanePath
from controllers.planning.surroundings import Neighbor, Surroundings

Speed = TypeVar("Speed", float, NDArray[np.float64])


@dataclass(frozen=True)
class SafetyConfig:
    """What a lane change must leave free.

    Attributes:
      margin: at least, at both ends [m].
      front_time_gap: to the new leader [s].
      front_deceleration: of the truck behind a slower leader, comfortable, positive [m/s2].
      rear_time_gap: of the new follower [s].
      rear_reaction_time: of the new follower before it brakes comfortably [s].
      rear_deceleration: of the new follower, comfortable, positive [m/s2].
      reaction_time: of the truck with its brakes, when the new leader brakes hard [s].
      driver_reaction_time: of the new follower, when the truck brakes hard [s]; it has seen the
        truck's indicator before the truck is in its lane.
      truck_braking: of the truck at its hardest, positive [m/s2].
      car_braking: of others at their hardest, positive [m/s2]; as leaders.
      driver_braking: that is counted on from a follower, positive [m/s2].
      entering: who will be in the target lane within this time, from whichever side, is in it [s].
      sight_behind: how far the sensors see to the rear [m].
      unlimited_speed: of who may come from beyond that where there is no limit [m/s].
      speeding: share by which it may be faster than a limit.
      abort_factor: share of these gaps below which a change is given up.
    """

    margin: float = 3.0
    front_time_gap: float = 0.9
    front_deceleration: float = 0.8
    rear_time_gap: float = 0.7
    rear_reaction_time: float = 1.0
    rear_deceleration: float = 1.5
    reaction_time: float = 0.5
    driver_reaction_time: float = 0.75
    truck_braking: float = 6.5
    car_braking: float = 8.0
    driver_braking: float = 6.5
    entering: float = 3.0
    sight_behind: float = 150.0
    unlimited_speed: float = 36.1
    speeding: float = 0.1
    abort_factor: float = 0.5


def stopping_gap(
    speed: Speed, lead_speed: Speed, reaction: float, braking: float, lead_braking: float
) -> Speed:
    """Gap from which one stands behind a leader that brakes to a stop, zero at least [m].

    Args:
      speed: of who is behind [m/s], any shape.
      lead_speed: [m/s], likewise.
      reaction: of who is behind, at constant speed [s].
      braking: of who is behind, positive [m/s2].
      lead_braking: positive [m/s2].
    """
    way = speed * reaction + speed**2 / (2.0 * braking)
    return np.maximum(way - lead_speed**2 / (2.0 * lead_braking), 0.0)


def front_gap_needed(speed: Speed, lead_speed: Speed, config: SafetyConfig) -> Speed:
    """Bumper gap to the new leader [m] at own and its speed [m/s], floats or arrays alike."""
    closing = np.maximum(speed - lead_speed, 0.0)
    comfort = config.front_time_gap * np.minimum(speed, lead_speed)
    comfort += closing**2 / (2.0 * config.front_deceleration)
    safe = stopping_gap(
        speed,
        np.maximum(lead_speed, 0.0),
        config.reaction_time,
        config.truck_braking,
        config.car_braking,
    )
    return config.margin + np.maximum(comfort, safe)


def rear_gap_needed(speed: Speed, follower_speed: Speed, config: SafetyConfig) -> Speed:
    """Bumper gap of the new follower [m] at own and its speed [m/s], floats or arrays alike."""
    closing = np.maximum(follower_speed - speed, 0.0)
    comfort = config.rear_time_gap * np.minimum(speed, follower_speed)
    comfort += config.rear_reaction_time * closing + closing**2 / (2.0 * config.rear_deceleration)
    safe = stopping_gap(
        np.maximum(follower_speed, 0.0),
        speed,
        config.driver_reaction_time,
        config.driver_braking,
        config.truck_braking,
    )
    return config.margin + np.maximum(comfort, safe)


def conflict(
    surroundings: Surroundings,
    path: LanePath,
    config: SafetyConfig,
    factor: float = 1.0,
    limit: float = 0.0,
) -> str | None:
    """Why the lane of a path may not be entered now, in words; None when it may.

    Args:
      surroundings: the traffic.
      path: of the target lane.
      config: what must be free.
      factor: on the gaps; 1 to begin a change, `abort_factor` while it runs.
      limit: speed limit of the target lane [m/s]: somebody that fast may come from beyond sight;
        zero: nobody.
    """
    speed = surroundings.scene.ego.speed
    worst: tuple[float, str] = (0.0, "")
    # Somebody slow at the rear may hide somebody faster: all count, not only the nearest.
    for other in surroundings.in_lane(path, config.entering):
        vehicle = other.vehicle
        if surroundings.rear <= vehicle.station <= surroundings.front:
            return f"vehicle {vehicle.id} is beside the truck"
        ahead = vehicle.station > surroundings.front
        judge = front_gap_needed if ahead else rear_gap_needed
        needed = factor * judge(speed, vehicle.speed, config)
        if needed - other.gap > worst[0]:
            worst = (needed - other.gap, _short(other, needed, "front" if ahead else "rear"))
    if not worst[1] and limit > 0.0:
        unseen = min(limit * (1.0 + config.speeding), config.unlimited_speed)
        needed = config.margin + stopping_gap(
            unseen,
            speed,
            config.driver_reaction_time,
            config.driver_braking,
            config.truck_braking,
        )
        if needed > config.sight_behind:
            return (
                f"rear gap {needed:.0f} m that somebody at {unseen:.0f} m/s needs is beyond the "
                f"{config.sight_behind:g} m in sight"
            )
    return worst[1] or None


def _short(neighbor: Neighbor, needed: float, end: str) -> str:
    return (
        f"{end} gap {neighbor.gap:.1f} m to vehicle {neighbor.vehicle.id} is below {needed:.1f} m"
    )
