"""The cab of a motor vehicle: a lofted shell with patches of glass, grille and lights on it."""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.model.visuals.layout import CAB_FLOOR, WHEEL_SPACE, Layout
from iits_mj.model.visuals.shapes import Painter, Shape, boxes, merge, prism, surface

# The cab's front seen from the side and from ahead: height, set-back behind the bumper's foremost
# point, half width, all for a cab 3.70 m high and 2.50 m wide; what is above the cab's floor is
# scaled to the height.
_PROFILE = np.array(
    [
        (0.34, 0.120, 1.190),
        (0.42, 0.040, 1.225),
        (0.55, 0.010, 1.238),
        (0.80, 0.000, 1.245),
        (1.16, 0.005, 1.245),
        (1.60, 0.025, 1.242),
        (1.98, 0.055, 1.236),
        (2.10, 0.075, 1.232),
        (2.50, 0.175, 1.215),
        (2.92, 0.300, 1.192),
        (3.02, 0.345, 1.185),
        (3.22, 0.560, 1.150),
        (3.42, 0.880, 1.105),
        (3.57, 1.210, 1.055),
        (3.66, 1.520, 1.000),
        (3.70, 1.800, 0.940),
    ]
)
_HEIGHT, _WIDTH = 3.70, 2.50
_CORNER = 6.5  # exponent of the superellipse of the front corners
_EXTENDERS = 0.44  # [m], behind the cab


class _Cab:
    """The cab's outer surface, by height and by arc length from the middle of the front.

    Heights are those of a cab 3.70 m high.
    """

    def __init__(self, layout: Layout, rear: float) -> None:
        unit = layout.unit
        self.z = _PROFILE[:, 0]
        self.scale = (layout.cab_height - CAB_FLOOR) / (_HEIGHT - CAB_FLOOR)
        self.front = unit.front_overhang - _PROFILE[:, 1]
        self.half_width = _PROFILE[:, 2] * unit.width / _WIDTH
        self.rear = rear

    def height(self, z: float) -> float:
        """Returns the height above the road [m] of a height of the profile."""
        return CAB_FLOOR + self.scale * (z - CAB_FLOOR) if z > CAB_FLOOR else z

    def line(self, z: float, inflate: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Horizontal section: arc length (n,), points (n, 3), from the right rear to the left."""
        front = float(np.interp(z, self.z, self.front)) + inflate
        half = float(np.interp(z, self.z, self.half_width)) + inflate
        t = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 241)
        power = 2.0 / _CORNER
        x = self.rear + (front - self.rear) * np.cos(t).clip(0.0) ** power
        y = half * np.sign(t) * np.abs(np.sin(t)) ** power
        points = np.stack([x, y, np.full_like(x, self.height(z))], axis=-1)
        length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        return length - length[120], points

    def at(self, z: float, along: FloatArray, inflate: float = 0.0) -> FloatArray:
        """Points at arc lengths from the middle of the front, positive to the left [m]."""
        length, points = self.line(z, inflate)
        return np.stack([np.interp(along, length, points[:, i]) for i in range(3)], axis=-1)

    def patch(
        self,
        low: float,
        high: float,
        start: tuple[float, float],
        end: tuple[float, float],
        inflate: float = 0.006,
    ) -> Shape:
        """A sheet on the surface; `start`, `end` are arc lengths at its lower and upper edge."""
        heights = self._heights(low, high)
        share = (heights - low) / (high - low)
        left = start[0] + share * (start[1] - start[0])
        right = end[0] + share * (end[1] - end[0])
        columns = min(60, max(3, 2 + int(np.max(np.abs(right - left)) / 0.05)))
        rows = [
            self.at(float(z), np.linspace(a, b, columns), inflate)
            for z, a, b in zip(heights, left, right, strict=True)
        ]
        return surface(np.stack(rows))

    def _heights(self, low: float, high: float) -> FloatArray:
        """Both heights and those of the profile between them, (n,)."""
        return np.unique([low, high, *self.z[(self.z > low) & (self.z < high)]])

    def body(self, low: float, high: float) -> Shape:
        """The closed cab between two heights."""
        rings = []
        for z in self._heights(low, high):
            length, _ = self.line(float(z))
            rings.append(self.at(float(z), np.linspace(length[0], length[-1], 73)))
        grid = np.stack(rings)
        back = np.stack([grid[:, -1], grid[:, 0]], axis=1)
        caps = [_cap(grid[-1]), _cap(grid[0][::-1])]
        return merge([surface(grid), surface(back), *caps])


def _cap(points: FloatArray) -> Shape:
    """A flat lid over a convex ring, facing the side from which it runs counter-clockwise."""
    fan = np.array([[0, i, i + 1] for i in range(1, len(points) - 1)], dtype=np.int32)
    return Shape(points.copy(), fan)


def draw_cab(painter: Painter, layout: Layout) -> None:
    """Adds the cab with bumper and mirrors."""
    steer = layout.unit.axles[0]
    ahead_of_wheels = layout.radius(steer) + WHEEL_SPACE - steer.position
    cab = _Cab(layout, layout.cab_rear)
    bumper = _Cab(layout, min(ahead_of_wheels, layout.unit.front_overhang - 0.3))
    _shell(painter, layout, cab, bumper)
    _front(painter, cab, bumper)
    _sides(painter, cab)
    _mirrors(painter, cab)


def _shell(painter: Painter, layout: Layout, cab: _Cab, bumper: _Cab) -> None:
    top, rear = float(cab.z[-1]), cab.rear
    painter.mesh("cab", cab.body(CAB_FLOOR, top), "truck_paint")
    painter.mesh("bumper", bumper.body(float(cab.z[0]), CAB_FLOOR - 0.012), "truck_paint")
    # Extenders close the gap to a semitrailer; they end ahead of its swinging corners.
    end = max(rear - _EXTENDERS, layout.clear_of_towed + 0.1)
    if layout.unit.kind == "tractor" and end < rear - 0.1:
        low, high = cab.height(1.25), (cab.height(3.02), cab.height(3.38))
        y = (1.20 - 0.035) * layout.unit.width / _WIDTH
        panel = [(rear + 0.02, low), (end, low), (end, high[0]), (rear + 0.02, high[1])]
        painter.pair("extenders", prism(panel, y, 0.035), "truck_paint")
    size = (0.02, layout.unit.width - 0.3, 1.9 * cab.scale)
    painter.box("cab_back", (rear - 0.005, 0, cab.height(2.2)), size, "truck_black")
    painter.box("engine", (0.0, 0, 0.85), (1.5, 0.86, 0.62), "truck_chassis")


def _front(painter: Painter, cab: _Cab, bumper: _Cab) -> None:
    # Patches across the middle: name, surface, heights, half widths at them, inflation, material.
    for name, of, low, high, below, above, inflate, material in (
        ("windscreen", cab, 2.04, 2.90, 1.30, 1.25, 0.008, "truck_glass"),
        ("sun_visor", cab, 2.93, 3.06, 1.22, 1.16, 0.05, "truck_black"),
        ("grille", cab, 1.18, 1.93, 0.86, 1.02, 0.008, "truck_black"),
    ):
        painter.mesh(name, of.patch(low, high, (-below, -above), (below, above), inflate), material)
    slats = [
        cab.patch(z, z + 0.035, (-w, -w), (w, w), 0.026)
        for z, w in ((1.26, 0.80), (1.38, 0.83), (1.50, 0.86), (1.62, 0.88))
    ]
    badge = cab.patch(1.76, 1.86, (-0.30, -0.31), (0.30, 0.31), 0.03)
    painter.mesh("grille_slats", merge([*slats, badge]), "truck_chrome")
    grille = bumper.patch(0.46, 0.92, (-0.62, -0.70), (0.62, 0.70), 0.008)
    painter.mesh("bumper_grille", grille, "truck_black")
    lamps = bumper.patch(0.60, 1.02, (0.80, 0.86), (1.42, 1.46), 0.010)
    painter.pair("headlamp_glass", lamps, "truck_glass")
    beams = (
        bumper.patch(0.80, 0.94, (0.93, 0.94), (1.12, 1.12), 0.018),
        bumper.patch(0.66, 0.75, (0.93, 0.93), (1.08, 1.08), 0.018),
        bumper.patch(0.965, 0.99, (0.88, 0.88), (1.40, 1.40), 0.018),
    )
    painter.pair("headlights", beams, "truck_headlight")
    front = float(bumper.front.max())
    on_roof = [
        ((front - 0.98, 0.34, cab.height(3.44)), (0.10, 0.16, 0.05)),
        ((front - 1.06, 0.80, cab.height(3.40)), (0.10, 0.16, 0.05)),
    ]
    blinker = bumper.patch(0.70, 0.92, (1.19, 1.19), (1.36, 1.36), 0.018)
    painter.sides("indicator", blinker, "truck_indicator")
    painter.pair("marker_lights", boxes(on_roof), "truck_amber")
    painter.box("plate", (front + 0.012, 0, 0.56), (0.02, 0.44, 0.14), "truck_plate")
    sill = cab.height(2.06)
    wipers = [((front - 0.085, s, sill), (0.03, 0.72, 0.03)) for s in (-0.5, 0.35)]
    painter.mesh("wipers", boxes(wipers), "truck_black")


def _sides(painter: Painter, cab: _Cab) -> None:
    window = cab.patch(2.06, 2.84, (1.56, 1.60), (2.62, 2.48), 0.007)
    painter.pair("side_windows", window, "truck_glass")
    gaps = (
        cab.patch(1.22, 2.88, (1.50, 1.46), (1.512, 1.472)),
        cab.patch(1.22, 2.88, (2.70, 2.70), (2.712, 2.712)),
        cab.patch(2.885, 2.897, (1.46, 1.46), (2.712, 2.712)),
        cab.patch(1.84, 1.90, (2.40, 2.40), (2.62, 2.62), 0.02),
    )
    painter.pair("door_gaps", gaps, "truck_black")
    stripes = (
        cab.patch(1.42, 1.50, (1.42, 1.45), (3.45, 3.45), 0.005),
        cab.patch(1.54, 1.57, (1.47, 1.48), (3.45, 3.45), 0.005),
        cab.patch(2.20, 3.02, (2.90, 3.16), (3.08, 3.34), 0.005),
    )
    painter.pair("stripes", stripes, "truck_accent")


def _mirrors(painter: Painter, cab: _Cab) -> None:
    x, side = float(cab.front[8]) - 0.02, float(cab.half_width.max()) - 1.245
    parts = [
        ((x + 0.02, side + 1.46, cab.height(2.44)), (0.16, 0.24, 0.62)),
        ((x + 0.02, side + 1.46, cab.height(2.02)), (0.16, 0.24, 0.16)),
        ((x, side + 1.32, cab.height(2.72)), (0.05, 0.34, 0.05)),
        ((x, side + 1.32, cab.height(2.10)), (0.05, 0.34, 0.05)),
    ]
    painter.pair("mirrors", boxes(parts), "truck_black")
    glass = boxes([((x - 0.065, side + 1.46, cab.height(2.44)), (0.012, 0.20, 0.56))])
    painter.pair("mirror_glass", glass, "truck_chrome")
