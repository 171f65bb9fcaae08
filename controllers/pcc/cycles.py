"""Certification cycles with grade over time, such as those of EPA's GEM, as roads.

A cycle gives speed and grade second by second. Driven at its own speed the grades lie at stations,
and their rises add up to heights; the road can then be driven at any other speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.pcc.profile import RoadProfile
from iits_mj.csv_table import read_columns
from iits_mj.errors import InputError

_COLUMNS = (("cycsecs", "time_s"), ("cycmps", "speed_mps"), ("cycgrade", "grade"))


@dataclass(frozen=True)
class Cycle:
    """A road made of a cycle.

    Attributes:
      road: without speed limits, which a cycle does not tell.
      speed: mean over its time [m/s]; spread: greatest less smallest speed [m/s].
    """

    road: RoadProfile
    speed: float
    spread: float


def read_cycle(path: str | Path, step: float = 50.0, length: float | None = None) -> Cycle:
    """Reads a CSV with columns cycSecs [s], cycMps [m/s], cycGrade [1, rise over run].

    Args:
      path: of the file.
      step: of the road's grid [m].
      length: that is wanted [m]; without it all.

    Raises:
      InputError: unreadable file, missing columns, time that does not rise, speeds below 0, or a
        road that is too short or too steep.
    """
    file = Path(path)
    time, speed, grade = read_columns(file, "cycle", _COLUMNS)
    if (np.diff(time) <= 0.0).any():
        raise InputError(f"cycle {str(file)!r}: time must rise from row to row")
    if speed.min() < 0.0:
        raise InputError(f"cycle {str(file)!r}: speed {speed.min():g} m/s is below 0")
    way = 0.5 * (speed[1:] + speed[:-1]) * np.diff(time)
    rise = 0.5 * (grade[1:] + grade[:-1]) * way
    # Where the cycle stands still nothing is added to the road.
    moves = np.concatenate([[True], way > 0.0])
    station = np.concatenate([[0.0], np.cumsum(way)])[moves]
    height = np.concatenate([[0.0], np.cumsum(rise)])[moves]
    if station.size < 2:
        raise InputError(f"cycle {str(file)!r} never moves")
    road = RoadProfile.from_heights(station, height, step, length, file.name)
    return Cycle(road, float(way.sum() / (time[-1] - time[0])), float(np.ptp(speed)))
