"""Who drives where: bumper gaps along a lane, for the planner and the decision makers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.planning.predicted_boxes import FIGURES, table_of
from controllers.planning.road_preview import LanePath, RoadPreview
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Scene, TrackedVehicle

INTRUSION = 0.3
# Clearances of bridges are 4.5 m and more, grades and crests shift heights by less than this [m].
OTHER_LEVEL = 3.0
# Slower than this across the lane is weaving, not changing lanes [m/s].
WEAVING = 0.3


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

    Args:
      scene: the truck and the traffic.
      anticipation: [s].
      preview: of the road; with it, who drives on another level, on a bridge above say, is left
        out. A vehicle with x, y and z all zero has no pose, and counts by station and offset alone.

    Attributes:
      station, offset, speed: of the vehicles, shape (n,) [m], [m/s].
      here: on the truck's level, shape (n,).
      table: of the vehicles, see `table_of`.

    Raises:
      InputError: a vehicle's station, offset, speed, acceleration, size or place is not finite;
        the message names it.
    """

    def __init__(
        self, scene: Scene, anticipation: float = 1.0, preview: RoadPreview | None = None
    ) -> None:
        self.scene = scene
        self.front = scene.ego.station + scene.footprint.front_overhang
        self.rear = self.front - scene.footprint.length
        self.table = table = table_of(scene.vehicles)
        finite = np.isfinite(table)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            raise InputError(
                f"vehicle {scene.vehicles[row].id!r}: {FIGURES[column]} is {table[row, column]}: "
                "not finite"
            )
        self.station, self.offset, self.speed = table[:, 0], table[:, 1], table[:, 2]
        self._half_length, self._half_width = 0.5 * table[:, 4], 0.5 * table[:, 5]
        self._lateral_speed = table[:, 3]
        self._predicted = self.offset + anticipation * table[:, 3]
        self._inside: dict[int, tuple[LanePath, NDArray[np.bool_]]] = {}
        self.here = np.ones(len(table), dtype=bool)
        if preview is not None and len(table):
            height = table[:, -1] - preview.height_at(self.station, self.offset)
            posed = (table[:, -3:] != 0.0).any(axis=1)
            self.here = ~posed | (np.abs(height) < OTHER_LEVEL)

    def within(self, path: LanePath, entering: float = 0.0) -> NDArray[np.bool_]:
        """Which vehicles are in the lane of a path, shape (n,).

        Args:
          path: of the lane.
          entering: those count, too, that move across faster than they weave and will be in the
            lane within so much time [s].
        """
        middle = path.offset_at(self.station)
        reach = path.half_width + self._half_width - INTRUSION
        inside = (np.abs(self.offset - middle) < reach) | (np.abs(self._predicted - middle) < reach)
        if entering > 0.0:
            crossing = np.abs(self._lateral_speed) > WEAVING
            later = self.offset + entering * self._lateral_speed
            # Who would be across the whole lane by then has been in it.
            through = (self.offset - middle) * (later - middle) < 0.0
            inside |= crossing & ((np.abs(later - middle) < reach) | through)
        seen = (self.station >= path.station[0]) & (self.station <= path.station[-1])
        # Beyond a lane's end nobody drives in it.
        return inside & seen & (self.station <= path.end) & self.here

    def in_lane(self, path: LanePath, entering: float = 0.0) -> list[Neighbor]:
        """Everybody in the lane of a path, in the scene's order; `entering` as of `within`."""
        if not self.station.size:
            return []
        return [
            Neighbor(self.scene.vehicles[int(i)], self.gap(int(i)))
            for i in np.flatnonzero(self.within(path, entering))
        ]

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

    def _in(self, path: LanePath) -> NDArray[np.bool_]:
        """`within` of a path, which is asked for several times a cycle."""
        known = self._inside.get(id(path))
        if known is None:
            known = self._inside[id(path)] = path, self.within(path)
        return known[1]

    def _nearest(self, path: LanePath, side: NDArray[np.bool_]) -> Neighbor | None:
        if not self.station.size:
            return None
        candidates = np.flatnonzero(side & self._in(path)).tolist()
        if not candidates:
            return None
        gap, index = min((self.gap(i), i) for i in candidates)
        return Neighbor(self.scene.vehicles[index], gap)
