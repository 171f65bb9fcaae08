"""Shapes of the mirrored trucks: x forward, y left, z up from the ground.

A rigid truck is one unit about its box's centre; of an articulated one, tractor and semitrailer
each have their origin on the ground under the kingpin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from iits_mj.model.visuals.shapes import Shape, boxes, merge, prism, surface
from traffic_bridge.mirror.articulation import Articulation
from traffic_bridge.mirror.look_parts import Box, Meshes, Unit, block, lamps, plates, wheels
from traffic_bridge.vehicles.registry import VehicleType

# Common European dimensions (judgement) [m].
FLOOR = 1.12
STEER_AXLE = 1.40  # behind the front
DRIVE_AXLE = 5.10
CAB_LENGTH = 2.15
TRAILER_OVERHANG = 1.60  # of the semitrailer before its kingpin
SINGLE, TWIN = 0.32, 0.58  # widths of tires


def _cab(front: float, width: float, height: float) -> Meshes:
    """A cab over the engine; the bumper is at x = front."""
    sill, top = 1.62, 0.78 * height
    outline = [
        (front - 0.03, 0.62),
        (front - 0.03, sill),
        (front - 0.24, top),
        (front - 0.75, height),
        (front - CAB_LENGTH, height),
        (front - CAB_LENGTH, 0.62),
    ]
    y = 0.5 * width - 0.12
    slope = np.array([(front - 0.24) - (front - 0.03), top - sill])
    rows = [np.array([front - 0.015, sill]) + part * slope for part in (0.05, 0.97)]
    screen = surface(np.array([[[x, -y, z], [x, y, z]] for x, z in rows]))
    window = [
        (front - 0.32, sill + 0.06),
        (front - 0.45, 0.95 * top),
        (front - 1.25, 0.95 * top),
        (front - 1.25, sill + 0.06),
    ]
    dark = [
        ((front - 0.25, 0.0, 0.52), (0.48, width, 0.36)),
        ((front - 0.01, 0.0, 1.18), (0.06, width - 0.8, 0.55)),
        *[((front - 0.20, s * (0.5 * width + 0.10), 2.15), (0.14, 0.20, 0.55)) for s in (1, -1)],
    ]
    return {
        "paint": prism(outline, -0.5 * width, width),
        "glass": merge([screen, plates(window, width)]),
        "dark": boxes(dark),
    }


def _cargo(front: float, rear: float, kind: VehicleType) -> tuple[Shape, Shape]:
    """A box body from `front` back to `rear` [m], and the stripe in the slot's color on it."""
    middle, long = 0.5 * (front + rear), front - rear
    body = boxes(
        [((middle, 0.0, 0.5 * (kind.height + FLOOR)), (long, kind.width, kind.height - FLOOR))]
    )
    stripe = boxes([((middle, 0.0, FLOOR + 0.28), (long - 0.3, kind.width + 0.02, 0.26))])
    return body, stripe


def _axles(places: Sequence[float], width: float, *, steered: bool) -> tuple[Shape, Shape]:
    """Tires and rims of axles at x; the first is steered and has single tires, or none is."""
    return wheels(
        [
            (x, width - 0.04, 0.50, SINGLE if steered and i == 0 else TWIN)
            for i, x in enumerate(places)
        ]
    )


def _underrun_bar(rear: float, width: float) -> list[Box]:
    """The bar at the rear and what it hangs on."""
    arms = [((rear + 0.12, side * 0.42, 0.85), (0.10, 0.08, 0.55)) for side in (1.0, -1.0)]
    return [((rear + 0.10, 0.0, 0.55), (0.14, width - 0.2, 0.16)), *arms]


def rigid_truck(kind: VehicleType) -> tuple[Unit, ...]:
    """A truck with a box body and two axles."""
    half, width = 0.5 * kind.length, kind.width
    axles = (half - STEER_AXLE, half - STEER_AXLE - 0.56 * kind.length)
    cab = _cab(half, width - 0.04, 0.86 * kind.height)
    body, stripe = _cargo(half - 2.30, -half, kind)
    tires, rims = _axles(axles, width, steered=True)
    frame = boxes(
        [
            ((-0.2, 0.0, 0.92), (kind.length - 0.8, 0.90, 0.30)),
            *_underrun_bar(-half, width),
            ((0.5 * (axles[0] + axles[1]), 0.0, 0.72), (1.1, width - 0.3, 0.55)),
        ]
    )
    meshes = {
        "paint": merge([cab["paint"], stripe]),
        "glass": cab["glass"],
        "dark": merge([cab["dark"], tires, frame]),
        "rim": rims,
        "cargo": body,
        "headlamp": lamps(half - 0.03, width, 0.74),
        "tail_lamp": lamps(0.03 - half, width, 0.95),
    }
    return (Unit("", meshes, (block(half, -half, width, kind.height),)),)


def articulated(kind: VehicleType) -> tuple[Unit, ...]:
    """Tractor with two axles and semitrailer with three."""
    half, place = 0.5 * kind.length, Articulation.of_length(kind.length)
    axles = -place.kingpin - place.axles
    return _tractor(kind, half - place.kingpin), _semitrailer(kind, -half - place.kingpin, axles)


def _tractor(kind: VehicleType, front: float) -> Unit:
    width, cab_height = kind.width, 0.95 * kind.height
    steer, drive = front - STEER_AXLE, front - DRIVE_AXLE
    rear = drive - 0.75
    cab = _cab(front, width - 0.04, cab_height)
    tires, rims = _axles((steer, drive), width, steered=True)
    frame = boxes(
        [
            ((0.5 * (front - 0.6 + rear), 0.0, 0.92), (front - 0.6 - rear, 0.90, 0.30)),
            # Fuel tanks between the axles, and the fifth wheel.
            ((0.5 * (steer + drive) - 0.1, 0.0, 0.72), (1.3, width - 0.3, 0.55)),
            ((0.0, 0.0, 1.08), (0.9, 0.9, 0.08)),
        ]
    )
    fenders = boxes(
        [((drive, side * (0.5 * width - 0.32), 1.05), (1.15, 0.60, 0.05)) for side in (1.0, -1.0)]
    )
    meshes = {
        "paint": cab["paint"],
        "glass": cab["glass"],
        "dark": merge([cab["dark"], tires, frame, fenders]),
        "rim": rims,
        "headlamp": lamps(front - 0.03, width, 0.74),
        "tail_lamp": lamps(rear, width, 0.90),
    }
    hull = (block(front, front - CAB_LENGTH, width, cab_height), block(front, rear, width, FLOOR))
    return Unit("tractor", meshes, hull)


def _semitrailer(kind: VehicleType, rear: float, axles: float) -> Unit:
    width, front = kind.width, TRAILER_OVERHANG
    body, stripe = _cargo(front, rear, kind)
    tires, rims = _axles((axles + 1.3, axles, axles - 1.3), width, steered=False)
    frame = boxes(
        [
            ((0.5 * (front + rear), 0.0, 1.03), (front - rear - 0.6, 0.90, 0.18)),
            *_underrun_bar(rear, width),
            # Landing legs, and the side guards between them and the axles.
            *[((-1.6, side * 0.75, 0.70), (0.16, 0.16, 0.70)) for side in (1.0, -1.0)],
            *[
                ((0.5 * (axles - 0.2), side * (0.5 * width - 0.06), z), (3.6, 0.06, 0.12))
                for side in (1.0, -1.0)
                for z in (0.60, 0.88)
            ],
        ]
    )
    meshes = {
        "paint": stripe,
        "dark": merge([tires, frame]),
        "rim": rims,
        "cargo": body,
        "tail_lamp": lamps(rear + 0.03, width, 0.95),
    }
    return Unit("trailer", meshes, (block(front, rear, width, kind.height),))
