"""Quintic polynomials across the road, and the trajectory made from a path and a speed plan."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from controllers.planning.road_preview import LanePath, RoadPreview
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, PlanMode, Trajectory, positional
from iits_mj.kernels import Address, Integer, Table

_SAMPLES = np.linspace(0.0, 1.0, 41)
_trajectory_of = positional(Trajectory)

_trajectory = kernels.function(
    "iits_trajectory",
    None,
    *(Address, Address, Integer),  # reference line and road
    *(Address, Integer, Address),  # path and quintic
    *(Address, Integer, Address),  # stations and result
)


@dataclass(frozen=True)
class Quintic:
    """Polynomial `q(s)` on [start, start + length]; constant before it, zero after it.

    It is a function of station, so that the path on the road does not depend on the later speed
    (Piazzi, Lo Bianco, Bertozzi, Fascioli and Broggi 2002).

    Attributes:
      start: station [m]; length: [m].
      coefficients: of powers 0 to 5 of (s - start) / length, shape (6,) [m].
    """

    start: float
    length: float
    coefficients: tuple[float, ...]

    @classmethod
    def to_zero(
        cls, start: float, length: float, value: float, slope: float = 0.0, bend: float = 0.0
    ) -> Quintic:
        """From value [m], slope [1] and second derivative [1/m] to zero in all three.

        Raises:
          InputError: length not positive, or a value that is not finite.
        """
        if not (length > 0.0 and np.isfinite([start, length, value, slope, bend]).all()):
            raise InputError(
                f"quintic from {value} m, slope {slope}, bend {bend} over {length} m: "
                "all must be finite and the length positive"
            )
        a0, a1, a2 = value, slope * length, 0.5 * bend * length**2
        # Three end conditions q = q' = q'' = 0 at 1 give the upper three coefficients.
        a3 = -10.0 * a0 - 6.0 * a1 - 3.0 * a2
        a4 = 15.0 * a0 + 8.0 * a1 + 3.0 * a2
        a5 = -6.0 * a0 - 3.0 * a1 - a2
        return cls(start, length, (a0, a1, a2, a3, a4, a5))

    @property
    def end(self) -> float:
        """Station of the end [m]."""
        return self.start + self.length

    @functools.cached_property
    def table(self) -> Table:
        """Start, length, its square and the coefficients, for the compiled functions."""
        return Table([self.start, self.length, self.length**2, *self.coefficients])

    def evaluate(self, station: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Value [m] and first three derivatives over station, each of station's shape."""
        t = (np.asarray(station, dtype=float) - self.start) / self.length
        t = np.minimum(np.maximum(t, 0.0), 1.0)
        a0, a1, a2, a3, a4, a5 = self.coefficients
        inside = (t > 0.0) & (t < 1.0)
        value = a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))
        first = a1 + t * (2 * a2 + t * (3 * a3 + t * (4 * a4 + t * 5 * a5)))
        second = 2 * a2 + t * (6 * a3 + t * (12 * a4 + t * 20 * a5))
        third = 6 * a3 + t * (24 * a4 + t * 60 * a5)
        flat = np.where(t >= 1.0, 0.0, 1.0)
        return (
            value * flat,
            first / self.length * flat,
            second / self.length**2 * flat,
            np.where(inside, third / self.length**3, 0.0),
        )

    def peak_lateral(self, speed: float) -> tuple[float, float]:
        """Greatest lateral acceleration [m/s2] and jerk [m/s3] when driven at a speed [m/s]."""
        _, _, second, _ = self.evaluate(self.start + _SAMPLES * self.length)
        t = _SAMPLES
        _, _, _, a3, a4, a5 = self.coefficients
        third = (6 * a3 + t * (24 * a4 + t * 60 * a5)) / self.length**3
        return float(np.abs(second).max()) * speed**2, float(np.abs(third).max()) * speed**3


def shortest_to_zero(
    start: float,
    value: float,
    slope: float,
    bend: float,
    speed: float,
    acceleration_max: float,
    jerk_max: float,
    duration_min: float,
    duration_max: float,
    length_min: float,
) -> Quintic | None:
    """The shortest quintic to zero within lateral limits; None when even the longest exceeds them.

    Args:
      start: station [m].
      value: at the start [m], see `Quintic.to_zero`.
      slope: at the start [1].
      bend: second derivative at the start [1/m].
      speed: greatest speed during the maneuver [m/s].
      acceleration_max: lateral [m/s2].
      jerk_max: lateral [m/s3].
      duration_min: [s].
      duration_max: [s].
      length_min: [m], for slow driving.
    """
    # The present bend cannot be avoided: the limit is at least 5 % above it.
    acceleration_max = max(acceleration_max, 1.05 * abs(bend) * speed**2)
    duration = duration_min
    while duration <= duration_max + 1e-9:
        quintic = Quintic.to_zero(start, max(speed * duration, length_min), value, slope, bend)
        acceleration, jerk = quintic.peak_lateral(speed)
        if acceleration <= acceleration_max and jerk <= jerk_max:
            return quintic
        duration += 0.1
    return None


def on_road(
    preview: RoadPreview,
    path: LanePath,
    residual: Quintic | None,
    time: float,
    station: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    step: float,
    mode: PlanMode = PlanMode.LANE_KEEPING,
    reason: str = "",
    target_lane: int = 0,
    refused: Decision = Decision.KEEP,
    extra: dict[str, float] | None = None,
) -> Trajectory:
    """Trajectory in the map frame: lane path plus quintic over station, with speed over time.

    Args:
      preview: tables of the road.
      path: of the target lane.
      residual: offset from the path, None for none.
      time: of the first point [s].
      station: of shape (n,) [m].
      speed: of shape (n,) [m/s].
      acceleration: of shape (n,) [m/s2].
      step: between points [s].
      mode: of the planner.
      reason: of the mode in words.
      target_lane: index of the lane that is kept or entered.
      refused: decision that the planner refused.
      extra: numbers for the log.
    """
    count = len(station)
    rows = np.empty((6, count))
    _trajectory(
        *(preview.route.line.table.address, preview.table.address, len(preview.station)),
        *(path.table.address, len(path.station)),
        None if residual is None else residual.table.address,
        *(kernels.address(station), count, kernels.address(rows)),
    )
    return _trajectory_of(
        *(time + _instants(count, step), station, *rows, speed, acceleration),
        *(mode, reason, target_lane, refused, {} if extra is None else extra),
    )


@functools.lru_cache(maxsize=4)
def _instants(count: int, step: float) -> FloatArray:
    """Times of the points from the first one on [s]."""
    return np.asarray(step * np.arange(count))
