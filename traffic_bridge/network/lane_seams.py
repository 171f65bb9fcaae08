"""Steps between roads that follow each other: dirty maps have some decimeters there.

Each side takes half of the step, fading out over a window by a cubic, as the ego's route has it
(`iits_mj.road.seams`). Only where one lane leads to one lane: there both know where to meet.
"""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.arrays import FloatArray
from traffic_bridge.network.net_file import NetFile
from traffic_bridge.network.road_frames import SurfacePoint, wrap

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
