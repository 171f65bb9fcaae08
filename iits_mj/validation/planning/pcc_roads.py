"""Roads for PCC: from certification cycles with grade over time, and finer than a plan's grid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns
from iits_mj.core.units import GRAVITY

_COLUMNS = (("cycsecs", "time_s"), ("cycmps", "speed_mps"), ("cycgrade", "grade"))


@dataclass(frozen=True)
class Cycle:
    """A road made from a certification cycle.

    A cycle gives speed and grade for each second. Integration at its own speed gives stations and
    heights of a road that can be driven at any speed.

    Attributes:
      road: without speed limits, because a cycle has none.
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
    # A standstill of the cycle adds no road.
    moves = np.concatenate([[True], way > 0.0])
    station = np.concatenate([[0.0], np.cumsum(way)])[moves]
    height = np.concatenate([[0.0], np.cumsum(rise)])[moves]
    if station.size < 2:
        raise InputError(f"cycle {str(file)!r} never moves")
    road = RoadProfile.from_heights(station, height, step, length, file.name)
    return Cycle(road, float(way.sum() / (time[-1] - time[0])), float(np.ptp(speed)))


def on_finer_road(
    vehicle: PointMass,
    road: RoadProfile,
    speed: FloatArray,
    fine: RoadProfile,
    v_max: float = np.inf,
) -> FloatArray:
    """Speeds of a plan at the nodes of a finer profile of the same road [m/s].

    A plan has one force for each interval. Linear v^2 over a road that is rough within the
    intervals needs forces that vary with every bump and sometimes brake: on the paper's road a 50 m
    plan then burns 0.8 % more than planned. A constant force exchanges kinetic and potential energy
    there and burns the planned fuel: with force, rolling resistance and drag as at the mean of the
    interval, `m_e v^2 / 2 + m g z` is linear in the station between two nodes of the plan. The
    result keeps the limits of the fine road and the band as well as the plan does between its
    nodes.

    Args:
      vehicle: the truck of the plan.
      road: the plan's grid.
      speed: of the plan at its nodes, shape (n + 1,) [m/s].
      fine: the same road with closer nodes, within the stations of `road`.
      v_max: of the band [m/s].

    Raises:
      InputError: the fine profile leaves the road, or the speeds do not match its nodes.
    """
    if speed.shape != road.station.shape or not np.isfinite(speed).all():
        raise InputError(f"a plan over {road.name!r} needs {road.station.size} finite speeds")
    first, last = road.station[[0, -1]]
    if fine.station[0] < first - 1e-6 or fine.station[-1] > last + 1e-6:
        raise InputError(
            f"fine profile {fine.name!r} from {fine.station[0]:.0f} to {fine.station[-1]:.0f} m "
            f"leaves the plan's {first:.0f} to {last:.0f} m"
        )
    line = np.interp(fine.station, road.station, speed**2)
    above = fine.height - np.interp(fine.station, road.station, road.height)
    b = line - 2.0 * GRAVITY * vehicle.mass / vehicle.inertial_mass * above
    # At least half of the planned kinetic energy remains, however high the road rises.
    b = np.maximum(b, 0.5 * line)
    cap = np.maximum(np.minimum(fine.v_limit, v_max), np.sqrt(line))
    return np.asarray(np.minimum(np.sqrt(b), cap))
