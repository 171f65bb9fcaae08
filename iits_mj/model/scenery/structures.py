"""Structures beside the road: tunnels, bridges, guard rails, delineators and trees.

Each function yields (material, shape); copies are merged into few meshes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.corridor import Corridor
from iits_mj.model.scenery.landscape import Ground
from iits_mj.model.scenery.materials import LAMP_LENGTH, LAMP_SPACING
from iits_mj.model.scenery.streets import Street
from iits_mj.model.visuals.shapes import Shape, boxes, merge, surface
from iits_mj.road import Route

Parts = Iterator[tuple[str, Shape]]
IsFree = Callable[[FloatArray], NDArray[np.bool_]]

WALL_GAP = 0.9  # [m] from the pavement's edge to a tunnel's wall
TUNNEL_WALL, TUNNEL_ROOF = 4.6, 6.9  # [m] above the road
PORTAL_REACH, PORTAL_TOP = 21.0, 9.9
DECK_DEPTH = 1.5
PIER_SPACING = 40.0
RAIL_GAP = 0.45
TREES_PER_KM = 140
WOODS_PER_KM, WOOD_TREES = 7, 14
NEAREST, FARTHEST = 22.0, 120.0  # [m] of the trees from the pavement's edge
# Profile of a guard rail: offset, height [m].
_RAIL = np.array(
    [(0.0, 0.44), (0.06, 0.49), (0.06, 0.53), (0.0, 0.60), (0.06, 0.67), (0.06, 0.71), (0.0, 0.76)]
)


def tunnel(corridor: Corridor, start: float, end: float) -> Parts:
    """Walls, curbs, roof, lights and portals of a tunnel, without the road."""
    part = corridor.between(start, end)
    width = part.left - part.right + 2.0 * WALL_GAP
    base = part.right - WALL_GAP
    along = (part.station - np.floor(start / LAMP_SPACING) * LAMP_SPACING) / LAMP_SPACING

    def sweep(
        points: list[tuple[float, float, float]], texture: list[float] | None = None
    ) -> Shape:
        """Points are (share of the width, meters beside it, height); `texture`: across, of each."""
        strips = []
        for i, ((f0, d0, z0), (f1, d1, z1)) in enumerate(pairwise(points)):
            offsets = base[:, None] + np.stack([f0 * width + d0, f1 * width + d1], axis=1)
            at = None
            if texture is not None:
                across = np.broadcast_to(texture[i : i + 2], offsets.shape)
                at = np.stack([across, np.broadcast_to(along[:, None], offsets.shape)], axis=-1)
            strips.append(surface(part.across(offsets, np.array([[z0, z1]])), at))
        return merge(strips)

    inner = WALL_GAP
    low, high = 0.02, 0.98
    walls = [
        sweep([(0.0, 0.0, -0.3), (0.0, 0.0, 3.0)], [low, high]),
        sweep([(1.0, 0.0, 3.0), (1.0, 0.0, -0.3)], [high, low]),
    ]
    curbs = [
        sweep([(0.0, inner, -0.05), (0.0, inner, 0.22), (0.0, 0.0, 0.22)]),
        sweep([(1.0, 0.0, 0.22), (1.0, -inner, 0.22), (1.0, -inner, -0.05)]),
    ]
    vault = zip(np.linspace(0.0, 1.0, 9), _vault(), strict=True)
    roof = [(0.0, 0.0, 3.0), *((f, 0.0, z) for f, z in vault), (1.0, 0.0, 3.0)]
    yield "road_tunnel_wall", merge(walls)
    yield "road_curb", merge(curbs)
    yield "road_tunnel_roof", sweep(roof, [f for f, _, _ in roof])
    yield "road_tunnel_light", _tunnel_lights(corridor.route, start, end)
    portals = [_portal(corridor.route, start, -1.0), _portal(corridor.route, end, 1.0)]
    yield "road_concrete", merge(portals)


def _vault() -> FloatArray:
    """Heights of a tunnel's ceiling from wall to wall [m], shape (9,)."""
    crown = np.sin(np.linspace(0.0, np.pi, 9))
    return TUNNEL_WALL + (TUNNEL_ROOF - TUNNEL_WALL) * crown**0.8


def _tunnel_lights(route: Route | Street, start: float, end: float) -> Shape:
    first = np.ceil((start + 4.0) / LAMP_SPACING) * LAMP_SPACING
    lamp = np.arange(first, end - 4.0, LAMP_SPACING)
    ends = np.stack([lamp - 0.5 * LAMP_LENGTH, lamp + 0.5 * LAMP_LENGTH], axis=1).ravel()
    row = Corridor.sample(route, ends)
    middle = 0.5 * (row.left + row.right)
    lamps = []
    for shift in (-2.2, 2.2):
        offsets = np.stack([middle + shift - 0.16, middle + shift + 0.16], axis=1)
        points = row.across(offsets, TUNNEL_ROOF - 0.55)
        for i in range(0, len(points), 2):
            lamps.append(surface(points[i : i + 2]))
    return merge(lamps)


def _portal(route: Route | Street, station: float, outward: float) -> Shape:
    """A head wall with the tube's opening, 1.2 m thick, facing away from the tunnel."""

    def rows(*reach: float) -> Corridor:
        """Rows at distances outward from the portal's middle [m]."""
        return Corridor.sample(route, np.array([station + outward * out for out in reach]))

    row, front = rows(0.6, -0.6), rows(0.6)
    right, left = float(front.right[0]) - WALL_GAP, float(front.left[0]) + WALL_GAP
    inner = np.concatenate([[right], np.linspace(right, left, 9), [left]])
    lower = np.concatenate([[-4.0], _vault(), [-4.0]])
    top_left, top_right = left + PORTAL_REACH, right - PORTAL_REACH
    faces = []

    def sheet(offsets: list[float], low: list[float], high: list[float]) -> None:
        grid = np.stack([front.across(np.array([offsets]), np.array([z]))[0] for z in (low, high)])
        # Columns run from right to left of the road: outside as seen when driving towards `front`.
        faces.append(surface(grid if outward > 0 else grid[:, ::-1]))

    sheet([top_right, right], [-4.0, -4.0], [PORTAL_TOP, PORTAL_TOP])
    sheet([left, top_left], [-4.0, -4.0], [PORTAL_TOP, PORTAL_TOP])
    sheet(list(inner), list(lower), [PORTAL_TOP] * len(inner))
    # Reveal of the opening and the coping on top.
    for i in range(len(inner) - 1):
        offsets = np.array([[inner[i], inner[i + 1]]] * 2)
        points = row.across(offsets, np.array([[lower[i], lower[i + 1]]]))
        faces.append(surface(points if outward < 0 else points[::-1]))
    low, high = PORTAL_TOP - 0.5, PORTAL_TOP + 0.25
    thick = rows(0.9, -0.9)
    top = thick.across(np.array([[top_left, top_right]] * 2), high)
    side = np.stack(
        [thick.across(np.array([[top_right, top_left]] * 2), z)[0] for z in (low, high)]
    )
    faces.append(surface(top if outward < 0 else top[::-1]))
    faces.append(surface(side if outward > 0 else side[:, ::-1]))
    return merge(faces)


def bridge(
    corridor: Corridor, ground: Ground, start: float, end: float, is_free: IsFree | None = None
) -> Parts:
    """Deck edges, parapets, underside, piers and abutments of a bridge.

    `is_free` tells where a pier may stand, below points (n, 3) of the road.
    """
    part = corridor.between(start - 1.0, end + 1.0)
    d = DECK_DEPTH
    # Clockwise seen in the direction of travel: parapet's inside, top, outside, underside.
    right = [(0.0, 0.0), (0.0, 0.85), (-0.35, 0.85), (-0.35, -0.5), (0.6, -d)]
    shapes = [part.extrude(right, part.right)]
    shapes.append(part.extrude([(-o, z) for o, z in reversed(right)], part.left))
    under = np.stack([part.right + 0.6, part.left - 0.6], axis=1)
    shapes.append(surface(part.across(under, -d)))
    count = max(1, round((end - start) / PIER_SPACING) - 1)
    for station in np.linspace(start, end, count + 2):
        row = Corridor.sample(corridor.route, np.array([station]))
        middle = 0.5 * (row.left + row.right)
        center = row.across(middle)[0]
        if is_free is not None and not is_free(center[None])[0]:
            continue
        bottom = float(ground.height(center[:1], center[1:2])[0][0]) - 2.0
        top = float(center[2]) - d + 0.2
        wide = 0.62 * float(row.left[0] - row.right[0])
        length, width = (2.4, wide * 1.55) if station in (start, end) else (1.4, wide)
        block = boxes([((0.0, 0.0, 0.0), (length, width, max(top - bottom, 0.5)))])
        c, s = np.cos(float(row.heading[0])), np.sin(float(row.heading[0]))
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        turned = Shape(block.vertices @ rotation.T, block.faces)
        shapes.append(turned.moved((center[0], center[1], 0.5 * (top + bottom))))
    yield "road_concrete", merge(shapes)


def guard_rails(part: Corridor) -> Parts:
    """Steel rails on both sides with posts every 8 m."""
    shapes = []
    for side in (1.0, -1.0):
        edge = part.edge(side, RAIL_GAP + 0.06)
        profile = _RAIL * [-side, 1.0]
        facing = profile if side < 0 else profile[::-1]
        shapes.append(part.extrude(facing, edge, smooth=True))
        shapes.append(part.extrude(facing[::-1], edge, smooth=True))
    posts = np.arange(part.station[0] + 2.0, part.station[-1], 8.0)
    row = Corridor.sample(part.route, posts)
    for side in (1.0, -1.0):
        points = row.across(row.edge(side, RAIL_GAP + 0.14))
        shapes.append(stakes(points, row.heading, 0.10, -0.6, 0.72))
    yield "road_steel", merge(shapes)


def delineators(part: Corridor) -> Parts:
    """Posts with reflectors every 50 m on both sides."""
    first = np.ceil(part.station[0] / 50.0) * 50.0
    stations = np.arange(first, part.station[-1], 50.0)
    if not stations.size:
        return
    row = Corridor.sample(part.route, stations)
    posts, lights = [], []
    for side in (1.0, -1.0):
        points = row.across(row.edge(side, 0.95))
        posts.append(stakes(points, row.heading, 0.11, -0.3, 1.05))
        lights.append(stakes(points, row.heading, 0.125, 0.78, 0.92))
    yield "road_post", merge(posts)
    yield "road_reflector", merge(lights)


def stakes(points: FloatArray, heading: FloatArray, width: float, low: float, high: float) -> Shape:
    """Upright square posts as one mesh, four faces each, without a lid."""
    half = 0.5 * width
    corners = np.array([(half, -half), (half, half), (-half, half), (-half, -half), (half, -half)])
    rows = np.stack([np.column_stack([corners, np.full(5, z)]) for z in (low, high)])
    block = surface(rows)
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x, y, z = (block.vertices[:, i][None, :] for i in range(3))
    turned = np.stack([c * x - s * y, s * x + c * y, z + 0.0 * c], axis=-1)
    return _placed(turned, block, points)


def _placed(vertices: FloatArray, shape: Shape, points: FloatArray) -> Shape:
    """Copies of a shape as one mesh: vertices of each (n, k, 3), moved to points (n, 3)."""
    start = len(shape.vertices) * np.arange(len(points))[:, None, None]
    faces = (shape.faces[None] + start).reshape(-1, 3).astype(np.int32)
    return Shape((vertices + points[:, None, :]).reshape(-1, 3), faces)


def trees(part: Corridor, ground: Ground, rng: np.random.Generator) -> Parts:
    """Trees along a stretch of road, clear of every road."""
    length = part.station[-1] - part.station[0]
    count = max(1, int(TREES_PER_KM * length / 1000.0))
    # Groups: a few centers, trees scattered about them.
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
    pale = rng.random(len(points)) < 0.4
    height[~conifer] *= 0.75
    for name, shape, kind in (
        ("road_conifer", _CONIFER, conifer),
        ("road_leaves", BROADLEAF, ~conifer),
    ):
        for material, chosen in ((name, kind & ~pale), (f"{name}_pale", kind & pale)):
            yield from _grown(material, shape, points[chosen], height[chosen], rng)
    yield from _grown("road_trunk", _TRUNK, points, height, rng)
    yield from _woods(part, ground, rng)


def _woods(part: Corridor, ground: Ground, rng: np.random.Generator) -> Parts:
    """Groups of conifers farther away."""
    length = part.station[-1] - part.station[0]
    groups = max(1, int(WOODS_PER_KM * length / 1000.0))
    count = groups * WOOD_TREES
    along = np.repeat(rng.uniform(part.station[0], part.station[-1], groups), WOOD_TREES)
    row = Corridor.sample(part.route, np.clip(along, part.station[0], part.station[-1]))
    side = np.repeat(np.where(rng.random(groups) < 0.5, 1.0, -1.0), WOOD_TREES)
    reach = np.repeat(FARTHEST + 330.0 * rng.random(groups), WOOD_TREES)
    points = row.across(np.where(side > 0, row.left, row.right) + side * reach)
    spread = np.repeat(rng.uniform(12.0, 42.0, groups), WOOD_TREES)
    points[:, :2] += spread[:, None] * rng.normal(0.0, 1.0, (count, 2))
    points[:, 2], clear = ground.height(points[:, 0], points[:, 1])
    points = points[clear > 0.5 * FARTHEST]
    height = rng.uniform(8.0, 17.0, len(points))
    half = len(points) // 2
    yield from _grown("road_conifer", _SPIRE, points[:half], height[:half], rng)
    yield from _grown("road_conifer_pale", _SPIRE, points[half:], height[half:], rng)


def _grown(
    material: str, shape: Shape, points: FloatArray, height: FloatArray, rng: np.random.Generator
) -> Parts:
    """Copies of a shape of unit height, scaled to heights [m], each turned and of its own girth."""
    if not len(points):
        return
    turn, girth = rng.uniform(0.0, 2.0 * np.pi, len(points)), rng.uniform(0.8, 1.25, len(points))
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y, z = (shape.vertices[:, i][None] for i in range(3))
    wide = girth[:, None]
    grown = np.stack([wide * (c * x - s * y), wide * (s * x + c * y), z + 0.0 * c], axis=-1)
    yield material, _placed(grown * height[:, None, None], shape, points)


def _cone(radius: float, low: float, high: float, sides: int = 7) -> Shape:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, low)], axis=-1)
    vertices = np.concatenate([rim, [[0.0, 0.0, high]]])
    faces = [(i, (i + 1) % sides, sides) for i in range(sides)]
    return Shape(vertices, np.array(faces, dtype=np.int32))


def _crown() -> Shape:
    """A lumpy ball of unit tree height, from rings."""
    levels = np.array(
        [(0.0, 0.24), (0.19, 0.30), (0.32, 0.48), (0.31, 0.66), (0.20, 0.86), (0.0, 1.0)]
    )
    sides = 8
    angle = 2.0 * np.pi * np.arange(sides) / sides
    rows = []
    for k, (r, z) in enumerate(levels):
        lump = (
            1.0 + 0.22 * np.cos(3.0 * angle + 0.7 + 2.1 * k) + 0.10 * np.cos(2.0 * angle + 1.3 * k)
        )
        sag = z + 0.035 * np.cos(4.0 * angle + 1.9 * k) * (r > 0.0)
        rows.append(np.stack([r * lump * np.cos(angle), r * lump * np.sin(angle), sag], axis=-1))
    faces = []
    for i in range(len(levels) - 1):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
    return Shape(np.concatenate(rows), np.array(faces, dtype=np.int32))


_CONIFER = merge([_cone(0.24, 0.10, 0.55), _cone(0.19, 0.34, 0.78), _cone(0.13, 0.58, 1.0)])
BROADLEAF = _crown()
_SPIRE = _cone(0.21, 0.02, 1.0, 5)
_TRUNK = _cone(0.03, -0.1, 0.6, 5)
