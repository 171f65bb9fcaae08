"""Speed over the coming seconds: limits ahead, leaders, the engine's power, emergencies."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.config import Powers, SpeedConfig
from controllers.planning.following import Lead, lead_table
from controllers.planning.road_preview import LanePath, RoadPreview
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import SpeedProfile
from iits_mj.core.units import GRAVITY
from iits_mj.kernels import Address, Integer, Real
from iits_mj.parameters import TruckParameters

# A truck that comes to rest this near to a stop stays there [m].
HOLD_REACH = 1.0

_most_urgent = kernels.function("iits_most_urgent", Real, Address, Integer, Real, Real, Real)
_power_acceleration = kernels.function("iits_power_acceleration", Real, *5 * [Real])
_speed_cap = kernels.function(
    "iits_speed_cap",
    Integer,
    *(Integer, *5 * [Address]),  # path, speeds and road
    *(Real, Real, Address),  # limits and result
)
_roll_out = kernels.function(
    "iits_roll_out",
    None,
    *(Address, Real, Real, Real),  # settings and start
    *(Address, Integer, Real, Real),  # bound on the speed
    *(Address, Integer),  # leads
    *(Real, Real, Real, Real),  # mass and power
    *(Real, Real, Real),  # stop
    *(Real, Integer, Integer, Real),  # emergency, hold, and steps
    Address,
)


@functools.cache
def _shipped() -> Powers:
    return Powers.of(TruckParameters.load())


def speed_cap(
    path: LanePath,
    preview: RoadPreview,
    config: SpeedConfig,
    profile: SpeedProfile | None = None,
) -> FloatArray:
    """Greatest comfortable speed along a path, shape of path.station [m/s].

    The least of cruise speed or profile, the lane's limit and curve speed, approached at the
    preview deceleration. Curves count from the row before them to the row after them.

    Raises:
      InputError: the reference speed is not a number.
    """
    count, line, road = len(path.station), path.table.numbers, preview.table.numbers
    if profile is None:
        wanted = np.full(count, config.cruise_speed)
    elif profile.station is path.station:
        wanted = profile.speed
    else:
        wanted = np.interp(path.station, profile.station, profile.speed)
    first, cap = preview.index(float(path.station[0])), np.empty(count)
    unknown = _speed_cap(
        *(count, kernels.address(line[0]), kernels.address(line[-1])),
        *(kernels.address(path.speed_limit), kernels.address(wanted)),
        kernels.address(road[1, first:]),
        *(config.curve_acceleration, config.following.preview_deceleration),
        kernels.address(cap),
    )
    if unknown:
        raise InputError("the reference speed ahead is not a number")
    return cap


def most_urgent(leads: list[Lead], speed: float, config: SpeedConfig) -> float:
    """Greatest deceleration that any leader requires of the truck now, positive [m/s2].

    A braking leader counts with its speed after the brakes' reaction time, and the truck must not
    reach it even if it stops.
    """
    if not leads:
        return 0.0
    margin = config.emergency_margin
    return float(_most_urgent(lead_table(leads), len(leads), speed, config.reaction_time, margin))


@dataclass(frozen=True)
class SpeedState:
    """Initial state of a speed plan: station [m], speed [m/s], acceleration [m/s2]."""

    station: float
    speed: float
    acceleration: float


def power_acceleration(speed: float, mass: float, grade: float, config: SpeedConfig) -> float:
    """Acceleration that the engine's power allows at a speed [m/s2], 0.05 m/s2 at least.

    With this least value the plan demands full power where the truck cannot hold its speed.
    """
    power, *resistances = _powers(grade, config)
    return float(_power_acceleration(speed, mass, power, *resistances))


def _powers(grade: float, config: SpeedConfig) -> tuple[float, float, float]:
    """Power [W], acceleration by rolling resistance and slope [m/s2], and drag [kg/m]."""
    power, rolling_resistance, drag = config.powers or _shipped()
    return power, GRAVITY * (grade + rolling_resistance), drag


def roll_out(
    start: SpeedState,
    path: LanePath,
    cap: FloatArray,
    leads: list[Lead],
    mass: float,
    preview: RoadPreview,
    steps: int,
    step: float,
    config: SpeedConfig,
    stop: float = math.inf,
    emergency: float = 0.0,
    hold: bool = False,
    braking: float | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Station, speed and acceleration at steps + 1 instants, the first being now.

    Args:
      start: initial state.
      path: gives the stations of cap.
      cap: from `speed_cap`.
      leads: vehicles to follow.
      mass: of the combination [kg].
      preview: of the road, for the grade.
      steps: number of steps.
      step: [s].
      config: limits.
      stop: station at which to stop at the latest [m].
      emergency: deceleration of emergency braking, positive [m/s2]; 0: no emergency.
      hold: the truck comes to rest at once and stays.
      braking: deceleration towards the stop, positive [m/s2]; default: the preview deceleration.
    """
    count = len(path.station)
    grade = preview.grade_at(start.station)
    rows = np.empty((3, steps + 1))
    _roll_out(
        config.following.table.address,
        *(start.station, start.speed, start.acceleration),
        *(kernels.address(cap), count, float(path.station[0]), preview.step),
        *(lead_table(leads), len(leads)),
        *(mass, *_powers(grade, config)),
        *(stop, braking or config.following.preview_deceleration, HOLD_REACH),
        *(emergency, hold, steps, step),
        kernels.address(rows),
    )
    station, speed, acceleration = rows
    return station, speed, acceleration
