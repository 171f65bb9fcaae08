"""Tractors and rigid trucks: the cab on a chassis whose parts follow the axles."""

from __future__ import annotations

import itertools
import math

import mujoco
import numpy as np

from iits_mj.model.visuals.cab import draw_cab
from iits_mj.model.visuals.chassis import (
    FENDER,
    RAIL_HEIGHT,
    RAIL_TOP,
    RAIL_Y,
    RAIL_Z,
    draw_hitch,
    draw_open_rear,
    draw_plate,
    draw_side_guards,
    fenders,
    rails,
)
from iits_mj.model.visuals.layout import WHEEL_SPACE, Layout
from iits_mj.model.visuals.load_body import draw_load_body, draw_rear
from iits_mj.model.visuals.shapes import Painter, arch, boxes, merge, prism

_FRAME_FRONT = 0.6
# Crossbars of the frame; the last one is at its end.
_CROSSBARS = (-1.3, -2.4, -3.9, -5.3, -6.7, -8.1, -9.5)
_STEPS_END = -1.12  # behind the steps below the cab
_TANK_LENGTH = 2.2  # [m], greatest


def draw_motor_vehicle(spec: mujoco.MjSpec, layout: Layout, *, laden: bool) -> None:
    """Adds a tractor's or rigid truck's visual geoms in a body welded to it."""
    name = layout.unit.name
    body = spec.body(name).add_body(name=f"{name}_visuals")
    painter = Painter(spec, body, name)
    rigid = layout.unit.kind == "rigid_truck"
    end = layout.rear + 0.04
    draw_cab(painter, layout)
    _frame(painter, end)
    draw_plate(painter, layout, RAIL_TOP)
    draw_hitch(painter, layout, RAIL_TOP - RAIL_HEIGHT)
    _tanks(painter, layout, rigid=rigid)
    _fenders(painter, layout)
    if not (rigid and layout.has_deck):
        draw_open_rear(painter, layout, end)
        return
    # Names of the load body's parts differ from those of the cab.
    cargo = Painter(spec, body, f"{name}_body")
    front, rear, height = layout.deck_front, layout.deck_rear, layout.floor - RAIL_TOP
    subframe = rails(front, rear + 0.04, layout.floor, height)
    cargo.mesh("subframe", subframe, "truck_chassis")
    draw_load_body(cargo, layout, laden=laden)
    draw_rear(cargo, layout)


def _frame(painter: Painter, end: float) -> None:
    places = [*(x for x in _CROSSBARS if x > end + 0.5), end + 0.1]
    crossbars = boxes([((x, 0, RAIL_Z + 0.03), (0.16, 2.0 * RAIL_Y, 0.2)) for x in places])
    frame = rails(_FRAME_FRONT, end, RAIL_TOP, RAIL_HEIGHT)
    painter.mesh("rails", merge([frame, crossbars]), "truck_chassis")


def _free_length(layout: Layout) -> tuple[float, float]:
    """Returns start and end of the longest free part between wheels, behind the cab's steps."""
    axles = layout.unit.axles
    spaces = []
    for ahead, behind in itertools.pairwise(axles):
        start = -ahead.position - layout.radius(ahead) - WHEEL_SPACE
        start = min(start - (0.0 if ahead is axles[0] else 0.1), _STEPS_END)
        spaces.append((start, -behind.position + layout.radius(behind) + WHEEL_SPACE))
    return max(spaces, key=lambda space: space[0] - space[1], default=(0.0, 0.0))


def _tanks(painter: Painter, layout: Layout, *, rigid: bool) -> None:
    """Adds the fuel tank on the left, battery and air tanks on the right, and what is near them."""
    a, end = _free_length(layout)
    b = max(end, a - _TANK_LENGTH)
    if a - b > 0.45:
        painter.cylinder("fuel_tank", (a, 0.86, 0.70), (b, 0.86, 0.70), 0.33, "truck_aluminum")
        bands = [((a + (b - a) * f, 0.86, 0.70), (0.05, 0.675, 0.675)) for f in (0.25, 0.75)]
        painter.mesh("tank_bands", boxes(bands), "truck_chassis")
        box = min(0.64, a - b)
        painter.box("battery_box", (a - 0.5 * box, -0.88, 0.70), (box, 0.62, 0.62), "truck_chassis")
    if a - b > 1.0:
        for index, z in enumerate((0.56, 0.88)):
            name, start = f"air_tank{index + 1}", (a - 0.74, -0.95, z)
            painter.cylinder(name, start, (b, -0.95, z), 0.135, "truck_aluminum")
    if rigid:
        draw_side_guards(painter, layout, b - 0.05, end)
        return
    # The catwalk ends ahead of the plate.
    walk = (a - 0.5, b - 0.2)
    if layout.plate is not None:
        walk = (walk[0], max(walk[1], 0.55 - layout.plate.position))
    if walk[0] - walk[1] > 0.2:
        middle, size = 0.5 * (walk[0] + walk[1]), (walk[0] - walk[1], 0.9, 0.03)
        painter.box("catwalk", (middle, 0, 1.0), size, "truck_aluminum")
    if layout.plate is None:
        return
    rear = layout.cab_rear
    lines = ((-0.25, "truck_tail_light"), (0.0, "truck_black"), (0.25, "truck_plate"))
    for index, (y, material) in enumerate(lines):
        low, high = (rear - 0.02, y, 1.75), (rear - 0.52, y * 0.8, 1.02)
        name = f"air_line{index + 1}"
        painter.cylinder(name, low, high, 0.022, material, round_ends=True)


def _fenders(painter: Painter, layout: Layout) -> None:
    unit = layout.unit
    (front, rear), outside = unit.groups(math.inf), 0.5 * unit.width
    arches = []
    for axle in front:
        radius = layout.radius(axle)
        shape = arch(radius + 0.055, 0.05, 0.06, math.pi - 0.06, outside - 0.40, 0.40)
        arches.append(shape.moved((-axle.position, 0.0, radius - 0.015)))
    painter.pair("front_fenders", arches, "truck_black")
    steps = boxes([((_STEPS_END + 0.30, outside - 0.20, 0.83), (0.32, 0.39, 0.66))])
    painter.pair("steps", steps, "truck_paint")
    # Skirts between the steps and the tank, if no wheel is there.
    if _free_length(layout)[0] == _STEPS_END:
        y = outside - 0.05
        skirt = prism([(-1.0, 0.42), (-1.0, 1.12), (-1.75, 1.12), (-1.55, 0.42)], y, 0.035)
        painter.pair("skirts", skirt, "truck_paint")
    if not rear:
        return
    apart = np.diff([axle.position for axle in rear]).min(initial=math.inf)
    widest = max(layout.radius(axle) for axle in rear) + 0.09
    # Arches of neighboring wheels do not overlap.
    start = max(FENDER[0], math.acos(min(1.0, 0.5 * float(apart) / widest)))
    shapes = fenders(
        layout, rear, gap=0.06, thickness=0.03, sink=0.015, angles=(start, math.pi - start)
    )
    painter.pair("rear_fenders", shapes, "truck_black")
