"""Areas of junctions: the asphalt between the ends of the roads that meet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.materials import ASPHALT_TILE
from iits_mj.model.scenery.streets import Footprints, Street
from iits_mj.model.visuals.shapes import IntArray, Shape
from iits_mj.road.elements import Junction, Road

AREA_DROP = 0.09  # [m] below the road plane, and so below the connecting roads
AREA_RADIUS = 60.0  # [m]; larger junctions are ramps of motorways, whose area is no asphalt
AREA_STEP = 3.0  # [m] between the points of an area


@dataclass(frozen=True)
class Area:
    """The area of a junction.

    Attributes:
      outline: its corners (k, 2), counter-clockwise [m].
      points: of its surface (n, 3) [m]; faces: triangles (m, 3).
    """

    outline: FloatArray
    points: FloatArray
    faces: IntArray

    @property
    def center(self) -> FloatArray:
        """The middle of its points (3,)."""
        return np.asarray(self.points.mean(axis=0))

    def inside(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether points (n, 2) lie in the outline."""
        return inside(self.outline, points)

    def surface(self) -> Shape:
        """Returns its asphalt."""
        up = np.tile([0.0, 0.0, 1.0], (len(self.points), 1))
        return Shape(self.points, self.faces, self.points[:, :2] / ASPHALT_TILE, up)


def junction_areas(
    junctions: Mapping[str, Junction], roads: Mapping[str, Road], paved: Footprints
) -> list[Area]:
    """Returns the areas of the junctions where roads meet.

    Args:
      junctions: of the map, by id.
      roads: that are drawn, by id.
      paved: places that vehicles use, by road id.
    """
    found = []
    for identity, junction in junctions.items():
        connecting = {one.connecting for one in junction.connections} & set(paved.rows)
        corners = list(_corners(identity, roads))
        if not connecting or len(corners) < 2:
            continue
        outline = _outline(np.array(corners))
        if outline is not None:
            found.append(_area(outline, connecting, paved))
    return found


def _corners(junction: str, roads: Mapping[str, Road]) -> Iterator[FloatArray]:
    """Yields both corners of the vehicles' lanes at every road end at a junction, (2, 2)."""
    for road in roads.values():
        for direction, s in ((1, road.length), (-1, 0.0)):
            link = road.link(direction)
            if road.junction is not None or link is None:
                continue
            if (link.element, link.id) != ("junction", junction):
                continue
            street, station = Street.of_road(road), np.array([min(max(s, 0.0), road.length - 1e-6)])
            point = street.evaluate(station)
            offset = np.concatenate(street.paved_edges(station))
            if np.ptp(offset) > 1.0:
                x, y = float(point.x[0]), float(point.y[0])
                heading = float(point.heading[0])
                yield np.stack([x - offset * np.sin(heading), y + offset * np.cos(heading)], axis=1)


def _outline(ends: FloatArray) -> FloatArray | None:
    """The corners of road ends (k, 2, 2) as a polygon about their middle; None if they are none."""
    corners = ends.reshape(-1, 2)
    away = corners - corners.mean(axis=0)
    if np.max(np.hypot(away[:, 0], away[:, 1])) > AREA_RADIUS:
        return None
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]))
    # Both corners of an end are neighbors, or the polygon would cross a road.
    place = np.argsort(order).reshape(-1, 2)
    gap = np.abs(place[:, 0] - place[:, 1])
    if np.any((gap != 1) & (gap != len(corners) - 1)):
        return None
    outline = corners[order]
    x, y = (outline - outline.mean(axis=0)).T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return outline if area > 1.0 else None


def _area(outline: FloatArray, names: set[str], paved: Footprints) -> Area:
    from scipy.spatial import Delaunay

    edge = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        count = max(int(np.hypot(*(end - start)) / AREA_STEP), 1)
        edge.append(start + (end - start) * np.arange(count)[:, None] / count)
    low, high = outline.min(axis=0), outline.max(axis=0)
    axes = (np.arange(a, b, AREA_STEP) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    points = np.concatenate([*edge, grid[inside(outline, grid)]])
    faces = np.asarray(Delaunay(points).simplices, dtype=np.int32)
    a, b, c = (points[faces[:, i]] for i in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where(turn[:, None] > 0.0, faces, faces[:, ::-1])
    faces = faces[(np.abs(turn) > 1e-6) & inside(outline, (a + b + c) / 3.0)]
    height = paved.height(points, names) - AREA_DROP
    return Area(outline, np.column_stack([points, height]), faces.astype(np.int32))


def inside(outline: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie in a polygon (k, 2), by the number of edges that a ray crosses."""
    found = np.zeros(len(points), dtype=bool)
    x, y = points[:, 0], points[:, 1]
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if ay == by:
            continue
        crosses = (ay > y) != (by > y)
        found ^= crosses & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return found
