"""Shapes of the mirrored vehicles: x forward, y left, z up from the ground.

Each function of `LOOKS` takes a vehicle type and returns its rigid units. A car, van or rigid truck
is one unit about the center of its box; tractor and semitrailer of an articulated truck have their
origin on the ground under the kingpin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.model.visuals.shapes import Shape, boxes, lathe, merge, prism, surface
from traffic_bridge.mirror.articulation import Articulation
from traffic_bridge.vehicles.types import VehicleType

Meshes = dict[str, Shape]
Section = tuple[float, Sequence[tuple[float, float]]]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]

GROUND_CLEARANCE = 0.2  # [m] under the boxes that take part in contact detection
# Common European dimensions (judgement) [m].
FLOOR = 1.12
STEER_AXLE = 1.40  # behind the front
DRIVE_AXLE = 5.10
CAB_LENGTH = 2.15
TRAILER_OVERHANG = 1.60  # of the semitrailer before its kingpin
SINGLE, TWIN = 0.32, 0.58  # widths of tires


@dataclass(frozen=True)
class Unit:
    """A rigid part of a vehicle: the whole car, or the tractor or semitrailer of a truck.

    Attributes:
      name: "" for the only unit; added to the body's name.
      meshes: visible shapes by material: "paint" (the slot's color), "glass", "dark" (tires,
        frame, bumpers), "rim", "headlamp", "tail_lamp", "indicator_left", "indicator_right" and
        "cargo".
      hull: contact boxes as (center, full size) [m].
    """

    name: str
    meshes: Meshes
    hull: tuple[Box, ...]


def block(front: float, rear: float, width: float, top: float) -> Box:
    """A contact box from `front` back to `rear`, from above the ground to `top` [m]."""
    low = GROUND_CLEARANCE
    return (0.5 * (front + rear), 0.0, 0.5 * (low + top)), (front - rear, width, top - low)


def loft(sections: Sequence[Section]) -> Shape:
    """A shell through cross-sections, front to rear, and its mirror image.

    Args:
      sections: (x, [(y, z), ...]) of the left half, from the bottom to the middle of the top.
    """
    grid = np.array(
        [
            [[x, section[k][0], section[k][1]] for x, section in sections]
            for k in range(len(sections[0][1]))
        ]
    )
    return surface(grid).with_mirror()


def wheels(places: Sequence[tuple[float, float, float, float]]) -> tuple[Shape, Shape]:
    """Tires and rims of axles, each (x, outer track, radius, tire width) [m]."""
    tires, rims = [], []
    for x, track, radius, width in places:
        half = 0.5 * width
        tire = lathe(
            [
                (0.58 * radius, half - 0.02),
                (0.92 * radius, half),
                (radius, 0.7 * half),
                (radius, -0.7 * half),
                (0.92 * radius, -half),
                (0.3 * radius, -half),
            ],
            24,
        )
        rim = lathe(
            [(0.01, half - 0.01), (0.30 * radius, half - 0.02), (0.60 * radius, half - 0.05)], 24
        )
        place = (x, 0.5 * track - half, radius)
        tires.append(tire.moved(place).with_mirror())
        rims.append(rim.moved(place).with_mirror())
    return merge(tires), merge(rims)


def both_sides(x: float, y: float, z: float, size: tuple[float, float, float]) -> list[Box]:
    """Two boxes of a size, on the left and on the right [m]."""
    return [((x, side * y, z), size) for side in (1.0, -1.0)]


def lamps(x: float, width: float, z: float) -> Shape:
    """Two lamps at one end of a body of a width [m]."""
    return boxes(both_sides(x, 0.5 * width - 0.24, z, (0.08, 0.30, 0.12)))


def indicators(width: float, *ends: tuple[float, float]) -> Meshes:
    """Direction indicators beside the lamps of a body of a width, at ends (x, z) [m]."""
    y, size = 0.5 * width - 0.05, (0.10, 0.10, 0.11)
    return {
        f"indicator_{side}": boxes([((x, sign * y, z), size) for x, z in ends])
        for side, sign in (("left", 1.0), ("right", -1.0))
    }


def plates(outline: Sequence[tuple[float, float]], width: float) -> Shape:
    """A flat outline in x and z on both sides of a body of a width: side windows, stripes."""
    return prism(outline, 0.5 * width - 0.01, 0.02).with_mirror()


def _car(kind: VehicleType) -> tuple[Unit, ...]:
    half, w, h = 0.5 * kind.length, 0.5 * kind.width, kind.height

    def body(x: float, wide: float, low: float, top: float) -> Section:
        y = wide * w
        rise = top - low
        return x, [
            (0.0, low),
            (0.86 * y, low),
            (0.97 * y, low + 0.18 * rise),
            (y, low + 0.50 * rise),
            (0.98 * y, low + 0.80 * rise),
            (0.88 * y, top),
            (0.0, top + 0.03),
        ]

    def cabin(x: float, top: float) -> Section:
        low = 0.86
        foot, lean = 0.89 * w, 0.38 * (top - low)
        return x, [
            (foot, low),
            (foot - 0.5 * lean, 0.5 * (low + top)),
            (foot - lean, top - 0.03),
            (0.86 * (foot - lean), top),
            (0.0, top + 0.01),
        ]

    shell = loft(
        [
            body(half, 0.05, 0.45, 0.50),
            body(half, 0.72, 0.32, 0.60),
            body(half - 0.10, 0.86, 0.25, 0.68),
            body(half - 0.45, 0.97, 0.20, 0.77),
            body(half - 1.30, 1.0, 0.19, 0.90),
            body(half - 1.60, 1.0, 0.19, 0.93),
            body(-half + 0.85, 1.0, 0.19, 0.95),
            body(-half + 0.30, 0.97, 0.22, 0.94),
            body(-half + 0.06, 0.88, 0.28, 0.88),
            body(-half, 0.78, 0.36, 0.80),
            body(-half, 0.05, 0.55, 0.60),
        ]
    )
    roof_front, roof_rear = half - 2.35, -half + 1.15
    glass = loft(
        [
            cabin(half - 1.35, 0.88),
            cabin(roof_front, h - 0.07),
            cabin(roof_front - 0.35, h - 0.02),
            cabin(0.5 * (roof_front + roof_rear), h - 0.01),
            cabin(roof_rear, h - 0.06),
            cabin(-half + 0.35, 0.90),
        ]
    )

    def panel(x: float, top: float) -> Section:
        edge = 0.89 * w - 0.38 * (top - 0.86)
        return x, [(edge + 0.01, top - 0.05), (0.86 * edge, top + 0.008), (0.0, top + 0.018)]

    roof = loft(
        [
            panel(roof_front - 0.02, h - 0.07),
            panel(roof_front - 0.35, h - 0.02),
            panel(0.5 * (roof_front + roof_rear), h - 0.01),
            panel(roof_rear, h - 0.06),
        ]
    )
    mirrors = boxes(both_sides(half - 1.75, w + 0.04, 0.98, (0.12, 0.16, 0.11)))
    track = kind.width - 0.01
    wheel_base = 0.58 * kind.length
    tires, rims = wheels(
        [(0.5 * wheel_base, track, 0.33, 0.22), (-0.5 * wheel_base, track, 0.33, 0.22)]
    )
    grille = boxes([((half - 0.02, 0.0, 0.45), (0.06, 0.9, 0.14))])
    meshes = {
        "paint": merge([shell, roof, mirrors]),
        "glass": glass,
        "dark": merge([tires, grille]),
        "rim": rims,
        "headlamp": lamps(half - 0.04, kind.width - 0.30, 0.56),
        "tail_lamp": lamps(0.04 - half, kind.width - 0.30, 0.74),
        **indicators(kind.width - 0.28, (half - 0.10, 0.56), (0.08 - half, 0.74)),
    }
    return (Unit("", meshes, (block(half, -half, kind.width, h),)),)


def _van(kind: VehicleType) -> tuple[Unit, ...]:
    half, h = 0.5 * kind.length, kind.height
    low = 0.38
    nose = [(half, low), (half - 0.04, 0.95), (half - 0.75, 1.42), (half - 1.75, h)]
    outline = [*nose, (-half + 0.05, h), (-half, 0.5 * h), (-half, low)]
    # The windscreen lies on the slope between bonnet and roof.
    (x1, z1), (x2, z2) = nose[2], nose[3]
    slope = np.array([x2 - x1, z2 - z1])
    out = np.array([slope[1], -slope[0]]) / np.hypot(*slope) * 0.015
    y = 0.5 * kind.width - 0.12
    rows = [np.array([x1, z1]) + part * slope + out for part in (0.04, 0.86)]
    screen = surface(np.array([[[x, -y, z], [x, y, z]] for x, z in rows]))
    window = [
        (half - 0.95, 1.42),
        (half - 1.62, 0.90 * h),
        (half - 2.20, 0.90 * h),
        (half - 2.20, 1.42),
    ]
    track = kind.width - 0.02
    tires, rims = wheels(
        [(0.31 * kind.length, track, 0.35, 0.24), (-0.29 * kind.length, track, 0.35, 0.24)]
    )
    bumper = boxes(
        [
            ((half - 0.05, 0.0, 0.45), (0.16, kind.width - 0.04, 0.26)),
            ((-half + 0.05, 0.0, 0.45), (0.16, kind.width - 0.04, 0.20)),
            ((half - 0.02, 0.0, 0.78), (0.06, 0.9, 0.16)),
        ]
    )
    meshes = {
        "paint": prism(outline, -0.5 * kind.width, kind.width),
        "glass": merge([screen, plates(window, kind.width)]),
        "dark": merge([tires, bumper]),
        "rim": rims,
        "headlamp": lamps(half - 0.03, kind.width, 0.86),
        "tail_lamp": lamps(0.03 - half, kind.width, 1.10),
        **indicators(kind.width, (half - 0.03, 0.86), (0.03 - half, 1.10)),
    }
    return (Unit("", meshes, (block(half, -half, kind.width, h),)),)


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
        *both_sides(front - 0.20, 0.5 * width + 0.10, 2.15, (0.14, 0.20, 0.55)),
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
    """The bar at the rear and its two arms."""
    arms = both_sides(rear + 0.12, 0.42, 0.85, (0.10, 0.08, 0.55))
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
        **indicators(width, (half - 0.03, 0.74), (0.03 - half, 0.95)),
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
    fenders = boxes(both_sides(drive, 0.5 * width - 0.32, 1.05, (1.15, 0.60, 0.05)))
    meshes = {
        "paint": cab["paint"],
        "glass": cab["glass"],
        "dark": merge([cab["dark"], tires, frame, fenders]),
        "rim": rims,
        "headlamp": lamps(front - 0.03, width, 0.74),
        "tail_lamp": lamps(rear, width, 0.90),
        **indicators(width, (front - 0.03, 0.74)),
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
            *both_sides(-1.6, 0.75, 0.70, (0.16, 0.16, 0.70)),
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
        **indicators(width, (rear + 0.03, 0.95)),
    }
    return Unit("trailer", meshes, (block(front, rear, width, kind.height),))


def _pedestrian(kind: VehicleType) -> tuple[Unit, ...]:
    """A standing person: legs, body and head."""
    h, w = kind.height, 0.7 * kind.width
    body = boxes([((0.0, 0.0, 0.66 * h), (0.24, w, 0.36 * h))])
    legs = boxes(both_sides(0.0, 0.1, 0.25 * h, (0.18, 0.15, 0.5 * h)))
    head = boxes([((0.0, 0.0, 0.93 * h), (0.2, 0.17, 0.13 * h))])
    meshes = {"paint": body, "dark": legs, "cargo": head}
    return (Unit("", meshes, (block(0.5 * kind.length, -0.5 * kind.length, kind.width, h),)),)


def _bicycle(kind: VehicleType) -> tuple[Unit, ...]:
    """A person on a bicycle."""
    half, h = 0.5 * kind.length, kind.height
    tires, rims = wheels([(x, 0.05, 0.34, 0.05) for x in (half - 0.34, 0.34 - half)])
    frame = boxes(
        [
            ((0.0, 0.0, 0.55), (0.75 * half, 0.05, 0.25)),
            ((half - 0.5, 0.0, 0.98), (0.06, 0.5, 0.05)),
        ]
    )
    rider = boxes([((-0.05, 0.0, 1.2), (0.3, 0.4, 0.6)), ((0.1, 0.0, 0.75), (0.4, 0.3, 0.3))])
    head = boxes([((0.05, 0.0, h - 0.12), (0.22, 0.18, 0.22))])
    meshes = {"paint": rider, "dark": merge([tires, frame]), "rim": rims, "cargo": head}
    return (Unit("", meshes, (block(half, -half, kind.width, h),)),)


def _obstacle(kind: VehicleType) -> tuple[Unit, ...]:
    """A load on a pallet."""
    length, width, h = kind.length, kind.width, kind.height
    load = boxes([((0.0, 0.0, 0.5 * (h + 0.15)), (length, width, h - 0.15))])
    pallet = boxes([((0.0, 0.0, 0.07), (length, width, 0.14))])
    return (
        Unit("", {"paint": load, "dark": pallet}, (block(0.5 * length, -0.5 * length, width, h),)),
    )


LOOKS: dict[str, Callable[[VehicleType], tuple[Unit, ...]]] = {
    "car": _car,
    "van": _van,
    "truck": rigid_truck,
    "articulated": articulated,
    "pedestrian": _pedestrian,
    "bicycle": _bicycle,
    "obstacle": _obstacle,
}
