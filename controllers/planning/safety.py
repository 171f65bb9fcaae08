"""Gaps that a lane change needs, by time and closing speed, for the whole combination.

The greater gap of two criteria counts. Responsibility-sensitive safety (Shalev-Shwartz, Shammah
and Shashua, On a formal model of safe and scalable self-driving cars, 2017, definition 1): if the
vehicle in front brakes as hard as it can, the one behind stops before it, after a reaction time.
Comfort: a time gap, and room to reduce the closing speed without hard braking.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from controllers.planning.config import SafetyConfig
from controllers.planning.road_preview import LanePath
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import Scene

Speed = TypeVar("Speed", float, FloatArray)


def stopping_gap(
    speed: Speed, lead_speed: Speed, reaction: float, braking: float, lead_braking: float
) -> Speed:
    """Gap with which a vehicle stops behind a leader that brakes to a stop [m], not negative.

    Args:
      speed: of the vehicle behind [m/s], any shape.
      lead_speed: [m/s], likewise.
      reaction: of the vehicle behind, at constant speed [s].
      braking: of the vehicle behind, positive [m/s2].
      lead_braking: positive [m/s2].
    """
    way = speed * reaction + speed**2 / (2.0 * braking)
    return np.maximum(way - lead_speed**2 / (2.0 * lead_braking), 0.0)


def front_gap_needed(speed: Speed, lead_speed: Speed, config: SafetyConfig) -> Speed:
    """Bumper gap [m] needed to a new leader, at own and its speed [m/s], floats or arrays."""
    closing = np.maximum(speed - lead_speed, 0.0)
    comfort = config.front_time_gap * np.minimum(speed, lead_speed)
    comfort += closing**2 / (2.0 * config.front_deceleration)
    lead_speed = np.maximum(lead_speed, 0.0)
    reaction = config.reaction_time
    safe = stopping_gap(speed, lead_speed, reaction, config.truck_braking, config.car_braking)
    return config.margin + np.maximum(comfort, safe)


def rear_gap_needed(speed: Speed, follower_speed: Speed, config: SafetyConfig) -> Speed:
    """Bumper gap [m] needed by a new follower, at own and its speed [m/s], floats or arrays."""
    closing = np.maximum(follower_speed - speed, 0.0)
    comfort = config.rear_time_gap * np.minimum(speed, follower_speed)
    comfort += config.rear_reaction_time * closing + closing**2 / (2.0 * config.rear_deceleration)
    safe = _follower_stopping_gap(np.maximum(follower_speed, 0.0), speed, config)
    return config.margin + np.maximum(comfort, safe)


def _follower_stopping_gap(follower_speed: Speed, speed: Speed, config: SafetyConfig) -> Speed:
    reaction, braking = config.driver_reaction_time, config.driver_braking
    return stopping_gap(follower_speed, speed, reaction, braking, config.truck_braking)


def conflict(
    scene: Scene,
    path: LanePath,
    config: SafetyConfig,
    factor: float = 1.0,
    limit: float = 0.0,
) -> str | None:
    """The reason not to enter the lane of a path now, or None if it is free.

    Args:
      scene: the truck and the traffic.
      path: of the target lane.
      config: the gaps.
      factor: on the gaps; 1 to begin a change, `abort_factor` while it runs.
      limit: speed limit of the target lane [m/s], for a vehicle that approaches from beyond the
        sensors' range; zero: there is none.
    """
    speed, neighbors = scene.ego.speed, scene.neighbors
    worst, reason = 0.0, None
    # A faster vehicle may be behind a slow follower: all vehicles count, not only the nearest.
    for index in np.flatnonzero(neighbors.along_path(path, config.entering)).tolist():
        station, gap = float(neighbors.station[index]), float(neighbors.gap[index])
        name, other_speed = neighbors.ids[index], float(neighbors.speed[index])
        if neighbors.rear <= station <= neighbors.front:
            return f"vehicle {name} is beside the truck"
        ahead = station > neighbors.front
        gap_needed, end = (front_gap_needed, "front") if ahead else (rear_gap_needed, "rear")
        needed = factor * gap_needed(speed, other_speed, config)
        if needed - gap > worst:
            worst = needed - gap
            reason = f"{end} gap {gap:.1f} m to vehicle {name} is below {needed:.1f} m"
    if reason is None and limit > 0.0:
        unseen = min(limit * (1.0 + config.speeding), config.unlimited_speed)
        needed = config.margin + _follower_stopping_gap(unseen, speed, config)
        if needed > config.sight_behind:
            return (
                f"a vehicle at {unseen:.0f} m/s would need a rear gap of {needed:.0f} m, more than "
                f"the {config.sight_behind:g} m in sight"
            )
    return reason
