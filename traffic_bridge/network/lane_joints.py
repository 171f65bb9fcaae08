"""Lanes inside junctions: from the end of one lane to the beginning of the next without a step."""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.arrays import FloatArray
from traffic_bridge.network.road_frames import SurfacePoint, wrap

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
