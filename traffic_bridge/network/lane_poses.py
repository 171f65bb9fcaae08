"""Poses of many vehicles at once from the tables of their lanes, stacked."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from traffic_bridge.network.lane_table import LaneTable, per_sample

IntArray = NDArray[np.intp]

# Columns of the stack: four coefficients of x, y and z, then two of each of the others.
_CUBIC = 3
_LINEAR = 6
_WIDTH = 4 * _CUBIC + 2 * _LINEAR
POSE_ROWS = ("x", "y", "z", "station", "offset", "heading", "pitch", "roll", "curvature")


class LanePoses:
    """All lanes that vehicles have been on, by number.

    Args:
      make: makes the table of a SUMO lane, by id; asked once a lane.
    """

    def __init__(self, make: Callable[[str], LaneTable]) -> None:
        self._make = make
        self.tables: list[LaneTable] = []
        self._numbers: dict[str, int] = {}
        self._stacked = 0
        self._pieces: FloatArray = np.zeros((0, _WIDTH))
        # Of each lane: first piece, last piece, number on the route, direction on it.
        self._of_lane: IntArray = np.zeros((4, 0), dtype=np.intp)
        self._scale: FloatArray = np.zeros(0)
        # Of the lanes asked for last: most often they are the same again.
        self._asked: IntArray | None = None
        self._answer = self._of_lane, self._scale

    def number(self, lane: str) -> int:
        """Number of a lane; its table is made when it is new."""
        found = self._numbers.get(lane)
        if found is None:
            found = self._numbers[lane] = len(self.tables)
            self.tables.append(self._make(lane))
        return found

    def evaluate(self, lane: IntArray, position: FloatArray) -> tuple[FloatArray, IntArray]:
        """Where the lanes' centres are at positions along them; beyond their ends straight on.

        Args:
          lane: numbers, shape (n,); not to be changed afterwards.
          position: as SUMO counts them [m], shape (n,).

        Returns:
          Rows `POSE_ROWS`, shape (9, n); index on the route (-1 off it) and direction (see
          `LaneTable`) of the lanes, shape (2, n).
        """
        if lane is not self._asked:
            if self._stacked != len(self.tables):
                self._stack()
            self._asked = lane
            self._answer = self._of_lane.take(lane, axis=1), self._scale.take(lane)
        of_lane, scale = self._answer
        place = position * scale
        piece = np.minimum(np.maximum(place, 0.0).astype(np.intp), of_lane[1])
        inside = place - piece
        t = np.minimum(np.maximum(inside, 0.0), 1.0)
        c = self._pieces.take(of_lane[0] + piece, axis=0).T
        result = np.empty((9, len(lane)))
        result[:3] = c[:3] + t * (c[3:6] + t * (c[6:9] + t * c[9:12]))
        result[3:] = c[12:18] + t * c[18:24]
        beyond = inside - t
        if beyond.any():
            slope = c[3:6] + t * (2.0 * c[6:9] + 3.0 * t * c[9:12])
            result[:3] += beyond * slope
            result[3] += of_lane[3] * beyond / scale
        return result, of_lane[2:].copy()

    def _stack(self) -> None:
        new = self.tables[self._stacked :]
        pieces = [_pieces(table) for table in new]
        counts = np.array([len(rows) for rows in pieces], dtype=np.intp)
        first = len(self._pieces) + np.cumsum(counts) - counts
        of_lane = np.array(
            [first, counts - 1, [t.lane for t in new], [t.direction for t in new]], dtype=np.intp
        )
        self._pieces = np.concatenate((self._pieces, *pieces))
        self._of_lane = np.concatenate((self._of_lane, of_lane), axis=1)
        self._scale = np.concatenate((self._scale, [1.0 / table.spacing for table in new]))
        self._stacked = len(self.tables)


def _pieces(table: LaneTable) -> FloatArray:
    """Polynomials between the samples of one lane: cubic Hermite for the place, else linear.

    Returns:
      Shape (samples - 1, _WIDTH), the variable going from 0 to 1 in each piece.
    """
    x, y, z, heading, pitch, roll, curvature = table.pose
    # The tangent is the heading's: exact where the samples' differences are not.
    reach = np.hypot(per_sample(x), per_sample(y))
    place = np.stack((x, y, z))
    slope = np.stack((reach * np.cos(heading), reach * np.sin(heading), per_sample(z)))
    rise, u, v = np.diff(place), slope[:, :-1], slope[:, 1:]
    rest = np.stack((table.station, table.offset, heading, pitch, roll, curvature))
    return np.ascontiguousarray(
        np.concatenate(
            (
                place[:, :-1],
                u,
                3.0 * rise - 2.0 * u - v,
                u + v - 2.0 * rise,
                rest[:, :-1],
                np.diff(rest),
            )
        ).T
    )
