"""What steering sees of a trajectory: offset, heading error and the path's curvature ahead."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from iits_mj.messages import EgoState, Trajectory

FloatArray = NDArray[np.float64]


class PathView:
    """A trajectory made ready for many looks at it.

    Args:
      trajectory: planned; its stations never fall.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.station = trajectory.station
        self.yaw = np.unwrap(trajectory.yaw)

    def error(self, ego: EgoState) -> tuple[float, float]:
        """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
        path, station = self.trajectory, self.station
        last = len(station) - 2
        row = min(max(int(station.searchsorted(ego.station, side="right")) - 1, 0), last)
        start, end = float(station[row]), float(station[row + 1])
        # Off its ends the path goes on straight.
        way = ego.station - start
        share = way / (end - start) if end > start else 0.0
        held = min(max(share, 0.0), 1.0)
        turn = float(self.yaw[row + 1] - self.yaw[row])
        yaw = float(self.yaw[row]) + held * turn
        x = float(path.x[row]) + share * float(path.x[row + 1] - path.x[row])
        y = float(path.y[row]) + share * float(path.y[row + 1] - path.y[row])
        # The points are ends of chords: the path bulges out between them by the sagitta.
        bulge = 0.5 * turn * (end - start) * held * (1.0 - held)
        error = -math.sin(yaw) * (ego.x - x) + math.cos(yaw) * (ego.y - y) + bulge
        turned = ego.yaw - yaw
        return error, math.atan2(math.sin(turned), math.cos(turned))

    def curvature(self, stations: FloatArray) -> FloatArray:
        """Mean curvature [1/m] between stations of shape (n + 1,), rising; shape (n,).

        It is the turn of the heading by the way; beyond the path's end the last curvature lasts.
        """
        yaw = np.interp(stations, self.station, self.yaw)
        if stations[-1] > self.station[-1]:
            beyond = np.maximum(stations - self.station[-1], 0.0)
            yaw += float(self.trajectory.curvature[-1]) * beyond
        return np.asarray((yaw[1:] - yaw[:-1]) / (stations[1:] - stations[:-1]))


def path_error(ego: EgoState, trajectory: Trajectory) -> tuple[float, float]:
    """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
    return PathView(trajectory).error(ego)
