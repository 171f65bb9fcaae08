"""The curtain-sider body of a trailer or rigid truck: livery, doors, rear and lights."""

from __future__ import annotations

import numpy as np

from iits_mj.model.visuals.chassis import draw_mud_flaps
from iits_mj.model.visuals.layout import Layout
from iits_mj.model.visuals.shapes import Painter, Shape, boxes, merge, prism

# Size for which the livery is drawn, to which a smaller one is scaled; heights above the road [m].
_LENGTH, _FLOOR, _TOP = 12.7, 1.16, 4.0
_STRAP_SPACING = 0.62
_GUARD = 0.56  # [m], height of the under-run guard
_DRAWBAR = 0.45  # [m], half the gap of the guard for a drawbar
_FLAT = 0.6  # [m], lowest body; below it, a flat deck

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


def draw_load_body(painter: Painter, layout: Layout, *, laden: bool) -> None:
    """Adds the body with livery; a low unit has a flat deck."""
    box = _Box(layout)
    if box.flat:
        size = (box.front - box.rear, 2.0 * box.half, 0.14)
        place = (box.middle, 0.0, box.floor + 0.07)
        painter.mesh("frame", boxes([(place, size)]), "truck_aluminum")
        return
    _body(painter, box, laden=laden)
    _livery(painter, box)


class _Box:
    """The load body's limits; x ahead of the unit's origin, heights above the road [m]."""

    def __init__(self, layout: Layout) -> None:
        unit = layout.unit
        self.front, self.rear = layout.deck_front, layout.deck_rear
        self.half, self.floor, self.top = 0.5 * unit.width, layout.floor, unit.height
        self.middle = 0.5 * (self.front + self.rear)
        self.scale = (self.top - self.floor) / (_TOP - _FLOOR)

        self.flat = self.top - self.floor < _FLAT

    def up(self, z: float) -> float:
        """Returns where a height of a body of 4 m with its floor at 1.16 m is on this one [m]."""
        return self.floor + self.scale * (z - _FLOOR)


def _body(painter: Painter, box: _Box, *, laden: bool) -> None:
    front, rear, middle, half = box.front, box.rear, box.middle, box.half
    floor, top, length, width = box.floor, box.top, front - rear, 2.0 * half
    size = (length - 0.06, width - 0.05, top - floor - 0.20)
    painter.box("body", (middle, 0, 0.5 * (floor + 0.14 + top - 0.06)), size, "trailer_curtain")
    sides = (half - 0.03, -half + 0.03)
    frame = [((middle, 0.0, floor + 0.07), (length, width, 0.14))]
    frame += [((middle, y, top - 0.05), (length, 0.06, 0.10)) for y in sides]
    frame += [
        ((x, y, 0.5 * (floor + top)), (0.10, 0.06, top - floor))
        for x in (front - 0.05, rear + 0.05)
        for y in sides
    ]
    painter.mesh("frame", boxes(frame), "truck_aluminum")
    size = (0.01, width - 0.24, 2.3 * box.scale)
    painter.mesh("front_wall", boxes([((front + 0.004, 0, box.up(2.6)), size)]), "trailer_strap")
    size = (length - 0.1, width - 0.1, 0.02)
    painter.box("roof", (middle, 0, top - 0.030), size, "trailer_curtain")
    straps = np.arange(rear + 0.45, front - 0.3, _STRAP_SPACING)
    # Laden curtains are buckled to the floor; an empty body's straps hang shorter.
    low, high = floor + (0.02 if laden else 0.30), top - 0.1
    shapes = [((x, half - 0.016, 0.5 * (low + high)), (0.045, 0.018, high - low)) for x in straps]
    painter.pair("straps", boxes(shapes), "trailer_strap")
    buckles = [((x, half + 0.002, low + 0.10), (0.06, 0.02, 0.12)) for x in straps]
    painter.pair("buckles", boxes(buckles), "truck_chassis")


def _livery(painter: Painter, box: _Box) -> None:
    y, front, rear = box.half - 0.0055, box.front, box.rear
    low, high = box.floor + 0.16, box.top - 0.11
    scale = min(1.0, (front - rear) / _LENGTH, box.scale)

    def slant(start: float, width: float) -> Shape:
        """A stripe that leans forward from its lower to its upper edge."""
        bottom = rear + scale * start
        top, width = bottom + scale * 1.2, scale * width
        outline = [(bottom, low), (bottom - width, low), (top - width, high), (top, high)]
        return prism(outline, y, 0.006)

    ends = (front - 0.12, rear + 0.12)
    band = [(ends[0], low), (ends[1], low), (ends[1], low + 0.22), (ends[0], low + 0.22)]
    painter.pair("stripes", (slant(4.6, 1.25), slant(2.9, 0.30)), "trailer_stripe")
    painter.pair("navy", (slant(2.35, 1.7), prism(band, y, 0.004)), "trailer_navy")
    z, size, start = box.up(2.05), 1.25 * scale, front - 1.3 * scale
    left = _word("IITS", start, z, size, y)
    right = _word("IITS", start - 4.45 * scale, z, size, y, forward=True).mirrored()
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


def _doors(painter: Painter, box: _Box) -> None:
    half, top, rear = box.half, box.top, box.rear
    middle, tall = 0.5 * (box.floor + 0.16 + top - 0.14), top - box.floor - 0.30
    doors = boxes([((rear - 0.004, 0.5 * half - 0.02, middle), (0.03, half - 0.08, tall))])
    painter.pair("doors", doors, "trailer_curtain")
    # Flat on the doors: protruding parts cast ragged shadows in a low sun.
    bars = [((rear - 0.020, y, middle), (0.014, 0.035, tall + 0.1)) for y in (0.22, 0.86)]
    bars += [((rear - 0.024, y - 0.08, box.up(1.75)), (0.014, 0.22, 0.05)) for y in (0.30, 0.94)]
    hinges = [box.up(z) for z in (1.6, 2.3, 3.0, 3.6)]
    bars += [((rear - 0.014, half - 0.05, z), (0.03, 0.10, 0.09)) for z in hinges]
    painter.pair("door_bars", boxes(bars), "truck_aluminum")
    size = (0.006, 2.0 * half - 0.26, 0.22)
    painter.box("door_stripe", (rear - 0.0215, 0, box.up(1.52)), size, "trailer_stripe")


def draw_rear(painter: Painter, layout: Layout) -> None:
    """Adds doors and lights, and what is below the floor's end if the chassis ends there."""
    box = _Box(layout)
    if not box.flat:
        _doors(painter, box)
    whole = layout.deck_rear == layout.rear
    if whole:
        _under_run_guard(painter, layout, box)
    half, rear, z = box.half, box.rear, box.floor - 0.18
    red = []
    if whole:
        lamp = boxes([((rear - 0.01, 0.86, z), (0.05, 0.62, 0.17))])
        painter.pair("lamp_housings", lamp, "truck_black")
        red += [((rear - 0.04, 0.72, z), (0.02, 0.26, 0.12))]
        red += [((rear - 0.03, half - 0.10, box.top - 0.06), (0.02, 0.12, 0.05))]
        painter.pair("tail_lights", boxes(red), "truck_tail_light")
        blinker = boxes([((rear - 0.04, 1.02, z), (0.02, 0.24, 0.12))])
        painter.sides("rear_indicator", blinker, "truck_indicator")
    along = np.arange(rear + 1.0, box.front - 0.2, 2.3)
    amber = [((x, half + 0.004, box.floor + 0.06), (0.11, 0.02, 0.05)) for x in along]
    painter.pair("marker_lights", boxes(amber), "truck_amber")


def _under_run_guard(painter: Painter, layout: Layout, box: _Box) -> None:
    half, rear, top = box.half, box.rear, box.floor - 0.06
    size = (0.10, 2.0 * half - 0.1, 0.14)
    hitch = layout.hitch
    if hitch is None or abs(hitch.height - _GUARD) > 0.25:
        painter.box("under_run_guard", (rear + 0.06, 0, _GUARD), size, "truck_aluminum")
    else:
        # A low drawbar passes between its halves.
        width = 0.5 * size[1] - _DRAWBAR
        part = boxes([((rear + 0.06, _DRAWBAR + 0.5 * width, _GUARD), (0.10, width, 0.14))])
        painter.pair("under_run_guard", part, "truck_aluminum")
    arms = boxes([((rear + 0.14, 0.5, 0.5 * (_GUARD + top)), (0.08, 0.10, top - _GUARD))])
    painter.pair("guard_arms", arms, "truck_chassis")
    draw_mud_flaps(painter, layout, rear + 0.05, 0.68, (0.55, 0.58, 0.6))
    if hitch is None:
        size = (0.02, 0.50, 0.12)
        painter.box("plate", (rear - 0.005, 0, box.floor - 0.38), size, "truck_plate")
