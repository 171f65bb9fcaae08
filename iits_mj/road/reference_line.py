"""Reference line of a route as dense knots, for fast evaluation and projection.

Knots are exact (see `seams`) and uniform in station, which is the horizontal arc length. Between
them x, y, z and superelevation are cubic Hermite polynomials, so position and height are C1, and
heading and grade continuous; at 0.5 m spacing they lie within 3 um of the exact curve on roads, and
within 0.4 mm beside a step of curvature in a town's corner.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.errors import InputError
from iits_mj.road.seams import ContinuousChain, X, Y

KNOT_SPACING = 0.5
ARC_TOLERANCE = 2e-4
_COARSE_SPACING = 5.0
_LOST = 50.0
_TURN = 2.0 * math.pi
# Rows of the knots: x, y, z and superelevation, their slopes over station, linear quantities.
_VALUES, _SLOPES = slice(0, 4), slice(4, 8)
_CURVATURE, _HEADING, _P = 8, 9, 10
_ROWS = 11
# Numbers of leading rows: those of the plane, and all polynomials.
_PLANE, _ALL = 2, 4
# Number of pieces that are cached as polynomials, far more than a truck covers.
_PIECES_KEPT = 4096

# Coefficients of powers 0 to 3 of the way through a piece, from 0 to 1.
Coefficients = tuple[float, float, float, float]
# Of x, y, z and superelevation; heading and curvature at the piece's start, the curvature's change.
KnotPiece = tuple[Coefficients, Coefficients, Coefficients, Coefficients, float, float, float]


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
        self._last = p.size - 2
        self._pieces: dict[int, KnotPiece] = {}
        stride = max(int(_COARSE_SPACING / self.spacing), 1)
        self._coarse_index = np.unique(np.append(np.arange(0, p.size, stride), p.size - 1))
        self._coarse = np.ascontiguousarray(knots[:2, self._coarse_index])

    def parameter(self, station: ArrayLike) -> FloatArray:
        """Chain parameter p at stations."""
        station = np.asarray(station, dtype=float)
        if self._p_is_station:
            return station
        inside = np.clip(station, 0.0, self.length)
        grid = np.arange(self._knots.shape[1]) * self.spacing
        return np.interp(inside, grid, self._knots[_P]) + (station - inside)

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
        return np.interp(p, self._knots[_P], np.arange(self._knots.shape[1]) * self.spacing)

    def evaluate(self, station: ArrayLike, offset: ArrayLike = 0.0) -> RoadPoint:
        """Road points; shapes of station and offset are broadcast. Ends extend along tangents."""
        if isinstance(station, (float, int)) and isinstance(offset, (float, int)):
            return RoadPoint._make(self._evaluate_scalar(float(station), float(offset)))
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
        piece, t, beyond = self._at(station)
        z, grade = _hermite(piece[2], t, self.spacing)
        return z + beyond * grade

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

    def _at(self, station: float) -> tuple[KnotPiece, float, float]:
        """The piece at a station, the way through it from 0 to 1, and how far beyond an end [m]."""
        inside = station
        if not 0.0 <= station <= self.length:
            inside = min(max(station, 0.0), self.length)
        position = inside / self.spacing
        i = min(int(position), self._last)
        piece = self._pieces.get(i)
        if piece is None:
            piece = self._piece(i)
        return piece, position - i, station - inside

    def _piece(self, i: int) -> KnotPiece:
        """Returns the polynomials between knot i and the next one, and caches them."""
        if len(self._pieces) >= _PIECES_KEPT:
            self._pieces.clear()
        h, pairs = self.spacing, self._knots[:, i : i + 2].tolist()
        x, y, z, roll = map(_cubic, pairs[_VALUES], pairs[_SLOPES], (h, h, h, h))
        curvature, following = pairs[_CURVATURE]
        piece = x, y, z, roll, pairs[_HEADING][0], curvature, following - curvature
        self._pieces[i] = piece
        return piece

    def _place(
        self, piece: KnotPiece, t: float, beyond: float, offset: float
    ) -> tuple[float, float, float, float, float, float]:
        """x, y [m], heading [rad], its sine and cosine, and curvature [1/m]."""
        h = self.spacing
        x, dx = _hermite(piece[0], t, h)
        y, dy = _hermite(piece[1], t, h)
        heading = math.atan2(dy, dx)
        heading -= _TURN * round((heading - piece[4]) / _TURN)
        sine, cosine = math.sin(heading), math.cos(heading)
        return (
            x + beyond * cosine - offset * sine,
            y + beyond * sine + offset * cosine,
            heading,
            sine,
            cosine,
            piece[5] + t * piece[6] if beyond == 0.0 else 0.0,
        )

    def _evaluate_scalar(self, station: float, offset: float) -> tuple[float, ...]:
        piece, t, beyond = self._at(station)
        x, y, heading, _, _, curvature = self._place(piece, t, beyond, offset)
        z, grade = _hermite(piece[2], t, self.spacing)
        roll, _ = _hermite(piece[3], t, self.spacing)
        z = z + beyond * grade + offset * math.tan(roll)
        return x, y, z, heading, curvature, grade, roll

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
        for _ in range(12):
            foot_x, foot_y, _, sine, cosine, curvature = self._place(*self._at(station), 0.0)
            dx, dy = x - foot_x, y - foot_y
            along = dx * cosine + dy * sine
            offset = dy * cosine - dx * sine
            # d(along)/d(station) = -(1 - curvature * offset)
            step = along / max(1.0 - curvature * offset, 0.2)
            station += min(max(step, -_LOST), _LOST)
            if abs(step) < 1e-7:
                return float(station), float(offset)
        return None

    def _scan(self, x: float, y: float, station: float) -> tuple[float, float]:
        """The best of a fine grid, for points at the center of a bend where Newton circles."""
        grid = station + np.linspace(-10.0, 10.0, 2001)
        point = self.evaluate(grid)
        best = int(np.argmin(np.hypot(point.x - x, point.y - y)))
        heading = point.heading[best]
        dx, dy = x - point.x[best], y - point.y[best]
        offset = dy * math.cos(heading) - dx * math.sin(heading)
        return float(grid[best]), float(offset)


def _cubic(values: tuple[float, float], slopes: tuple[float, float], h: float) -> Coefficients:
    """Hermite polynomial between two knots `h` meters apart."""
    a, rise = values[0], values[1] - values[0]
    u, v = h * slopes[0], h * slopes[1]
    return a, u, 3.0 * rise - 2.0 * u - v, u + v - 2.0 * rise


def _hermite(cubic: Coefficients, t: float, h: float) -> tuple[float, float]:
    """Value and slope over station at the way t through a piece of `h` meters."""
    a, u, c, d = cubic
    return a + t * (u + t * (c + t * d)), (u + t * (2.0 * c + 3.0 * t * d)) / h
