"""Removes the steps between the roads under SUMO's lanes: at seams and inside junctions.

In some maps consecutive roads are some decimeters apart. Where one lane leads to exactly one lane,
each side takes half of the step, faded out over a window by a cubic, as on the ego's route
(`iits_mj.road.seams`). Inside a junction a lane starts and ends where its neighbors do.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.road.road_frames import SurfacePoint
from traffic_bridge.network.net_file import NetFile

WINDOW = 30.0  # [m] over which half of a step fades out
STEP_LIMIT = 3.0  # [m]: lane ends farther apart do not meet (as on routes)
SHORT = 0.5  # [m]: a joint this short has no direction of its own
_HEADING = SurfacePoint._fields.index("heading")


def lane_seams(net: NetFile, joints: Collection[str]) -> tuple[dict[str, str], dict[str, str]]:
    """The lanes that meet at a seam, where one lane leads to exactly one lane.

    Args:
      net: the file.
      joints: SUMO's own short lanes inside junctions, which lie on no road.

    Returns:
      The lane after a lane, and the lane before a lane, by lane id.
    """
    ends: dict[str, list[str]] = {}
    starts: dict[str, list[str]] = {}
    for link in net.connections:
        if not link.start.startswith(":"):
            ends.setdefault(link.start, []).append(link.end)
            starts.setdefault(link.end, []).append(link.start)
    after = {}
    for link in net.connections:
        plain = not link.via or link.via in joints
        if plain and ends.get(link.start) == [link.end] and starts[link.end] == [link.start]:
            after[link.start] = link.end
    return after, {end: start for start, end in after.items()}


def half_step(here: SurfacePoint, there: SurfacePoint) -> FloatArray | None:
    """Half of the step from one lane end to another; None if it is zero or too large."""
    step = np.array([float(b[0] - a[0]) for a, b in zip(here, there, strict=True)])
    step[_HEADING] = wrap_angle(step[_HEADING])
    if math.hypot(step[0], step[1]) > STEP_LIMIT or abs(step[2]) > STEP_LIMIT:
        return None
    return 0.5 * step if np.abs(step).max() > 1e-9 else None


def blended(
    point: SurfacePoint, distance: FloatArray, length: float, step: FloatArray, at_end: bool
) -> SurfacePoint:
    """Points of a lane, moved by a step that fades with the distance from one end.

    Args:
      point: points of the lane, columns of shape (n,).
      distance: from the lane's beginning [m], shape (n,).
      length: of the lane [m]; the windows of its two ends do not overlap.
      step: at the moved end, in the order of `SurfacePoint`, shape (6,).
      at_end: True moves the lane's end, False its beginning.
    """
    window = min(WINDOW, 0.5 * length)
    u = np.minimum((length - distance if at_end else distance) / window, 1.0)
    share = 1.0 - u * u * (3.0 - 2.0 * u)
    rate = (6.0 if at_end else -6.0) * u * (1.0 - u) / window
    moved = SurfacePoint(*(column + share * part for column, part in zip(point, step, strict=True)))
    aside = step[1] * np.cos(point.heading) - step[0] * np.sin(point.heading)
    return moved._replace(heading=moved.heading + rate * aside, grade=moved.grade + rate * step[2])


def joint(start: SurfacePoint, end: SurfacePoint, u: FloatArray) -> SurfacePoint:
    """Points at the fractions u of a cubic Hermite curve between two points."""
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
    """Points of a lane inside a junction, moved so that it begins at `start` and ends at `end`.

    The steps at its own ends (`given_start`, `given_end`; None: no step) fade along the lane with
    the fractions u.
    """
    columns = []
    for k, column in enumerate(point):
        steps = []
        for wanted, given in ((start, given_start), (end, given_end)):
            step = 0.0 if given is None else float(wanted[k][0] - given[k][0])
            steps.append(wrap_angle(step) if point._fields[k] == "heading" else step)
        columns.append(column + (1.0 - u) * steps[0] + u * steps[1])
    return SurfacePoint(*columns)
