"""Who drives where: bumper gaps along a lane, for the planner and the decision makers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.road_preview import LanePath
from iits_mj.errors import InputError
from iits_mj.messages import Scene, TrackedVehicle

FloatArray = NDArray[np.float64]
INTRUSION = 0.3


@dataclass(frozen=True, slots=True)
class Neighbor:
    """A vehicle in a lane and the gap to it.

    Attributes:
      vehicle: who; gap: between bumpers [m], negative where it overlaps the truck's length.
    """

    vehicle: TrackedVehicle
    gap: float


class Surroundings:
    """The traffic of a scene as arrays, asked by lane path.

    A vehicle is in a lane when its body reaches 0.3 m or more into it now, or will within
    `anticipation` seconds at its present lateral speed: who changes lanes is in both.

    Raises:
      InputError: a vehicle's station, offset or speed is not finite; the message names it.
    """

    def __init__(self, scene: Scene, anticipation: float = 1.0) -> None:
        self.scene = scene
        self.front = scene.ego.station + scene.footprint.front_overhang
        self.rear = self.front - scene.footprint.length
        rows = [
            (v.station, v.offset, v.speed, v.lateral_speed, v.length, v.width)
            for v in scene.vehicles
        ]
        table = np.array(rows, dtype=float).reshape(-1, 6)
        bad = np.argwhere(~np.isfinite(table))
        if bad.size:
            row, column = bad[0]
            name = ("station", "offset", "speed", "lateral_speed", "length", "width")[column]
            raise InputError(
                f"vehicle {scene.vehicles[row].id!r}: {name} is {table[row, column]}: not finite"
            )
        self.station, self.offset, self.speed = table[:, 0], table[:, 1], table[:, 2]
        self._half_length, self._half_width = 0.5 * table[:, 4], 0.5 * table[:, 5]
        self._predicted = self.offset + anticipation * table[:, 3]

    def within(self, path: LanePath) -> NDArray[np.bool_]:
        """Which vehicles are in the lane of a path, shape (n,)."""
        middle = path.offset_at(self.station)
        reach = path.half_width + self._half_width - INTRUSION
        now = np.abs(self.offset - middle) < reach
        soon = np.abs(self._predicted - middle) < reach
        inside = (self.station >= path.station[0]) & (self.station <= path.station[-1])
        # Beyond a lane's end nobody drives in it.
        return (now | soon) & inside & (self.station <= path.end)

    def leader(self, path: LanePath) -> Neighbor | None:
        """The nearest vehicle whose middle is ahead of the truck's front bumper."""
        return self._nearest(path, self.station > self.front)

    def follower(self, path: LanePath) -> Neighbor | None:
        """The nearest vehicle whose middle is behind the trailer's rear."""
        return self._nearest(path, self.station < self.rear)

    def beside(self, path: LanePath) -> Neighbor | None:
        """A vehicle whose middle is beside the truck, anywhere along its 16.5 m."""
        return self._nearest(path, (self.station <= self.front) & (self.station >= self.rear))

    def gap(self, index: int) -> float:
        """Bumper gap to a vehicle of the scene [m]; negative where it overlaps the truck."""
        ahead = float(self.station[index] - self._half_length[index]) - self.front
        behind = self.rear - float(self.station[index] + self._half_length[index])
        return max(ahead, behind)

    def _nearest(self, path: LanePath, side: NDArray[np.bool_]) -> Neighbor | None:
        if not self.station.size:
            return None
        candidates = np.flatnonzero(side & self.within(path))
        if not candidates.size:
            return None
        gaps = [(self.gap(int(i)), int(i)) for i in candidates]
        gap, index = min(gaps)
        return Neighbor(self.scene.vehicles[index], gap)
