"""The straight two-lane road of the fast world: answers what decision makers ask of a `Route`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

LANES = 2
LANE_WIDTH = 4.0
LENGTH = 15_000.0


@dataclass(frozen=True)
class StraightPoint:
    """Pose on the straight road; the fields are those of `iits_mj.road.RoadPoint`."""

    x: float
    y: float
    z: float
    heading: float
    curvature: float
    grade: float
    superelevation: float


class HighwayRoad:
    """Two lanes of 4 m, 15 km, straight in plan, hilly in profile.

    The reference line is the centre of lane 0, so that a lane's offset is its index times 4 m.
    Grades are two sine waves with random phases, at most `grade_max`: shaped like the paper's
    road, whose grades lie within 5 %. Plays the part of `iits_mj.road.Route` for the functions
    below only.
    """

    def __init__(
        self, generator: np.random.Generator, length: float = LENGTH, grade_max: float = 0.045
    ) -> None:
        self.length = length
        self._amplitude = (0.65 * grade_max, 0.35 * grade_max)
        self._period = (1900.0, 730.0)
        self._phase = tuple(generator.uniform(0.0, 2.0 * math.pi, 2).tolist())

    def smoothed_grade(self, station: float) -> float:
        """Grade dz/ds."""
        waves = zip(self._amplitude, self._period, self._phase, strict=True)
        return sum(a * math.sin(2.0 * math.pi * station / p + phase) for a, p, phase in waves)

    def evaluate(self, station: float, offset: float = 0.0) -> StraightPoint:
        """Pose at a station and offset; height is not modeled."""
        grade = self.smoothed_grade(station)
        return StraightPoint(station, offset, 0.0, 0.0, 0.0, grade, 0.0)

    def lane_count(self, station: float) -> int:
        """Always two."""
        del station
        return LANES

    def lane_exists(self, lane: int, station: float) -> bool:
        """True for lanes 0 and 1 on the road."""
        return 0 <= lane < LANES and station <= self.length + 1000.0

    def lane_offset(self, lane: int, station: float) -> float:
        """Offset of the lane's centre [m]."""
        del station
        return lane * LANE_WIDTH

    def lane_width(self, lane: int, station: float) -> float:
        """Width [m]."""
        del lane, station
        return LANE_WIDTH

    def lane_at(self, station: float, offset: float) -> int:
        """Lane under an offset, -1 beside the road."""
        del station
        lane = math.floor(offset / LANE_WIDTH + 0.5)
        return lane if 0 <= lane < LANES else -1

    def speed_limit(self, station: float, lane: int = 0) -> float:
        """The truck's limit, 60 km/h [m/s]."""
        del station, lane
        return 60.0 / 3.6
