"""Shapes of the mirrored vehicles: one mesh per material, in the box's frame (x forward, ground).

Each function takes the vehicle's dimensions and returns meshes by material: "paint" (the slot's
colour), "glass", "dark" (tires, frame, bumpers), "rim", "headlamp", "tail_lamp" and "cargo".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from iits_mj.model.shapes import Shape, boxes, lathe, merge, prism, surface
from traffic_bridge.vehicles import VehicleType

Meshes = dict[str, Shape]
Section = tuple[float, Sequence[tuple[float, float]]]


def _loft(sections: Sequence[Section]) -> Shape:
    """A shell through cross-sections, front to rear, and its mirror image.

    Args:
      sections: (x, [(y, z), ...]) of the left half, from the bottom to the middle of the top.
    """
    grid = np.array(
        [
            [[x, section[k][0], section[k][1]] for x, section in sections]
            for k in range(_rows(sections))
        ]
    )
    return surface(grid).with_mirror()


def _rows(sections: Sequence[Section]) -> int:
    return len(sections[0][1])


def _wheels(places: Sequence[tuple[float, float, float, float]]) -> tuple[Shape, Shape]:
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


def _lamps(length: float, width: float, front: float, rear: float) -> Meshes:
    """Head and tail lamps at two heights [m]."""
    y = 0.5 * width - 0.24
    ends = {"headlamp": (0.5 * length - 0.03, front), "tail_lamp": (-0.5 * length + 0.03, rear)}
    return {
        name: boxes([((x, side * y, z), (0.08, 0.30, 0.12)) for side in (1.0, -1.0)])
        for name, (x, z) in ends.items()
    }


def _plates(outline: Sequence[tuple[float, float]], width: float) -> Shape:
    """A flat outline in x and z on both sides of a body of a width: side windows, stripes."""
    return prism(outline, 0.5 * width - 0.01, 0.02).with_mirror()


def _car(kind: VehicleType) -> Meshes:
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

    shell = _loft(
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
    glass = _loft(
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

    roof = _loft(
        [
            panel(roof_front - 0.02, h - 0.07),
            panel(roof_front - 0.35, h - 0.02),
            panel(0.5 * (roof_front + roof_rear), h - 0.01),
            panel(roof_rear, h - 0.06),
        ]
    )
    mirrors = boxes([((half - 1.75, s * (w + 0.04), 0.98), (0.12, 0.16, 0.11)) for s in (1, -1)])
    track = kind.width - 0.01
    wheel_base = 0.58 * kind.length
    tires, rims = _wheels(
        [(0.5 * wheel_base, track, 0.33, 0.22), (-0.5 * wheel_base, track, 0.33, 0.22)]
    )
    grille = boxes([((half - 0.02, 0.0, 0.45), (0.06, 0.9, 0.14))])
    return {
        "paint": merge([shell, roof, mirrors]),
        "glass": glass,
        "dark": merge([tires, grille]),
        "rim": rims,
        **_lamps(kind.length - 0.02, kind.width - 0.30, 0.56, 0.74),
    }


def _van(kind: VehicleType) -> Meshes:
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
    tires, rims = _wheels(
        [(0.31 * kind.length, track, 0.35, 0.24), (-0.29 * kind.length, track, 0.35, 0.24)]
    )
    bumper = boxes(
        [
            ((half - 0.05, 0.0, 0.45), (0.16, kind.width - 0.04, 0.26)),
            ((-half + 0.05, 0.0, 0.45), (0.16, kind.width - 0.04, 0.20)),
            ((half - 0.02, 0.0, 0.78), (0.06, 0.9, 0.16)),
        ]
    )
    return {
        "paint": prism(outline, -0.5 * kind.width, kind.width),
        "glass": merge([screen, _plates(window, kind.width)]),
        "dark": merge([tires, bumper]),
        "rim": rims,
        **_lamps(kind.length, kind.width, 0.86, 1.10),
    }


def _cab(front: float, width: float, height: float) -> Meshes:
    """A cab over the engine; the bumper is at x = front."""
    sill, top = 1.62, 0.78 * height
    outline = [
        (front - 0.03, 0.62),
        (front - 0.03, sill),
        (front - 0.24, top),
        (front - 0.75, height),
        (front - 2.15, height),
        (front - 2.15, 0.62),
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
        "glass": merge([screen, _plates(window, width)]),
        "dark": boxes(dark),
    }


def _heavy(
    kind: VehicleType, cab_height: float, box: tuple[float, float], axles: Sequence[float]
) -> Meshes:
    """A truck: cab, a box from `box[0]` back to `box[1]`, and axles at x, the first steered."""
    half, width = 0.5 * kind.length, kind.width
    cab = _cab(half, width - 0.04, cab_height)
    floor = 1.12
    middle, long = 0.5 * (box[0] + box[1]), box[0] - box[1]
    cargo = boxes(
        [((middle, 0.0, 0.5 * (kind.height + floor)), (long, width, kind.height - floor))]
    )
    stripe = boxes([((middle, 0.0, floor + 0.28), (long - 0.3, width + 0.02, 0.26))])
    tires, rims = _wheels(
        [(x, width - 0.04, 0.50, 0.32 if i == 0 else 0.58) for i, x in enumerate(axles)]
    )
    frame = boxes(
        [
            ((-0.2, 0.0, 0.92), (kind.length - 0.8, 0.90, 0.30)),
            ((-half + 0.10, 0.0, 0.55), (0.14, width - 0.2, 0.16)),
            ((0.5 * (axles[0] + axles[1]), 0.0, 0.72), (1.1, width - 0.3, 0.55)),
        ]
    )
    return {
        "paint": merge([cab["paint"], stripe]),
        "glass": cab["glass"],
        "dark": merge([cab["dark"], tires, frame]),
        "rim": rims,
        "cargo": cargo,
        **_lamps(kind.length, width, 0.74, 0.95),
    }


def _truck(kind: VehicleType) -> Meshes:
    half = 0.5 * kind.length
    steer = half - 1.40
    return _heavy(
        kind, 0.86 * kind.height, (half - 2.30, -half), (steer, steer - 0.56 * kind.length)
    )


def _articulated(kind: VehicleType) -> Meshes:
    half = 0.5 * kind.length
    axles = (half - 1.40, half - 5.10, -half + 5.1, -half + 3.8, -half + 2.5)
    return _heavy(kind, 0.95 * kind.height, (half - 2.90, -half), axles)


LOOKS: dict[str, Callable[[VehicleType], Meshes]] = {
    "car": _car,
    "van": _van,
    "truck": _truck,
    "articulated": _articulated,
}
