"""Objects of a map beside its roads: buildings, barriers, poles, crossings, signs and lights.

OpenDRIVE gives their place, kind and size. Kinds that a picture does not need, and objects without
a size, are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.junction import inside
from iits_mj.model.scenery.paint import MARKING_LIFT
from iits_mj.model.scenery.signs import sign
from iits_mj.model.scenery.streets import Street
from iits_mj.model.scenery.structures import BROADLEAF, stakes
from iits_mj.model.visuals.shapes import Shape, merge, surface
from iits_mj.road import Route
from iits_mj.road.elements import CROSSING, PEDESTRIAN_LIGHT, STOP_LINE, Road, Signal
from iits_mj.road.objects import Corner, MapObject, Repeat

Placed = Iterator[tuple[FloatArray, str, Shape]]

STRIPE, GAP = 0.5, 0.5  # [m] of a zebra crossing
LINE_WIDTH = 0.5  # [m] of a stop line
COPIES_MAX = 2_000  # of one object
COPY_SPACING = 0.5  # [m] at least
WALL = 0.15  # [m] thickness of a barrier without a width
FOUNDATION = 1.5  # [m] of a solid below the road plane, for ground that falls
FLAT = 0.25  # [m] of height up to which an outline is no solid
# Material of a solid by the words in its kind or name; the first that fits.
_SOLIDS = (
    (("building", "house"), "road_building"),
    (("rail", "guard"), "road_steel"),
    (("veget", "tree", "bush", "hedge", "forest"), "road_leaves"),
    (("fence",), "road_trunk"),
    (("post", "pole", "lamp", "light"), "road_post"),
    (("", "barrier", "wall", "obstacle"), "road_concrete"),
)
_SKIPPED = ("roadmark", "patch", "parking", "manhole", "stencil", "roadsurface")
_STOP = ("stopline", "stop_line", "stencil_stop")


@dataclass(frozen=True)
class Site:
    """A road as the place of its objects."""

    road: Road
    street: Street

    def points(self, s: FloatArray, t: FloatArray, lift: FloatArray | float = 0.0) -> FloatArray:
        """Points of the road plane at road coordinates (n,), raised by `lift` [m]; (n, 3)."""
        s, t = np.atleast_1d(s).astype(float), np.atleast_1d(t).astype(float)
        row = self.street.evaluate(s)
        x, y = row.x - t * np.sin(row.heading), row.y + t * np.cos(row.heading)
        return np.stack([x, y, row.z + t * np.tan(row.superelevation) + lift], axis=-1)

    def heading(self, s: float) -> float:
        """Heading of the road [rad]."""
        return float(self.street.evaluate(np.array([s])).heading[0])


def furniture(route: Route, roads: dict[str, tuple[float, float]]) -> Placed:
    """Yields (place, material, shape) of the objects and signals of some roads.

    Args:
      route: of the truck.
      roads: interval of s that is drawn [m], by road id.
    """
    # Lamps are separate geoms, so that a picture can switch them; these the truck obeys.
    obeyed = {
        one.signal: one.station
        for one in route.signals
        if one.signal.is_traffic_light and one.signal.kind != PEDESTRIAN_LIGHT
    }
    for identity, (low, high) in roads.items():
        road = route.road_map.roads[identity]
        if not road.objects and not road.signals:
            continue
        site = Site(road, Street.of_road(road))
        for item in road.objects:
            if low <= item.s <= high or item.repeats:
                for material, shape in _object(site, item):
                    yield shape.vertices[0], material, shape
        for signal in road.signals:
            if low <= signal.s <= high:
                for material, shape in _signal(site, signal, obeyed.get(signal)):
                    yield shape.vertices[0], material, shape


def _object(site: Site, item: MapObject) -> Iterator[tuple[str, Shape]]:
    words = f"{item.kind} {item.name}"
    if item.is_crossing:
        corners = [_outline(site, item, one)[0] for one in item.outlines] or [_plan(site, item)]
        for one in corners:
            yield "road_marking", stripes(one, STRIPE, GAP)
    elif any(word in words for word in _STOP):
        yield "road_marking", stripes(_plan(site, item), depth=LINE_WIDTH)
    elif not any(word in words for word in _SKIPPED):
        material = next(name for keys, name in _SOLIDS if any(key in words for key in keys))
        solids = [*_solids(site, item, material == "road_leaves")]
        if solids:
            yield material, merge(solids)


def _solids(site: Site, item: MapObject, plant: bool) -> Iterator[Shape]:
    for repeat in item.repeats:
        yield from _repeated(site, item, repeat)
    if item.repeats:
        return
    for outline in item.outlines:
        corners, height = _outline(site, item, outline)
        if np.max(height) > FLAT and len(corners) > 2 and _area(corners) > 0.01:
            yield extruded(corners, height)
    if item.outlines:
        return
    full = item.height
    if item.radius > 0.0 and full > FLAT:
        points = site.points(np.array([item.s]), np.array([item.t]), item.z)
        if plant:
            yield Shape(full * BROADLEAF.vertices + points, BROADLEAF.faces)
        else:
            yield stakes(points, np.zeros(1), 2.0 * item.radius, -FOUNDATION, full)
    elif full > FLAT and item.length > 0.0 and item.width > 0.0:
        yield extruded(_plan(site, item), np.full(4, full))


def _plan(site: Site, item: MapObject) -> FloatArray:
    """Corners (4, 3) of an object without an outline; counter-clockwise."""
    length, width = max(item.length, 0.1), max(item.width, 0.1)
    u, v = 0.5 * length * np.array([1, 1, -1, -1]), 0.5 * width * np.array([-1, 1, 1, -1])
    return _local(site, item, u, v, np.zeros(4))


def _local(site: Site, item: MapObject, u: FloatArray, v: FloatArray, z: FloatArray) -> FloatArray:
    origin = site.points(np.array([item.s]), np.array([item.t]), item.z)[0]
    heading = site.heading(item.s) + item.heading
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([origin[0] + c * u - s * v, origin[1] + s * u + c * v, origin[2] + z], axis=-1)


def _outline(
    site: Site, item: MapObject, outline: tuple[Corner, ...]
) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 3) of an outline, counter-clockwise, and its height at each [m]."""
    a, b, z, height = np.array([(one.a, one.b, one.z, one.height) for one in outline]).T
    points = site.points(a, b, z) if outline[0].on_road else _local(site, item, a, b, z)
    if np.allclose(points[0], points[-1], atol=0.05):
        points, height = points[:-1], height[:-1]
    if len(points) > 2 and _area(points) < 0.0:
        points, height = points[::-1], height[::-1]
    return points, np.where(height > 0.0, height, item.height)


def _area(points: FloatArray) -> float:
    """Area of a polygon in the plane [m2], positive if it is counter-clockwise."""
    following = np.roll(points, -1, axis=0)
    cross = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
    return 0.5 * float(np.sum(cross))


def extruded(corners: FloatArray, height: FloatArray) -> Shape:
    """A solid over a counter-clockwise outline (n, 3), of the height at each corner [m]."""
    from scipy.spatial import Delaunay

    base = corners - np.array([0.0, 0.0, FOUNDATION])
    top = corners + np.stack([0.0 * height, 0.0 * height, height], axis=-1)
    parts = []
    for i in range(len(corners)):
        j = (i + 1) % len(corners)
        parts.append(surface(np.array([[base[i], base[j]], [top[i], top[j]]])))
    plan = top[:, :2]
    faces = np.asarray(Delaunay(plan, qhull_options="QJ").simplices, dtype=np.int32)
    a, b, c = (plan[faces[:, i]] for i in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where(turn[:, None] > 0.0, faces, faces[:, ::-1])
    parts.append(Shape(top, faces[inside(plan, (a + b + c) / 3.0)].astype(np.int32)))
    return merge(parts)


def _repeated(site: Site, item: MapObject, repeat: Repeat) -> Iterator[Shape]:
    last = min(repeat.s + repeat.length, site.road.length)
    start = min(max(repeat.s, 0.0), last)
    if repeat.distance == 0.0:
        s = np.linspace(start, last, max(int((last - start) / 4.0), 1) + 1)
    else:
        step = max(repeat.distance, COPY_SPACING, (last - start) / COPIES_MAX)
        s = np.arange(start, last + 1e-6, step)

    def ramp(ends: tuple[float, float], otherwise: float = 0.0) -> FloatArray:
        value = ends[0] + (ends[1] - ends[0]) * (s - start) / max(last - start, 1e-9)
        return np.where(value > 0.0, value, otherwise) if otherwise else value

    t, z = ramp(repeat.t), ramp(repeat.z)
    height = ramp(repeat.height, item.height)
    if np.max(height) < 0.05:
        return
    if repeat.distance > 0.0:
        wide = max(2.0 * item.radius, min(item.width, item.length), 0.1)
        for k in range(len(s)):
            yield stakes(site.points(s[k], t[k], z[k]), np.zeros(1), wide, -0.5, float(height[k]))
        return
    half = 0.5 * ramp(repeat.width, item.width or WALL)
    low, high = (site.points(s, t + side * half, z) for side in (-1.0, 1.0))
    raised = np.stack([0.0 * height, 0.0 * height, height], axis=-1)
    # Right side, top and left side, each seen from outside.
    for lower, upper in ((low, low + raised), (low + raised, high + raised), (high + raised, high)):
        yield surface(np.stack([lower, upper]))


def stripes(
    corners: FloatArray, width: float = np.inf, gap: float = 0.0, depth: float = np.inf
) -> Shape:
    """Paint over a rectangle (n, 3): stripes in a row along its longer side.

    Args:
      corners: of the rectangle.
      width: of a stripe, along the longer side [m].
      gap: to the next stripe [m].
      depth: of a stripe, along the shorter side, at most [m].
    """
    edges = np.roll(corners, -1, axis=0)[:, :2] - corners[:, :2]
    length = np.hypot(edges[:, 0], edges[:, 1])
    along = edges[int(np.argmax(length))] / max(float(length.max()), 1e-9)
    across = np.array([-along[1], along[0]])
    middle = corners.mean(axis=0)
    u, v = (corners - middle)[:, :2] @ along, (corners - middle)[:, :2] @ across
    # Height of the plane through the corners.
    plane = np.linalg.lstsq(np.column_stack([u, v, np.ones(len(u))]), corners[:, 2], rcond=None)[0]
    width = min(width, float(np.ptp(u)))
    count = int((np.ptp(u) - width) / (width + gap) + 1e-6) + 1 if width > 0.0 else 1
    first = u.min() + 0.5 * (np.ptp(u) - count * width - (count - 1) * gap)
    half = 0.5 * min(depth, float(np.ptp(v)))
    center = 0.5 * (v.min() + v.max())
    parts = []
    for k in range(min(count, COPIES_MAX)):
        a = first + k * (width + gap)
        row = [(a, center + half), (a, center - half)]
        grid = np.array([row, [(a + width, y) for _, y in row]])
        place = middle[:2] + grid[..., :1] * along + grid[..., 1:] * across
        height = grid @ plane[:2] + plane[2] + MARKING_LIFT + 0.005
        parts.append(surface(np.concatenate([place, height[..., None]], axis=-1)))
    return merge(parts)


def _signal(
    site: Site, signal: Signal, station: float | None = None
) -> Iterator[tuple[str, Shape]]:
    heading = site.heading(signal.s)
    is_paint = signal.height < 0.1 and signal.z_offset < 0.5 and not signal.dynamic
    if is_paint and signal.kind in (CROSSING, STOP_LINE):
        width = max(signal.width, 1.0)
        t, length = signal.t, LINE_WIDTH
        if signal.kind == CROSSING:
            length = signal.value or 3.0
            # Maps give the width of the whole road about its center line.
            right, left = site.street.paved_edges(np.array([signal.s]))
            low, high = max(t - 0.5 * width, right[0]), min(t + 0.5 * width, left[0])
            if high - low > STRIPE:
                t, width = 0.5 * (low + high), high - low
        elif abs(t) < 0.5:
            # Some maps give the line's inner end instead of its middle.
            t += 0.5 * width * (1.0 if signal.orientation == "-" else -1.0)
        u, v = 0.5 * length * np.array([1, 1, -1, -1]), 0.5 * width * np.array([-1, 1, 1, -1])
        corners = site.points(signal.s + u, t + v)
        stripe = (STRIPE, GAP) if signal.kind == CROSSING else (np.inf, 0.0)
        yield "road_marking", stripes(corners, *stripe)
        return
    if is_paint:
        return
    right, left = site.street.paved_edges(np.array([signal.s]))
    foot = signal.t
    if float(right[0]) < foot < float(left[0]):
        gap_left, gap_right = float(left[0]) - foot, foot - float(right[0])
        foot = float(left[0]) + 0.6 if gap_left < gap_right else float(right[0]) - 0.6
    base, head = site.points(np.full(2, signal.s), np.array([foot, signal.t]))
    yield from sign(signal, base, head, heading, station)
