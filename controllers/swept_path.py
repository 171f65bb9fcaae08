"""The ground that tractor and semitrailer sweep when the steer axle follows a path, without slip.

Each unit is a bar whose rear axle group moves along the bar (a tractrix): tractor from the steer
axle to the middle of its fixed axles, semitrailer from the kingpin to the middle of its axle group.
At walking pace this is what trucks do; at speed tires' slip moves the trailer outward, see
`controllers.placement.off_tracking`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.mass_state import group_center
from iits_mj.parameters import TruckParameters


@dataclass(frozen=True)
class SweptPath:
    """Tracks over the path's points; positions of shape (n, 2) [m], headings (n,) [rad].

    Attributes:
      steer, kingpin, trailer_axle: of the steer axle, the kingpin, the trailer's axle group.
      yaw, trailer_yaw: headings of the units.
      tractor_corners, trailer_corners: front left, front right, rear right, rear left of the
        bodies, shape (n, 4, 2).
    """

    steer: FloatArray
    kingpin: FloatArray
    trailer_axle: FloatArray
    yaw: FloatArray
    trailer_yaw: FloatArray
    tractor_corners: FloatArray
    trailer_corners: FloatArray


def swept_path(
    parameters: TruckParameters,
    path: FloatArray,
    yaw: float,
    trailer_yaw: float | None = None,
) -> SweptPath:
    """Sweeps the truck along a path of its steer axle.

    Args:
      parameters: of the truck.
      path: points, shape (n, 2), some decimetres apart [m].
      yaw: heading of the tractor at the first point [rad].
      trailer_yaw: of the semitrailer there [rad]; default: the tractor's.
    """
    tractor, trailer = parameters.tractor, parameters.semitrailer
    wheelbase = group_center(tractor.axles[1:]) - tractor.axles[0].position
    hitch = parameters.fifth_wheel.position - tractor.axles[0].position
    length = group_center(trailer.axles)
    headings = _towed(path, wheelbase, yaw)
    kingpin = path - hitch * _unit(headings)
    followed = _towed(kingpin, length, yaw if trailer_yaw is None else trailer_yaw)
    tail = wheelbase + 1.0
    return SweptPath(
        steer=path,
        kingpin=kingpin,
        trailer_axle=kingpin - length * _unit(followed),
        yaw=headings,
        trailer_yaw=followed,
        tractor_corners=_corners(path, headings, tractor.front_overhang, tail, tractor.width),
        trailer_corners=_corners(
            kingpin,
            followed,
            trailer.front_overhang,
            trailer.length - trailer.front_overhang,
            trailer.width,
        ),
    )


def _towed(lead: FloatArray, length: float, heading: float) -> FloatArray:
    """Headings of a bar whose front is at the points and whose rear rolls, shape (n,).

    Between two points the front goes straight, for which the tractrix is known: the angle to its
    course falls by `tan(theta / 2) exp(-way / length)`.
    """
    result = np.empty(len(lead))
    result[0] = heading
    steps = np.diff(lead, axis=0)
    ways, courses = np.hypot(*steps.T), np.arctan2(steps[:, 1], steps[:, 0])
    for i, (way, course) in enumerate(zip(ways.tolist(), courses.tolist(), strict=True)):
        if way > 0.0:
            angle = math.remainder(heading - course, 2.0 * math.pi)
            left = 2.0 * math.atan(math.tan(0.5 * angle) * math.exp(-way / length))
            heading += left - angle
        result[i + 1] = heading
    return result


def _unit(heading: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(heading), np.sin(heading)])


def _corners(
    origin: FloatArray, heading: FloatArray, front: float, rear: float, width: float
) -> FloatArray:
    """Corners of a body about its origin, shape (n, 4, 2)."""
    along, left = _unit(heading), _unit(heading + 0.5 * np.pi)
    half = 0.5 * width
    ends = ((front, half), (front, -half), (-rear, -half), (-rear, half))
    return np.stack([origin + x * along + y * left for x, y in ends], axis=1)
