"""The cab-over 6x4 tractor: a lofted cab with patches of glass, grille and lights on it."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.model.visuals.shapes import Painter, Shape, arch, boxes, merge, prism, surface
from iits_mj.parameters import TruckParameters

# The cab's front seen from the side and from ahead: height, set-back behind the bumper's foremost
# point, half width, all for a cab 3.70 m high and 2.50 m wide; scaled to the parameters.
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
_CAB_REAR = -0.98
_CAB_FLOOR = 1.16
_BUMPER_REAR = 0.64
_CORNER = 6.5  # exponent of the superellipse of the front corners
# Start and end of a rear fender about the wheel [rad], from ahead over the top to behind.
_FENDER = (math.radians(12.0), math.radians(168.0))


class _Cab:
    """The cab's outer surface, by height and by arc length from the middle of the front."""

    def __init__(self, parameters: TruckParameters, rear: float) -> None:
        tractor = parameters.lead
        self.z = _PROFILE[:, 0] * tractor.height / 3.70
        self.front = tractor.front_overhang - _PROFILE[:, 1]
        self.half_width = _PROFILE[:, 2] * tractor.width / 2.50
        self.rear = rear

    def line(self, z: float, inflate: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Horizontal section: arc length (n,), points (n, 3), from the right rear to the left."""
        front = float(np.interp(z, self.z, self.front)) + inflate
        half = float(np.interp(z, self.z, self.half_width)) + inflate
        t = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 241)
        power = 2.0 / _CORNER
        x = self.rear + (front - self.rear) * np.cos(t).clip(0.0) ** power
        y = half * np.sign(t) * np.abs(np.sin(t)) ** power
        points = np.stack([x, y, np.full_like(x, z)], axis=-1)
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


def draw_tractor(spec: mujoco.MjSpec, parameters: TruckParameters) -> None:
    """Adds cab, chassis and fittings in a body welded to `tractor`."""
    body = spec.body("tractor").add_body(name="tractor_visuals")
    painter = Painter(spec, body, "tractor")
    cab, bumper = _Cab(parameters, _CAB_REAR), _Cab(parameters, _BUMPER_REAR)
    _cab_shell(painter, cab, bumper)
    _front(painter, cab, bumper)
    _sides(painter, cab)
    _mirrors(painter, cab)
    _chassis(painter, parameters)
    _fenders(painter, parameters)
    _rear(painter, parameters)


def _cab_shell(painter: Painter, cab: _Cab, bumper: _Cab) -> None:
    top = float(cab.z[-1])
    painter.mesh("cab", cab.body(_CAB_FLOOR, top), "truck_paint")
    painter.mesh("bumper", bumper.body(float(cab.z[0]), _CAB_FLOOR - 0.012), "truck_paint")
    # Extenders close the gap to the trailer; they end ahead of its swinging corners.
    panel = prism([(-0.96, 1.25), (-1.42, 1.25), (-1.42, 3.02), (-0.96, 3.38)], 1.165, 0.035)
    painter.pair("extenders", panel, "truck_paint")
    painter.box("cab_back", (-0.985, 0, 2.2), (0.02, 2.2, 1.9), "truck_black")
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
    on_roof = [((0.42, 0.34, 3.44), (0.10, 0.16, 0.05)), ((0.34, 0.80, 3.40), (0.10, 0.16, 0.05))]
    blinker = bumper.patch(0.70, 0.92, (1.19, 1.19), (1.36, 1.36), 0.018)
    painter.pair("turn_lights", (blinker, boxes(on_roof)), "truck_amber")
    front = float(bumper.front.max())
    painter.box("plate", (front + 0.012, 0, 0.56), (0.02, 0.44, 0.14), "truck_plate")
    wipers = [((front - 0.085, s, 2.06), (0.03, 0.72, 0.03)) for s in (-0.5, 0.35)]
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
    x = float(cab.front[8]) - 0.02
    parts = [
        ((x + 0.02, 1.46, 2.44), (0.16, 0.24, 0.62)),
        ((x + 0.02, 1.46, 2.02), (0.16, 0.24, 0.16)),
        ((x, 1.32, 2.72), (0.05, 0.34, 0.05)),
        ((x, 1.32, 2.10), (0.05, 0.34, 0.05)),
    ]
    painter.pair("mirrors", boxes(parts), "truck_black")
    painter.pair(
        "mirror_glass", boxes([((x - 0.065, 1.46, 2.44), (0.012, 0.20, 0.56))]), "truck_chrome"
    )


def _chassis(painter: Painter, p: TruckParameters) -> None:
    end = -p.lead.axles[-1].position - 0.86
    length = 0.6 - end
    rails = boxes([((0.6 - 0.5 * length, 0.40, 0.83), (length, 0.09, 0.28))]).with_mirror()
    crossbars = boxes([((x, 0, 0.86), (0.16, 0.8, 0.2)) for x in (-1.3, -2.4, -3.9, end + 0.1)])
    painter.mesh("rails", merge([rails, crossbars]), "truck_chassis")
    x, seat = -p.couplings[0].position, p.couplings[0].height
    low, high = (x, 0.0, seat - 0.075), (x, 0.0, seat - 0.015)
    painter.cylinder("fifth_wheel", low, high, 0.46, "truck_black")
    foot = boxes([((x, 0.36, seat - 0.11), (0.5, 0.14, 0.10))]).with_mirror()
    profile = [(0.3, 0.03), (0.95, 0.17), (0.95, 0.21), (0.3, 0.09)]
    ramps = prism([(x - back, seat - down) for back, down in profile], 0.14, 0.2).with_mirror()
    painter.mesh("fifth_wheel_foot", merge([foot, ramps]), "truck_black")
    # Between the axles: fuel tank left, air tanks and battery box right, skirts below the cab.
    a, b = -1.12, -p.lead.axles[1].position + 0.64
    painter.cylinder("fuel_tank", (a, 0.86, 0.70), (b, 0.86, 0.70), 0.33, "truck_aluminum")
    bands = [((a + (b - a) * f, 0.86, 0.70), (0.05, 0.675, 0.675)) for f in (0.25, 0.75)]
    painter.mesh("tank_bands", boxes(bands), "truck_chassis")
    painter.box("battery_box", (a - 0.32, -0.88, 0.70), (0.64, 0.62, 0.62), "truck_chassis")
    for index, z in enumerate((0.56, 0.88)):
        name = f"air_tank{index + 1}"
        painter.cylinder(name, (a - 0.74, -0.95, z), (b, -0.95, z), 0.135, "truck_aluminum")
    middle = 0.5 * (a - 0.7 + b)
    painter.box("catwalk", (middle, 0, 1.0), (abs(b - a) - 0.3, 0.9, 0.03), "truck_aluminum")
    lines = ((-0.25, "truck_tail_light"), (0.0, "truck_black"), (0.25, "truck_plate"))
    for index, (y, material) in enumerate(lines):
        name, low, high = f"air_line{index + 1}", (-1.0, y, 1.75), (-1.5, y * 0.8, 1.02)
        painter.cylinder(name, low, high, 0.022, material, round_ends=True)


def _fenders(painter: Painter, parameters: TruckParameters) -> None:
    steer, *drive = parameters.lead.axles
    radius = parameters.tires[steer.tire].free_radius
    outside = 0.5 * parameters.lead.width
    front = arch(radius + 0.055, 0.05, 0.06, math.pi - 0.06, outside - 0.40, 0.40)
    front = front.moved((-steer.position, 0.0, radius - 0.015))
    painter.pair("front_fenders", front, "truck_black")
    steps = boxes([((-0.82, outside - 0.20, 0.83), (0.32, 0.39, 0.66))])
    painter.pair("steps", steps, "truck_paint")
    skirt = prism([(-1.0, 0.42), (-1.0, 1.12), (-1.75, 1.12), (-1.55, 0.42)], 1.20, 0.035)
    painter.pair("skirts", skirt, "truck_paint")
    rear = []
    for axle in drive:
        tire = parameters.tires[axle.tire]
        shape = arch(tire.free_radius + 0.06, 0.03, *_FENDER, 0.5 * axle.track - 0.30, 0.60)
        rear.append(shape.moved((-axle.position, 0.0, tire.free_radius - 0.015)))
    painter.pair("rear_fenders", rear, "truck_black")


def _rear(painter: Painter, parameters: TruckParameters) -> None:
    x = -parameters.lead.axles[-1].position - 0.92
    painter.box("rear_bar", (x, 0, 0.80), (0.08, 2.30, 0.16), "truck_chassis")
    red = boxes([((x - 0.05, 0.86, 0.80), (0.03, 0.36, 0.12))])
    painter.pair("tail_lights", red, "truck_tail_light")
    flaps = boxes([((x + 0.06, 0.92, 0.46), (0.02, 0.56, 0.52))])
    painter.pair("mud_flaps", flaps, "truck_black")
