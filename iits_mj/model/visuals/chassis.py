"""Parts of a chassis that several kinds of units share: couplings, fenders, guards, the rear."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from iits_mj.model.visuals.layout import Layout
from iits_mj.model.visuals.shapes import Painter, Shape, arch, beam, boxes, merge, prism
from iits_mj.parameters import Axle

RAIL_Y, RAIL_Z, RAIL_HEIGHT = 0.40, 0.83, 0.28  # [m], of a frame that carries a plate
RAIL_TOP = RAIL_Z + 0.5 * RAIL_HEIGHT
# Start and end of a fender about the wheel [rad], from ahead over the top to behind.
FENDER = (math.radians(12.0), math.radians(168.0))
_POST_SPACING = 1.5


def rails(front: float, rear: float, top: float, height: float) -> Shape:
    """Returns a pair of frame rails between two places [m]."""
    middle, length = 0.5 * (front + rear), front - rear
    size = (length, 0.09, height)
    return boxes([((middle, RAIL_Y, top - 0.5 * height), size)]).with_mirror()


def draw_plate(painter: Painter, layout: Layout, frame_top: float) -> None:
    """Adds the fifth wheel or turntable on a frame, if the unit has one."""
    coupling = layout.plate
    if coupling is None:
        return
    x, seat = -coupling.position, coupling.height
    low, high = (x, 0.0, seat - 0.075), (x, 0.0, seat - 0.015)
    painter.cylinder(coupling.kind, low, high, 0.46, "truck_black")
    bottom = min(seat - 0.16, frame_top)
    size = (0.5, 0.14, seat - 0.06 - bottom)
    parts = [boxes([((x, 0.36, 0.5 * (bottom + seat - 0.06)), size)]).with_mirror()]
    if coupling.kind == "fifth_wheel":
        profile = [(0.3, 0.03), (0.95, 0.17), (0.95, 0.21), (0.3, 0.09)]
        ramps = prism([(x - back, seat - down) for back, down in profile], 0.14, 0.2)
        parts.append(ramps.with_mirror())
    painter.mesh(f"{coupling.kind}_foot", merge(parts), "truck_black")


def draw_hitch(painter: Painter, layout: Layout, frame_low: float) -> None:
    """Adds the jaw for a drawbar below a frame, if the unit has one."""
    coupling = layout.hitch
    if coupling is None:
        return
    x, z = -coupling.position, coupling.height
    front = max(x + 0.35, layout.rear + 0.06)
    ends = sorted((z - 0.12, frame_low + 0.06))
    parts = [
        ((front, 0.0, 0.5 * (ends[0] + ends[1])), (0.08, 0.9, ends[1] - ends[0])),
        ((0.5 * (front + x) + 0.03, 0.0, z), (front - x - 0.06, 0.12, 0.12)),
        ((x + 0.06, 0.0, z), (0.16, 0.22, 0.20)),
    ]
    painter.mesh("hitch", boxes(parts), "truck_chassis")


def draw_drawbar(painter: Painter, layout: Layout, end: float, z: float) -> None:
    """Adds the drawbar from the eye, the unit's origin, to the frame's rails at (`end`, `z`)."""
    coupling = layout.unit.coupling
    assert coupling is not None
    eye = coupling.height
    neck = max(0.35 * end, -0.6)
    painter.cylinder("drawbar_eye", (0, 0, eye - 0.05), (0, 0, eye + 0.05), 0.08, "truck_chassis")
    arm = beam((neck + 0.1, 0.03, eye), (end, RAIL_Y, z), 0.09, 0.14)
    bar = boxes([((0.5 * neck - 0.03, 0.0, eye), (0.06 - neck, 0.12, 0.12))])
    painter.mesh("drawbar", merge([arm.with_mirror(), bar]), "truck_chassis")


def fenders(
    layout: Layout,
    axles: Iterable[Axle],
    *,
    gap: float,
    thickness: float,
    sink: float,
    angles: tuple[float, float],
) -> list[Shape]:
    """Returns an arch above the left wheels of each axle.

    Args:
      layout: of the unit.
      axles: that get one.
      gap: from tire to fender [m].
      thickness: of the fender [m].
      sink: of the arch's center below the wheel's, which is a tire's deflection [m].
      angles: start and end about the wheel, from ahead over the top to behind [rad].
    """
    found = []
    for axle in axles:
        half = layout.half_width(axle)
        low = 0.5 * axle.track - half
        shape = arch(layout.radius(axle) + gap, thickness, *angles, low, 2.0 * half)
        found.append(shape.moved((-axle.position, 0.0, layout.center(axle) - sink)))
    return found


def draw_side_guards(painter: Painter, layout: Layout, start: float, end: float) -> None:
    """Adds rails along both sides that keep others from the wheels, if there is room for them."""
    if start - end < 0.6:
        return
    half, top = 0.5 * layout.unit.width, layout.floor + 0.02
    size = (start - end, 0.035, 0.13)
    guards = [((0.5 * (start + end), half - 0.05, z), size) for z in (0.55, 0.82)]
    between = np.arange(start - _POST_SPACING, end + 0.6, -_POST_SPACING)
    posts = (start - 0.2, *between, end + 0.25)
    guards += [((x, half - 0.07, 0.5 * (0.52 + top)), (0.06, 0.03, top - 0.52)) for x in posts]
    painter.pair("side_guards", boxes(guards), "truck_aluminum")


def draw_open_rear(painter: Painter, layout: Layout, end: float) -> None:
    """Adds the rear of a frame without a load body above it: crossbar, lights, mud flaps."""
    x = end - 0.06
    width = layout.unit.width - 0.20
    painter.box("rear_bar", (x, 0, 0.80), (0.08, width, 0.16), "truck_chassis")
    red = boxes([((x - 0.05, 0.80, 0.80), (0.03, 0.24, 0.12))])
    painter.pair("tail_lights", red, "truck_tail_light")
    blinker = boxes([((x - 0.05, 0.98, 0.80), (0.03, 0.12, 0.12))])
    painter.sides("rear_indicator", blinker, "truck_indicator")
    draw_mud_flaps(painter, layout, end, 0.86, (0.46, 0.56, 0.52))


def draw_mud_flaps(
    painter: Painter,
    layout: Layout,
    end: float,
    behind: float,
    shape: tuple[float, float, float],
) -> None:
    """Adds a flap `behind` the last axle [m], not behind `end`; `shape`: middle, width, height."""
    z, width, height = shape
    x = max(-layout.unit.axles[-1].position - behind, end)
    flap = boxes([((x, 0.92, z), (0.02, width, height))])
    painter.pair("mud_flaps", flap, "truck_black")
