"""Semitrailers, center-axle trailers and dollies: the load body and what is below it."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from iits_mj.model.visuals.chassis import (
    RAIL_HEIGHT,
    draw_drawbar,
    draw_hitch,
    draw_open_rear,
    draw_plate,
    draw_side_guards,
    fenders,
    rails,
)
from iits_mj.model.visuals.layout import PLATES, Layout
from iits_mj.model.visuals.load_body import draw_load_body, draw_rear
from iits_mj.model.visuals.shapes import Painter, boxes, merge

# Main beams and legs of a semitrailer start this far behind the kingpin [m], or farther, clear of
# the unit ahead when it turns.
_BEAM_START, _LEG_START = 2.4, 2.55
_BEAM_HEIGHT = 0.34
# Start and end of the fenders about the wheel [rad].
_FENDER = (0.95, 2.19)
_PLATE_TO_FRAME = 0.14  # [m], from a plate's seat down to the frame that carries it


def draw_towed(spec: mujoco.MjSpec, layout: Layout, *, laden: bool) -> None:
    """Adds a towed unit's visual geoms in a body welded to it: origin at the coupling point."""
    unit = layout.unit
    assert unit.coupling is not None
    body = spec.body(unit.name).add_body(name=f"{unit.name}_visuals")
    # Heights of the parts are above the ground.
    painter = Painter(spec, body, unit.name, (0.0, 0.0, -unit.coupling.height))
    if unit.kind == "dolly":
        _dolly(painter, layout)
        return
    if layout.has_deck:
        draw_load_body(painter, layout, laden=laden)
    if unit.coupling.kind in PLATES:
        _semitrailer(painter, layout)
    else:
        _center_axle_trailer(painter, layout)
    shapes = fenders(layout, unit.axles, gap=0.045, thickness=0.02, sink=0.01, angles=_FENDER)
    painter.pair("fenders", shapes, "truck_black")
    low = layout.floor - _BEAM_HEIGHT
    if layout.plate is not None:
        low = _plate_frame(painter, layout)
    draw_hitch(painter, layout, low)
    if layout.has_deck:
        draw_rear(painter, layout)
    if layout.deck_rear > layout.rear:
        draw_open_rear(painter, layout, layout.rear + 0.10)


def _beams(painter: Painter, layout: Layout, start: float) -> None:
    """Adds the main beams below the floor, and crossbars."""
    floor, rear = layout.floor, layout.deck_rear if layout.has_deck else layout.rear
    length = start - rear - 0.1
    size = (length, 0.12, _BEAM_HEIGHT)
    place = (rear + 0.1 + 0.5 * length, 0.50, floor - 0.5 * _BEAM_HEIGHT)
    beams = boxes([(place, size)]).with_mirror()
    along = np.arange(rear + 0.6, layout.unit.front_overhang - 0.3, 1.1)
    width = layout.unit.width - 0.25
    cross = [((x, 0, floor - 0.06), (0.08, width, 0.12)) for x in along]
    painter.mesh("beams", merge([beams, boxes(cross)]), "truck_chassis")


def _semitrailer(painter: Painter, layout: Layout) -> None:
    unit, ahead, floor = layout.unit, layout.ahead, layout.floor
    assert unit.coupling is not None
    reach = 0.0
    if ahead is not None:
        behind = ahead.length - ahead.front_overhang - unit.coupling.position
        reach = math.hypot(behind, 0.5 * ahead.width - 0.1)
    _beams(painter, layout, -max(_BEAM_START, reach + 0.1))
    low, high = unit.coupling.height + 0.007, floor - 0.003
    front = min(1.1, unit.front_overhang - 0.05)
    size, place = (front + 1.1, 1.5, high - low), (0.5 * (front - 1.1), 0, 0.5 * (low + high))
    painter.box("kingpin_plate", place, size, "truck_chassis")
    legs = -max(_LEG_START, reach + 0.25)
    first = unit.axles[0]
    end = layout.radius(first) + 0.23 - first.position
    if unit.coupling.kind == "fifth_wheel" and legs - end > 0.35:
        _landing_legs(painter, legs, floor)
    _under_the_floor(painter, layout, legs - 0.45, end)


def _landing_legs(painter: Painter, x: float, floor: float) -> None:
    leg = [
        ((x, 0.72, 0.5 * (0.48 + floor)), (0.13, 0.13, floor - 0.50)),
        ((x, 0.72, 0.47), (0.09, 0.09, 0.20)),
        ((x, 0.72, 0.37), (0.30, 0.24, 0.03)),
    ]
    brace = boxes([((x, 0, 0.86), (0.06, 1.4, 0.06))])
    painter.mesh("landing_legs", merge([boxes(leg).with_mirror(), brace]), "truck_chassis")


def _under_the_floor(painter: Painter, layout: Layout, start: float, end: float) -> None:
    """Adds side guards, pallet box and air tank between two places [m]."""
    draw_side_guards(painter, layout, start, end)
    space, z = start - end, layout.floor - 0.44
    if space < 1.2:
        return
    box, tank = min(2.2, space - 0.6), min(1.6, space - 0.8)
    size = (box, 0.66, 0.52)
    place = (start - 0.3 - 0.5 * box, 0.15 - 0.93, z)
    painter.box("pallet_box", place, size, "truck_chassis")
    low, high = (start - 0.6, 0.42, z), (start - 0.6 - tank, 0.42, z)
    painter.cylinder("air_tank", low, high, 0.15, "truck_aluminum")


def _center_axle_trailer(painter: Painter, layout: Layout) -> None:
    unit = layout.unit
    front, first = unit.front_overhang, unit.axles[0]
    _beams(painter, layout, front - 0.1)
    ahead_of_wheels = layout.radius(first) + 0.23 - first.position
    end = min(front - 0.6, max(front - 1.6, ahead_of_wheels))
    draw_drawbar(painter, layout, end, layout.floor - _BEAM_HEIGHT + 0.05)
    draw_side_guards(painter, layout, front - 0.3, ahead_of_wheels)


def _plate_frame(painter: Painter, layout: Layout) -> float:
    """Adds the frame below the fifth wheel behind a load body; returns its underside [m]."""
    assert layout.plate is not None
    top = layout.plate.height - _PLATE_TO_FRAME
    end = layout.rear + 0.10
    frame = rails(layout.deck_rear + 1.0, end, top, RAIL_HEIGHT)
    painter.mesh("plate_frame", frame, "truck_chassis")
    draw_plate(painter, layout, top)
    return top - RAIL_HEIGHT


def _dolly(painter: Painter, layout: Layout) -> None:
    unit = layout.unit
    seat = layout.plate.height if layout.plate else unit.height
    top, height = seat - _PLATE_TO_FRAME, 0.22
    first, last = unit.axles[0], unit.axles[-1]
    front = min(unit.front_overhang, layout.radius(first) + 0.35 - first.position)
    end = max(layout.rear + 0.10, -last.position - layout.radius(last) - 0.35)
    crossbars = boxes(
        [((x, 0, top - 0.5 * height), (0.12, 0.8, 0.16)) for x in (front - 0.06, end + 0.1)]
    )
    frame = rails(front, end, top, height)
    painter.mesh("rails", merge([frame, crossbars]), "truck_chassis")
    draw_plate(painter, layout, top)
    draw_hitch(painter, layout, top - height)
    draw_drawbar(painter, layout, front - 0.05, top - 0.5 * height)
    shapes = fenders(layout, unit.axles, gap=0.045, thickness=0.02, sink=0.01, angles=_FENDER)
    painter.pair("fenders", shapes, "truck_black")
    draw_open_rear(painter, layout, end)
