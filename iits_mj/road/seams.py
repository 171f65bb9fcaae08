"""Blends the steps between records and roads of a chain into one continuous curve.

Real maps have errors: roads overlap or leave gaps of up to a meter, records start a few millimeters
or milliradians off, elevation records meet with different grades. Here a chain of roads becomes a
curve over one parameter p (meters of road s travelled) that is continuous with its first
derivative in x, y, z and superelevation. At a seam each side takes half of the step of value and
slope, fading out over a window by cubic polynomials; outside windows the curve is exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.errors import MapError
from iits_mj.road.chain import LinkError, Piece

HEIGHT_STEP_LIMIT = 3.0
HEADING_STEP_LIMIT = 0.35
# Windows are long enough that blending adds no more than this curvature [1/m] and grade.
BLEND_CURVATURE = 1e-3
BLEND_GRADE = 0.02
X, Y, Z, ROLL = range(4)


@dataclass(frozen=True)
class Seam:
    """A step in a chain at parameter p, inside a piece at its road s, or (None) after the piece.

    Attributes:
      step: steps of value and of slope over arc length, (2, 4), of x, y, z, roll.
      speeds: arc length per p before and after.
      windows: over which each fades, (4,).
    """

    p: float
    piece: int
    s: float | None
    step: FloatArray
    speeds: tuple[float, float]
    windows: FloatArray


class ContinuousChain:
    """A chain of pieces with its seams blended."""

    def __init__(self, pieces: Sequence[Piece], source: str, roll_scale: float = 1.0) -> None:
        """`roll_scale` multiplies every superelevation; `source` names the map in errors."""
        self.pieces = tuple(pieces)
        self.roll_scale = roll_scale
        self._ends = np.array([piece.p_end for piece in pieces])
        self.seams = tuple(self._find_seams(source))
        self.length = float(self._ends[-1])

    def breaks(self) -> FloatArray:
        """Chain parameters where a record starts or a road ends, each with a place just before."""
        inside = [piece.p_at(s) for piece in self.pieces for s in piece.breaks()]
        places = np.array([*inside, *self._ends[:-1]])
        return np.sort(np.concatenate((places, places - 1e-9)))

    def state(self, p: ArrayLike) -> FloatArray:
        """Blended values and derivatives by p, shape (3, 4, n); see `Piece.state`."""
        p = np.atleast_1d(np.asarray(p, dtype=float))
        index = np.searchsorted(self._ends, p, side="right")
        index = np.minimum(index, len(self.pieces) - 1)
        result = np.empty((3, 4, p.size))
        s = np.empty_like(p)
        for i in np.unique(index):
            chosen = index == i
            piece = self.pieces[i]
            s[chosen] = piece.s_at(p[chosen])
            result[:, :, chosen] = piece.state(s[chosen], piece.direction, self.roll_scale)
        for seam in self.seams:
            self._blend(seam, p, s, index, result)
        return result

    def _blend(
        self, seam: Seam, p: FloatArray, s: FloatArray, index: IndexArray, result: FloatArray
    ) -> None:
        near = np.flatnonzero(np.abs(p - seam.p) < seam.windows.max())
        if near.size == 0:
            return
        after = index[near] > seam.piece
        if seam.s is not None:
            # A record, and so a seam, counts from its start on in either direction of travel.
            beyond = s[near] >= seam.s
            beyond = beyond if self.pieces[seam.piece].direction > 0 else ~beyond
            after |= (index[near] == seam.piece) & beyond
        u = p[near] - seam.p
        half = np.where(after, -0.5, 0.5)
        speed = np.where(after, seam.speeds[1], seam.speeds[0])
        for channel in range(4):
            window = seam.windows[channel]
            tau = np.minimum(np.abs(u) / window, 1.0)
            sign = np.where(after, 1.0, -1.0)
            value, slope = seam.step[0, channel], seam.step[1, channel] * speed
            # Both sides together make one smooth step 3x^2 - 2x^3 of the value over two windows.
            x = 0.5 * (1.0 - tau)
            result[0, channel, near] += half * (
                value * 2.0 * x**2 * (3.0 - 2.0 * x) + slope * u * (1.0 - tau) ** 2
            )
            result[1, channel, near] += half * (
                -6.0 * value * x * (1.0 - x) * sign / window
                + slope * (1.0 - tau) * (1.0 - 3.0 * tau)
            )
            inside = half * (tau < 1.0)
            result[2, channel, near] += inside * (
                value * (3.0 - 6.0 * x) / window**2 + slope * sign * (6.0 * tau - 4.0) / window
            )

    def _find_seams(self, source: str) -> Iterator[Seam]:
        for i, piece in enumerate(self.pieces):
            for s in piece.breaks():
                before = piece.state(s, -1, self.roll_scale)
                after = piece.state(s, 1, self.roll_scale)
                place = f"{source}: road {piece.road.id!r} at s = {s:g}"
                yield from _seam(piece.p_at(s), i, s, before, after, place)
            if i + 1 < len(self.pieces):
                follower = self.pieces[i + 1]
                before = piece.state(piece.s_end, -1, self.roll_scale)
                after = follower.state(follower.s_start, 1, self.roll_scale)
                place = f"{source}: where road {piece.road.id!r} meets {follower.road.id!r}"
                try:
                    yield from _seam(piece.p_end, i, None, before, after, place)
                except MapError as error:
                    nodes = [(each.road.id, each.direction) for each in (piece, follower)]
                    raise LinkError(str(error), (nodes[0], nodes[1])) from error


def _seam(
    p: float, piece: int, s: float | None, before: FloatArray, after: FloatArray, place: str
) -> Iterator[Seam]:
    speeds = tuple(float(np.hypot(*state[1, :2, 0])) for state in (before, after))
    step = np.array([after[0] - before[0], after[1] / speeds[1] - before[1] / speeds[0]])[..., 0]
    if np.all(np.abs(step) < 1e-7):
        return
    if abs(step[0, Z]) > HEIGHT_STEP_LIMIT:
        raise MapError(f"{place}: {height_step(float(step[0, Z]))}")
    turn = float(np.hypot(*step[1, :2]))
    if turn > HEADING_STEP_LIMIT:
        raise MapError(f"{place}: {heading_step(turn)}")
    side = float(np.hypot(*step[0, :2]))
    wanted = max(math.sqrt(1.5 * side / BLEND_CURVATURE), 2.0 * turn / BLEND_CURVATURE)
    plane = float(np.clip(wanted, 10.0, 40.0))
    height = float(np.clip(0.75 * abs(step[0, Z]) / BLEND_GRADE, 20.0, 100.0))
    yield Seam(p, piece, s, step, (speeds[0], speeds[1]), np.array([plane, plane, height, 20.0]))


def height_step(step: float) -> str:
    """Words for a step of height [m] that is too large to be blended."""
    return f"the height steps by {step:.2f} m; up to {HEIGHT_STEP_LIMIT:g} m are blended"


def heading_step(turn: float) -> str:
    """Words for a step of heading [rad] that is too large to be blended."""
    return (
        f"the heading steps by {math.degrees(turn):.0f} degrees; "
        f"up to {math.degrees(HEADING_STEP_LIMIT):.0f} are blended"
    )
