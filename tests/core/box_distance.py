"""Python form of the compiled distance of two rectangles, see `iits_mj/kernels/boxes.cc`."""

from __future__ import annotations

import math

from iits_mj.core.boxes import Corners, axis_gaps


def separation(a: Corners, b: Corners) -> float:
    """Lower bound of the distance of two rectangles [m]; zero or negative: they overlap."""
    (ax, ay, *one), (bx, by, *other) = _outline(a), _outline(b)
    return float(max(axis_gaps(bx - ax, by - ay, one, other)))


def box_distance(a: Corners, b: Corners) -> float:
    """Distance of two rectangles [m]; 0 when they overlap."""
    return 0.0 if separation(a, b) <= 0.0 else min(_to_edges(a, b), _to_edges(b, a))


def _outline(box: Corners) -> tuple[float, float, float, float, float, float]:
    """Center, cosine and sine of the heading, half of the length, half of the width."""
    (x0, y0), (x1, y1), (x2, y2), _ = box
    length, width = math.hypot(x1 - x2, y1 - y2), math.hypot(x1 - x0, y1 - y0)
    cosine, sine = (x1 - x2) / length, (y1 - y2) / length
    return 0.5 * (x0 + x2), 0.5 * (y0 + y2), cosine, sine, 0.5 * length, 0.5 * width


def _to_edges(corners: Corners, box: Corners) -> float:
    """Least distance from corners to the edges of a rectangle [m]."""
    nearest = math.inf
    for (x0, y0), (x1, y1) in zip(box, [*box[1:], box[0]], strict=True):
        ex, ey = x1 - x0, y1 - y0
        square = ex * ex + ey * ey
        for x, y in corners:
            dx, dy = x - x0, y - y0
            along = min(max((dx * ex + dy * ey) / square, 0.0), 1.0)
            dx, dy = dx - along * ex, dy - along * ey
            nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)
