"""The ground beside the road: verges, embankments and hills.

The ground's height is one function of the map position: near the road it follows the pavement of
the nearest station, farther away it blends into hills. Fine ribbons along the road show the near
ground, and a coarse grid below them shows the far ground.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.corridor import Corridor
from iits_mj.model.scenery.materials import GRASS_TILE, bilinear, periodic_noise
from iits_mj.model.visuals.shapes import Shape, surface
from iits_mj.road import Route

if TYPE_CHECKING:
    from iits_mj.model.scenery.network import Network

VERGE = (1.3, 0.05)  # [m] width of the gravel strip and its fall
RIBBON = np.array([1.3, 3.0, 5.0, 8.0, 13.0, 20.0, 30.0, 45.0, 65.0])
DIVE = 3.0  # [m] that the ribbons' outer rim lies below the far ground, so that they meet cleanly
BISECTIONS = 8  # in the search for the place where the ground of two stretches of road meets
OVERLAP = 4.5  # [m] that the ribbons of two stretches of road share
BEHIND_CENTER = 1.0  # [m] that they reach beyond the center of their own bend
SHARED_FALL = 0.4  # [m] that each of them falls there
TUNNEL_COVER = 9.6  # [m] least ground above the road of a tunnel
TUNNEL_HILL = 17.0
VALLEY_DEPTH = 15.0
GRID_POINTS = 24_000
MARGIN = 1500.0
SUNK = 3.2  # [m] of the far ground below a road
PATCH_CELL = 2.0  # [m] of the ground about junctions and ends of roads
PATCH_REACH = 12.0  # [m] that it extends beyond them
NETWORK_POINTS = 30_000  # of the ground between the ribbons of other roads
NO_STATION = -1e9  # of roads off the route

OpenRim = Callable[[Corridor, float], NDArray[np.bool_]]
"""Whether the ground beside a corridor's edge on a side is drawn, (n,)."""


def smoothstep(low: float, high: float, x: FloatArray) -> FloatArray:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


class Landscape:
    """Ground heights about a route, for one scene."""

    def __init__(
        self, route: Route, corridor: Corridor, seed: int = 11, around: Network | None = None
    ) -> None:
        # Imported here: SciPy takes longer to import than a truck on a plane takes to load.
        from scipy.spatial import cKDTree

        self.route = route
        self._levels = around is not None
        if around is None:
            self._station = np.arange(-400.0, route.length + 400.0, 4.0)
            line = Corridor.sample(route, self._station)
            self._centers = line.across(0.5 * (line.left + line.right))
            self._half_width = 0.5 * (line.left - line.right)
        else:
            self._station, self._centers, self._half_width = _network_rows(around)
        self._nearest = cKDTree(self._centers[:, :2])
        self._coarse = self._centers[::50]
        self._far = cKDTree(self._coarse[:, :2])
        self._noise = periodic_noise(np.random.default_rng(seed), 256, 1.9)
        low, high = self._centers[:, :2].min(axis=0), self._centers[:, :2].max(axis=0)
        size = high - low + 2.0 * MARGIN
        self._cell = max(60.0, float(np.sqrt(size[0] * size[1] / GRID_POINTS)))
        self._corner, self._count = low - MARGIN, np.ceil(size / self._cell).astype(int) + 1
        # Wide ribbons: every grid cell that meets the road has all its corners below the road.
        self._sunk = max(115.0, 1.5 * self._cell)
        self._reach = self._sunk + 35.0
        self._ribbon_reach = np.concatenate([RIBBON, [0.6 * self._reach, self._reach]])
        self.corridor = corridor

    def height(
        self, x: FloatArray, y: FloatArray, *, far: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Ground height and distance from the pavement's edge (negative on it) [m].

        `x` and `y` are map positions of any shape. `far` gives the coarse grid's ground: without
        the tunnels' hills, and sunk near the road.
        """
        points = np.stack([np.ravel(x), np.ravel(y)], axis=-1)
        distance, index = self._nearest.query(points)
        station = self._station[index]
        edge = distance - self._half_width[index]
        count = min(8, len(self._coarse))
        reach, neighbor = self._far.query(points, k=count)
        weight = 1.0 / (reach.reshape(-1, count) ** 2 + 250.0**2) ** 1.5
        level = self._coarse[neighbor.reshape(-1, count), 2]
        wide = (weight * level).sum(axis=1) / weight.sum(axis=1)
        blend = smoothstep(60.0, 600.0, edge)
        ground = (1.0 - blend) * self._centers[index, 2] + blend * wide - 0.7
        small = self._sample(points, 900.0)
        large = self._sample(points[:, ::-1] + 777.0, 5200.0)
        ground += 4.0 * small * smoothstep(5.0, 70.0, edge)
        ground += (34.0 * large + 16.0) * smoothstep(40.0, 750.0, edge)
        ground -= self._valley(station)
        if far:
            near = 1.0 - smoothstep(self._sunk, self._reach - 2.0, edge)
            depth = SUNK + 9.0 * (self._valley(station, 120.0) > 0.0) + self._valley(station)
            # The finer ground between the roads of a map is above this coarse one.
            own = ground - 2.5 if self._levels else ground
            sunk = np.minimum(own, self._centers[index, 2] - depth)
            ground = (1.0 - near) * ground + near * sunk
        else:
            ground = self._tunnel(ground, station, edge, self._centers[index, 2])
        shape = np.shape(x)
        return ground.reshape(shape), edge.reshape(shape)

    def ribbons(
        self, part: Corridor, open_rim: OpenRim | None = None
    ) -> Iterator[tuple[str, Shape]]:
        """(material, shape) of the verge and the ground on both sides of a stretch of road."""
        for side in (1.0, -1.0):
            for run in [part] if open_rim is None else part.runs(open_rim(part, side)):
                yield from self._beside(run, side)

    def _beside(self, part: Corridor, side: float) -> Iterator[tuple[str, Shape]]:
        edge = part.edge(side)
        points, normals = self._ribbon(part, edge, side)
        across = edge + side * VERGE[0]
        rows = part.across(np.stack([edge, across], axis=1), np.array([[0.0, -VERGE[1]]]))
        gravel = rows if side < 0 else rows[:, ::-1]
        yield "road_gravel", surface(gravel)
        yield "road_grass", surface(points, points[..., :2] / GRASS_TILE, normals)

    def cover(self, part: Corridor) -> Shape:
        """The ground right across the road: above a tunnel, below a bridge."""
        middle = 0.5 * (part.left + part.right)
        half = 0.5 * (part.left - part.right)
        wide = self._ribbon_reach
        reach = np.concatenate([-wide[::-1], [0.0], wide])
        offset = middle[:, None] - np.sign(reach) * half[:, None] - self._limit(part, reach)
        points = part.across(offset)
        points[..., 2], _ = self.height(points[..., 0], points[..., 1])
        points[:, [0, -1], 2] -= DIVE
        return surface(points, points[..., :2] / GRASS_TILE, _grid_normals(points))

    def grid(self) -> Shape:
        """The far ground as one coarse mesh over the route's bounding box and a margin."""
        x, y = np.meshgrid(
            self._corner[0] + self._cell * np.arange(self._count[0]),
            self._corner[1] + self._cell * np.arange(self._count[1]),
        )
        z, _ = self.height(x, y, far=True)
        if self._levels:
            z = np.minimum(z, self._lowest(x, y) - SUNK)
        points = np.stack([x, y, z], axis=-1)
        return surface(points, points[..., :2] / GRASS_TILE, _grid_normals(points))

    def patch(self, low: FloatArray, high: FloatArray, number: int) -> Shape:
        """The ground over a small rectangle with roads, from corner to corner (2,) each.

        Each number of a patch gives another depth, so that no two lie in the same plane.
        """
        drop = 0.06 + 0.03 * (number % 6)
        return self._sheet(low - PATCH_REACH, high + PATCH_REACH, PATCH_CELL, (0.3, 0.6), drop)

    def middle_ground(self) -> Shape:
        """The ground between the ribbons of a map's roads, below them where they overlap."""
        low, high = (f(self._centers[:, :2], axis=0) for f in (np.min, np.max))
        low, high = low - self._reach, high + self._reach
        cell = max(8.0, float(np.sqrt(np.prod(high - low) / NETWORK_POINTS)))
        return self._sheet(low, high, cell, (1.5 * cell, 1.8), 0.4)

    def _lowest(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height of the lowest road within a cell of the points of a grid; inf without one."""
        low, cell = np.array([x[0, 0], y[0, 0]]), x[0, 1] - x[0, 0]
        place = np.round((self._centers[:, :2] - low) / cell).astype(int) + 1
        found = np.full((x.shape[0] + 2, x.shape[1] + 2), np.inf)
        inside = np.all((place >= 0) & (place < found.shape[::-1]), axis=1)
        np.minimum.at(found, (place[inside, 1], place[inside, 0]), self._centers[inside, 2])
        found = np.minimum.reduce([found[:-2], found[1:-1], found[2:]])
        return np.minimum.reduce([found[:, :-2], found[:, 1:-1], found[:, 2:]])

    def _sheet(
        self,
        low: FloatArray,
        high: FloatArray,
        cell: float,
        sunk: tuple[float, float],
        drop: float,
    ) -> Shape:
        """A grid of ground, lowered by `drop`.

        Nearer to a road than the first of `sunk` it lies at least the second below the road [m].
        """
        axes = (np.arange(a, b + cell, cell) for a, b in zip(low, high, strict=True))
        x, y = np.meshgrid(*axes)
        ground, edge = self.height(x, y)
        _, index = self._nearest.query(np.stack([x.ravel(), y.ravel()], axis=-1))
        road = self._centers[index, 2].reshape(x.shape)
        share = smoothstep(4.0, 20.0, edge)
        ground = (1.0 - share) * (road - _ditch(edge)) + share * ground
        ground = np.where(edge < sunk[0], np.minimum(ground, road - sunk[1]), ground)
        ground = np.minimum(ground, self._lowest(x, y) - np.where(edge < sunk[0], sunk[1], 0.0))
        points = np.stack([x, y, ground - drop], axis=-1)
        sheet = surface(points, points[..., :2] / GRASS_TILE, _grid_normals(points))
        near = edge.ravel()[sheet.faces].max(axis=1) < self._reach
        return Shape(sheet.vertices, sheet.faces[near], sheet.texture, sheet.normals)

    def _ribbon(
        self, part: Corridor, edge: FloatArray, side: float
    ) -> tuple[FloatArray, FloatArray]:
        wide = self._ribbon_reach
        reach = np.minimum(wide, self._own(part, edge, side)[:, None])
        # The road's tilt ends at the verge: heights are set below, not taken from the tilt.
        points = part.across(edge[:, None] + side * reach)
        rim = part.z + edge * part.tilt
        ground, _ = self.height(points[..., 0], points[..., 1])
        share = smoothstep(4.0, 20.0, reach)
        points[..., 2] = (1.0 - share) * (rim[:, None] - _ditch(reach)) + share * ground
        # Where two ribbons share ground, each falls below the other beyond the middle.
        points[..., 2] -= np.where(reach < wide, SHARED_FALL, 0.0)
        points[:, -1, 2] -= np.where(reach[:, -1] < wide[-1], 0.0, DIVE)
        if side > 0:
            points = points[:, ::-1]
        return points, _grid_normals(points)

    def _own(self, part: Corridor, edge: FloatArray, side: float) -> FloatArray:
        """Distance up to which no other part of the road is nearer [m], (n,)."""
        wide = self._ribbon_reach

        def beyond(reach: FloatArray) -> NDArray[np.bool_]:
            points = part.across(edge[:, None] + side * reach)[..., :2]
            distance, index = self._nearest.query(points)
            return np.asarray(reach - distance + self._half_width[index] > OVERLAP)

        found = beyond(np.broadcast_to(wide, (len(edge), len(wide))))
        first = np.argmax(found, axis=1)
        low, high = np.where(first > 0, wide[first - 1], 0.0), wide[first]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            far = beyond(middle[:, None])[:, 0]
            low, high = np.where(far, low, middle), np.where(far, middle, high)
        inner = np.maximum(side * part.curvature, 1e-9)
        center = 1.0 / inner - side * edge + BEHIND_CENTER
        return np.minimum(np.where(found.any(axis=1), high, np.inf), center)

    def _limit(self, part: Corridor, reach: FloatArray) -> FloatArray:
        """Distances that stay short of the center of the bend on its inner side, (n, k)."""
        room = 0.85 / np.maximum(np.abs(part.curvature), 1e-6) - 0.5 * (part.left - part.right)
        inside = np.sign(reach)[None, :] == np.sign(part.curvature)[:, None]
        room = np.maximum(room, 2.0)[:, None]
        return np.where(inside, np.sign(reach) * np.minimum(np.abs(reach), room), reach)

    def _sample(self, points: FloatArray, period: float) -> FloatArray:
        scaled = points / period * self._noise.shape[0] / 4.0
        return bilinear(self._noise, scaled[..., 0], scaled[..., 1])

    def _valley(self, station: FloatArray, margin: float = 0.0) -> FloatArray:
        depth = np.zeros_like(station)
        for start, end in self.route.bridges:
            ramp = min(60.0, 0.4 * (end - start))
            rise = smoothstep(start - margin, start - margin + ramp, station)
            fall = 1 - smoothstep(end + margin - ramp, end + margin, station)
            depth += VALLEY_DEPTH * rise * fall
        return depth

    def _tunnel(
        self, ground: FloatArray, station: FloatArray, edge: FloatArray, road: FloatArray
    ) -> FloatArray:
        for start, end in self.route.tunnels:
            hill = smoothstep(start - 130.0, start + 60.0, station)
            hill *= 1.0 - smoothstep(end - 60.0, end + 130.0, station)
            fade = 1.0 - smoothstep(75.0, 127.0, edge)
            slope = np.clip(0.75 * (edge - 6.0), 0.0, TUNNEL_HILL * hill) * fade
            inside = (station >= start - 2.0) & (station <= end + 2.0)
            # Behind a portal the ground rises from the head wall's top to the hill.
            depth = np.minimum(station - start, end - station)
            rise = np.maximum(TUNNEL_HILL * hill - TUNNEL_COVER, 0.0) * smoothstep(0.0, 60.0, depth)
            over = road + TUNNEL_COVER + rise
            covered = inside & (edge < 40.0)
            share = smoothstep(12.0, 40.0, edge)
            top = (1.0 - share) * over + share * (ground + slope)
            ground = np.where(covered, np.maximum(top, ground + slope), ground + slope)
        return ground


class Plain:
    """A level or evenly sloping ground for a straight road of constant grade."""

    def __init__(self, route: Route) -> None:
        start = route.evaluate(0.0)
        self.origin = np.array([float(start.x), float(start.y), float(start.z) - 0.25])
        heading, grade = float(start.heading), float(start.grade)
        forward = np.array([np.cos(heading), np.sin(heading), grade])
        self.forward = forward / np.linalg.norm(forward)
        self._slope = grade * np.array([np.cos(heading), np.sin(heading)])
        self.heading = heading

    def height(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Ground height [m]; the distance from the pavement is given as inf."""
        rise = (x - self.origin[0]) * self._slope[0] + (y - self.origin[1]) * self._slope[1]
        return self.origin[2] + rise, np.full(np.shape(x), np.inf)

    def ribbons(self, part: Corridor, _: OpenRim | None = None) -> Iterator[tuple[str, Shape]]:
        """(material, shape) of verges that fall below the plain."""
        for side in (1.0, -1.0):
            offsets = part.edge(side)[:, None] + side * np.array([0.0, 1.3, 4.5])
            points = part.across(offsets, np.array([[0.0, -VERGE[1], -0.4]]))
            inner, outer = points[:, :2], points[:, 1:]
            if side > 0:
                inner, outer = inner[:, ::-1], outer[:, ::-1]
            yield "road_gravel", surface(inner)
            yield "road_grass", surface(outer, outer[..., :2] / GRASS_TILE)


Ground = Landscape | Plain


def is_plain(route: Route) -> bool:
    """Whether the route is straight, of constant grade, without tunnel or bridge."""
    if route.tunnels or route.bridges:
        return False
    point = route.evaluate(np.linspace(0.0, route.length, 201))
    bent = np.max(np.abs(point.curvature)) > 1e-9 or np.ptp(point.grade) > 1e-9
    return not (bent or np.max(np.abs(point.superelevation)) > 1e-9)


def _ditch(reach: FloatArray) -> FloatArray:
    """Depth of the ditch at distances from the pavement's edge [m]."""
    return np.interp(reach, [1.3, 3.0, 5.0, 8.0], [VERGE[1], 0.35, 0.75, 0.95])


def _network_rows(around: Network) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Station (n,), center (n, 3) and half width (n,) of the rows that shape the ground."""
    station, centers, half = [], [], []
    for is_route, first, rows in around.ground_rows():
        x, y, z, wide = (value[::2] for value in (rows.x, rows.y, rows.z, rows.half))
        along = first + 2.0 * np.arange(len(x))
        station.append(along if is_route else np.full(len(x), NO_STATION))
        centers.append(np.stack([x, y, z], axis=-1))
        half.append(wide)
    for area in around.areas:
        station.append(np.full(len(area.points), NO_STATION))
        centers.append(area.points)
        half.append(np.full(len(area.points), 1.5))
    return np.concatenate(station), np.concatenate(centers), np.concatenate(half)


def _grid_normals(points: FloatArray) -> FloatArray:
    """Upward unit normals of a grid of points (rows, columns, 3)."""
    along, across = np.gradient(points, axis=0), np.gradient(points, axis=1)
    normal = np.cross(across, along)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(length > 1e-9, normal / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    return np.where(normal[..., 2:] < 0.0, -normal, normal)
