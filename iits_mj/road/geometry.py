"""Exact evaluation of OpenDRIVE plan-view geometry: line, arc, spiral, poly3, paramPoly3.

Every record gives position, heading, curvature and the speed |dP/ds| at distances ds from its
start. Arrays have the shape of `ds`. Lengths in meters, angles in radians, curvature positive to
the left. Records extrapolate naturally beyond both ends, which bridges small gaps of a map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_UNIT_NODES = 0.5 * (_NODES + 1.0)
_UNIT_WEIGHTS = 0.5 * _WEIGHTS


class PlanarPoint(NamedTuple):
    """Points of a curve in the plane; `speed` is |dP/ds|, 1 where s is the arc length."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    curvature: FloatArray
    speed: FloatArray


@dataclass(frozen=True)
class Geometry:
    """One record of the plan view; a straight line unless a subclass says otherwise."""

    s: float
    x: float
    y: float
    heading: float
    length: float

    def local(self, ds: FloatArray) -> PlanarPoint:
        """Curve in the record's own frame: it starts at the origin along the u axis."""
        zero = np.zeros_like(ds)
        return PlanarPoint(ds, zero, zero, zero, zero + 1.0)

    def evaluate(self, ds: ArrayLike) -> PlanarPoint:
        """Curve in the map frame at distances `ds` from the record's start."""
        u, v, heading, curvature, speed = self.local(np.asarray(ds, dtype=float))
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        return PlanarPoint(
            self.x + cosine * u - sine * v,
            self.y + sine * u + cosine * v,
            self.heading + heading,
            curvature,
            speed,
        )


class Line(Geometry):
    """A straight line (OpenDRIVE 1.6, 7.3)."""


@dataclass(frozen=True)
class Arc(Geometry):
    """An arc of constant curvature (OpenDRIVE 1.6, 7.5)."""

    curvature: float

    def local(self, ds: FloatArray) -> PlanarPoint:
        """Circle, written with sinc so that a curvature of zero is no special case."""
        turn = self.curvature * ds
        chord = ds * np.sinc(turn / (2.0 * np.pi))
        return PlanarPoint(
            chord * np.cos(0.5 * turn),
            chord * np.sin(0.5 * turn),
            turn,
            np.full_like(ds, self.curvature),
            np.ones_like(ds),
        )


@dataclass(frozen=True)
class Spiral(Geometry):
    """A clothoid: curvature linear in s (OpenDRIVE 1.6, 7.4)."""

    curvature_start: float
    curvature_end: float

    def local(self, ds: FloatArray) -> PlanarPoint:
        """Integral of the unit tangent by Gauss-Legendre quadrature.

        32 nodes for every 3 rad of turning leave an error below 1e-12 of the length, with no
        special case for nearly circular spirals (where Fresnel integrals lose their digits).
        """
        rate = (self.curvature_end - self.curvature_start) / self.length
        largest = np.max(np.abs(ds), initial=0.0)
        bend = max(abs(self.curvature_start), abs(self.curvature_start + rate * largest))
        pieces = max(1, math.ceil(bend * largest / 3.0))
        shape = ds.shape
        flat = ds.reshape(-1)
        fraction = ((np.arange(pieces)[:, None] + _UNIT_NODES) / pieces).reshape(-1)
        weight = np.tile(_UNIT_WEIGHTS / pieces, pieces)
        u, v = np.empty_like(flat), np.empty_like(flat)
        # In blocks, so that a long list of points does not need a huge matrix.
        for first in range(0, flat.size, 4096):
            block = flat[first : first + 4096]
            along = np.multiply.outer(block, fraction)
            angle = along * (self.curvature_start + 0.5 * rate * along)
            u[first : first + 4096] = block * (np.cos(angle) @ weight)
            v[first : first + 4096] = block * (np.sin(angle) @ weight)
        return PlanarPoint(
            u.reshape(shape),
            v.reshape(shape),
            ds * (self.curvature_start + 0.5 * rate * ds),
            self.curvature_start + rate * ds,
            np.ones_like(ds),
        )


@dataclass(frozen=True)
class ParamPoly3(Geometry):
    """Parametric cubic u(p), v(p) (OpenDRIVE 1.6, 7.7).

    With `pRange="arcLength"` p is the distance itself. With `normalized` p runs from 0 to 1 and
    is found so that distance grows evenly with true arc length.
    """

    u_coefficients: tuple[float, float, float, float]
    v_coefficients: tuple[float, float, float, float]
    normalized: bool = False

    def _derivatives(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        _, bu, cu, du = self.u_coefficients
        _, bv, cv, dv = self.v_coefficients
        return (
            bu + p * (2.0 * cu + 3.0 * du * p),
            bv + p * (2.0 * cv + 3.0 * dv * p),
            2.0 * cu + 6.0 * du * p,
            2.0 * cv + 6.0 * dv * p,
        )

    def _norm(self, p: FloatArray) -> FloatArray:
        first_u, first_v, _, _ = self._derivatives(p)
        return np.hypot(first_u, first_v)

    @cached_property
    def _arc_length(self) -> tuple[FloatArray, FloatArray]:
        """Table of p and the arc length up to p, (n,) each."""
        p = np.linspace(0.0, 1.0 if self.normalized else self.length, 257)
        width = np.diff(p)[:, None]
        pieces = (self._norm(p[:-1, None] + width * _UNIT_NODES) * _UNIT_WEIGHTS).sum(axis=1)
        return p, np.concatenate(([0.0], np.cumsum(pieces * width[:, 0])))

    @property
    def curve_length(self) -> float:
        """Length of the cubic itself [m], which `length` should be."""
        return float(self._arc_length[1][-1])

    def _parameter(self, ds: FloatArray) -> FloatArray:
        """P at distances ds."""
        if not self.normalized:
            return ds
        table, arc = self._arc_length
        wanted = ds * (arc[-1] / self.length)
        index = np.clip(np.searchsorted(arc, wanted, side="right") - 1, 0, table.size - 2)
        p = table[index] + (wanted - arc[index]) / np.maximum(self._norm(table[index]), 1e-12)
        # Newton on arc(p) = wanted; the integral from the table's node is short and smooth.
        for _ in range(3):
            width = p - table[index]
            points = table[index][..., None] + width[..., None] * _UNIT_NODES
            length = arc[index] + width * (self._norm(points) @ _UNIT_WEIGHTS)
            p = p + (wanted - length) / np.maximum(self._norm(p), 1e-12)
        return p

    def local(self, ds: FloatArray) -> PlanarPoint:
        """The cubic, its direction, curvature and speed."""
        p = self._parameter(ds)
        au, bu, cu, du = self.u_coefficients
        av, bv, cv, dv = self.v_coefficients
        first_u, first_v, second_u, second_v = self._derivatives(p)
        norm = np.maximum(np.hypot(first_u, first_v), 1e-12)
        speed = norm
        if self.normalized:
            speed = np.full_like(norm, self._arc_length[1][-1] / self.length)
        return PlanarPoint(
            au + p * (bu + p * (cu + p * du)),
            av + p * (bv + p * (cv + p * dv)),
            np.arctan2(first_v, first_u),
            (first_u * second_v - first_v * second_u) / norm**3,
            speed,
        )


@dataclass(frozen=True)
class Poly3(Geometry):
    """Cubic v(u) in local axes (OpenDRIVE 1.4, 5.3.4.4): s is the arc length along it."""

    coefficients: tuple[float, float, float, float]

    @cached_property
    def _normalized(self) -> ParamPoly3:
        """The curve over p from 0 to 1, which ends at the u whose arc length is `length`."""
        along = (0.0, 1.0, 0.0, 0.0)
        extent = self.length
        for _ in range(50):
            curve = ParamPoly3(0.0, 0.0, 0.0, 0.0, extent, along, self.coefficients)
            error = self.length - float(curve._arc_length[1][-1])
            if abs(error) < 1e-12 * max(1.0, self.length):
                break
            extent += error / float(curve._norm(np.array(extent)))
        a, b, c, d = self.coefficients
        scaled = (a, b * extent, c * extent**2, d * extent**3)
        return ParamPoly3(
            0.0, 0.0, 0.0, 0.0, self.length, (0.0, extent, 0.0, 0.0), scaled, normalized=True
        )

    def local(self, ds: FloatArray) -> PlanarPoint:
        """The cubic by arc length."""
        return self._normalized.local(ds)


class PlanJump(NamedTuple):
    """A break of the plan view: where, and the step of position and heading."""

    s: float
    dx: float
    dy: float
    heading: float


class PlanView:
    """The records of a road's reference line, in order of s."""

    def __init__(self, records: tuple[Geometry, ...]) -> None:
        self.records = tuple(sorted(records, key=lambda record: record.s))
        self.starts: FloatArray = np.array([record.s for record in self.records])

    def evaluate(self, s: ArrayLike, side: int = 1) -> PlanarPoint:
        """Points at road coordinates `s`, any shape; beyond the ends the outer records extend.

        Where two records meet, the one after (`side` = 1) or before (-1) is taken.
        """
        s = np.asarray(s, dtype=float)
        flat = s.reshape(-1)
        order: Literal["left", "right"] = "right" if side > 0 else "left"
        index = np.maximum(np.searchsorted(self.starts, flat, side=order) - 1, 0)
        result = np.empty((5, flat.size))
        for i in np.unique(index):
            chosen = index == i
            result[:, chosen] = self.records[i].evaluate(flat[chosen] - self.records[i].s)
        return PlanarPoint(*(row.reshape(s.shape) for row in result))

    def jumps(self) -> list[PlanJump]:
        """Steps of position and heading between neighboring records."""
        steps = []
        for before, after in zip(self.records, self.records[1:], strict=False):
            end = before.evaluate(after.s - before.s)
            start = after.evaluate(0.0)
            turn = wrap_angle(float(start.heading) - float(end.heading))
            steps.append(PlanJump(after.s, float(start.x - end.x), float(start.y - end.y), turn))
        return steps
