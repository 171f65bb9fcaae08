"""The part of a road that one of SUMO's lanes covers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from traffic_bridge.network.net_file import NetConnection
from traffic_bridge.network.road_frames import RoadFrame, SurfacePoint


class Row(NamedTuple):
    """Stations of a road that a SUMO lane covers; `parts` of it where no stretch tells them."""

    low: float
    high: float
    lane: str
    parts: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Stretch:
    """The part of a road that a SUMO lane covers: stations `s` at fractions `part` of its length.

    Fractions grow evenly with the length of the lane's centre (of the mean of an edge's lanes, so
    that neighbors who stand at one position stand abreast). `lanes` are the lane's OpenDRIVE ids by
    lane section.
    """

    frame: RoadFrame
    lanes: dict[int, int]
    part: FloatArray
    s: FloatArray

    @property
    def sense(self) -> float:
        """+1 where stations grow in travel, -1 where they fall."""
        return 1.0 if self.s[-1] > self.s[0] else -1.0

    def beyond(
        self, end: bool, covered: float, lane: str, parts: tuple[float, float]
    ) -> tuple[tuple[str, int], Row]:
        """What another lane covers beyond this one's end (or before its beginning) [m].

        Args:
          end: beyond the end, not before the beginning.
          covered: metres of the road.
          lane: that covers them.
          parts: of that lane, in travel.
        """
        near = float(self.s[-1] if end else self.s[0])
        far = near + self.sense * (covered if end else -covered)
        section = (max if (self.sense > 0) == end else min)(self.lanes)
        rising = self.sense > 0
        row = Row(min(near, far), max(near, far), lane, parts if rising else parts[::-1])
        return (self.frame.road.id, self.lanes[section]), row

    def road_end(self, end: int) -> SurfacePoint:
        """The lane's centre where its road begins (0) or ends (-1) in travel, columns (1,)."""
        ends = (0.0, self.frame.length) if self.sense > 0 else (self.frame.length, 0.0)
        return self.frame.evaluate(self.lanes, ends[end])

    def s_at(self, part: ArrayLike) -> FloatArray:
        """Stations of the road at fractions of the lane."""
        return np.interp(np.asarray(part, dtype=float), self.part, self.s)

    def part_at(self, s: float) -> float:
        """Fraction of the lane at a station, 0 to 1."""
        order = slice(None) if self.s[-1] > self.s[0] else slice(None, None, -1)
        return float(np.interp(s, self.s[order], self.part[order]))


class Inside(NamedTuple):
    """A lane inside a junction: the way it belongs to, from fraction `start` to `end` of it."""

    connection: NetConnection
    start: float
    end: float
