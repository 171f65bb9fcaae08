"""ISO/TS 18571:2014, objective rating metric for non-ambiguous signals.

A simulated signal C is compared with a measured one T, both sampled at the same n times:

- corridor: a sample counts 1 within 5 % of `max |T|`, 0 beyond 50 %, and between them the square of
  its relative distance from the outer corridor; the mean over all samples;
- phase: 1 less the time shift of greatest correlation over a fifth of the duration;
- magnitude: with the shift removed and the curves warped onto each other in time (dynamic time
  warping within a tenth of the duration), 1 less the relative error over 50 %;
- slope: with the shift removed, of the slopes as means of nine samples, 1 less the relative error
  over 200 %.

The rating is 0.4 corridor + 0.2 phase + 0.2 magnitude + 0.2 slope. The standard wants data of
10 kHz; here the samples are the measured ones, which suits vehicle dynamics. The scores equal those
of the program objective_rating_metrics 1.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError

_INNER, _OUTER, _CORRIDOR_POWER = 0.05, 0.5, 2.0
_SHIFT_MAX, _WINDOW = 0.2, 0.1
_MAGNITUDE_MAX, _SLOPE_MAX, _SLOPE_SAMPLES = 0.5, 2.0, 9
_WEIGHTS = (0.4, 0.2, 0.2, 0.2)
# Least rating of each grade.
GRADES = ((0.94, "excellent"), (0.8, "good"), (0.58, "fair"), (0.0, "poor"))
_SAMPLES_MIN = 50


@dataclass(frozen=True)
class Rating:
    """Scores of 0 to 1; shift: of the simulation behind the measurement [samples]."""

    corridor: float
    phase: float
    magnitude: float
    slope: float
    shift: int

    @property
    def overall(self) -> float:
        """The weighted mean."""
        scores = (self.corridor, self.phase, self.magnitude, self.slope)
        return float(np.dot(_WEIGHTS, scores))

    @property
    def grade(self) -> str:
        """Excellent, good, fair or poor."""
        return next(grade for least, grade in GRADES if self.overall > least or least == 0.0)


def rate(simulated: FloatArray, measured: FloatArray) -> Rating:
    """Rates a simulated signal against a measured one, both of shape (n,), n >= 50.

    Raises:
      InputError: shapes differ, too few samples, a value is not finite, or the measured signal is
        constant.
    """
    c, t = np.asarray(simulated, dtype=float), np.asarray(measured, dtype=float)
    if c.shape != t.shape or c.ndim != 1 or len(t) < _SAMPLES_MIN:
        raise InputError(
            f"signals of shapes {c.shape} and {t.shape} cannot be rated: two of one length are "
            f"needed, with {_SAMPLES_MIN} samples or more"
        )
    if not (np.isfinite(c).all() and np.isfinite(t).all()):
        raise InputError("a signal with values that are not finite cannot be rated")
    if np.ptp(t) == 0.0:
        raise InputError(f"a measured signal that is always {t[0]:g} cannot be rated")
    size = float(np.max(np.abs(t)))
    apart = np.abs(c - t)
    inside = np.clip((_OUTER * size - apart) / ((_OUTER - _INNER) * size), 0.0, 1.0)
    most = int(_SHIFT_MAX * len(t))
    shift = _best_shift(c, t, most)
    late, early = max(shift, 0), max(-shift, 0)
    c, t = c[late : len(c) - early], t[early : len(t) - late]
    warped = _warp(c, t, max(int(_WINDOW * len(t)), 1))
    slopes = [_slope(signal) for signal in (c, t)]
    return Rating(
        corridor=float(np.mean(inside**_CORRIDOR_POWER)),
        phase=max(1.0 - abs(shift) / most, 0.0),
        magnitude=_share(*warped, _MAGNITUDE_MAX),
        slope=_share(slopes[0], slopes[1], _SLOPE_MAX),
        shift=shift,
    )


def _best_shift(c: FloatArray, t: FloatArray, most: int) -> int:
    """Samples by which C is behind T, at the greatest correlation of the common part."""
    best, found = -np.inf, 0
    for shift in sorted(range(-most, most + 1), key=abs):
        late, early = max(shift, 0), max(-shift, 0)
        a, b = c[late : len(c) - early], t[early : len(t) - late]
        a, b = a - a.mean(), b - b.mean()
        scale = float(np.sqrt((a @ a) * (b @ b)))
        correlation = float(a @ b) / scale if scale > 0.0 else -1.0
        if correlation > best + 1e-12:
            best, found = correlation, shift
    return found


def _warp(c: FloatArray, t: FloatArray, window: int) -> tuple[FloatArray, FloatArray]:
    """Both signals along the warping path of the least sum of squared differences."""
    n = len(c)
    cost = np.full((n + 1, n + 1), np.inf)
    cost[0, 0] = 0.0
    for i in range(n):
        low, high = max(i - window, 0), min(i + window + 1, n)
        own = (c[i] - t[low:high]) ** 2
        above = np.minimum(cost[i, low:high], cost[i, low + 1 : high + 1])
        left = cost[i + 1, low]
        for k, (step, before) in enumerate(zip(own.tolist(), above.tolist(), strict=True)):
            left = step + min(before, left)
            cost[i + 1, low + k + 1] = left
    i = j = n
    path = []
    while i and j:
        path.append((i - 1, j - 1))
        steps = ((i - 1, j - 1), (i - 1, j), (i, j - 1))
        i, j = min(steps, key=lambda place: cost[place])
    first, second = np.array(path).T
    return c[first], t[second]


def _slope(signal: FloatArray) -> FloatArray:
    """Slope per sample, the mean of nine; near an end of as many as lie on both sides alike."""
    slope = np.gradient(signal)
    sizes = range(1, _SLOPE_SAMPLES, 2)
    begin = [np.mean(slope[:size]) for size in sizes]
    end = [np.mean(slope[-size:]) for size in reversed(sizes)]
    middle = np.convolve(slope, np.full(_SLOPE_SAMPLES, 1.0 / _SLOPE_SAMPLES), "valid")
    return np.concatenate([begin, middle, end])


def _share(c: FloatArray, t: FloatArray, most: float) -> float:
    """1 less the error of C over the size of T, as a share of the greatest one."""
    size = float(np.sum(np.abs(t)))
    error = float(np.sum(np.abs(c - t))) / size if size > 0.0 else np.inf
    return max(1.0 - error / most, 0.0)
