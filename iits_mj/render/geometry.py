"""Triangles of a model's geoms in one array, in parts that are small enough to be culled."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray, IntArray

Floats = NDArray[np.float32]
Indices = NDArray[np.uint32]
Kind = mujoco.mjtGeom

# A part has at most this many triangles; large meshes are split in space.
PART_TRIANGLES = 600
# Sizes of the cubes whose vertices are merged in the coarser forms [m].
CELLS = (0.06, 0.12, 0.4)
# A mesh's normal that differs more than this from the triangle's [cosine] is replaced by it.
_SMOOTH = 0.8
_SLICES, _STACKS = 28, 16
_PLANE_CELLS = 40


@dataclass(frozen=True)
class Geometry:
    """Triangles of all geoms that have a surface, and of a unit box, in levels of detail.

    Attributes:
      vertices: position, normal and texture coordinates, (n, 8).
      indices: of the triangles' corners.
      geom: of each part; the unit box, of half-size 1, is the last part and has the number of
        geoms here.
      first, count: range of each part in `indices`, (levels, parts): the fine form, then one for
        each of `CELLS`.
      center, radius: bounding sphere of each part in the geom's frame.
    """

    vertices: Floats
    indices: Indices
    geom: IntArray
    first: IntArray
    count: IntArray
    center: FloatArray
    radius: FloatArray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Geometry:
        """Returns the triangles of a model's geoms; geoms that share a mesh share its triangles."""
        builder = _Builder()
        made: dict[int, list[_Part]] = {}
        parts: list[tuple[int, _Part]] = []
        for geom in range(model.ngeom):
            kind, mesh = Kind(model.geom_type[geom]), int(model.geom_dataid[geom])
            if kind == Kind.mjGEOM_MESH:
                if mesh not in made:
                    made[mesh] = builder.add(*_mesh(model, mesh))
                found = made[mesh]
            elif kind in _PRIMITIVES:
                found = builder.add(*_PRIMITIVES[kind](model, geom))
            else:
                continue
            parts += [(geom, part) for part in found]
        parts += [(model.ngeom, part) for part in builder.add(*_box(np.ones(3)))]
        ranges = np.array([part.ranges for _, part in parts])
        return cls(
            np.concatenate(builder.vertices),
            np.concatenate(builder.indices),
            np.array([geom for geom, _ in parts]),
            ranges[:, :, 0].T,
            ranges[:, :, 1].T,
            np.array([part.center for _, part in parts]),
            np.array([part.radius for _, part in parts]),
        )


@dataclass(frozen=True)
class _Part:
    ranges: list[tuple[int, int]]
    center: FloatArray
    radius: float


class _Builder:
    """Collects vertices and indices."""

    def __init__(self) -> None:
        self.vertices: list[Floats] = []
        self.indices: list[Indices] = []
        self._stored = self._used = 0

    def add(self, points: Floats, corners: Indices) -> list[_Part]:
        """Adds triangles; returns their parts."""
        start = self._store(points)
        coarser = [_merged(points, cell) for cell in CELLS]
        starts = [self._store(vertices) for vertices, _, _ in coarser]
        parts = []
        for piece in _split(points, corners):
            box = points[piece.ravel(), :3]
            center = 0.5 * (box.min(axis=0) + box.max(axis=0)).astype(float)
            radius = float(np.sqrt(((box - center) ** 2).sum(axis=1).max()))
            area, ranges = _area(points, piece), [self._index(piece + start)]
            for (vertices, vertex, cube), begin in zip(coarser, starts, strict=True):
                merged = vertex[piece[_distinct(cube[piece])]]
                # Thin parts would vanish, and others hardly become simpler.
                same = _area(vertices, merged) < 0.8 * area
                same |= 3 * len(merged) > 0.7 * ranges[-1][1]
                ranges.append(ranges[-1] if same else self._index(merged + begin))
            parts.append(_Part(ranges, center, radius))
        return parts

    def _store(self, points: Floats) -> int:
        self.vertices.append(points)
        self._stored += len(points)
        return self._stored - len(points)

    def _index(self, corners: NDArray[np.integer]) -> tuple[int, int]:
        self.indices.append(corners.ravel().astype(np.uint32))
        self._used += corners.size
        return self._used - corners.size, corners.size


def _merged(points: Floats, cell: float) -> tuple[Floats, IntArray, IntArray]:
    """Merges the vertices in each cube of a size [m].

    Returns:
      The merged vertices, whose place is the mean of a cube's vertices and which keep different
      normals apart; the merged vertex of each vertex; its cube.
    """
    _, cube = np.unique(_numbers(np.floor(points[:, :3] / cell)), return_inverse=True)
    sums = [np.bincount(cube, points[:, i]) for i in range(3)]
    places = np.stack(sums, axis=1) / np.bincount(cube)[:, None]
    side = _numbers(np.round(1.5 * points[:, 3:6]))
    key = cube.astype(np.int64) * (side.max() + 1) + side
    _, chosen, vertex = np.unique(key, return_index=True, return_inverse=True)
    vertices = points[chosen].copy()
    vertices[:, :3] = places[cube[chosen]]
    return vertices, vertex, cube


def _area(points: Floats, corners: NDArray[np.integer]) -> float:
    """Returns the area of triangles (n, 3)."""
    a, b, c = (points[corners[:, i], :3] for i in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _numbers(rows: NDArray[np.floating]) -> IntArray:
    """Returns a number for each row (n, 3) of whole numbers; equal rows have equal numbers."""
    whole = (rows - rows.min(axis=0, initial=0)).astype(np.int64)
    span = whole.max(axis=0, initial=0) + 1
    return np.asarray((whole[:, 0] * span[1] + whole[:, 1]) * span[2] + whole[:, 2])


def _distinct(cells: IntArray) -> IntArray:
    """Returns the indices of triangles (n, 3) that have three cells, each such triangle once."""
    a, b, c = cells.T
    whole = np.flatnonzero((a != b) & (b != c) & (a != c))
    # Turned so that the smallest comes first, which keeps the side that the triangle faces.
    turned = cells[whole]
    shift = turned.argmin(axis=1)
    turned = turned[np.arange(len(whole))[:, None], (shift[:, None] + np.arange(3)) % 3]
    _, first = np.unique(_numbers(turned), return_index=True)
    return np.asarray(whole[np.sort(first)])


def _split(points: Floats, corners: Indices) -> list[Indices]:
    """Returns triangles (n, 3) in pieces of at most `PART_TRIANGLES` that lie close together."""
    if len(corners) <= PART_TRIANGLES:
        return [corners]
    middle = points[corners, :3].mean(axis=1)
    axis = int(np.ptp(middle, axis=0).argmax())
    order = np.argsort(middle[:, axis], kind="stable")
    half = len(order) // 2
    return _split(points, corners[order[:half]]) + _split(points, corners[order[half:]])


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[Floats, Indices]:
    first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = slice(first, first + count)
    corner, normal_of = model.mesh_face[faces], model.mesh_facenormal[faces]
    points = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    normals = model.mesh_normal[model.mesh_normaladr[mesh] :][: model.mesh_normalnum[mesh]]
    coordinates = np.zeros((1, 2), np.float32)
    coordinate_of = np.zeros_like(corner)
    textured = model.mesh_texcoordadr[mesh] >= 0
    if textured:
        start = model.mesh_texcoordadr[mesh]
        coordinates = model.mesh_texcoord[start:][: model.mesh_texcoordnum[mesh]]
        coordinate_of = model.mesh_facetexcoord[faces]
    else:
        a, b, c = (points[corner[:, i]] for i in range(3))
        flat = np.cross(b - a, c - a)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-15)
        sharp = np.einsum("ijk,ik->ij", normals[normal_of], flat) < _SMOOTH
        own = len(normals) + np.arange(count)[:, None]
        normal_of = np.where(sharp, own, normal_of)
        normals = np.concatenate([normals, flat])
    # Corners with the same point, normal and texture coordinates are one vertex.
    key = (corner.astype(np.int64) * len(normals) + normal_of) * len(coordinates) + coordinate_of
    unique, place = np.unique(key, return_inverse=True)
    rest, texture = np.divmod(unique, len(coordinates))
    point, normal = np.divmod(rest, len(normals))
    vertices = np.concatenate([points[point], normals[normal], coordinates[texture]], axis=1)
    return vertices.astype(np.float32), place.reshape(-1, 3).astype(np.uint32)


def _box(size: FloatArray) -> tuple[Floats, Indices]:
    vertices: list[list[float]] = []
    corners: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * np.eye(3)[axis]
            u, v = np.eye(3)[(axis + 1) % 3], sign * np.eye(3)[(axis + 2) % 3]
            start = len(vertices)
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                vertices.append([*((normal + a * u + b * v) * size), *normal, 0.0, 0.0])
            corners += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return np.array(vertices, np.float32), np.array(corners, np.uint32)


def _turned(profile: list[tuple[float, ...]]) -> tuple[Floats, Indices]:
    """Returns the surface of a profile (radius, z, normal radius, normal z) turned around z.

    The profile runs upwards on the outer side.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, _SLICES + 1)
    c, s = np.cos(angle), np.sin(angle)
    rings = [
        np.stack([r * c, r * s, z + 0 * c, n * c, n * s, m + 0 * c, 0 * c, 0 * c], axis=1)
        for r, z, n, m in profile
    ]
    corners = []
    width = _SLICES + 1
    for i in range(len(profile) - 1):
        for j in range(_SLICES):
            a, b = i * width + j, (i + 1) * width + j
            corners += [[a, a + 1, b + 1], [a, b + 1, b]]
    return np.concatenate(rings).astype(np.float32), np.array(corners, np.uint32)


def _arc(radius: float, center: float, start: float, end: float) -> list[tuple[float, ...]]:
    angles = np.linspace(start, end, _STACKS + 1)
    return [(radius * np.cos(a), center + radius * np.sin(a), np.cos(a), np.sin(a)) for a in angles]


def _cylinder(model: mujoco.MjModel, geom: int) -> tuple[Floats, Indices]:
    radius, half, _ = model.geom_size[geom]
    return _turned(
        [
            (0.0, -half, 0.0, -1.0),
            (radius, -half, 0.0, -1.0),
            (radius, -half, 1.0, 0.0),
            (radius, half, 1.0, 0.0),
            (radius, half, 0.0, 1.0),
            (0.0, half, 0.0, 1.0),
        ]
    )


def _capsule(model: mujoco.MjModel, geom: int) -> tuple[Floats, Indices]:
    radius, half, _ = model.geom_size[geom]
    quarter = 0.5 * np.pi
    return _turned([*_arc(radius, -half, -quarter, 0.0), *_arc(radius, half, 0.0, quarter)])


def _ellipsoid(model: mujoco.MjModel, geom: int) -> tuple[Floats, Indices]:
    size = model.geom_size[geom]
    if model.geom_type[geom] == Kind.mjGEOM_SPHERE:
        size = np.full(3, size[0])
    points, corners = _turned(_arc(1.0, 0.0, -0.5 * np.pi, 0.5 * np.pi))
    points[:, :3] *= size
    points[:, 3:6] /= size
    return points, corners


def _plane(model: mujoco.MjModel, geom: int) -> tuple[Floats, Indices]:
    half = model.geom_size[geom, :2].copy()
    # Larger than the distance seen; `Offscreen` moves an infinite plane with the camera.
    half[half <= 0.0] = 1.05 * model.vis.map.zfar * model.stat.extent
    line = np.linspace(-1.0, 1.0, _PLANE_CELLS + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(half[0] * line, half[1] * line))
    repeat = plane_repeat(model, geom)
    points = np.stack(
        [
            x,
            y,
            0 * x,
            0 * x,
            0 * x,
            0 * x + 1,
            0.5 * repeat[0] * x - 0.5,
            -0.5 * repeat[1] * y - 0.5,
        ],
        axis=1,
    )
    a = (np.arange(_PLANE_CELLS)[:, None] * (_PLANE_CELLS + 1) + np.arange(_PLANE_CELLS)).ravel()
    b = a + _PLANE_CELLS + 1
    corners = np.concatenate([np.stack([a, a + 1, b + 1], 1), np.stack([a, b + 1, b], 1)])
    return points.astype(np.float32), corners.astype(np.uint32)


def turn_of(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Returns the rotation of a geom in its body, (3, 3)."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return turn.reshape(3, 3)


def plane_repeat(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Returns how often a plane's texture repeats in 2 m along x and y."""
    material = model.geom_matid[geom]
    if material < 0:
        return np.ones(2)
    repeat = model.mat_texrepeat[material].astype(float)
    half = model.geom_size[geom, :2]
    if not model.mat_texuniform[material]:
        repeat = np.where(half > 0.0, repeat / np.maximum(half, 1e-9), repeat)
    return np.asarray(repeat)


_PRIMITIVES = {
    Kind.mjGEOM_BOX: lambda model, geom: _box(model.geom_size[geom]),
    Kind.mjGEOM_SPHERE: _ellipsoid,
    Kind.mjGEOM_ELLIPSOID: _ellipsoid,
    Kind.mjGEOM_CYLINDER: _cylinder,
    Kind.mjGEOM_CAPSULE: _capsule,
    Kind.mjGEOM_PLANE: _plane,
}
