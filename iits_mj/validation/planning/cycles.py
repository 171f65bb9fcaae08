"""Roads from certification cycles with grade over time, such as those of EPA's GEM."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.pcc.profile import RoadProfile
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns

_COLUMNS = (("cycsecs", "time_s"), ("cycmps", "speed_mps"), ("cycgrade", "grade"))


@dataclass(frozen=True)
class Cycle:
    """A road made from a certification cycle.

    A cycle gives speed and grade second by second. Integrated at its own speed the grades lie at
    stations, and their rises add up to heights; the road can then be driven at any speed.

    Attributes:
      road: without speed limits, which a cycle does not give.
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
      length: of the road [m]; default: to the end.

    Raises:
      InputError: the file cannot be read or lacks columns, time does not rise, a speed is below 0,
        or the road is too short or too steep.
    """
    file = Path(path)
    time, speed, grade = read_columns(file, "cycle", _COLUMNS)
    if (np.diff(time) <= 0.0).any():
        raise InputError(f"cycle {str(file)!r}: time must rise from row to row")
    if speed.min() < 0.0:
        raise InputError(f"cycle {str(file)!r}: speed {speed.min():g} m/s is below 0")
    way = 0.5 * (speed[1:] + speed[:-1]) * np.diff(time)
    rise = 0.5 * (grade[1:] + grade[:-1]) * way
    # A standstill of the cycle adds nothing to the road.
    moves = np.concatenate([[True], way > 0.0])
    station = np.concatenate([[0.0], np.cumsum(way)])[moves]
    height = np.concatenate([[0.0], np.cumsum(rise)])[moves]
    if station.size < 2:
        raise InputError(f"cycle {str(file)!r} never moves")
    road = RoadProfile.from_heights(station, height, step, length, file.name)
    return Cycle(road, float(way.sum() / (time[-1] - time[0])), float(np.ptp(speed)))
