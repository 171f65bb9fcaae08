"""What steering sees of a trajectory: offset, heading error and the path's curvature ahead."""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.messages import EgoState, Trajectory


class PathView:
    """A trajectory made ready for many looks at it.

    Args:
      trajectory: planned; its stations never fall.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.station = trajectory.station
        yaw = trajectory.yaw
        continuous = bool((np.abs(yaw[1:] - yaw[:-1]) < np.pi).all())
        self.yaw = yaw if continuous else np.unwrap(yaw)
        self._last = self.station.item(-1), trajectory.curvature.item(-1)
        # The same as numbers, for one place.
        self._places, self._yaws = self.station.tolist(), self.yaw.tolist()
        self._x, self._y = trajectory.x.tolist(), trajectory.y.tolist()

    def error(self, ego: EgoState) -> tuple[float, float]:
        """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
        places, yaws, xs, ys = self._places, self._yaws, self._x, self._y
        row = min(max(bisect_right(places, ego.station) - 1, 0), len(places) - 2)
        start, end = places[row], places[row + 1]
        # Off its ends the path goes on straight.
        way = ego.station - start
        share = way / (end - start) if end > start else 0.0
        held = min(max(share, 0.0), 1.0)
        turn = yaws[row + 1] - yaws[row]
        yaw = yaws[row] + held * turn
        x = xs[row] + share * (xs[row + 1] - xs[row])
        y = ys[row] + share * (ys[row + 1] - ys[row])
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
        end, curvature = self._last
        if stations[-1] > end:
            yaw += curvature * np.maximum(stations - end, 0.0)
        return np.asarray((yaw[1:] - yaw[:-1]) / (stations[1:] - stations[:-1]))


def path_error(ego: EgoState, trajectory: Trajectory) -> tuple[float, float]:
    """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
    return PathView(trajectory).error(ego)
