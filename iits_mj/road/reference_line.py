"""Reference line of a route as dense knots, for fast evaluation and projection.

Knots are exact (see `seams`) and uniform in station, which is the horizontal arc length. Between
them x, y, z and superelevation are cubic Hermite polynomials, so position and height are C1, and
heading and grade continuous; at 0.5 m spacing they lie within 3 um of the exact curve on roads, and
within 0.4 mm beside a step of curvature in a town's corner.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.errors import InputError
from iits_mj.kernels import Address, Integer, Real
from iits_mj.road.seams import ContinuousChain, X, Y

KNOT_SPACING = 0.5
ARC_TOLERANCE = 2e-4
_COARSE_SPACING = 5.0
_LOST = 50.0
_SCAN = 10.0  # [m] on each side
_TURN = 2.0 * math.pi
# Rows of the knots: x, y, z and superelevation, their slopes over station, linear quantities.
_VALUES, _ROLL, _SLOPES = slice(0, 4), 3, slice(4, 8)
_CURVATURE, _HEADING, _P = 8, 9, 10
_ROWS = 11
# Numbers of leading rows: those of the plane, and all polynomials.
_PLANE, _ALL = 2, 4

# Look-ups at single places: table, then station and offset, or x, y and a station nearby.
_evaluate = kernels.function("iits_line_evaluate", None, Address, Real, Real, Address)
_height = kernels.function("iits_line_height", Real, Address, Real)
_mean_grade = kernels.function("iits_line_mean_grade", Real, Address, Real, Real)
_locate = kernels.function("iits_line_locate", Integer, Address, Real, Real, Real, Address)
_Point = Real * 7
_Place = Real * 2


class RoadPoint(NamedTuple):
    """Points on the road surface; floats where station and offset are scalars, else arrays.

    Attributes:
      x, y, z: map frame [m].
      heading: of travel along the reference line [rad]; continuous along a route, so it may leave
        (-pi, pi]: wrap differences, not values.
      curvature: of the reference line [1/m], positive to the left.
      grade: dz/ds of the reference line.
      superelevation: roll angle of the surface [rad], positive where the left side is higher.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    heading: FloatArray
    curvature: FloatArray
    grade: FloatArray
    superelevation: FloatArray


class ReferenceLine:
    """Knots of a continuous chain of roads."""

    def __init__(self, chain: ContinuousChain, spacing: float = KNOT_SPACING) -> None:
        """Samples the chain at knots about `spacing` meters apart."""
        p = np.linspace(0.0, chain.length, max(math.ceil(chain.length / spacing), 1) + 1)
        state = chain.state(p)
        speed = np.hypot(state[1, X], state[1, Y])
        self.length = chain.length
        if np.max(np.abs(speed - 1.0)) > ARC_TOLERANCE:
            # Station is arc length: where p is not, resample at even steps of the integral.
            fine = np.linspace(0.0, chain.length, 10 * (p.size - 1) + 1)
            fine = np.union1d(fine, chain.breaks())
            fine_speed = np.hypot(*chain.state(fine)[1, [X, Y]])
            pieces = 0.5 * np.diff(fine) * (fine_speed[:-1] + fine_speed[1:])
            arc = np.concatenate(([0.0], np.cumsum(pieces)))
            self.length = float(arc[-1])
            p = np.interp(np.linspace(0.0, self.length, p.size), arc, fine)
            state = chain.state(p)
            speed = np.hypot(state[1, X], state[1, Y])
            self._p_is_station = False
        else:
            self._p_is_station = True
        self.spacing = self.length / (p.size - 1)
        knots = np.empty((_ROWS, p.size))
        knots[_VALUES] = state[0]
        knots[_SLOPES] = state[1] / speed
        cross = state[1, X] * state[2, Y] - state[1, Y] * state[2, X]
        knots[_CURVATURE] = cross / speed**3
        knots[_HEADING] = np.unwrap(np.arctan2(state[1, Y], state[1, X]))
        knots[_P] = p
        self._knots = knots
        self._grid = np.arange(p.size) * self.spacing
        self._last = p.size - 2
        stride = max(int(_COARSE_SPACING / self.spacing), 1)
        self._coarse_index = np.unique(np.append(np.arange(0, p.size, stride), p.size - 1))
        self._coarse = np.ascontiguousarray(knots[:2, self._coarse_index])
        self._make_table()

    def _make_table(self) -> None:
        """Writes the knots for the look-ups at single places."""
        table = np.zeros((self._knots.shape[1] + 1, _ROWS))
        table[0, :3] = self.length, self.spacing, self._last
        table[1:] = self._knots.T
        self.table = kernels.Table(table)

    @property
    def superelevations(self) -> FloatArray:
        """Superelevation of each knot [rad]."""
        return self._knots[_ROLL]

    def leaning(self, slope: float) -> ReferenceLine:
        """Returns the line with a superelevation [rad] in addition to its own."""
        other = copy.copy(self)
        other._knots = self._knots.copy()
        other._knots[_ROLL] += slope
        other._make_table()
        return other

    def parameter(self, station: ArrayLike) -> FloatArray:
        """Chain parameter p at stations."""
        station = np.asarray(station, dtype=float)
        if self._p_is_station:
            return station
        inside = np.clip(station, 0.0, self.length)
        return np.interp(inside, self._grid, self._knots[_P]) + (station - inside)

    def parameter_at(self, station: float) -> float:
        """Chain parameter at one station; the fast form of `parameter`."""
        if self._p_is_station:
            return station
        if not 0.0 < station < self.length:
            end = float(self._knots[_P, 0 if station <= 0.0 else -1])
            return end + (min(station, 0.0) + max(station - self.length, 0.0))
        i = min(int(station / self.spacing), self._last)
        low, high = self._knots[_P, i : i + 2].tolist()
        return float(low + (station / self.spacing - i) * (high - low))

    def station(self, p: ArrayLike) -> FloatArray:
        """Station at chain parameters p within the chain."""
        p = np.asarray(p, dtype=float)
        if self._p_is_station:
            return p
        return np.interp(p, self._knots[_P], self._grid)

    def evaluate(self, station: ArrayLike, offset: ArrayLike = 0.0) -> RoadPoint:
        """Road points; shapes of station and offset are broadcast. Ends extend along tangents."""
        if isinstance(station, (float, int)) and isinstance(offset, (float, int)):
            point = _Point()
            _evaluate(self.table.address, station, offset, point)
            return RoadPoint._make(point[:])
        station, offset = np.asarray(station, dtype=float), np.asarray(offset, dtype=float)
        if station.shape != offset.shape:
            station, offset = np.broadcast_arrays(station, offset)
        i, t, beyond = self._pieces_at(station)
        knot, following = self._knots.take(i, axis=1), self._knots.take(i + 1, axis=1)
        (x, y, z, roll), slopes = self._polynomials(knot, following, _ALL, t)
        heading = self._heading(slopes, knot)
        grade = slopes[2]
        curvature = knot[_CURVATURE] + t * (following[_CURVATURE] - knot[_CURVATURE])
        curvature = np.where(beyond == 0.0, curvature, 0.0)
        sine, cosine = np.sin(heading), np.cos(heading)
        return RoadPoint(
            x + beyond * cosine - offset * sine,
            y + beyond * sine + offset * cosine,
            z + beyond * grade + offset * np.tan(roll),
            heading,
            curvature,
            grade,
            roll,
        )

    def heading(self, station: FloatArray) -> FloatArray:
        """Headings of travel [rad]; the fast form of `evaluate(station).heading`."""
        i, t, _ = self._pieces_at(station)
        knot, following = self._knots.take(i, axis=1), self._knots.take(i + 1, axis=1)
        return self._heading(self._polynomials(knot, following, _PLANE, t)[1], knot)

    def height(self, station: float) -> float:
        """Height of the line at one station [m]; the fast form of `evaluate(station).z`."""
        return float(_height(self.table.address, station))

    def mean_grade(self, station: float, window: float) -> float:
        """Mean grade over a window [m] about one station."""
        return float(_mean_grade(self.table.address, station, window))

    def _pieces_at(self, station: FloatArray) -> tuple[IndexArray, FloatArray, FloatArray]:
        """Pieces at stations, the ways through them from 0 to 1, how far beyond an end [m]."""
        inside = np.minimum(np.maximum(station, 0.0), self.length)
        position = inside / self.spacing
        i = np.minimum(position.astype(np.intp), self._last)
        return i, position - i, station - inside

    def _polynomials(
        self, knot: FloatArray, following: FloatArray, rows: int, t: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Values of the first rows between knots, and their slopes over station."""
        h = self.spacing
        slopes = slice(_SLOPES.start, _SLOPES.start + rows)
        a, u, v = knot[:rows], h * knot[slopes], h * following[slopes]
        rise = following[:rows] - a
        c, d = 3.0 * rise - 2.0 * u - v, u + v - 2.0 * rise
        return a + t * (u + t * (c + t * d)), (u + t * (2.0 * c + 3.0 * t * d)) / h

    @staticmethod
    def _heading(slopes: FloatArray, knot: FloatArray) -> FloatArray:
        """Headings on the same turn as those of the knots before them [rad]."""
        angle = np.arctan2(slopes[1], slopes[0])
        turns = np.round((angle - knot[_HEADING]) / _TURN)
        return np.asarray(angle - _TURN * turns)

    def locate(self, x: float, y: float, near_station: float | None = None) -> tuple[float, float]:
        """Station and offset of a point of the map; the inverse of `evaluate` in the plane.

        `near_station` (within some tens of meters) speeds the search up and resolves crossings.
        Without it, or when the point is far from it, the whole line is searched. Beyond the ends
        the line extends along its tangents.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InputError(f"a point of the map must be finite, not ({x}, {y})")
        if near_station is not None:
            found = self._newton(x, y, near_station)
            if found is None and math.isfinite(near_station):
                # At the center of a bend; elsewhere on a line that passes twice lies another place.
                found = self._scan(x, y, near_station)
                if abs(found[0] - near_station) >= _SCAN:
                    found = None
            if found is not None and abs(found[1]) < _LOST:
                return found
        distance = np.square(self._coarse[0] - x) + np.square(self._coarse[1] - y)
        nearest = float(self._coarse_index[int(np.argmin(distance))]) * self.spacing
        best = self._newton(x, y, nearest)
        if near_station is not None and found is not None:
            best = found if best is None or abs(found[1]) <= abs(best[1]) else best
        return self._scan(x, y, nearest) if best is None else best

    def _newton(self, x: float, y: float, station: float) -> tuple[float, float] | None:
        """Foot of the perpendicular by Newton's method; None when it does not settle."""
        place = _Place()
        if _locate(self.table.address, x, y, station, place):
            return place[0], place[1]
        return None

    def _scan(self, x: float, y: float, station: float) -> tuple[float, float]:
        """The best of a fine grid, for points at the center of a bend where Newton circles."""
        grid = station + np.linspace(-_SCAN, _SCAN, 2001)
        point = self.evaluate(grid)
        best = int(np.argmin(np.hypot(point.x - x, point.y - y)))
        heading = point.heading[best]
        dx, dy = x - point.x[best], y - point.y[best]
        offset = dy * math.cos(heading) - dx * math.sin(heading)
        return float(grid[best]), float(offset)
