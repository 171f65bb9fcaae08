"""Visual geoms of a route: pavement, paint, rails, tunnels, bridges, landscape, sky and sun.

They have no contact and do not change the physics. The tires roll on the compiled table of the
route; the drawn pavement follows the same function within 5 mm of height.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.corridor import Corridor, chunks
from iits_mj.model.scenery.furniture import GAP, STRIPE, furniture, stripes
from iits_mj.model.scenery.landscape import Ground, Landscape, Plain, is_plain
from iits_mj.model.scenery.materials import (
    ASPHALT_TILE,
    GRASS_TILE,
    LAMP_SPACING,
    add_road_materials,
    add_sky,
    ensure_material,
    set_view,
)
from iits_mj.model.scenery.network import REACH, ROUTE, Network, lanes, network, other_roads
from iits_mj.model.scenery.paint import markings, potholes
from iits_mj.model.scenery.streets import Street
from iits_mj.model.scenery.structures import bridge, delineators, guard_rails, trees, tunnel
from iits_mj.model.visuals.shapes import Shape, add_mesh, merge
from iits_mj.road import Route

ROAD_GROUP = 2
CHUNK_LENGTH = 600.0  # [m] of road in one mesh; longer on very long routes
CHUNKS_MAX = 40
TILE = 400.0  # [m] of the map in one mesh for each material
FURNITURE_END = {True: 4_000.0, False: 40_000.0}  # [m], by `is_plain`


def add_road(spec: mujoco.MjSpec, route: Route) -> None:
    """Adds the visual road of a route, the sky and the light.

    The sun follows the body `tractor`, if the specification has one.
    """
    start = route.evaluate(min(20.0, route.length))
    set_view(spec, (float(start.x), float(start.y), float(start.z) + 1.5))
    add_sky(spec)
    add_road_materials(spec)
    around = network(route)
    if around is None:
        street, corridor = Street.of_route(route), Corridor.sample(route)
        wide, bridges = corridor, []
    else:
        street, wide = around.street(ROUTE), around.corridors[ROUTE]
        corridor, bridges = Corridor.sample(route, wide.station), around.bridges[ROUTE]
    plain = is_plain(route) and (around is None or not around.others)
    ground = Plain(route) if plain else Landscape(route, corridor, around=around)
    if isinstance(ground, Plain):
        _add_plain(spec, ground)
    else:
        _add_meshes(spec, "", {"road_terrain": [ground.grid()]}, "road_grass")
    rng = np.random.default_rng(5)
    length = max(CHUNK_LENGTH, route.length / CHUNKS_MAX)
    hidden = None if around is None else around.hides(ROUTE)
    for index, (a, b) in enumerate(chunks(corridor, length)):
        parts = _by_material(markings(street, corridor, a, b, hidden).items())
        if (holes := potholes(route, a, b)) is not None:
            parts["road_pothole"].append(holes)
        for begin, end, kind in _pieces(route, a, b, bridges):
            piece = corridor.between(begin, end)
            surface, tile = "road_asphalt", ASPHALT_TILE
            if kind == "tunnel":
                surface, tile = "road_asphalt_tunnel", LAMP_SPACING
            found = [(surface, piece.strip(piece.left, piece.right, 0.0, tile))]
            if kind in ("tunnel", "bridge") and isinstance(ground, Landscape):
                found.append(("road_grass", ground.cover(piece)))
            elif kind != "over":
                furnished = begin < FURNITURE_END[plain]
                rim = wide.between(begin, end)
                found += _beside(route, rim, ground, around, furnished=furnished, rng=rng)
            for material, shape in found:
                parts[material].append(shape)
        _add_meshes(spec, f"_{index}", parts)
    for index, (a, b) in enumerate(route.tunnels):
        _add_meshes(spec, f"_tunnel{index}", _by_material(tunnel(corridor, a, b)))
    for index, (a, b) in enumerate(route.bridges):
        _add_meshes(spec, f"_bridge{index}", _by_material(bridge(corridor, ground, a, b)))
    _add_tiles(spec, _map(route, around, ground))


def add_paint(
    spec: mujoco.MjSpec,
    route: Route,
    lines: Iterable[FloatArray],
    dashed: Iterable[FloatArray],
    crossings: Iterable[FloatArray],
) -> None:
    """Adds painted rectangles on the roads about a route, each given by its corners (n, 3) [m].

    Args:
      spec: with the road of the route.
      route: of the truck.
      lines: unbroken stop lines.
      dashed: stop lines in short dashes.
      crossings: of pedestrians.
    """
    from scipy.spatial import cKDTree

    point = route.evaluate(np.arange(0.0, route.length + 20.0, 20.0))
    line = cKDTree(np.stack([point.x, point.y], axis=-1))
    patterns = ((lines, ()), (dashed, (STRIPE, 0.5 * GAP)), (crossings, (STRIPE, GAP)))
    found = [
        (corners[0], "road_marking", stripes(corners, *pattern))
        for some, pattern in patterns
        for corners in some
        if line.query(corners[0, :2])[0] < REACH
    ]
    _add_tiles(spec, found, "_paint")


def _map(
    route: Route, around: Network | None, ground: Ground
) -> Iterator[tuple[FloatArray, str, Shape]]:
    """Yields (place, material, shape) of everything about the route that the map gives."""
    reaches = {segment.road_id: (-np.inf, np.inf) for segment in route.segments}
    if around is not None:
        for material, shape in lanes(around, ROUTE):
            yield shape.vertices[0], material, shape
        yield from other_roads(around)
        for name, corridor in around.corridors.items():
            reaches.setdefault(name, (float(corridor.station[0]), float(corridor.station[-1])))
            for a, b in around.bridges[name]:
                for material, shape in bridge(corridor, ground, a, b, around.is_free):
                    yield shape.vertices[0], material, shape
        reaches.pop(ROUTE)
    if around is not None and isinstance(ground, Landscape):
        yield from _network_ground(around, ground)
    yield from furniture(route, reaches)


def _network_ground(around: Network, ground: Landscape) -> Iterator[tuple[FloatArray, str, Shape]]:
    """Yields (place, material, shape) of the ground beside the roads off the route."""
    places = [area.outline for area in around.areas]
    for name, corridor in around.others.items():
        for a, b in around.on_ground(name):
            part = corridor.between(a, b)

            def open_rim(row: Corridor, side: float, name: str = name) -> NDArray[np.bool_]:
                return around.open_rim(name, row, side)

            for material, shape in ground.ribbons(part, open_rim):
                yield shape.vertices[0], material, shape
        ends = corridor.across(np.stack([corridor.right, corridor.left], axis=1))[[0, -1]]
        places += [end[:, :2] for end in ends]
    sheets = [ground.middle_ground()]
    for number, place in enumerate(places):
        sheets.append(ground.patch(place.min(axis=0), place.max(axis=0), number))
    for sheet in sheets:
        yield sheet.vertices[0], "road_grass", sheet


def _add_tiles(
    spec: mujoco.MjSpec, found: Iterable[tuple[FloatArray, str, Shape]], label: str = ""
) -> None:
    """Adds shapes as one mesh for each material and square of the map."""
    tiles: dict[tuple[int, int], list[tuple[str, Shape]]] = defaultdict(list)
    for place, material, shape in found:
        tiles[int(place[0] // TILE), int(place[1] // TILE)].append((material, shape))
    for (column, row), shapes in sorted(tiles.items(), key=lambda item: item[0]):
        _add_meshes(spec, f"{label}_map_{column}_{row}", _by_material(shapes))


def _beside(
    route: Route,
    piece: Corridor,
    ground: Ground,
    around: Network | None,
    *,
    furnished: bool,
    rng: np.random.Generator,
) -> Iterator[tuple[str, Shape]]:
    """Ground, posts, trees and guard rails beside a stretch of open road."""
    if around is None:
        yield from ground.ribbons(piece)
    else:
        yield from ground.ribbons(piece, lambda row, side: around.open_rim(ROUTE, row, side))
    if not furnished:
        return
    yield from trees(piece, ground, rng)
    for part in [piece] if around is None else around.rural_parts(piece):
        yield from delineators(part)
        middle = 0.5 * float(part.station[0] + part.station[-1])
        if route.lane_count(middle) > 1:
            yield from guard_rails(part)


def _pieces(
    route: Route, start: float, end: float, over: Iterable[tuple[float, float]] = ()
) -> Iterable[tuple[float, float, str]]:
    """Splits an interval at tunnels and bridges: (from, to, "open" | "tunnel" | "bridge" | "over").

    `over` gives the stations where the route leads over another road.
    """
    spans = [(a, b, "over") for a, b in over]
    spans += [(a, b, "tunnel") for a, b in route.tunnels]
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

    The entry's name up to an "@" is also its material, unless one is given.
    """
    for stem, shapes in parts.items():
        name, shape = f"{stem}{label}", merge(shapes)
        own = material or stem.split("@")[0]
        ensure_material(spec, own)
        # Vertices relative to the mesh's own place keep single precision far from the origin.
        place = np.round(shape.vertices.mean(axis=0))
        add_mesh(spec, name, shape.moved(-place))
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            material=own,
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
