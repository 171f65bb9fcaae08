"""Cubic records along a road: elevation, superelevation, lane offset and widths.

OpenDRIVE describes every profile by records `f(s) = a + b ds + c ds^2 + d ds^3`, ds = s - start,
each valid until the next one starts (ASAM OpenDRIVE 1.6, sections 8.4, 8.5, 9.3, 9.4).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray


class Cubic(NamedTuple):
    """One record; `start` in meters, coefficients in powers of meters."""

    start: float
    a: float = 0.0
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0


class PiecewiseCubic:
    """A profile made of cubic records; the first and last record extend beyond both ends."""

    def __init__(self, records: Iterable[Cubic] = ()) -> None:
        """Takes records in any order; none at all is the constant zero."""
        rows = sorted(records, key=lambda record: record.start) or [Cubic(0.0)]
        self.records: tuple[Cubic, ...] = tuple(Cubic(*map(float, row)) for row in rows)
        self._starts = [record.start for record in self.records]
        table = np.array(self.records, dtype=float)
        self.starts: FloatArray = table[:, 0]
        self.coefficients: FloatArray = table[:, 1:]

    def at(self, s: float) -> float:
        """Value at one place; the scalar, fast form of `evaluate`."""
        start, a, b, c, d = self.records[max(bisect_right(self._starts, s) - 1, 0)]
        u = s - start
        return a + u * (b + u * (c + u * d))

    def evaluate(self, s: ArrayLike, derivative: int = 0, side: int = 1) -> FloatArray:
        """Value, or first or second derivative, of shape of `s`.

        Where two records meet, the one after (`side` = 1) or before (-1) is taken.
        """
        s = np.asarray(s, dtype=float)
        order: Literal["left", "right"] = "right" if side > 0 else "left"
        index = np.maximum(np.searchsorted(self.starts, s, side=order) - 1, 0)
        a, b, c, d = np.moveaxis(self.coefficients[index], -1, 0)
        u = s - self.starts[index]
        if derivative == 0:
            return np.asarray(a + u * (b + u * (c + u * d)))
        if derivative == 1:
            return np.asarray(b + u * (2.0 * c + 3.0 * u * d))
        return np.asarray(2.0 * c + 6.0 * u * d)

    def expanded_at(self, s: float, side: int = 1) -> Cubic:
        """The record valid just after (`side` = 1) or before (-1) `s`, expanded about `s`."""
        index = bisect_right(self._starts, s) - 1
        if side < 0 and index > 0 and self._starts[index] == s:
            index -= 1
        start, a, b, c, d = self.records[max(index, 0)]
        u = s - start
        return Cubic(
            s, a + u * (b + u * (c + u * d)), b + u * (2.0 * c + 3.0 * u * d), c + 3.0 * u * d, d
        )

    def breaks(self) -> tuple[float, ...]:
        """Starts of the records."""
        return tuple(self._starts)

    def along(self, start: float, end: float, direction: int, origin: float) -> PiecewiseCubic:
        """The same profile over a parameter p of travel that is `origin` where s is `start`.

        Travelling with direction +1 from `start` to a larger `end`, or with -1 to a smaller one.
        """
        low, high = min(start, end), max(start, end)
        inner = [s for s in self._starts if low < s < high]
        if direction > 0:
            places = [start, *inner]
            return PiecewiseCubic(
                self.expanded_at(s)._replace(start=origin + s - start) for s in places
            )
        records = []
        for s in (start, *reversed(inner)):
            _, a, b, c, d = self.expanded_at(s, side=-1)
            records.append(Cubic(origin + start - s, a, -b, c, -d))
        return PiecewiseCubic(records)


def combine(terms: Iterable[tuple[float, PiecewiseCubic]], constant: float = 0.0) -> PiecewiseCubic:
    """Weighted sum of profiles plus a constant, again a profile."""
    terms = list(terms)
    places = sorted({s for _, profile in terms for s in profile.breaks()}) or [0.0]
    records = []
    for s in places:
        total = np.array([constant, 0.0, 0.0, 0.0])
        for weight, profile in terms:
            total += weight * np.array(profile.expanded_at(s)[1:])
        records.append(Cubic(s, *(float(value) for value in total)))
    return PiecewiseCubic(records)


def constant(value: float) -> PiecewiseCubic:
    """The profile that has one value everywhere."""
    return PiecewiseCubic((Cubic(0.0, value),))
