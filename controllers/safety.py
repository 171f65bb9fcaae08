"""Is the neighbor lane free? Gaps by time and closing speed, for the whole 16.5 m of truck.

The judgment follows the idea of responsibility-sensitive safety (Shalev-Shwartz, Shammah and
Shashua 2017): both ends need a time gap, and room to take away the closing speed at a rate that is
comfortable for whoever has to brake.
"""

from __future__ import annotations

from dataclasses import dataclass

from controllers.road_preview import LanePath
from controllers.surroundings import Neighbor, Surroundings


@dataclass(frozen=True)
class SafetyConfig:
    """What a lane change must leave free.

    Attributes:
      margin: at least, at both ends [m].
      front_time_gap: to the new leader [s].
      front_deceleration: of the truck behind a slower leader, positive [m/s2].
      rear_time_gap: of the new follower [s].
      rear_reaction_time: of the new follower before it brakes [s].
      rear_deceleration: of the new follower, positive [m/s2].
      abort_factor: share of these gaps below which a change is given up.
    """

    margin: float = 3.0
    front_time_gap: float = 0.9
    front_deceleration: float = 0.8
    rear_time_gap: float = 0.7
    rear_reaction_time: float = 1.0
    rear_deceleration: float = 1.5
    abort_factor: float = 0.5


def front_gap_needed(speed: float, lead_speed: float, config: SafetyConfig) -> float:
    """Bumper gap to the new leader [m] at own and its speed [m/s]."""
    closing = max(speed - lead_speed, 0.0)
    return (
        config.margin
        + config.front_time_gap * min(speed, lead_speed)
        + closing**2 / (2.0 * config.front_deceleration)
    )


def rear_gap_needed(speed: float, follower_speed: float, config: SafetyConfig) -> float:
    """Bumper gap of the new follower [m] at own and its speed [m/s]."""
    closing = max(follower_speed - speed, 0.0)
    return (
        config.margin
        + config.rear_time_gap * min(speed, follower_speed)
        + config.rear_reaction_time * closing
        + closing**2 / (2.0 * config.rear_deceleration)
    )


def conflict(
    surroundings: Surroundings, path: LanePath, config: SafetyConfig, factor: float = 1.0
) -> str | None:
    """Why the lane of a path may not be entered now, in words; None when it may.

    Args:
      surroundings: the traffic.
      path: of the target lane.
      config: what must be free.
      factor: on the gaps; 1 to begin a change, `abort_factor` while it runs.
    """
    speed = surroundings.scene.ego.speed
    beside = surroundings.beside(path)
    if beside is not None:
        return f"vehicle {beside.vehicle.id} is beside the truck"
    leader = surroundings.leader(path)
    if leader is not None:
        needed = factor * front_gap_needed(speed, leader.vehicle.speed, config)
        if leader.gap < needed:
            return _short(leader, needed, "front")
    follower = surroundings.follower(path)
    if follower is not None:
        needed = factor * rear_gap_needed(speed, follower.vehicle.speed, config)
        if follower.gap < needed:
            return _short(follower, needed, "rear")
    return None


def _short(neighbor: Neighbor, needed: float, end: str) -> str:
    return (
        f"{end} gap {neighbor.gap:.1f} m to vehicle {neighbor.vehicle.id} is below {needed:.1f} m"
    )
