"""Lanes inside junctions: from the end of one lane to the beginning of the next without a step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.road.road_frames import RoadFrame, SurfacePoint, wrap
from traffic_bridge.network.net_file import NetConnection, NetFile

# --- The part of a road that one of SUMO's lanes covers ---


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


# --- Steps between roads that follow each other: dirty maps have some decimeters there ---
# Each side takes half of the step, fading out over a window by a cubic, as the ego's route has it
# (`iits_mj.road.seams`). Only where one lane leads to one lane: there both know where to meet.

WINDOW = 30.0  # [m] over which half of a step fades out
STEP_LIMIT = 3.0  # [m]: beyond it two ends are not one place (as in routes)
_HEADING = SurfacePoint._fields.index("heading")


class LaneSeams:
    """Which lane ends meet, and how far each has to move.

    Args:
      net: the file.
      joints: SUMO's own short lanes inside junctions, that no road lies under.
    """

    def __init__(self, net: NetFile, joints: frozenset[str]) -> None:
        after: dict[str, list[str]] = {}
        before: dict[str, list[str]] = {}
        for link in net.connections:
            if not link.start.startswith(":"):
                after.setdefault(link.start, []).append(link.end)
                before.setdefault(link.end, []).append(link.start)
        self.after: dict[str, str] = {}
        self.before: dict[str, str] = {}
        for link in net.connections:
            start, end = link.start, link.end
            plain = not link.via or link.via in joints
            if plain and after.get(start) == [end] and before[end] == [start]:
                self.after[start], self.before[end] = end, start


def half_step(here: SurfacePoint, there: SurfacePoint) -> FloatArray | None:
    """What moves an end half-way to another; None where they are too far apart, or one already."""
    step = np.array([float(b[0] - a[0]) for a, b in zip(here, there, strict=True)])
    step[_HEADING] = wrap(step[_HEADING])
    if math.hypot(step[0], step[1]) > STEP_LIMIT or abs(step[2]) > STEP_LIMIT:
        return None
    return 0.5 * step if np.abs(step).max() > 1e-9 else None


def blended(
    point: SurfacePoint, way: FloatArray, length: float, step: FloatArray, at_end: bool
) -> SurfacePoint:
    """Points of a lane moved by a step that fades with the distance from one end.

    Args:
      point: of the lane, columns of shape (n,).
      way: from the lane's beginning [m], shape (n,).
      length: of the lane [m]; each end's window ends at its middle at the latest.
      step: at the end that moves, in the order of `SurfacePoint`, shape (6,).
      at_end: the lane's end moves, not its beginning.
    """
    window = min(WINDOW, 0.5 * length)
    u = np.minimum((length - way if at_end else way) / window, 1.0)
    share = 1.0 - u * u * (3.0 - 2.0 * u)
    rate = (6.0 if at_end else -6.0) * u * (1.0 - u) / window
    moved = SurfacePoint(*(column + share * part for column, part in zip(point, step, strict=True)))
    aside = step[1] * np.cos(point.heading) - step[0] * np.sin(point.heading)
    return moved._replace(heading=moved.heading + rate * aside, grade=moved.grade + rate * step[2])


# --- Lanes inside junctions: from the end of one lane to the beginning of the next without a step

SHORT = 0.5  # [m]: a joint this short has no direction of its own


def joint(start: SurfacePoint, end: SurfacePoint, u: FloatArray) -> SurfacePoint:
    """A cubic Hermite curve from end to end, at fractions u of it."""
    gap = math.hypot(float(end.x[0] - start.x[0]), float(end.y[0] - start.y[0]))
    turn = np.array([wrap(float(end.heading[0] - start.heading[0]))])
    bank = start.bank + u * (end.bank - start.bank)
    if gap < SHORT:
        x, y, z, grade = (
            a + u * (b - a)
            for a, b in (
                (start.x, end.x), (start.y, end.y), (start.z, end.z), (start.grade, end.grade)
            )
        )  # fmt: skip
        return SurfacePoint(x, y, z, start.heading + u * turn, grade, bank)
    values, slopes = [], []
    for a, b, da, db in (
        (start.x, end.x, np.cos(start.heading), np.cos(end.heading)),
        (start.y, end.y, np.sin(start.heading), np.sin(end.heading)),
        (start.z, end.z, start.grade, end.grade),
    ):
        c = 3.0 * (b - a) - gap * (2.0 * da + db)
        d = gap * (da + db) - 2.0 * (b - a)
        values.append(a + u * (gap * da + u * (c + u * d)))
        slopes.append(gap * da + u * (2.0 * c + 3.0 * u * d))
    way = np.maximum(np.hypot(slopes[0], slopes[1]), 1e-9)
    heading = np.arctan2(slopes[1], slopes[0])
    return SurfacePoint(values[0], values[1], values[2], heading, slopes[2] / way, bank)


def moved(
    point: SurfacePoint,
    u: FloatArray,
    start: SurfacePoint,
    begun: SurfacePoint | None,
    end: SurfacePoint,
    ended: SurfacePoint | None,
) -> SurfacePoint:
    """A way moved to begin at `start` and end at `end`; what is missing fades along it."""
    columns = []
    for k, column in enumerate(point):
        steps = []
        for wanted, given in ((start, begun), (end, ended)):
            step = 0.0 if given is None else float(wanted[k][0] - given[k][0])
            steps.append(wrap(step) if point._fields[k] == "heading" else step)
        columns.append(column + (1.0 - u) * steps[0] + u * steps[1])
    return SurfacePoint(*columns)
