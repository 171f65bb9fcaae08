"""What brake tests measure in a recorded drive: pressures, jerk, locked wheels, distance."""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.results import Line, Panel
from iits_mj.units import KMH
from iits_mj.validation.longitudinal_run import Run
from iits_mj.validation.recorder import PERIOD

# A chamber's pressure has begun to rise [Pa].
_RISEN = 2e3
_LOCKED = 0.8


def mean_pressure(record: Run) -> FloatArray:
    """Pressure averaged over all chambers [Pa], shape (n,)."""
    return np.asarray(record.wheel_pressures.mean(axis=1))


def rise_time(time: FloatArray, pressure: FloatArray, share: float, final: float) -> float:
    """Time [s] after which a pressure (n,) has reached this share of its final level [Pa]."""
    reached = np.flatnonzero((time >= 0.0) & (pressure >= share * final))
    return float(time[reached[0]]) if len(reached) else float("nan")


def first_rise(time: FloatArray, pressure: FloatArray) -> float:
    """Time [s] after which a pressure (n,) has risen by 2 kPa."""
    before = float(pressure[time <= 0.0][-1])
    risen = np.flatnonzero((time >= 0.0) & (pressure > before + _RISEN))
    return float(time[risen[0]]) if len(risen) else float("nan")


def lock_time(record: Run, above: float = 15.0 * KMH) -> float:
    """Longest time [s] for which one and the same wheel slips by 80 % or more above a speed."""
    locked = (np.abs(record.wheel_slips) > _LOCKED) & (record.speed > above)[:, None]
    longest, current = 0, np.zeros(locked.shape[1], dtype=int)
    for now in locked:
        current = np.where(now, current + 1, 0)
        longest = max(longest, int(current.max()))
    return longest * PERIOD


def distance(record: Run) -> float:
    """Way from the first sample to the last [m]."""
    return float(record.station[-1] - record.station[0])


def fully_developed(record: Run) -> float:
    """Mean fully developed deceleration [m/s2]: over the way from 80 to 10 % of the speed.

    UN R13, annex 4, 1.1.2. Nan when the truck did not get that slow.
    """
    fast, slow = (record.speed <= share * record.speed[0] for share in (0.8, 0.1))
    if not slow.any():
        return float("nan")
    a, b = int(np.argmax(fast)), int(np.argmax(slow))
    way = record.station[b] - record.station[a]
    return float((record.speed[a] ** 2 - record.speed[b] ** 2) / (2.0 * way))


def mean_jerk(record: Run, window: float) -> FloatArray:
    """Change of the acceleration over a window [s], per time [m/s3], shape (n - k,).

    The acceleration is that of the speed, as the chassis pitches in front of an accelerometer.
    """
    rate = smooth_rate(record)
    k = round(window / PERIOD)
    return np.asarray((rate[k:] - rate[:-k]) / (k * PERIOD))


def smooth_rate(record: Run, window: float = 0.1) -> FloatArray:
    """Slope of the speed over a window [m/s2], shape (n,)."""
    k = max(1, round(0.5 * window / PERIOD))
    padded = np.pad(record.speed, k, mode="edge")
    rate = (padded[2 * k :] - padded[: -2 * k]) / (2 * k * PERIOD)
    # At both ends only half of the window is there.
    rate[:k], rate[-k:] = rate[k], rate[-k - 1]
    return np.asarray(rate)


def panel(title: str, y_label: str, record: Run, values: FloatArray) -> Panel:
    """A time history of the truck."""
    return Panel(title, "time [s]", y_label, (Line("truck", record.time, values, "simulation"),))
