"""Smooths recorded motion, and checks that speeds fit the positions."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError
from traffic_bridge.datasets.trajectories import INSTANT, Trajectories

# Widths of the kernels in Thiemann et al. [s].
POSITION_WIDTH = 0.5
SPEED_WIDTH = 1.0
ACCELERATION_WIDTH = 4.0
REACH = 3.0  # the kernel is cut at this many widths, as in Thiemann et al.
# [s] over which distances are compared: long enough that the noise of raw positions, tenths of a
# meter, does not matter.
WINDOW = 2.0
MOVING = 2.0  # [m/s], by position or by speed; slower vehicles are not compared
ENOUGH = 30  # windows of moving vehicles
APART = 0.2  # of the speed: a larger median difference is refused
NEAR = 0.05  # of a factor: tolerance for naming it
MILE = 1609.344  # [m]
FOOT = 0.3048  # [m]
FACTORS = (
    (3.6, "3.6, as of km/h taken for m/s"),
    (1.0 / 3.6, "1/3.6, as of m/s taken for km/h"),
    (1.0 / FOOT, "1/0.3048, as of ft/s taken for m/s"),
    (FOOT, "0.3048, as of m/s taken for ft/s"),
    (MILE / 1000.0, "1.609, as of mph taken for km/h"),
    (3600.0 / MILE, "2.237, as of mph taken for m/s"),
    (FOOT * 3600.0 / MILE, "0.682, as of mph taken for ft/s"),
    (10.0, "10, as of frames of 0.1 s taken for seconds"),
    (0.1, "0.1, as of seconds taken for frames of 0.1 s"),
    (100.0, "100, as of cm/s taken for m/s"),
)
DEGREE = 3  # of splines


def exponential_average(values: FloatArray, width: float) -> FloatArray:
    """Symmetric exponential moving average, equations 1 and 2 of Thiemann et al. (2008).

    Within a window of half-width D = min(3 width, i, n - 1 - i) about sample i the weights are
    exp(-|i - j| / width), so a straight line stays unchanged up to its ends.

    Args:
      values: evenly spaced, shape (n,).
      width: of the kernel, in samples, positive.
    """
    count = len(values)
    reach = min(math.ceil(REACH * width), (count - 1) // 2)
    if reach < 1:
        return values.copy()
    weights = np.exp(-np.arange(reach + 1) / width)
    # Sums over windows of growing half-width, each from the one before.
    total, weight = values.copy(), np.ones(count)
    for d in range(1, reach + 1):
        total[d : count - d] += weights[d] * (values[: count - 2 * d] + values[2 * d :])
        weight[d : count - d] += 2.0 * weights[d]
    return total / weight


def without_noise(trajectories: Trajectories) -> Trajectories:
    """Trajectories with averaged positions, speeds and accelerations, against noisy positions.

    C. Thiemann, M. Treiber and A. Kesting, "Estimating acceleration and lane-changing dynamics from
    Next Generation Simulation trajectory data", Transportation Research Record 2088 (2008):
    positions are differentiated first, then positions, speeds and accelerations are averaged, each
    with a symmetric exponential kernel of its own width. Recorded speeds and accelerations are not
    used. Tracks of fewer than three rows stay unchanged.

    Args:
      trajectories: raw ones, with rows evenly spaced in time.

    Raises:
      InputError: a track is not evenly spaced.
    """
    t = trajectories
    station, speed, acceleration = t.station.copy(), t.speed.copy(), t.acceleration.copy()
    across = t.lane + t.offset / t.lane_width
    for index, name in enumerate(t.ids):
        rows = t.rows(index)
        time = t.time[rows]
        if len(time) < 3:
            continue
        if np.ptp(np.diff(time)) > 0.1 * t.step:
            raise InputError(
                f"{t.source}: vehicle {name!r} is missing at some instants: the noise filter needs "
                "evenly spaced rows"
            )
        raw_speed = np.gradient(t.station[rows], t.step)
        raw_acceleration = np.gradient(raw_speed, t.step)
        station[rows] = exponential_average(t.station[rows], POSITION_WIDTH / t.step)
        across[rows] = exponential_average(across[rows], POSITION_WIDTH / t.step)
        speed[rows] = exponential_average(raw_speed, SPEED_WIDTH / t.step)
        acceleration[rows] = exponential_average(raw_acceleration, ACCELERATION_WIDTH / t.step)
    return dataclasses.replace(
        t,
        station=station,
        offset=(across - t.lane) * t.lane_width,
        # Averages of a standing vehicle may be a little below zero.
        speed=np.maximum(speed, 0.0),
        acceleration=acceleration,
        notes=(*t.notes, "positions, speeds and accelerations are averaged against noise"),
    )


def check_speeds(
    what: str, vehicle: IntArray, time: FloatArray, station: FloatArray, speed: FloatArray
) -> None:
    """Compares the distances between positions with those that the speeds give.

    Sets with too few moving vehicles pass.

    Args:
      what: file and column of the speeds, for the message.
      vehicle: index of the vehicle, shape (k,), in any order.
      time: shape (k,) [s].
      station: along the road, shape (k,) [m].
      speed: along the road, shape (k,) [m/s].

    Raises:
      InputError: the median difference is more than a fifth of the speed; names the likely factor.
    """
    by_way, by_speed = _means(vehicle, time, station, speed)
    moving = np.maximum(np.abs(by_way), by_speed) > MOVING
    if int(moving.sum()) < ENOUGH:
        return
    by_way, by_speed = by_way[moving], by_speed[moving]
    driven, said = float(np.median(by_way)), float(np.median(by_speed))
    if float(np.median(np.abs(by_way - by_speed))) <= APART * abs(driven):
        return
    ratio = said / driven if driven else np.inf
    named = [words for factor, words in FACTORS if abs(ratio / factor - 1.0) < NEAR]
    likely = (
        f"a factor of {named[0]}"
        if named
        else "no usual factor of units: are these the right columns?"
    )
    raise InputError(
        f"{what}: the median speed is {said:.3g} m/s, by the positions {driven:.3g} m/s, {likely}"
    )


def _means(
    vehicle: IntArray, time: FloatArray, station: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean speeds over the windows, from positions and from speeds, shape (w,) each [m/s]."""
    order = np.lexsort((time, vehicle))
    gap = np.diff(time[order])
    again = np.concatenate(([False], (np.diff(vehicle[order]) == 0) & (gap < INSTANT)))
    order = order[~again]
    vehicle, time, station, speed = vehicle[order], time[order], station[order], speed[order]
    gap, same = np.diff(time), np.diff(vehicle) == 0
    if not same.any():
        return np.zeros(0), np.zeros(0)
    step = float(np.median(gap[same]))
    rows = max(round(WINDOW / step), 1)
    way = np.concatenate(
        ([0.0], np.cumsum(np.where(same, 0.5 * (speed[1:] + speed[:-1]) * gap, 0)))
    )
    lasted = time[rows:] - time[:-rows]
    whole = (vehicle[rows:] == vehicle[:-rows]) & (np.abs(lasted - rows * step) < 0.5 * step)
    lasted = lasted[whole]
    return (
        (station[rows:] - station[:-rows])[whole] / lasted,
        (way[rows:] - way[:-rows])[whole] / lasted,
    )


@dataclass(frozen=True, eq=False)
class Motion:
    """A quantity at n instants with its first and second derivative, shape (n,) each."""

    value: FloatArray
    rate: FloatArray
    bend: FloatArray

    def __add__(self, other: Motion) -> Motion:
        return Motion(self.value + other.value, self.rate + other.rate, self.bend + other.bend)

    @classmethod
    def of_spline(cls, spline: Any, at: FloatArray) -> Motion:
        """Values and derivatives of one of SciPy's splines at instants of shape (n,)."""
        bend = spline.derivative(2)(at) if spline.k >= 2 else np.zeros_like(at)
        return cls(spline(at), spline.derivative(1)(at), bend)

    def pick(self, chosen: BoolArray) -> Motion:
        """The instants of a mask of shape (n,)."""
        return Motion(self.value[chosen], self.rate[chosen], self.bend[chosen])


def fit(time: FloatArray, value: FloatArray, at: FloatArray, spacing: float) -> Motion:
    """Least-squares cubic spline through points, whose acceleration is continuous.

    C. de Boor, "A practical guide to splines", Springer 1978, chapter XIV. With knots `spacing`
    apart the spline follows changes slower than about twice that and averages faster ones, such as
    rounding and noise of recorded positions. Speed and acceleration are its exact derivatives.

    Args:
      time: of the points, increasing, shape (k,) with k >= 2 [s].
      value: shape (k,).
      at: instants within the points' time, shape (n,) [s].
      spacing: between knots [s]; with 0 the spline passes through the points.
    """
    from scipy.interpolate import make_interp_spline, make_lsq_spline

    degree = min(DEGREE, len(time) - 1)
    usual = float(np.median(np.diff(time)))
    every = max(round(spacing / usual), 1)
    inner = time[every:-every:every]
    # Not a short last stretch: with few points its end would not be determined.
    if len(inner) and time[-1] - inner[-1] < 0.75 * spacing:
        inner = inner[:-1]
    if every == 1 or degree < DEGREE or len(inner) + 2 * (degree + 1) > len(time):
        spline = make_interp_spline(time, value, k=degree)
    else:
        ends = [np.full(degree + 1, time[0]), inner, np.full(degree + 1, time[-1])]
        spline = make_lsq_spline(time, value, np.concatenate(ends), k=degree)
    return Motion.of_spline(spline, at)


def smooth(time: FloatArray, value: FloatArray, at: FloatArray, width: float) -> Motion:
    """Cubic spline through Gaussian averages of points, without overshoot.

    For a quantity that is constant most of the time and then changes, as the lane does.

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
    return Motion.of_spline(make_interp_spline(even, samples, k=min(DEGREE, count - 1)), at)


def split_jumps(
    time: FloatArray, value: FloatArray, jump: float
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Separates a quantity from its steps.

    Args:
      time: shape (k,) [s].
      value: shape (k,).
      jump: smallest change between two neighboring points that counts as a step.

    Returns:
      The values less all steps before them, shape (k,), and time and size of every step.
    """
    change = np.diff(value)
    steps = np.flatnonzero(np.abs(change) > jump)
    found = [(0.5 * float(time[k] + time[k + 1]), float(change[k])) for k in steps.tolist()]
    stepped = np.concatenate(([0.0], np.cumsum(np.where(np.abs(change) > jump, change, 0.0))))
    return value - stepped, found


def transitions(steps: list[tuple[float, float]], at: FloatArray, duration: float) -> Motion:
    """Sum of smooth transitions, each centered on a step.

    A transition is the quintic of zero speed and acceleration at both ends (Takahashi et al., IROS
    1989).

    Args:
      steps: time and size of each.
      at: instants, shape (n,) [s].
      duration: of a transition, positive [s].
    """
    value, rate, bend = np.zeros((3, *at.shape))
    for middle, size in steps:
        p = np.clip((at - middle) / duration + 0.5, 0.0, 1.0)
        value += size * p**3 * (10.0 + p * (6.0 * p - 15.0))
        rate += size / duration * 30.0 * p**2 * (1.0 - p) ** 2
        bend += size / duration**2 * 60.0 * p * (1.0 - p) * (1.0 - 2.0 * p)
    return Motion(value, rate, bend)
