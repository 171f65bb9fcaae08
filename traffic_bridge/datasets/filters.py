"""Takes the noise out of raw recorded positions.

C. Thiemann, M. Treiber and A. Kesting, "Estimating acceleration and lane-changing dynamics from
Next Generation Simulation trajectory data", Transportation Research Record 2088 (2008): positions
are differentiated first, then positions, speeds and accelerations are averaged each with a
symmetric exponential kernel of its own width, narrowed towards the ends of a track.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from traffic_bridge.datasets.trajectories import Trajectories

# Widths of the paper [s].
POSITION_WIDTH = 0.5
SPEED_WIDTH = 1.0
ACCELERATION_WIDTH = 4.0
REACH = 3.0  # the kernel is cut at this many widths, as the paper has it


def exponential_average(values: FloatArray, width: float) -> FloatArray:
    """Symmetric exponential moving average, equations 1 and 2 of the paper.

    Within a window of half-width D = min(3 width, i, n - 1 - i) about sample i the weights are
    exp(-|i - j| / width), so that a straight line stays as it is, up to its ends.

    Args:
      values: evenly spaced, shape (n,).
      width: of the kernel, in samples; 0 leaves the values as they are.
    """
    count = len(values)
    reach = min(math.ceil(REACH * width), (count - 1) // 2)
    if reach < 1 or width <= 0.0:
        return values.copy()
    weights = np.exp(-np.arange(reach + 1) / width)
    # Sums over windows of growing half-width, every one made from the one before.
    total, weight = values.copy(), np.ones(count)
    for d in range(1, reach + 1):
        total[d : count - d] += weights[d] * (values[: count - 2 * d] + values[2 * d :])
        weight[d : count - d] += 2.0 * weights[d]
    return total / weight


def without_noise(
    trajectories: Trajectories,
    position_width: float = POSITION_WIDTH,
    speed_width: float = SPEED_WIDTH,
    acceleration_width: float = ACCELERATION_WIDTH,
) -> Trajectories:
    """Trajectories with averaged positions, along and across, and speeds and accelerations thereof.

    Recorded speeds and accelerations are not used. Tracks of fewer than three rows stay as they
    are, and so do the instants: rows must be evenly spaced in time.

    Args:
      trajectories: raw ones.
      position_width: of the kernel for positions [s].
      speed_width: of the kernel for speeds [s].
      acceleration_width: of the kernel for accelerations [s].

    Raises:
      InputError: a width is negative, or a track is not evenly spaced.
    """
    for width in (position_width, speed_width, acceleration_width):
        if not (math.isfinite(width) and width >= 0.0):
            raise InputError(f"width {width!r} of the noise filter: must be zero or positive")
    t = trajectories
    station, speed, acceleration = t.station.copy(), t.speed.copy(), t.acceleration.copy()
    across = t.lane + t.offset / t.lane_width
    for index, name in enumerate(t.ids):
        rows = t.rows(index)
        time = t.time[rows]
        if len(time) < 3:
            continue
        if np.ptp(np.diff(time)) > 0.1 * t.step:
            raise InputError(
                f"{t.source}: vehicle {name!r} is missing at some instants: the noise filter needs "
                "evenly spaced rows"
            )
        raw_speed = np.gradient(t.station[rows], t.step)
        raw_acceleration = np.gradient(raw_speed, t.step)
        station[rows] = exponential_average(t.station[rows], position_width / t.step)
        across[rows] = exponential_average(across[rows], position_width / t.step)
        speed[rows] = exponential_average(raw_speed, speed_width / t.step)
        acceleration[rows] = exponential_average(raw_acceleration, acceleration_width / t.step)
    return dataclasses.replace(
        t,
        station=station,
        offset=(across - t.lane) * t.lane_width,
        # Averages of a vehicle that stands may come out a little below zero.
        speed=np.maximum(speed, 0.0),
        acceleration=acceleration,
        notes=(*t.notes, "positions, speeds and accelerations are averaged against noise"),
    )
