"""Objects in the truck's way, and the deceleration that avoids them.

The way is a circular arc from the steer axle, of the present yaw rate over speed, as wide as the
truck. The path of the trailer inside of a bend is not part of it, nor is the road: emergency
braking knows no map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.messages import EgoFootprint, EgoState
from iits_mj.core.neighbors import LEVEL_OVER_TRUCK
from iits_mj.core.vehicles import VehicleFrame

# Least overlap of the widths [m]: smaller ones are within the error of a track.
_INTRUSION = 0.25
# Longest prediction of an object's motion across the way, as a lane change can still be given up,
# and of those that cross it [s].
_HORIZON, _CROSSING_HORIZON, _CROSSING = 1.0, 2.5, ("pedestrian", "bicycle")
# Reach as a time at the truck's speed [s].
_REACH = 8.0
# Objects that come nearer at more than this speed do not count [m/s]: the function is for vehicles
# ahead that are slower or stand.
_ONCOMING = 1.0
# Of an object's deceleration, what is within the error of a track [m/s2].
_ACCELERATION_ERROR = 0.5


@dataclass(frozen=True, slots=True)
class Target:
    """An object in the way.

    Attributes:
      id: name; gap: from the front bumper along the way [m].
      speed: along the way [m/s]; acceleration: along the way, zero or negative [m/s2].
    """

    id: str
    gap: float
    speed: float
    acceleration: float

    def after(self, time: float, speed: float, acceleration: float) -> Target:
        """Returns the target as it will be after a time [s].

        Args:
          time: [s].
          speed: of the truck now [m/s].
          acceleration: of the truck, which it keeps until it stands [m/s2].
        """
        way, _ = moved(speed, acceleration, time)
        own, left = moved(self.speed, self.acceleration, time)
        still = self.acceleration if left > 0.0 else 0.0
        return Target(self.id, self.gap + own - way, left, still)


def moved(speed: float, acceleration: float, time: float) -> tuple[float, float]:
    """Returns the distance [m] and the speed [m/s] after a time; a braking body stops and stays."""
    if acceleration < 0.0 and speed + acceleration * time < 0.0:
        return -0.5 * speed**2 / acceleration if speed > 0.0 else 0.0, 0.0
    return speed * time + 0.5 * acceleration * time**2, speed + acceleration * time


def required_deceleration(target: Target, speed: float, margin: float) -> float:
    """The constant deceleration from now on that leaves a margin to a target [m/s2].

    The target keeps its deceleration until it stands. Zero if the truck does not come near, inf if
    the margin is already lost while it closes in.

    Args:
      target: in the way.
      speed: of the truck [m/s].
      margin: distance to leave [m].
    """
    room, braking = target.gap - margin, -target.acceleration
    closing = speed - target.speed
    if closing <= 0.0 and (braking <= 0.0 or speed <= 0.0):
        return 0.0
    if room <= 0.0:
        return math.inf if closing > 0.0 else 0.0
    if braking <= 0.0:
        return 0.5 * closing**2 / room
    stop = 0.5 * speed**2 / (room + 0.5 * target.speed**2 / braking)
    if closing <= 0.0:
        return stop
    # Both at one speed when the margin is reached, unless the target stands before that.
    meeting = 2.0 * room / closing
    return braking + 0.5 * closing**2 / room if meeting * braking < target.speed else stop


def time_to_collision(target: Target, speed: float) -> float:
    """Gap over closing speed [s]; inf if the truck does not close in."""
    closing = speed - target.speed
    return max(target.gap, 0.0) / closing if closing > 0.0 else math.inf


def find_targets(
    ego: EgoState,
    vehicles: VehicleFrame,
    age: float,
    footprint: EgoFootprint,
    curvature: float,
) -> list[Target]:
    """Returns the objects in the truck's way, in the order of the frame.

    Args:
      ego: the truck now.
      vehicles: tracks, or the traffic, `age` seconds ago.
      age: [s].
      footprint: of the truck.
      curvature: of the way [1/m], positive to the left.
    """
    if not len(vehicles):
        return []
    columns = ("x", "y", "z", "yaw", "speed", "acceleration", "lateral_speed", "length", "width")
    x, y, z, yaw, speed, acceleration, across, length, width = vehicles.columns(*columns)
    dx = x + speed * np.cos(yaw) * age - ego.x
    dy = y + speed * np.sin(yaw) * age - ego.y
    forward, left = math.cos(ego.yaw), math.sin(ego.yaw)
    ahead, aside = dx * forward + dy * left, dy * forward - dx * left
    near = (ahead > footprint.front_overhang) & (
        ahead < footprint.front_overhang + _REACH * max(ego.speed, 1.0) + 10.0
    )
    near &= np.abs(z - ego.z + math.tan(ego.pitch) * ahead) < LEVEL_OVER_TRUCK
    chosen = np.flatnonzero(near)
    if not chosen.size:
        return []
    ahead, aside, yaw, speed, acceleration, across, length, width = (
        column[chosen] for column in (ahead, aside, yaw, speed, acceleration, across, length, width)
    )
    along, offset = along_arc(ahead, aside, curvature)
    turned = yaw - ego.yaw - curvature * along
    cosine, sine = np.cos(turned), np.sin(turned)
    half_length = 0.5 * (length * np.abs(cosine) + width * np.abs(sine))
    half_width = 0.5 * (width * np.abs(cosine) + length * np.abs(sine))
    gap = along - half_length - footprint.front_overhang
    own, slowing = (
        speed * cosine,
        np.minimum(acceleration * cosine + _ACCELERATION_ERROR, 0.0),
    )
    closing = ego.speed - own
    contact = np.where(closing > 0.0, np.maximum(gap, 0.0) / np.maximum(closing, 1e-6), np.inf)
    crossing = np.array([vehicles.kinds[k] in _CROSSING for k in chosen])
    horizon = np.where(crossing, _CROSSING_HORIZON, _HORIZON)
    later = offset + across * np.minimum(contact, horizon)
    inside = np.abs(later) < half_width + 0.5 * footprint.width - _INTRUSION
    inside &= own > -_ONCOMING
    return [
        Target(vehicles.ids[chosen[k]], float(gap[k]), max(float(own[k]), 0.0), float(slowing[k]))
        for k in np.flatnonzero(inside)
    ]


def along_arc(
    ahead: np.ndarray, aside: np.ndarray, curvature: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns distance along a circular arc and offset to its left [m] of points in the truck.

    Args:
      ahead: of the points from the arc's start, along its first direction [m].
      aside: the same to the left of it [m].
      curvature: [1/m], positive to the left.
    """
    if abs(curvature) < 1e-6:
        return ahead, aside
    radius, side = 1.0 / abs(curvature), math.copysign(1.0, curvature)
    toward = radius - side * aside
    return radius * np.arctan2(ahead, toward), side * (radius - np.hypot(ahead, toward))
