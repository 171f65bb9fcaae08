"""Rectangles in the plane: whether they touch, by separating axes, and how far apart they are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.arrays import BoolArray, FloatArray

Corners = Sequence[Sequence[float]]
"""Front right, front left, rear left and rear right corner of a rectangle, x and y [m]."""


def axis_gaps(dx: Any, dy: Any, a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
    """Gaps of two rectangles along the axes of both [m], floats or arrays of one shape.

    They overlap when no gap is positive. The greatest gap is a lower bound of the distance; it is
    less than the distance where two corners face each other.

    Args:
      dx: from the center of `a` to that of `b` along x [m].
      dy: the same along y [m].
      a: cosine and sine of the heading, half of the length, half of the width [m].
      b: likewise.
    """
    a_cos, a_sin, a_length, a_width = a
    b_cos, b_sin, b_length, b_width = b
    cosine = abs(a_cos * b_cos + a_sin * b_sin)
    sine = abs(a_cos * b_sin - a_sin * b_cos)
    return (
        abs(a_cos * dx + a_sin * dy) - (a_length + b_length * cosine + b_width * sine),
        abs(a_cos * dy - a_sin * dx) - (a_width + b_length * sine + b_width * cosine),
        abs(b_cos * dx + b_sin * dy) - (b_length + a_length * cosine + a_width * sine),
        abs(b_cos * dy - b_sin * dx) - (b_width + a_length * sine + a_width * cosine),
    )


@dataclass(frozen=True)
class Boxes:
    """Rectangles; arrays of one shape, length and width broadcast to it.

    Attributes:
      x, y: of the centers [m]; yaw: [rad]; length, width: [m].
    """

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray

    def part(self, rows: slice) -> Boxes:
        """Returns the boxes of some rows; all share the length and width."""
        return Boxes(self.x[rows], self.y[rows], self.yaw[rows], self.length, self.width)

    def touch(self, others: Boxes, room: float) -> BoolArray:
        """Returns which of the others are nearer than `room` [m], shape (n, *shape of others)."""
        own = slice(None), *(None,) * others.x.ndim
        yaw = self.yaw[own]
        half = 0.5 * self.length + room, 0.5 * self.width + room
        gaps = axis_gaps(
            others.x[None] - self.x[own],
            others.y[None] - self.y[own],
            (np.cos(yaw), np.sin(yaw), *half),
            (
                np.cos(others.yaw)[None],
                np.sin(others.yaw)[None],
                0.5 * others.length,
                0.5 * others.width,
            ),
        )
        return np.asarray(np.logical_and.reduce([gap <= 0.0 for gap in gaps]))


def box_corners(
    x: float, y: float, yaw: float, ahead: float, behind: float, width: float
) -> Corners:
    """Corners of a rectangle that reaches `ahead` and `behind` of its origin [m]."""
    forward_x, forward_y, half = math.cos(yaw), math.sin(yaw), 0.5 * width
    return [
        (x + along * forward_x + across * -forward_y, y + along * forward_y + across * forward_x)
        for along, across in ((ahead, -half), (ahead, half), (-behind, half), (-behind, -half))
    ]


class UnitShape(NamedTuple):
    """A unit of a combination from above [m].

    Attributes:
      hitch: from the origin of the unit ahead back to the coupling, which is this unit's origin;
        0 for the motor vehicle, whose origin is the center of its first axle.
      ahead, behind: from the origin to the ends of the body; negative where it ends on the other
        side, as the frame of a dolly.
      width: of the body.
    """

    hitch: float
    ahead: float
    behind: float
    width: float


class UnitBox(NamedTuple):
    """A unit's box in the plane: its origin [m], heading [rad], reach and width [m]."""

    x: float
    y: float
    yaw: float
    ahead: float
    behind: float
    width: float

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Returns the distances of a point ahead of the origin and to its left [m]."""
        dx, dy, c, s = x - self.x, y - self.y, math.cos(self.yaw), math.sin(self.yaw)
        return c * dx + s * dy, c * dy - s * dx

    def moved(self, x: float, y: float, ahead: float, left: float) -> tuple[float, float]:
        """Returns a point moved by distances along the heading and to its left [m]."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return x + c * ahead - s * left, y + s * ahead + c * left


def unit_boxes(
    x: float, y: float, yaw: float, articulations: Iterable[float], shapes: Iterable[UnitShape]
) -> list[UnitBox]:
    """Returns the boxes of a combination's units, front to rear.

    Args:
      x: center of the first axle [m].
      y: likewise [m].
      yaw: of the motor vehicle [rad].
      articulations: of the couplings, yaw of the unit ahead minus that of the towed unit [rad].
      shapes: of the units.
    """
    found: list[UnitBox] = []
    for shape, articulation in zip(shapes, (0.0, *articulations), strict=False):
        x, y = x - shape.hitch * math.cos(yaw), y - shape.hitch * math.sin(yaw)
        yaw -= articulation
        found.append(UnitBox(x, y, yaw, shape.ahead, shape.behind, shape.width))
    return found
