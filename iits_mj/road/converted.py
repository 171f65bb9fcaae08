"""Makes roads that netconvert writes fit for a truck: curves of arcs, and smooth heights.

netconvert describes every bend by one cubic, whose curvature peaks at several times that of an arc
between the same tangents, and every height by straight lines between its nodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.road.elements import Lane, OpenDriveMap, Road
from iits_mj.road.geometry import Arc, Geometry, Line, ParamPoly3
from iits_mj.road.measured import height_profile
from iits_mj.road.polynomials import Cubic
from iits_mj.road.terrain import Terrain

HEIGHT_SPACING = 20.0  # [m] between samples of a terrain along a road, at most
LEAST_TURN = 1e-3  # [rad]; a cubic that turns by less stays
LARGEST_TURN = 2.8  # [rad]; beyond it the tangents meet too far away
SHORTEST_LINE = 0.01  # [m]


def with_arcs(content: OpenDriveMap) -> OpenDriveMap:
    """Returns the map with each cubic bend as the largest arc between its tangents.

    The ends of the roads and their directions there stay. Lane widths, heights and signals keep
    their places relative to the road's length.
    """
    return replace(content, roads=tuple(map(_with_arcs, content.roads)))


def with_terrain(content: OpenDriveMap, terrain: Terrain) -> OpenDriveMap:
    """Returns the map with the heights of a terrain, as natural cubic splines along each road.

    Args:
      content: the map.
      terrain: gives heights at x and y [m], shape (n,) each.

    Raises:
      InputError: a road would be too steep.
    """
    roads = []
    for road in content.roads:
        count = max(math.ceil(road.length / HEIGHT_SPACING), 2) + 1
        s = np.linspace(0.0, road.length, count)
        point = road.plan.evaluate(s)
        try:
            elevations = height_profile(s, terrain(point.x, point.y))
        except InputError as error:
            raise InputError(f"road {road.id!r}: {error}") from error
        roads.append(replace(road, elevations=elevations))
    return replace(content, roads=tuple(roads))


def _with_arcs(road: Road) -> Road:
    old, new, geometries = [0.0], [0.0], []
    for geometry in road.geometries:
        pieces = list(_pieces(geometry))
        for piece in pieces:
            geometries.append(replace(piece, s=new[-1] + piece.s))
        old.append(geometry.s + geometry.length)
        new.append(new[-1] + math.fsum(piece.length for piece in pieces))
    length = new[-1]
    scale = road.length / length

    def moved(s: float) -> float:
        return float(np.interp(s, old, new))

    heights = [float(road.elevation.evaluate(s, side=-1)) for s in old]
    return replace(
        road,
        length=length,
        geometries=tuple(geometries),
        elevations=_smooth(np.array(new), np.array(heights)),
        sections=tuple(
            replace(
                section,
                s=moved(section.s),
                lanes=tuple(_stretched(lane, scale) for lane in section.lanes),
            )
            for section in road.sections
        ),
        types=tuple(replace(record, s=moved(record.s)) for record in road.types),
        signals=tuple(replace(signal, s=moved(signal.s)) for signal in road.signals),
    )


def _pieces(geometry: Geometry) -> Iterator[Geometry]:
    """A line, an arc and a line in place of a cubic, with s from its start; else the record."""
    start, end = geometry.evaluate(0.0), geometry.evaluate(geometry.length)
    turn = wrap_angle(float(end.heading - start.heading))
    plain = replace(geometry, s=0.0)
    if not isinstance(geometry, ParamPoly3) or not LEAST_TURN < abs(turn) < LARGEST_TURN:
        yield plain
        return
    x, y, heading = float(start.x), float(start.y), float(start.heading)
    dx, dy = float(end.x) - x, float(end.y) - y
    along = dx * math.cos(heading) + dy * math.sin(heading)
    aside = dy * math.cos(heading) - dx * math.sin(heading)
    # Distances from the start and to the end of the point where the tangents meet.
    after = aside / math.sin(turn)
    before = along - after * math.cos(turn)
    tangent = min(before, after)
    if tangent <= SHORTEST_LINE:
        yield plain
        return
    radius = tangent / math.tan(0.5 * turn)
    s = 0.0
    for length, curvature in (
        (before - tangent, 0.0),
        (abs(radius * turn), 1.0 / radius),
        (after - tangent, 0.0),
    ):
        if length <= SHORTEST_LINE:
            continue
        place = (s, x, y, heading, length)
        piece: Geometry = Arc(*place, curvature) if curvature else Line(*place)
        yield piece
        point = piece.evaluate(length)
        x, y, heading = float(point.x), float(point.y), float(point.heading)
        s += length


def _stretched(lane: Lane, scale: float) -> Lane:
    """The lane of a road whose length is divided by `scale`."""
    widths = tuple(
        Cubic(r.start / scale, r.a, r.b * scale, r.c * scale**2, r.d * scale**3)
        for r in lane.widths
    )
    return replace(lane, widths=widths)


def _smooth(s: FloatArray, z: FloatArray) -> tuple[Cubic, ...]:
    """Records through heights without overshoot: monotone cubics (Fritsch and Carlson)."""
    if np.ptp(z) < 1e-3:
        return (Cubic(0.0, float(z[0])),)
    from scipy.interpolate import PchipInterpolator

    d, c, b, a = PchipInterpolator(s, z).c
    return tuple(Cubic(*map(float, row)) for row in zip(s[:-1], a, b, c, d, strict=True))
