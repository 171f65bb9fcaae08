"""Smooth motion through recorded points: position, speed and acceleration of one curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DEGREE = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """A quantity at n instants, with its first and second derivative, shape (n,) each."""

    value: FloatArray
    rate: FloatArray
    bend: FloatArray


def fit(time: FloatArray, value: FloatArray, at: FloatArray, spacing: float) -> Motion:
    """Least-squares cubic spline through points, whose acceleration is continuous.

    C. de Boor, "A practical guide to splines", Springer 1978, chapter XIV. With its knots `spacing`
    apart the spline follows changes slower than about twice that and averages what is faster, as
    the rounding and jitter of recorded positions are. Speed and acceleration are its derivatives,
    so that they belong to the positions exactly.

    Args:
      time: of the points, increasing, shape (k,) with k >= 2 [s].
      value: shape (k,).
      at: instants within the points' time, shape (n,) [s].
      spacing: between knots [s]; 0 puts a knot at (nearly) every point: the spline passes through.
    """
    from scipy.interpolate import make_interp_spline, make_lsq_spline

    degree = min(DEGREE, len(time) - 1)
    usual = float(np.median(np.diff(time)))
    every = max(round(spacing / usual), 1)
    inner = time[every:-every:every]
    # The last stretch is not to be a short one: few points there would leave its end loose.
    if len(inner) and time[-1] - inner[-1] < 0.75 * spacing:
        inner = inner[:-1]
    if every == 1 or degree < DEGREE or len(inner) + 2 * (degree + 1) > len(time):
        spline = make_interp_spline(time, value, k=degree)
    else:
        ends = [np.full(degree + 1, time[0]), inner, np.full(degree + 1, time[-1])]
        spline = make_lsq_spline(time, value, np.concatenate(ends), k=degree)
    zero = np.zeros_like(at)
    return Motion(
        spline(at),
        spline.derivative(1)(at),
        spline.derivative(2)(at) if degree >= 2 else zero,
    )


def without_jumps(time: FloatArray, value: FloatArray, jump: float, duration: float) -> FloatArray:
    """Values in which steps are drawn out to smooth transitions.

    A step is a change between two neighboring points by more than `jump`. It becomes the quintic of
    zero speed and acceleration at both ends (Takahashi et al., IROS 1989), centred on the step.

    Args:
      time: shape (k,) [s].
      value: shape (k,).
      jump: the least step.
      duration: of a transition [s].
    """
    steps = np.flatnonzero(np.abs(np.diff(value)) > jump)
    if not steps.size or duration <= 0.0:
        return value
    smooth = value.copy()
    for k in steps.tolist():
        size = value[k + 1] - value[k]
        middle = 0.5 * (time[k] + time[k + 1])
        part = np.clip((time - middle) / duration + 0.5, 0.0, 1.0)
        smooth += size * (part**3 * (10.0 + part * (6.0 * part - 15.0)) - (time > middle))
    return smooth
