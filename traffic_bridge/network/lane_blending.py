"""Removes the steps between the roads under SUMO's lanes: at seams and inside junctions.

Maps can have some decimeters between roads that follow each other. Where one lane leads to exactly
one lane, each side takes half of the step, faded out over a window by a cubic, as on the ego's
route (`iits_mj.road.seams`). Inside a junction a lane starts and ends where its neighbors do.
"""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.road.road_frames import SurfacePoint
from traffic_bridge.network.net_file import NetFile

WINDOW = 30.0  # [m] over which half of a step fades out
STEP_LIMIT = 3.0  # [m]: ends that are farther apart do not belong together (as on routes)
SHORT = 0.5  # [m]: a joint this short has no direction of its own
_HEADING = SurfacePoint._fields.index("heading")


class LaneSeams:
    """Which lane ends meet.

    Args:
      net: the file.
      joints: SUMO's own short lanes inside junctions, which lie on no road.

    Attributes:
      after, before: the lane that follows or precedes a lane, by lane.
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
    """Half of the step from one end to another; None if they are equal or too far apart."""
    step = np.array([float(b[0] - a[0]) for a, b in zip(here, there, strict=True)])
    step[_HEADING] = wrap_angle(step[_HEADING])
    if math.hypot(step[0], step[1]) > STEP_LIMIT or abs(step[2]) > STEP_LIMIT:
        return None
    return 0.5 * step if np.abs(step).max() > 1e-9 else None


def blended(
    point: SurfacePoint, distance: FloatArray, length: float, step: FloatArray, at_end: bool
) -> SurfacePoint:
    """Points of a lane moved by a step that fades with the distance from one end.

    Args:
      point: of the lane, columns of shape (n,).
      distance: from the lane's beginning [m], shape (n,).
      length: of the lane [m]; the windows of its two ends do not overlap.
      step: at the end that moves, in the order of `SurfacePoint`, shape (6,).
      at_end: the lane's end moves, not its beginning.
    """
    window = min(WINDOW, 0.5 * length)
    u = np.minimum((length - distance if at_end else distance) / window, 1.0)
    share = 1.0 - u * u * (3.0 - 2.0 * u)
    rate = (6.0 if at_end else -6.0) * u * (1.0 - u) / window
    moved = SurfacePoint(*(column + share * part for column, part in zip(point, step, strict=True)))
    aside = step[1] * np.cos(point.heading) - step[0] * np.sin(point.heading)
    return moved._replace(heading=moved.heading + rate * aside, grade=moved.grade + rate * step[2])


def joint(start: SurfacePoint, end: SurfacePoint, u: FloatArray) -> SurfacePoint:
    """A cubic Hermite curve from point to point, at fractions u of it."""
    gap = math.hypot(float(end.x[0] - start.x[0]), float(end.y[0] - start.y[0]))
    turn = np.array([wrap_angle(float(end.heading[0] - start.heading[0]))])
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
    given_start: SurfacePoint | None,
    end: SurfacePoint,
    given_end: SurfacePoint | None,
) -> SurfacePoint:
    """A lane inside a junction, moved to begin at `start` and end at `end`.

    The steps from its own ends (`given_start`, `given_end`; None: no step) fade along it with the
    fractions u.
    """
    columns = []
    for k, column in enumerate(point):
        steps = []
        for wanted, given in ((start, given_start), (end, given_end)):
            step = 0.0 if given is None else float(wanted[k][0] - given[k][0])
            steps.append(wrap_angle(step) if point._fields[k] == "heading" else step)
        columns.append(column + (1.0 - u) * steps[0] + u * steps[1])
    return SurfacePoint(*columns)
