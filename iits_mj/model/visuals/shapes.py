"""Triangle meshes for pictures: builders in numpy, and a painter that adds them to a body.

All shapes are closed or one-sided surfaces whose triangles run counter-clockwise seen from outside
(MuJoCo culls the other side). They have no mass and no contact.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.arrays import FloatArray

IntArray = NDArray[np.int32]
Point = Sequence[float] | NDArray[np.float64]

VISUAL_GROUP = 1


@dataclass(frozen=True)
class Shape:
    """A mesh: `vertices` (n, 3) [m], `faces` (m, 3); maybe `texture` (n, 2), `normals` (n, 3)."""

    vertices: FloatArray
    faces: IntArray
    texture: FloatArray | None = None
    normals: FloatArray | None = None

    def moved(self, offset: Point) -> Shape:
        """The shape shifted by `offset` [m]."""
        moved = self.vertices + np.asarray(offset, dtype=float)
        return Shape(moved, self.faces, self.texture, self.normals)

    def mirrored(self) -> Shape:
        """The shape reflected in the plane y = 0, still facing outwards."""
        return Shape(self.vertices * [1.0, -1.0, 1.0], self.faces[:, ::-1], self.texture)

    def with_mirror(self) -> Shape:
        """The shape together with its reflection in the plane y = 0."""
        return merge([self, self.mirrored()])


def merge(shapes: Iterable[Shape]) -> Shape:
    """Several shapes as one mesh; texture coordinates and normals are kept when all have them."""
    parts = list(shapes)
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    textures = [part.texture for part in parts if part.texture is not None]
    normals = [part.normals for part in parts if part.normals is not None]
    return Shape(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(textures) if len(textures) == len(parts) else None,
        np.concatenate(normals) if len(normals) == len(parts) else None,
    )


def surface(
    points: FloatArray, texture: FloatArray | None = None, normals: FloatArray | None = None
) -> Shape:
    """A smooth sheet through a grid of points (rows, columns, 3).

    Seen from outside, rows run upwards and columns to the right.
    """
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    )
    coordinates = None if texture is None else texture.reshape(-1, 2)
    directions = None if normals is None else normals.reshape(-1, 3)
    return Shape(points.reshape(-1, 3), faces.astype(np.int32), coordinates, directions)


def boxes(items: Iterable[tuple[Point, Point]]) -> Shape:
    """Many boxes as one mesh; each is (center, full size) [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    quads = np.array([corners[list(side)] for side in sides]).reshape(-1, 3)
    start = 4 * np.arange(6)[:, None]
    faces = np.concatenate([start + np.array(half) for half in ((0, 1, 2), (0, 2, 3))])
    faces = faces.astype(np.int32)
    return merge(
        Shape(quads * np.asarray(size, dtype=float) + np.asarray(center, dtype=float), faces)
        for center, size in items
    )


def beam(start: Point, end: Point, width: float, height: float) -> Shape:
    """Returns a straight box between two points; its width is horizontal [m]."""
    first, last = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    along = last - first
    length = float(np.linalg.norm(along))
    x = along / length
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    straight = boxes([((0.0, 0.0, 0.0), (length, width, height))])
    axes = np.stack([x, y, np.cross(x, y)])
    return Shape(straight.vertices @ axes + 0.5 * (first + last), straight.faces)


def prism(outline: ArrayLike, y: float, thickness: float) -> Shape:
    """A flat plate: a convex outline (n, 2) in x and z, from `y` to `y + thickness`."""
    points = np.asarray(outline, dtype=float)
    turn = np.roll(points, -1, axis=0)
    # Seen from +y, x runs to the left: outside is counter-clockwise when the area is negative.
    if np.sum(points[:, 0] * turn[:, 1] - turn[:, 0] * points[:, 1]) > 0:
        points = points[::-1]
    n = len(points)
    near = np.insert(points, 1, y + thickness, axis=1)
    far = np.insert(points, 1, y, axis=1)
    fan = np.array([[0, i, i + 1] for i in range(1, n - 1)])
    parts = [Shape(near, fan.astype(np.int32)), Shape(far, fan[:, ::-1].astype(np.int32))]
    for i in range(n):
        j = (i + 1) % n
        quad = np.array([near[i], far[i], far[j], near[j]])
        parts.append(Shape(quad, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)))
    return merge(parts)


def lathe(profile: ArrayLike, segments: int = 40, lug: ArrayLike | None = None) -> Shape:
    """A body of revolution about the y axis.

    Args:
      profile: (n, 2) radius and y, running from large y to small y along the outside.
      segments: around the axis.
      lug: radial depth of grooves for each profile point (n,) [m], cut in every other segment.
    """
    points = np.asarray(profile, dtype=float)
    depth = np.zeros(len(points)) if lug is None else np.asarray(lug, dtype=float)
    angle = np.linspace(0.0, 2.0 * np.pi, segments + 1)
    groove = (np.arange(segments + 1) % 4 >= 2).astype(float)
    parts = []
    for (r0, y0), (r1, y1), d0, d1 in zip(points, points[1:], depth, depth[1:], strict=False):
        rows = [_circle(r - d * groove, angle, y) for r, y, d in ((r0, y0, d0), (r1, y1, d1))]
        parts.append(surface(np.stack(rows)))
    return merge(parts)


def _circle(radius: ArrayLike, angle: FloatArray, y: float) -> FloatArray:
    """Points about the y axis, (n, 3), at angles from x towards z."""
    return np.stack([radius * np.cos(angle), y + 0 * angle, radius * np.sin(angle)], axis=-1)


def ring(shape: Shape, count: int, radius: float) -> Shape:
    """Copies of a shape around the y axis at a radius [m]; the shape's x axis points outwards."""
    parts = []
    for angle in 2.0 * np.pi * np.arange(count) / count:
        c, s = np.cos(angle), np.sin(angle)
        x = shape.vertices[:, 0] + radius
        z = shape.vertices[:, 2]
        turned = np.stack([c * x - s * z, shape.vertices[:, 1], s * x + c * z], axis=-1)
        parts.append(Shape(turned, shape.faces))
    return merge(parts)


def arch(
    radius: float, thickness: float, start: float, end: float, y: float, width: float
) -> Shape:
    """A fender about the y axis from angle `start` to `end` [rad], x towards z, y to y + width."""
    angle = np.linspace(start, end, 19)

    outer, inner = radius + thickness, radius
    strips = (
        ((outer, y + width), (outer, y)),
        ((inner, y), (inner, y + width)),
        ((inner, y + width), (outer, y + width)),
        ((outer, y), (inner, y)),
    )
    return merge(
        surface(np.stack([_circle(r, angle, side) for r, side in strip])) for strip in strips
    )


class Painter:
    """Adds named visual geoms to one body; coordinates are in the body's frame plus `origin`."""

    def __init__(
        self, spec: mujoco.MjSpec, body: Any, prefix: str, origin: Point = (0.0, 0.0, 0.0)
    ) -> None:
        self.spec = spec
        self.body = body
        self.prefix = prefix
        self.origin = np.asarray(origin, dtype=float)

    def box(self, name: str, center: Point, size: Point, material: str) -> None:
        """Adds a box of full size [m]."""
        self._geom(
            name,
            material,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=self.origin + center,
            size=0.5 * np.asarray(size, dtype=float),
        )

    def cylinder(
        self,
        name: str,
        start: Point,
        end: Point,
        radius: float,
        material: str,
        *,
        round_ends: bool = False,
    ) -> None:
        """Adds a cylinder (or capsule) between two points."""
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE if round_ends else mujoco.mjtGeom.mjGEOM_CYLINDER
        fromto = [*(self.origin + start), *(self.origin + end)]
        self._geom(name, material, type=kind, fromto=fromto, size=[radius, 0, 0])

    def mesh(self, name: str, shape: Shape, material: str) -> None:
        """Adds a mesh and a geom that shows it."""
        mesh_name = f"{self.prefix}_{name}"
        add_mesh(self.spec, mesh_name, shape.moved(self.origin))
        self.reuse(name, mesh_name, material)

    def pair(self, name: str, shapes: Shape | Iterable[Shape], material: str) -> None:
        """Adds shapes on the left side together with their reflection, as one mesh."""
        shape = shapes if isinstance(shapes, Shape) else merge(shapes)
        self.mesh(name, shape.with_mirror(), material)

    def sides(self, name: str, shape: Shape, material: str) -> None:
        """Adds a shape on the left side and its reflection, as two meshes with own materials."""
        for side, part in (("left", shape), ("right", shape.mirrored())):
            self.mesh(f"{name}_{side}", part, f"{material}_{side}")

    def reuse(self, name: str, mesh_name: str, material: str, quat: Point = (1, 0, 0, 0)) -> None:
        """Adds a geom that shows a mesh of the specification."""
        self._geom(
            name, material, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh_name, quat=list(quat)
        )

    def _geom(self, name: str, material: str, **fields: Any) -> None:
        self.body.add_geom(
            name=f"{self.prefix}_{name}",
            material=material,
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
            mass=0.0,
            **fields,
        )


def add_mesh(spec: mujoco.MjSpec, name: str, shape: Shape) -> None:
    """Adds a shape to the specification; shell inertia, so that flat sheets are allowed."""
    mesh = spec.add_mesh(
        name=name,
        uservert=np.round(shape.vertices, 4).ravel(),
        userface=shape.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    if shape.texture is not None:
        mesh.usertexcoord = np.round(shape.texture, 4).ravel()
        mesh.userfacetexcoord = shape.faces.ravel()
    if shape.normals is not None:
        mesh.usernormal = shape.normals.ravel()
        mesh.userfacenormal = shape.faces.ravel()
