"""Visual geoms of a route: pavement, paint, rails, tunnels, bridges, landscape, sky and sun.

They have no contact and do not change the physics. The tires roll on the compiled table of the
route; the drawn pavement follows the same function within 5 mm of height.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

import mujoco
import numpy as np

from iits_mj.model.scenery.corridor import Corridor, chunks, markings
from iits_mj.model.scenery.landscape import Ground, Landscape, Plain, is_plain
from iits_mj.model.scenery.materials import (
    ASPHALT_TILE,
    GRASS_TILE,
    LAMP_SPACING,
    add_road_materials,
    add_sky,
    set_view,
)
from iits_mj.model.scenery.structures import bridge, delineators, guard_rails, trees, tunnel
from iits_mj.model.visuals.shapes import Shape, add_mesh, merge
from iits_mj.road import Route

ROAD_GROUP = 2
CHUNK_LENGTH = 600.0  # [m] of road in one mesh; longer on very long routes
CHUNKS_MAX = 40
FURNITURE_END = {True: 4_000.0, False: 40_000.0}  # [m], by `is_plain`


def add_road(spec: mujoco.MjSpec, route: Route) -> None:
    """Adds the visual road of a route, the sky and the light.

    The sun follows the body `tractor`, if the specification has one.
    """
    start = route.evaluate(min(20.0, route.length))
    set_view(spec, (float(start.x), float(start.y), float(start.z) + 1.5))
    add_sky(spec)
    add_road_materials(spec)
    corridor = Corridor.sample(route)
    plain = is_plain(route)
    ground = Plain(route) if plain else Landscape(route, corridor)
    if isinstance(ground, Plain):
        _add_plain(spec, ground)
    else:
        _add_meshes(spec, "", {"road_terrain": [ground.grid()]}, "road_grass")
    rng = np.random.default_rng(5)
    length = max(CHUNK_LENGTH, route.length / CHUNKS_MAX)
    for index, (a, b) in enumerate(chunks(route, length)):
        parts = _by_material(markings(corridor, a, b).items())
        for begin, end, kind in _pieces(route, a, b):
            piece = corridor.between(begin, end)
            surface, tile = "road_asphalt", ASPHALT_TILE
            if kind == "tunnel":
                surface, tile = "road_asphalt_tunnel", LAMP_SPACING
            pavement = piece.strip(piece.left, piece.right, 0.0, tile)
            found = [(surface, pavement)]
            if kind != "open" and isinstance(ground, Landscape):
                found.append(("road_grass", ground.cover(piece)))
            else:
                furnished = begin < FURNITURE_END[plain]
                found += _beside(piece, ground, furnished=furnished, rng=rng)
            for material, shape in found:
                parts[material].append(shape)
        _add_meshes(spec, f"_{index}", parts)
    for index, (a, b) in enumerate(route.tunnels):
        _add_meshes(spec, f"_tunnel{index}", _by_material(tunnel(corridor, a, b)))
    for index, (a, b) in enumerate(route.bridges):
        _add_meshes(spec, f"_bridge{index}", _by_material(bridge(corridor, ground, a, b)))


def _beside(
    piece: Corridor, ground: Ground, *, furnished: bool, rng: np.random.Generator
) -> Iterator[tuple[str, Shape]]:
    """Ground, posts, trees and guard rails beside a stretch of open road."""
    yield from ground.ribbons(piece)
    if furnished:
        yield from delineators(piece)
        yield from trees(piece, ground, rng)
        middle = 0.5 * (piece.station[0] + piece.station[-1])
        if piece.route.lane_count(middle) > 1:
            yield from guard_rails(piece)


def _pieces(route: Route, start: float, end: float) -> Iterable[tuple[float, float, str]]:
    """Splits an interval at tunnels and bridges: (from, to, "open" | "tunnel" | "bridge")."""
    spans = [(a, b, "tunnel") for a, b in route.tunnels]
    spans += [(a, b, "bridge") for a, b in route.bridges]
    cursor = start
    for a, b, kind in sorted(spans):
        low, high = max(a, cursor), min(b, end)
        if high - low < 0.1:
            continue
        if low - cursor > 0.1:
            yield cursor, low, "open"
        yield low, high, kind
        cursor = high
    if end - cursor > 0.1:
        yield cursor, end, "open"


def _by_material(found: Iterable[tuple[str, Shape]]) -> dict[str, list[Shape]]:
    parts: dict[str, list[Shape]] = defaultdict(list)
    for material, shape in found:
        parts[material].append(shape)
    return parts


def _add_meshes(
    spec: mujoco.MjSpec, label: str, parts: dict[str, list[Shape]], material: str = ""
) -> None:
    """Adds one mesh without contact for each entry of `parts`, named after it and the label.

    The entry's name is also its material, unless one is given.
    """
    for stem, shapes in parts.items():
        name, shape = f"{stem}{label}", merge(shapes)
        # Vertices relative to the mesh's own place keep single precision far from the origin.
        place = np.round(shape.vertices.mean(axis=0))
        add_mesh(spec, name, shape.moved(-place))
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            material=material or stem,
            pos=place,
            contype=0,
            conaffinity=0,
            group=ROAD_GROUP,
            mass=0.0,
        )


def _add_plain(spec: mujoco.MjSpec, plain: Plain) -> None:
    material = spec.material("road_grass")
    # An infinite plane has no texture coordinates of its own: the texture repeats by meters.
    material.texrepeat = [1.0 / GRASS_TILE, 1.0 / GRASS_TILE]
    material.texuniform = True
    across = np.array([-np.sin(plain.heading), np.cos(plain.heading), 0.0])
    axes = np.column_stack([plain.forward, across, np.cross(plain.forward, across)])
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    spec.worldbody.add_geom(
        name="road_plain",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        pos=plain.origin,
        quat=quat,
        material="road_grass",
        contype=0,
        conaffinity=0,
        group=ROAD_GROUP,
    )
