"""Samples a route for drawing: stations dense in bends, points across the road, lane markings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.streets import Street
from iits_mj.model.visuals.shapes import Shape, merge, surface
from iits_mj.road import Route

RUN_OUT = 400.0  # [m] drawn beyond an end of the route that leads away from it
CHORD_ERROR = 0.02  # [m] in plan
SAG_ERROR = 0.003  # [m] in height
STEP_MAX = 25.0  # [m], of a straight road; longer on routes beyond 30 km


@dataclass(frozen=True)
class Corridor:
    """A route or street at drawing stations (n,): reference point, heading, tilt and edges."""

    route: Route | Street
    station: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    heading: FloatArray
    tilt: FloatArray
    curvature: FloatArray
    right: FloatArray
    left: FloatArray

    @classmethod
    def sample(cls, route: Route | Street, stations: FloatArray | None = None) -> Corridor:
        """Samples a line, by default at stations that keep the chord errors above."""
        station = drawing_stations(route) if stations is None else stations
        point = route.evaluate(station)
        right, left = route.surface_edges(station)
        x, y, z, heading, curvature, _, superelevation = point
        tilt = np.tan(superelevation)
        return cls(route, station, x, y, z, heading, tilt, curvature, right, left)

    def between(self, start: float, end: float) -> Corridor:
        """Returns the part from `start` to `end`, with samples at exactly both stations."""
        inner = self.station[(self.station > start + 0.01) & (self.station < end - 0.01)]
        return Corridor.sample(self.route, np.concatenate([[start], inner, [end]]))

    def runs(self, kept: NDArray[np.bool_]) -> Iterator[Corridor]:
        """Yields the stretches of two or more neighboring rows that are kept, (n,)."""
        bounds = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
        for first, last in bounds.reshape(-1, 2):
            if last - first > 1:
                rows = (getattr(self, one.name)[first:last] for one in fields(self)[1:])
                yield Corridor(self.route, *rows)

    def edge(self, side: float, beyond: float = 0.0) -> FloatArray:
        """Offset of a place `beyond` [m] the pavement's left (`side` 1) or right (-1) edge."""
        return (self.left if side > 0 else self.right) + side * beyond

    def across(self, offset: ArrayLike, lift: ArrayLike = 0.0) -> FloatArray:
        """Points on the tilted road plane, offsets (n, k) or (n,), raised by `lift` [m]."""
        offset = np.asarray(offset, dtype=float)
        raised = np.asarray(lift, dtype=float)
        shape = (-1, *(1,) * (offset.ndim - 1))
        x, y, z, heading, tilt = (
            value.reshape(shape) for value in (self.x, self.y, self.z, self.heading, self.tilt)
        )
        east, north = x - offset * np.sin(heading), y + offset * np.cos(heading)
        return np.stack([east, north, z + offset * tilt + raised], axis=-1)

    def strip(
        self, left: ArrayLike, right: ArrayLike, lift: float = 0.0, tile: float = 0.0
    ) -> Shape:
        """A ribbon of the road surface between two offsets, facing up; textured when tile > 0."""
        n = len(self.station)
        offsets = np.stack([np.broadcast_to(left, n), np.broadcast_to(right, n)], axis=1)
        points = self.across(offsets, lift)
        texture = None
        if tile > 0:
            origin = np.floor(self.station[0] / tile) * tile
            along = np.broadcast_to((self.station - origin)[:, None], offsets.shape)
            texture = np.stack([offsets / tile, along / tile], axis=-1)
        return surface(points, texture, self.up(2))

    def extrude(self, profile: ArrayLike, base: ArrayLike, *, smooth: bool = False) -> Shape:
        """Sweeps a profile (k, 2) of (offset, height) about the offset `base` along the route.

        Seen in the direction of travel the profile runs clockwise around the solid. A smooth
        profile shares its vertices, one with edges does not.
        """
        points = np.asarray(profile, dtype=float)
        if smooth:
            offsets = np.broadcast_to(base, len(self.station))[:, None] + points[:, 0]
            return surface(self.across(offsets, points[None, :, 1]))
        parts = []
        n = len(self.station)
        base = np.broadcast_to(base, n)[:, None]
        for a, b in pairwise(points):
            pair = np.stack([a, b])
            parts.append(surface(self.across(base + pair[:, 0], pair[:, 1])))
        return merge(parts)

    def up(self, columns: int) -> FloatArray:
        """Upward unit normals of the road plane, (n, columns, 3)."""
        slope = np.gradient(self.z, self.station)
        c, s = np.cos(self.heading), np.sin(self.heading)
        normal = np.stack(
            [-slope * c + self.tilt * s, -slope * s - self.tilt * c, np.ones_like(c)], axis=-1
        )
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return np.repeat(normal[:, None, :], columns, axis=1)


def drawing_stations(route: Route | Street) -> FloatArray:
    """Returns stations from one run-out to the other whose chords stay near the road."""
    inner = inner_stations(route)
    before, after = run_outs(route)
    ahead = np.arange(STEP_MAX, after + 1.0, STEP_MAX)
    behind = np.arange(STEP_MAX, before + 1.0, STEP_MAX)
    return np.concatenate([-behind[::-1], inner, route.length + ahead])


def inner_stations(route: Route | Street) -> FloatArray:
    """Returns stations from the start to the end whose chords stay near the road."""
    step = max(1.0, route.length / 20_000.0)
    longest = STEP_MAX * max(1.0, route.length / 30_000.0)
    fine = np.linspace(0.0, route.length, max(int(route.length / step), 2) + 1)
    point = route.evaluate(fine)
    bend = np.abs(point.curvature)
    twist = np.gradient(point.superelevation, fine)
    # At the pavement's edges, about 10 m off, a changing twist adds to the sag.
    sag = np.abs(np.gradient(point.grade, fine)) + 10.0 * np.abs(np.gradient(twist, fine))
    length = np.minimum.reduce(
        [
            np.full_like(fine, longest),
            np.sqrt(8.0 * CHORD_ERROR / np.maximum(bend, 1e-9)),
            np.sqrt(8.0 * SAG_ERROR / np.maximum(sag, 1e-9)),
            0.02 / np.maximum(np.abs(twist), 1e-9),
        ]
    ).clip(2.0, longest)
    width = np.diff(fine)
    count = np.concatenate([[0.0], np.cumsum(width * 0.5 * (1 / length[1:] + 1 / length[:-1]))])
    return np.interp(np.linspace(0.0, count[-1], int(np.ceil(count[-1])) + 1), count, fine)


def run_outs(route: Route | Street) -> tuple[float, float]:
    """Returns the lengths of the straight run-outs at both ends; 0 where one would meet the road.

    A truck at the start needs road below its trailer; a closed ring needs no run-out.
    """
    station = np.linspace(0.0, route.length, max(int(route.length / 10.0), 2) + 1)
    point = route.evaluate(station)
    out = np.arange(20.0, RUN_OUT + 1.0, 10.0)
    lengths = []
    for tail, keep in (
        (-out, station > 100.0),
        (route.length + out, station < station[-1] - 100.0),
    ):
        end = route.evaluate(tail)
        gap = np.hypot(end.x[:, None] - point.x[keep], end.y[:, None] - point.y[keep])
        lengths.append(0.0 if gap.size and gap.min() < 25.0 else RUN_OUT)
    return lengths[0], lengths[1]


def chunks(corridor: Corridor, length: float) -> Iterator[tuple[float, float]]:
    """Yields intervals of about `length` meters that cover a corridor."""
    start, end = float(corridor.station[0]), float(corridor.station[-1])
    count = max(1, round((end - start) / length))
    edges = np.linspace(start, end, count + 1)
    yield from zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
