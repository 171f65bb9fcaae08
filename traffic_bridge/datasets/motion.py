"""Smooth motion through recorded points: position, speed and acceleration of one curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray

DEGREE = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """A quantity at n instants, with its first and second derivative, shape (n,) each."""

    value: FloatArray
    rate: FloatArray
    bend: FloatArray

    def __add__(self, other: Motion) -> Motion:
        return Motion(self.value + other.value, self.rate + other.rate, self.bend + other.bend)

    def pick(self, chosen: NDArray[np.bool_]) -> Motion:
        """The instants of a mask of shape (n,)."""
        return Motion(self.value[chosen], self.rate[chosen], self.bend[chosen])


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


def calm(time: FloatArray, value: FloatArray, at: FloatArray, width: float) -> Motion:
    """Cubic spline through Gaussian averages of points, which never go beyond the points.

    For a quantity that mostly rests: what is averaged with its ends held keeps a rest, and steps
    from one rest to another without overshoot.

    Args:
      time: of the points, increasing, shape (k,) with k >= 2 [s].
      value: shape (k,).
      at: instants within the points' time, shape (n,) [s].
      width: standard deviation of the average [s].
    """
    from scipy.interpolate import make_interp_spline
    from scipy.ndimage import gaussian_filter1d

    usual = float(np.median(np.diff(time)))
    count = max(round((time[-1] - time[0]) / usual), 1) + 1
    even = np.linspace(time[0], time[-1], count)
    samples = gaussian_filter1d(np.interp(even, time, value), width / usual, mode="nearest")
    degree = min(DEGREE, count - 1)
    spline = make_interp_spline(even, samples, k=degree)
    bend = spline.derivative(2)(at) if degree >= 2 else np.zeros_like(at)
    return Motion(spline(at), spline.derivative(1)(at), bend)


def split_jumps(
    time: FloatArray, value: FloatArray, jump: float
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """A quantity without its steps, and these.

    Args:
      time: shape (k,) [s].
      value: shape (k,).
      jump: the least change between two neighboring points that is a step.

    Returns:
      The values less all steps before them, shape (k,), and time and size of every step.
    """
    change = np.diff(value)
    steps = np.flatnonzero(np.abs(change) > jump)
    found = [(0.5 * float(time[k] + time[k + 1]), float(change[k])) for k in steps.tolist()]
    stepped = np.concatenate(([0.0], np.cumsum(np.where(np.abs(change) > jump, change, 0.0))))
    return value - stepped, found


def transitions(steps: list[tuple[float, float]], at: FloatArray, duration: float) -> Motion:
    """Sum of smooth transitions, each centred on a step.

    A transition is the quintic of zero speed and acceleration at both ends (Takahashi et al., IROS
    1989).

    Args:
      steps: time and size of each.
      at: instants, shape (n,) [s].
      duration: of a transition, positive [s].
    """
    value, rate, bend = np.zeros_like(at), np.zeros_like(at), np.zeros_like(at)
    for middle, size in steps:
        p = np.clip((at - middle) / duration + 0.5, 0.0, 1.0)
        value += size * p**3 * (10.0 + p * (6.0 * p - 15.0))
        rate += size / duration * 30.0 * p**2 * (1.0 - p) ** 2
        bend += size / duration**2 * 60.0 * p * (1.0 - p) * (1.0 - 2.0 * p)
    return Motion(value, rate, bend)
