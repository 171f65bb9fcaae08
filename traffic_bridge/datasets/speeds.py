"""Whether recorded speeds are those of the recorded positions, as they are in one set of units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from traffic_bridge.datasets.trajectories import INSTANT

# [s] over which a way is compared: positions of raw sets jitter by tenths of a metre from row to
# row, which is of no account over this time.
WINDOW = 2.0
MOVING = 2.0  # [m/s], by position or by speed; who stands tells nothing of units
ENOUGH = 30  # windows of moving vehicles
APART = 0.2  # of the speed: the median difference that is refused
NEAR = 0.05  # of a factor: how near the found one must be to be called by its name
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


def check_speeds(
    what: str, vehicle: NDArray[np.int64], time: FloatArray, station: FloatArray, speed: FloatArray
) -> None:
    """Compares the way that vehicles made with the way that their speeds make.

    Sets with too few moving vehicles pass: they do not tell.

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
    likely = f"a factor of {named[0]}" if named else "no usual factor of units: other columns?"
    raise InputError(
        f"{what}: the median speed is {said:.3g} m/s where the positions make {driven:.3g} m/s, "
        f"{likely}"
    )


def _means(
    vehicle: NDArray[np.int64], time: FloatArray, station: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean speeds over the windows, by the positions and by the speeds, shape (w,) each [m/s]."""
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
