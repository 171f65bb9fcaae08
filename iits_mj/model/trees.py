"""Trees beside the road: a few vertices each, merged into a few meshes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.model.corridor import Corridor
from iits_mj.model.shapes import Shape, merge
from iits_mj.model.structures import Ground

TREES_PER_KM = 140
NEAREST, FARTHEST = 15.0, 120.0  # [m] from the pavement's edge


def trees(part: Corridor, ground: Ground, rng: np.random.Generator) -> Iterator[tuple[str, Shape]]:
    """(material, shape) of the trees along a stretch of road, clear of every road."""
    length = part.station[-1] - part.station[0]
    count = max(1, int(TREES_PER_KM * length / 1000.0))
    # Groups: a few centres, trees scattered about them.
    centers = rng.uniform(part.station[0], part.station[-1], max(2, count // 7))
    along = rng.choice(centers, count) + rng.normal(0.0, 18.0, count)
    row = Corridor.sample(part.route, np.clip(along, part.station[0], part.station[-1]))
    side = np.where(rng.random(count) < 0.5, 1.0, -1.0)
    reach = NEAREST + (FARTHEST - NEAREST) * rng.random(count) ** 1.6
    offset = np.where(side > 0, row.left, row.right) + side * reach
    points = row.across(offset)
    points[:, 2], clear = ground.height(points[:, 0], points[:, 1])
    points = points[(clear > 0.8 * NEAREST) & (np.abs(points[:, 2] - row.z) < 22.0)]
    height = rng.uniform(6.0, 14.0, len(points))
    conifer = rng.random(len(points)) < 0.55
    if np.any(conifer):
        yield "road_conifer", _copies(_CONIFER, points[conifer], height[conifer])
    if np.any(~conifer):
        yield "road_leaves", _copies(_BROADLEAF, points[~conifer], 0.75 * height[~conifer])
    if len(points):
        yield "road_trunk", _copies(_TRUNK, points, height)


def _cone(radius: float, low: float, high: float, sides: int = 7) -> Shape:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, low)], axis=-1)
    vertices = np.concatenate([rim, [[0.0, 0.0, high]]])
    faces = [(i, (i + 1) % sides, sides) for i in range(sides)]
    return Shape(vertices, np.array(faces, dtype=np.int32))


def _crown() -> Shape:
    """A lumpy ball of unit tree height, from rings."""
    levels = np.array([(0.0, 0.26), (0.20, 0.34), (0.31, 0.55), (0.24, 0.80), (0.0, 1.0)])
    sides = 7
    angle = 2.0 * np.pi * np.arange(sides) / sides
    lump = 1.0 + 0.16 * np.cos(3.0 * angle + 0.7)
    rows = [
        np.stack([r * lump * np.cos(angle), r * lump * np.sin(angle), np.full(sides, z)], axis=-1)
        for r, z in levels
    ]
    faces = []
    for i in range(len(levels) - 1):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
    return Shape(np.concatenate(rows), np.array(faces, dtype=np.int32))


def _copies(shape: Shape, points: FloatArray, height: FloatArray) -> Shape:
    vertices = shape.vertices[None] * height[:, None, None] + points[:, None, :]
    start = len(shape.vertices) * np.arange(len(points))[:, None, None]
    return Shape(
        vertices.reshape(-1, 3), (shape.faces[None] + start).reshape(-1, 3).astype(np.int32)
    )


_CONIFER = merge([_cone(0.24, 0.10, 0.55), _cone(0.19, 0.34, 0.78), _cone(0.13, 0.58, 1.0)])
_BROADLEAF = _crown()
_TRUNK = _cone(0.03, -0.1, 0.6, 5)
