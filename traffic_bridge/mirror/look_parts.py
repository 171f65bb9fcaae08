"""Parts that the shapes of mirrored vehicles are put together from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.model.visuals.shapes import Shape, boxes, lathe, merge, prism, surface

Meshes = dict[str, Shape]
Section = tuple[float, Sequence[tuple[float, float]]]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]

GROUND_CLEARANCE = 0.2  # [m] under the boxes that take part in contact detection


@dataclass(frozen=True)
class Unit:
    """A rigid part of a vehicle: the whole car, or the tractor or semitrailer of a truck.

    Attributes:
      name: "" for the only unit; added to the body's name.
      meshes: what is seen, by material: "paint" (the slot's color), "glass", "dark" (tires, frame,
        bumpers), "rim", "headlamp", "tail_lamp" and "cargo".
      hull: what touches: boxes as (center, full size) [m].
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
            for k in range(_rows(sections))
        ]
    )
    return surface(grid).with_mirror()


def _rows(sections: Sequence[Section]) -> int:
    return len(sections[0][1])


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


def lamps(x: float, width: float, z: float) -> Shape:
    """Two lamps at one end of a body of a width [m]."""
    y = 0.5 * width - 0.24
    return boxes([((x, side * y, z), (0.08, 0.30, 0.12)) for side in (1.0, -1.0)])


def plates(outline: Sequence[tuple[float, float]], width: float) -> Shape:
    """A flat outline in x and z on both sides of a body of a width: side windows, stripes."""
    return prism(outline, 0.5 * width - 0.01, 0.02).with_mirror()
