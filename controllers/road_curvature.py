"""The road's curvature without what no truck drives: spikes at the seams of real maps.

Between two rows the curvature is the turn of the heading by the way, so that short bends keep their
radius. Where one or two rows stand out of their neighbors by a turn too small to be a bend, the
turn is spread over 25 m.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from iits_mj.core.arrays import FloatArray

if TYPE_CHECKING:
    from iits_mj.road import Route

# A seam turns the heading by less than this, about 1 degree a row [rad].
SEAM_TURN = 0.02
_ROWS = 5


def road_curvature(route: Route, station: FloatArray) -> FloatArray:
    """Curvature of the reference line about each station, shape as station [1/m].

    Args:
      route: the road.
      station: uniform, shape (n,) [m].
    """
    step = float(station[1] - station[0])
    ends = np.append(station - 0.5 * step, station[-1] + 0.5 * step)
    heading = np.asarray(route.evaluate(ends, 0.0).heading, dtype=float)
    turn = np.diff(heading)
    turn = np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi
    half = _ROWS // 2
    around = np.lib.stride_tricks.sliding_window_view(np.pad(turn, half, mode="edge"), _ROWS)
    # The median of five keeps bends and their beginnings as they are.
    excess = turn - np.median(around, axis=1)
    spike = np.where(np.abs(excess) < SEAM_TURN, excess, 0.0)
    spread = np.convolve(np.pad(spike, half), np.full(_ROWS, 1.0 / _ROWS), mode="valid")
    return np.asarray((turn - spike + spread) / step)


def sharpest(curvature: FloatArray, offset: FloatArray | float) -> FloatArray:
    """Magnitude of the curvature at an offset, the greatest of a row and its neighbors [1/m].

    For bounds on the speed, which has to be down where the bend begins.

    Args:
      curvature: of the reference line, shape (n,) [1/m].
      offset: of the path from it, shape (n,) or one [m].
    """
    offset = np.asarray(offset, dtype=float)
    if not np.isfinite(offset).all():
        offset = np.nan_to_num(offset)
    own = np.abs(curvature / np.maximum(1.0 - curvature * offset, 0.2))
    beside = np.concatenate((own[:1], own, own[-1:]))
    return np.maximum(np.maximum(beside[:-2], beside[1:-1]), beside[2:])


def gradient(values: FloatArray, step: float) -> FloatArray:
    """Slope of values `step` apart, shape (n,); `np.gradient` without what it decides anew."""
    slope = np.empty(len(values))
    slope[1:-1] = (values[2:] - values[:-2]) / (2.0 * step)
    slope[0], slope[-1] = (values[1] - values[0]) / step, (values[-1] - values[-2]) / step
    return slope
