"""Poses of many vehicles at once from the tables of their lanes, stacked."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from traffic_bridge.lane_table import LaneTable

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# Columns of the stack: first those that are cubic with their slopes per sample, then linear ones.
_CUBIC = 3
_LINEAR = 2 * _CUBIC
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
        self._nodes: FloatArray = np.zeros((0, 12))
        self._base: IntArray = np.zeros(0, dtype=np.intp)
        self._last: IntArray = np.zeros(0, dtype=np.intp)
        self._scale: FloatArray = np.zeros(0)
        self.route_lane: IntArray = np.zeros(0, dtype=np.intp)
        self.direction: IntArray = np.zeros(0, dtype=np.intp)

    def number(self, lane: str) -> int:
        """Number of a lane; its table is made when it is new."""
        found = self._numbers.get(lane)
        if found is None:
            found = self._numbers[lane] = len(self.tables)
            self.tables.append(self._make(lane))
        return found

    def evaluate(self, lane: IntArray, position: FloatArray) -> FloatArray:
        """Where the lanes' centres are at positions along them; beyond their ends straight on.

        Args:
          lane: numbers, shape (n,).
          position: as SUMO counts them [m], shape (n,).

        Returns:
          Rows `POSE_ROWS`, shape (9, n).
        """
        if self._stacked != len(self.tables):
            self._stack()
        last, scale = self._last.take(lane), self._scale.take(lane)
        place = position * scale
        inside = np.minimum(np.maximum(place, 0.0), last)
        index = np.minimum(inside.astype(np.intp), last - 1)
        t = inside - index
        row = self._base.take(lane) + index
        a, b = self._nodes.take(row, axis=0).T, self._nodes.take(row + 1, axis=0).T
        rise = b[:_CUBIC] - a[:_CUBIC]
        u, v = a[_CUBIC:_LINEAR], b[_CUBIC:_LINEAR]
        result = np.empty((9, len(lane)))
        result[:_CUBIC] = a[:_CUBIC] + t * (
            u + t * ((3.0 * rise - 2.0 * u - v) + t * (u + v - 2.0 * rise))
        )
        result[_CUBIC:] = a[_LINEAR:] + t * (b[_LINEAR:] - a[_LINEAR:])
        if not np.array_equal(place, inside):
            beyond = place - inside
            result[:_CUBIC] += beyond * np.where(beyond < 0.0, u, v)
            way = beyond / scale
            result[_CUBIC] += way * self.direction.take(lane)
        return result

    def _stack(self) -> None:
        nodes, counts = [], []
        for table in self.tables[self._stacked :]:
            nodes.append(_nodes(table))
            counts.append(len(table.station))
        starts = len(self._nodes) + np.concatenate(([0], np.cumsum(counts)[:-1])).astype(np.intp)
        new = self.tables[self._stacked :]
        self._nodes = np.concatenate((self._nodes, *nodes))
        self._base = np.concatenate((self._base, starts))
        self._last = np.concatenate((self._last, np.array(counts, dtype=np.intp) - 1))
        self._scale = np.concatenate((self._scale, [1.0 / table.spacing for table in new]))
        lanes = np.array([table.lane for table in new], dtype=np.intp)
        self.route_lane = np.concatenate((self.route_lane, lanes))
        senses = np.array([table.direction for table in new], dtype=np.intp)
        self.direction = np.concatenate((self.direction, senses))
        self._stacked = len(self.tables)


def _nodes(table: LaneTable) -> FloatArray:
    """The stack's rows of one lane, shape (n, 12)."""
    x, y, z, heading, pitch, roll, curvature = table.pose
    order = 2 if len(x) > 2 else 1
    # The tangent is the heading's: exact where the samples' differences are not.
    reach = np.hypot(np.gradient(x, edge_order=order), np.gradient(y, edge_order=order))
    slopes = (reach * np.cos(heading), reach * np.sin(heading), np.gradient(z, edge_order=order))
    return np.column_stack(
        (x, y, z, *slopes, table.station, table.offset, heading, pitch, roll, curvature)
    )
