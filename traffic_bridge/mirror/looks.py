"""Shapes of the mirrored cars and vans: x forward, y left, z up from the ground.

Each function takes the vehicle's dimensions and gives its units; `truck_looks` has the trucks'.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from iits_mj.model.visuals.shapes import boxes, merge, prism, surface
from traffic_bridge.mirror.look_parts import Section, Unit, block, lamps, loft, plates, wheels
from traffic_bridge.mirror.truck_looks import articulated, rigid_truck
from traffic_bridge.vehicles.registry import VehicleType

# --- Shapes of the mirrored cars and vans: x forward, y left, z up from the ground ---


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
    mirrors = boxes([((half - 1.75, s * (w + 0.04), 0.98), (0.12, 0.16, 0.11)) for s in (1, -1)])
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
    }
    return (Unit("", meshes, (block(half, -half, kind.width, h),)),)


LOOKS: dict[str, Callable[[VehicleType], tuple[Unit, ...]]] = {
    "car": _car,
    "van": _van,
    "truck": rigid_truck,
    "articulated": articulated,
}
