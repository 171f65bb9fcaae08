"""The grade of the road along a log: from a table, a number, or the heights that were recorded."""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from iits_mj.identification.log import Log, Series
from iits_mj.identification.tables import read_table_columns

# Length over which the slope of a height is taken, on both sides [m].
_SLOPE_LENGTH = 40.0


def with_slope(log: Log) -> Log:
    """Adds the grade as slope of height over station, a straight line over 80 m fitted each."""
    height = log.series("z")
    station = np.maximum.accumulate(log.at("station", height.time))
    places = np.arange(station[0], station[-1], 10.0)
    if len(places) < 2:
        return log
    slopes = []
    for place in places:
        low, high = np.searchsorted(station, [place - _SLOPE_LENGTH, place + _SLOPE_LENGTH])
        near = slice(int(low), max(int(high), int(low) + 2))
        x, y = station[near] - station[near].mean(), height.value[near]
        slopes.append(float(x @ y / max(float(x @ x), 1e-9)))
    return with_grade(log, places, np.array(slopes))


def with_grade(log: Log, station: FloatArray, grade: FloatArray) -> Log:
    """The log with the road's grade from a table over station [m], both of shape (n,).

    Raises:
      InputError: the log has neither station nor speed, or the table's stations do not increase.
    """
    if np.any(np.diff(station) <= 0.0):
        raise InputError("the stations of a grade table must increase")
    if "station" in log:
        place = log.series("station")
    else:
        speed = log.series("speed")
        steps = 0.5 * (speed.value[1:] + speed.value[:-1]) * np.diff(speed.time)
        place = Series(speed.time, np.concatenate([[0.0], np.cumsum(steps)]))
    value = np.interp(place.value, station, grade)
    return Log({**log.signals, "grade": Series(place.time, np.asarray(value))})


def read_grade(text: str, log: Log) -> Log:
    """The log with the grade that a number (everywhere) or a CSV of station and grade gives.

    Raises:
      InputError: neither a number within +/-0.3 nor a readable table.
    """
    try:
        value = float(text)
    except ValueError:
        table = read_table_columns(text, ("station", "grade"))
        return with_grade(log, table[0], table[1])
    if not abs(value) <= 0.3:
        raise InputError(f"grade {text!r} is not allowed: use -0.3 to 0.3, or a table's name")
    return with_grade(log, np.array([0.0, 1.0]), np.array([value, value]))
