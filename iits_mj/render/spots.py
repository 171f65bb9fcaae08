"""Soft spots of pictures: shade below vehicles, spray and rain.

A spot is a row of 14 numbers: center, half axes u and v [m], color with opacity (0 adds light, 1
covers) and 1 for a box-like or 0 for a round shape. Places are relative to the eye.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray

COLUMNS = 14
FALL = 8.5  # [m/s] of rain
_BOX = np.array([26.0, 26.0, 14.0])  # [m] about the eye, with drops
_EXPOSURE = 1.0 / 40.0  # [s], makes drops streaks
_PUFFS, _LIFE = 34, 1.3  # of spray behind an axle; [s]
_SPRAY_SPEED = 6.0  # [m/s] without spray


def spots(
    center: FloatArray,
    u: ArrayLike,
    v: ArrayLike,
    color: ArrayLike,
    opacity: ArrayLike,
    box: float = 0.0,
) -> FloatArray:
    """Returns spots (n, 14); axes, color and opacity may be those of all."""
    found = np.zeros((len(center), COLUMNS))
    found[:, 0:3], found[:, 3:6], found[:, 6:9] = center, u, v
    found[:, 9:12], found[:, 12], found[:, 13] = color, opacity, box
    return found


def rain(
    count: int, time: float, eye: FloatArray, velocity: FloatArray, color: FloatArray
) -> FloatArray:
    """Returns falling drops about the eye as streaks.

    Args:
      count: of drops.
      time: [s].
      eye: in the map [m].
      velocity: of the eye [m/s].
      color: of the air.
    """
    seeds = np.random.default_rng(17).random((count, 3))
    fall = np.array([0.6, 0.3, -FALL])
    at = (seeds * _BOX + fall * time - eye) % _BOX - 0.5 * _BOX
    distance = np.linalg.norm(at, axis=1, keepdims=True)
    streak = 0.5 * _EXPOSURE * (fall - velocity)
    streak *= min(1.0, 0.5 / max(float(np.linalg.norm(streak)), 1e-9))
    across = np.cross(at, streak)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    width = np.maximum(0.005, 0.0009 * distance)
    seen = np.clip(distance - 1.5, 0.0, 1.0) * 0.75
    return spots(at, across * width, streak, color * seen, 0.6 * seen[:, 0])


def spray(
    place: FloatArray,
    forward: FloatArray,
    speed: float,
    time: float,
    axes: FloatArray,
    color: FloatArray,
    wet: float,
) -> FloatArray:
    """Returns the spray behind an axle.

    Args:
      place: on the road below the axle.
      forward: direction of travel.
      speed: [m/s].
      time: [s].
      axes: right, up and forward of the camera.
      color: of the air.
      wet: film of water, 0 to 1.
    """
    strength = wet * min(max((speed - _SPRAY_SPEED) / 12.0, 0.0), 1.0)
    if strength <= 0.0:
        return np.empty((0, COLUMNS))
    seeds = np.random.default_rng(23).random((_PUFFS, 3))
    age = (seeds[:, 0] + time / _LIFE) % 1.0
    left = np.array([-forward[1], forward[0], 0.0])
    drift = 0.62 * speed * _LIFE * age  # the wake carries it along
    side = 2.1 * (seeds[:, 1] - 0.5) * (1.0 + 0.5 * age)
    height = 0.25 + (0.55 + 0.9 * seeds[:, 2]) * age
    at = place - np.outer(drift, forward) + np.outer(side, left)
    at[:, 2] += height
    radius = 0.35 + 1.0 * age
    opacity = 0.65 * strength * (1.0 - age) ** 1.2
    return spots(
        at,
        radius[:, None] * axes[0],
        0.8 * radius[:, None] * axes[1],
        color * opacity[:, None],
        opacity,
    )


def shade(
    center: FloatArray, forward: FloatArray, half: tuple[float, float], dark: float
) -> FloatArray:
    """Returns the shade below a vehicle on the road.

    Args:
      center: on the road.
      forward: along the vehicle, in the road's slope.
      half: half of its length and width [m].
      dark: 0 to 1.
    """
    left = np.array([-forward[1], forward[0], 0.0])
    left /= math.hypot(left[0], left[1]) or 1.0
    return spots(
        center[None],
        (half[0] + 0.35) * forward,
        (half[1] + 0.30) * left,
        0.0,
        dark,
        1.0,
    )
