"""Recorded vehicles at any time, by interpolation between the recorded frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from iits_mj.errors import InputError
from iits_mj.messages import TrackedVehicle
from traffic_bridge.recording import Recording

EXACT = 1e-6  # [s]: this near a recorded frame the frame itself is given


class Replay:
    """The frames of a recording as functions of time.

    Args:
      recording: with at least one frame, times increasing.

    Raises:
      InputError: there is no frame, or the times do not increase.
    """

    def __init__(self, recording: Recording) -> None:
        times = np.asarray(recording.time, dtype=float)
        if times.size == 0 or np.any(np.diff(times) <= 0.0):
            raise InputError("the recording has no frames, or its times do not increase")
        self._times = times - times[0]
        self._frames = recording.frames

    @property
    def duration(self) -> float:
        """From the first to the last frame [s]."""
        return float(self._times[-1])

    def at(self, time: float) -> list[TrackedVehicle]:
        """The vehicles at a time since the first frame [s]; none outside the recording.

        At a recorded time the recorded values are returned unchanged. Between two frames a vehicle
        of both moves on a cubic Hermite curve through both poses with the recorded velocities; one
        that enters or leaves is there from or until the recorded frame.
        """
        if not math.isfinite(time):
            raise InputError(f"time {time!r}: must be finite")
        if not -EXACT <= time <= self.duration + EXACT:
            return []
        k = int(np.searchsorted(self._times, time + EXACT, side="right")) - 1
        if abs(time - self._times[k]) <= EXACT or k + 1 == len(self._frames):
            return list(self._frames[k])
        h = float(self._times[k + 1] - self._times[k])
        part = (time - float(self._times[k])) / h
        following = {vehicle.id: vehicle for vehicle in self._frames[k + 1]}
        return [
            between(vehicle, following[vehicle.id], part, h)
            for vehicle in self._frames[k]
            if vehicle.id in following
        ]


def between(a: TrackedVehicle, b: TrackedVehicle, part: float, duration: float) -> TrackedVehicle:
    """A vehicle between two of its states.

    Args:
      a: the vehicle, earlier.
      b: the same, later.
      part: 0 at a, 1 at b.
      duration: from a to b [s].
    """
    turn = math.remainder(b.yaw - a.yaw, 2.0 * math.pi)
    reach = math.hypot(b.x - a.x, b.y - a.y)
    # Velocities that do not fit the distance (recorded noise) would make the curve loop: the
    # chord's length is taken where the recorded speed is off by more than half.
    rates = []
    for v in (a, b):
        length = v.speed * duration
        length = length if 0.5 * reach <= length <= 1.5 * reach else reach
        rates.append((length * math.cos(v.yaw), length * math.sin(v.yaw)))

    def linear(name: str) -> float:
        low, high = float(getattr(a, name)), float(getattr(b, name))
        return low + part * (high - low)

    return replace(
        a if part < 0.5 else b,
        x=_hermite(a.x, b.x, rates[0][0], rates[1][0], part),
        y=_hermite(a.y, b.y, rates[0][1], rates[1][1], part),
        yaw=math.remainder(a.yaw + part * turn, 2.0 * math.pi),
        z=linear("z"),
        speed=linear("speed"),
        acceleration=linear("acceleration"),
        lateral_speed=linear("lateral_speed"),
        station=linear("station"),
        offset=linear("offset"),
    )


def _hermite(p: float, q: float, dp: float, dq: float, t: float) -> float:
    return (
        p * (1.0 + 2.0 * t) * (1.0 - t) ** 2
        + dp * t * (1.0 - t) ** 2
        + q * t * t * (3.0 - 2.0 * t)
        + dq * t * t * (t - 1.0)
    )
