"""The curtain-sider semitrailer: body, livery, underbody, rear and lights."""

from __future__ import annotations

import mujoco
import numpy as np

from iits_mj.model.visuals.shapes import Painter, Shape, arch, boxes, merge, prism
from iits_mj.parameters import TruckParameters

FLOOR = 1.16  # [m] above the ground, underside of the body
STRAP_SPACING = 0.62

# Letters as convex strokes in a box 1 wide and 1 high; x runs with the reading direction.
_LETTERS: dict[str, list[list[tuple[float, float]]]] = {
    "I": [[(0.36, 0), (0.64, 0), (0.64, 1), (0.36, 1)]],
    "T": [
        [(0.36, 0), (0.64, 0), (0.64, 0.75), (0.36, 0.75)],
        [(0, 0.75), (1, 0.75), (1, 1), (0, 1)],
    ],
    "S": [
        [(0, 0), (1, 0), (1, 0.22), (0, 0.22)],
        [(0.74, 0.22), (1, 0.22), (1, 0.39), (0.74, 0.39)],
        [(0, 0.39), (1, 0.39), (1, 0.61), (0, 0.61)],
        [(0, 0.61), (0.26, 0.61), (0.26, 0.78), (0, 0.78)],
        [(0, 0.78), (1, 0.78), (1, 1), (0, 1)],
    ],
}


def draw_trailer(spec: mujoco.MjSpec, parameters: TruckParameters, *, laden: bool) -> None:
    """Adds the semitrailer's visual geoms in a body welded to `trailer`: origin at the kingpin."""
    height = parameters.couplings[0].height
    # Heights below are above the ground.
    body = spec.body("trailer").add_body(name="trailer_visuals")
    painter = Painter(spec, body, "trailer", (0.0, 0.0, -height))
    _body(painter, parameters, laden=laden)
    _livery(painter, parameters)
    _underbody(painter, parameters)
    _rear(painter, parameters)
    _lights(painter, parameters)


def _body(painter: Painter, p: TruckParameters, *, laden: bool) -> None:
    t = p.units[1]
    front, rear = t.front_overhang, t.front_overhang - t.length
    middle, half, top = 0.5 * (front + rear), 0.5 * t.width, t.height
    size = (t.length - 0.06, t.width - 0.05, top - FLOOR - 0.20)
    painter.box("body", (middle, 0, 0.5 * (FLOOR + 0.14 + top - 0.06)), size, "trailer_curtain")
    sides = (half - 0.03, -half + 0.03)
    frame = [((middle, 0.0, FLOOR + 0.07), (t.length, t.width, 0.14))]
    frame += [((middle, y, top - 0.05), (t.length, 0.06, 0.10)) for y in sides]
    frame += [
        ((x, y, 0.5 * (FLOOR + top)), (0.10, 0.06, top - FLOOR))
        for x in (front - 0.05, rear + 0.05)
        for y in sides
    ]
    painter.mesh("frame", boxes(frame), "truck_aluminum")
    wall = boxes([((front + 0.004, 0, 2.6), (0.01, t.width - 0.24, 2.3))])
    painter.mesh("front_wall", wall, "trailer_strap")
    size = (t.length - 0.1, t.width - 0.1, 0.02)
    painter.box("roof", (middle, 0, top - 0.030), size, "trailer_curtain")
    straps = np.arange(rear + 0.45, front - 0.3, STRAP_SPACING)
    # Laden curtains are buckled to the floor; an empty trailer's straps hang shorter.
    low, high = FLOOR + (0.02 if laden else 0.30), top - 0.1
    shapes = [((x, half - 0.016, 0.5 * (low + high)), (0.045, 0.018, high - low)) for x in straps]
    painter.pair("straps", boxes(shapes), "trailer_strap")
    buckles = [((x, half + 0.002, low + 0.10), (0.06, 0.02, 0.12)) for x in straps]
    painter.pair("buckles", boxes(buckles), "truck_chassis")


def _livery(painter: Painter, p: TruckParameters) -> None:
    t = p.units[1]
    y = 0.5 * t.width - 0.0055
    front, rear = t.front_overhang, t.front_overhang - t.length
    low, high = FLOOR + 0.16, t.height - 0.11

    def slant(start: float, width: float) -> Shape:
        """A stripe that leans 1.2 m forward from its lower to its upper edge."""
        top = start + 1.2
        outline = [(start, low), (start - width, low), (top - width, high), (top, high)]
        return prism(outline, y, 0.006)

    ends = (front - 0.12, rear + 0.12)
    band = [(ends[0], low), (ends[1], low), (ends[1], low + 0.22), (ends[0], low + 0.22)]
    painter.pair("stripes", (slant(rear + 4.6, 1.25), slant(rear + 2.9, 0.30)), "trailer_stripe")
    painter.pair("navy", (slant(rear + 2.35, 1.7), prism(band, y, 0.004)), "trailer_navy")
    left = _word("IITS", front - 1.3, 2.05, 1.25, y)
    right = _word("IITS", front - 1.3 - 4.45, 2.05, 1.25, y, forward=True).mirrored()
    painter.mesh("name", merge([left, right]), "trailer_navy")


def _word(word: str, x: float, z: float, size: float, y: float, *, forward: bool = False) -> Shape:
    """Letters on a side wall; text runs rearwards on the left side, forwards on the right side."""
    sign = 1.0 if forward else -1.0
    strokes = []
    cursor = 0.0
    for letter in word:
        for stroke in _LETTERS[letter]:
            # The letters are slightly slanted.
            along = [cursor + (u - 0.5) * 0.78 * size + 0.14 * size * v for u, v in stroke]
            points = [(x + sign * a, z + v * size) for a, (_, v) in zip(along, stroke, strict=True)]
            strokes.append(prism(points, y, 0.006))
        cursor += ((0.55 if letter == "I" else 0.95) + 0.12) * size
    return merge(strokes)


def _underbody(painter: Painter, p: TruckParameters) -> None:
    t = p.units[1]
    half, rear = 0.5 * t.width, t.front_overhang - t.length
    beams = boxes([((rear + 4.6, 0.50, FLOOR - 0.17), (9.0, 0.12, 0.34))]).with_mirror()
    cross = [((x, 0, FLOOR - 0.06), (0.08, 2.3, 0.12)) for x in np.arange(rear + 0.6, 0.9, 1.1)]
    painter.mesh("beams", merge([beams, boxes(cross)]), "truck_chassis")
    painter.box("kingpin_plate", (0.0, 0, FLOOR - 0.028), (2.2, 1.5, 0.05), "truck_chassis")
    leg = [
        ((-2.55, 0.72, 0.82), (0.13, 0.13, 0.66)),
        ((-2.55, 0.72, 0.47), (0.09, 0.09, 0.20)),
        ((-2.55, 0.72, 0.37), (0.30, 0.24, 0.03)),
    ]
    brace = boxes([((-2.55, 0, 0.86), (0.06, 1.4, 0.06))])
    painter.mesh("landing_legs", merge([boxes(leg).with_mirror(), brace]), "truck_chassis")
    first = -t.axles[0].position + 0.75
    size = (abs(first + 3.0), 0.035, 0.13)
    guards = [((0.5 * (first - 3.0), half - 0.05, z), size) for z in (0.55, 0.82)]
    guards += [((x, half - 0.07, 0.85), (0.06, 0.03, 0.66)) for x in (-3.2, -4.5, first + 0.25)]
    painter.pair("side_guards", boxes(guards), "truck_aluminum")
    painter.box("pallet_box", (-4.4, -0.78, 0.72), (2.2, 0.66, 0.52), "truck_chassis")
    painter.cylinder("air_tank", (-3.6, 0.42, 0.72), (-5.2, 0.42, 0.72), 0.15, "truck_aluminum")
    fenders = []
    for axle in t.axles:
        tire = p.tires[axle.tire]
        shape = arch(tire.free_radius + 0.045, 0.02, 0.95, 2.19, 0.5 * axle.track - 0.30, 0.60)
        fenders.append(shape.moved((-axle.position, 0.0, tire.free_radius - 0.01)))
    painter.pair("fenders", fenders, "truck_black")


def _rear(painter: Painter, p: TruckParameters) -> None:
    t = p.units[1]
    half, top, rear = 0.5 * t.width, t.height, t.front_overhang - t.length
    middle, tall = 0.5 * (FLOOR + 0.16 + top - 0.14), top - FLOOR - 0.30
    doors = boxes([((rear - 0.004, 0.5 * half - 0.02, middle), (0.03, half - 0.08, tall))])
    painter.pair("doors", doors, "trailer_curtain")
    # Flat on the doors: protruding parts cast ragged shadows in a low sun.
    bars = [((rear - 0.020, y, middle), (0.014, 0.035, tall + 0.1)) for y in (0.22, 0.86)]
    bars += [((rear - 0.024, y - 0.08, 1.75), (0.014, 0.22, 0.05)) for y in (0.30, 0.94)]
    bars += [((rear - 0.014, half - 0.05, z), (0.03, 0.10, 0.09)) for z in (1.6, 2.3, 3.0, 3.6)]
    painter.pair("door_bars", boxes(bars), "truck_aluminum")
    size = (0.006, t.width - 0.26, 0.22)
    painter.box("door_stripe", (rear - 0.0215, 0, 1.52), size, "trailer_stripe")
    size = (0.10, t.width - 0.1, 0.14)
    painter.box("under_run_guard", (rear + 0.06, 0, 0.56), size, "truck_aluminum")
    arms = boxes([((rear + 0.14, 0.5, 0.83), (0.08, 0.10, 0.54))])
    painter.pair("guard_arms", arms, "truck_chassis")
    flap = boxes([((-t.axles[-1].position - 0.68, 0.92, 0.55), (0.02, 0.58, 0.6))])
    painter.pair("mud_flaps", flap, "truck_black")
    painter.box("plate", (rear - 0.005, 0, 0.78), (0.02, 0.50, 0.12), "truck_plate")


def _lights(painter: Painter, p: TruckParameters) -> None:
    t = p.units[1]
    half, rear = 0.5 * t.width, t.front_overhang - t.length
    lamp = boxes([((rear - 0.01, 0.86, 0.98), (0.05, 0.62, 0.17))])
    painter.pair("lamp_housings", lamp, "truck_black")
    red = [((rear - 0.04, 0.72, 0.98), (0.02, 0.26, 0.12))]
    red += [((rear - 0.03, half - 0.10, t.height - 0.06), (0.02, 0.12, 0.05))]
    painter.pair("tail_lights", boxes(red), "truck_tail_light")
    amber = [((rear - 0.04, 1.02, 0.98), (0.02, 0.24, 0.12))]
    along = np.arange(rear + 1.0, 1.0, 2.3)
    amber += [((x, half + 0.004, FLOOR + 0.06), (0.11, 0.02, 0.05)) for x in along]
    painter.pair("marker_lights", boxes(amber), "truck_amber")
