"""Speed over the coming seconds: limits ahead, leaders, the engine's power, emergencies."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from controllers.planning.following import (
    FollowingConfig,
    Lead,
    braking_profile,
    curve_speed,
    follow_acceleration,
    required_deceleration,
)
from controllers.planning.road_preview import LanePath, RoadPreview
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import require_positive
from iits_mj.core.messages import SpeedProfile
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters

# The cap is met by looking this far ahead [s]: far for a smooth onset, near for an exact end.
_LOOK_AHEAD = (1.0, 0.4)
# Looking ahead, a stop would be crept up to for ever: slower than this it is made by the way that
# is left [m/s].
_LAST_SPEED = 2.0
# Who has come to rest this near to a stop stays there [m], braking by this much [m/s2].
HOLD_REACH = 1.0
_HOLD_DECELERATION = 1.2


class Powers(NamedTuple):
    """Of a truck: power at the wheels [W], rolling resistance [1], 0.5 rho CdA [kg/m]."""

    power: float
    rolling_resistance: float
    drag: float


def powers(parameters: TruckParameters) -> Powers:
    """Greatest power at the wheels in the best gear, and the resistances."""
    engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
    greatest = float((engine.full_load_torque * engine.full_load_speed).max())
    return Powers(
        greatest * gearbox.efficiency * gearbox.driveline_efficiency,
        parameters.tire_common.rolling_resistance,
        0.5 * air.density * air.drag_area,
    )


@functools.cache
def _shipped() -> Powers:
    return powers(TruckParameters.load())


@dataclass(frozen=True)
class SpeedConfig:
    """Longitudinal limits of the plan.

    Attributes:
      cruise_speed: wanted where no profile is given [m/s]; the paper's 60 km/h.
      curve_acceleration: lateral acceleration that bounds the speed in curves [m/s2].
      preview: how far ahead limits are looked up [m].
      stop_gap: left before the end of the lane or of the road, from the front bumper [m].
      powers: of the truck, for the acceleration that can be planned: with less power than it has
        the plan would hold it back after a climb. None: of the planner's truck, or the shipped one.
      emergency_onset: required deceleration that calls the last layer, and the least that is
        demanded then [m/s2].
      emergency_release: required deceleration that the ordinary plan can be left with [m/s2].
      emergency_share: of the required deceleration that is demanded, above 1.
      emergency_deceleration: demanded at most [m/s2].
      emergency_margin: gap wanted after an emergency stop [m].
      reaction_time: of the brakes, for the required deceleration [s].
      following: see `FollowingConfig`.

    Raises:
      InputError: a setting cannot be; the message names it.
    """

    cruise_speed: float = 16.67
    curve_acceleration: float = 1.3
    preview: float = 400.0
    stop_gap: float = 3.0
    powers: Powers | None = None
    emergency_onset: float = 2.8
    emergency_release: float = 2.0
    emergency_share: float = 1.3
    emergency_deceleration: float = 6.5
    emergency_margin: float = 2.0
    reaction_time: float = 0.5
    following: FollowingConfig = field(default_factory=FollowingConfig)

    def __post_init__(self) -> None:
        names = "cruise_speed", "curve_acceleration", "preview", "emergency_onset"
        require_positive(self, *names, "emergency_release", "emergency_deceleration")
        require_positive(self, "emergency_share")
        if self.powers is not None:
            require_positive(self.powers, *Powers._fields)
        require_positive(self, "stop_gap", "emergency_margin", "reaction_time", zero=True)


def speed_cap(
    path: LanePath,
    preview: RoadPreview,
    config: SpeedConfig,
    profile: SpeedProfile | None = None,
) -> FloatArray:
    """Highest comfortable speed along a path, shape of path.station [m/s].

    The least of cruise speed or profile, the lane's limit and curve speed, each approached at the
    preview deceleration.
    """
    station = path.station
    wanted = (
        np.full(len(station), config.cruise_speed)
        if profile is None
        else np.interp(station, profile.station, profile.speed)
    )
    cap = np.minimum(wanted, path.speed_limit)
    cap = np.minimum(cap, curve_speed(preview.sharpest(path), config.curve_acceleration))
    return braking_profile(station, cap, config.following.preview_deceleration)


def most_urgent(leads: list[Lead], speed: float, config: SpeedConfig) -> float:
    """Greatest deceleration that any leader requires of the truck now, positive [m/s2].

    A braking leader counts with the speed that it will have after the brakes' reaction time, and
    must not be reached even if it stops.
    """
    worst = 0.0
    for lead in leads:
        way, lead_speed = lead.at(config.reaction_time)
        gap = lead.gap + way - speed * config.reaction_time
        needed = required_deceleration(gap, speed, lead_speed, config.emergency_margin)
        if lead.acceleration < -1.0:
            # Both stop: the leader's own stopping way is room, too.
            room = gap - config.emergency_margin + lead_speed**2 / (-2.0 * lead.acceleration)
            needed = max(needed, speed**2 / (2.0 * max(room, 0.1)))
        worst = max(worst, needed)
    return worst


@dataclass(frozen=True)
class SpeedState:
    """Where the speed plan begins: station [m], speed [m/s], acceleration [m/s2]."""

    station: float
    speed: float
    acceleration: float


def power_acceleration(speed: float, mass: float, grade: float, config: SpeedConfig) -> float:
    """Acceleration that the engine's power leaves at a speed, 0.05 m/s2 at least [m/s2].

    The floor keeps the plan asking for full power where the truck cannot hold its speed.
    """
    return _power_left(mass, grade, config)(speed)


def _power_left(mass: float, grade: float, config: SpeedConfig) -> Callable[[float], float]:
    """`power_acceleration` over speed."""
    power, rolling_resistance, drag = config.powers or _shipped()
    rolling_and_slope = GRAVITY * (grade + rolling_resistance)

    def left(speed: float) -> float:
        resistance = rolling_and_slope + drag * speed**2 / mass
        found = power / (mass * (speed if speed > 3.0 else 3.0)) - resistance
        return found if found > 0.05 else 0.05

    return left


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
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Station, speed and acceleration at steps + 1 instants, the first being now.

    Args:
      start: initial state.
      path: gives the stations of cap.
      cap: from `speed_cap`.
      leads: vehicles to follow.
      mass: of the combination [kg].
      preview: gives the grade, for the power that is left to accelerate.
      steps: number of steps.
      step: [s].
      config: limits.
      stop: station at which to stand at the latest [m], for the end of lane or road.
      emergency: brake this hard instead of following, positive [m/s2]; 0: follow.
      hold: come to rest here and stay.
    """
    following = config.following
    rows: list[tuple[float, float, float]] = []
    s, v, a = start.station, max(start.speed, 0.0), start.acceleration
    grade = float(np.interp(s, preview.station, preview.grade))
    power_left = _power_left(mass, grade, config)
    first, inverse = float(path.station[0]), 1.0 / preview.step
    caps, last = cap.tolist(), len(cap) - 1
    rises = (cap[1:] - cap[:-1]).tolist()

    wanted_braking = following.preview_deceleration
    braking = 2.0 * wanted_braking
    # Where the stop is not in force yet: the square root is not needed.
    near_stop = stop - max(caps) ** 2 / braking

    def cap_at(place: float, creeping: bool = False) -> float:
        position = (place - first) * inverse
        if position <= 0.0:
            cap_here = caps[0]
        elif position >= last:
            cap_here = caps[last]
        else:
            row = int(position)
            cap_here = caps[row] + (position - row) * rises[row]
        if place > near_stop and not creeping:
            cap_here = min(cap_here, math.sqrt(braking * max(stop - place, 0.0)))
        return cap_here

    far, near = _LOOK_AHEAD
    down, up = following.jerk_max * step, 0.5 * (following.jerk_max * step)
    least, most = -following.deceleration_max, following.acceleration_max
    for k in range(steps + 1):
        time = k * step
        if k:
            moved, v_next = v * step + 0.5 * a * step * step, v + a * step
            moved = moved if moved > 0.0 else 0.0
            # Standing still within the step: the way to the stop, not beyond.
            s += moved if v_next > 0.0 or a >= 0.0 else min(moved, v * v / max(-2.0 * a, 1e-6))
            v = v_next if v_next > 0.0 else 0.0
        wanted = -emergency
        hold = hold or (k > 0 and v <= 0.0 and s > stop - HOLD_REACH)
        if not emergency:
            slow = v < _LAST_SPEED
            to_cap = (cap_at(s + v * far, slow) - v) / far
            soon = (cap_at(s + v * near, slow) - v) / near
            to_cap = soon if soon < to_cap else to_cap
            if hold:
                to_cap = -_HOLD_DECELERATION
            elif slow and s > near_stop:
                to_cap = min(to_cap, _to_stop(v, stop - s, wanted_braking, following))
            wanted = to_cap if to_cap < most else most
            if leads:
                way, free = s - start.station, cap_at(s)
                wanted = min(wanted, _behind(v, way, time, free, to_cap, leads, following))
            wanted = wanted if wanted > least else least
            left = power_left(v)
            wanted = left if left < wanted else wanted
            slowest, fastest = a - down, a + up
            wanted = slowest if wanted < slowest else fastest if wanted > fastest else wanted
        a = wanted
        # At a stop the brakes stay on until the truck is at rest, too: it may lag behind the plan.
        if v <= 0.0 and a < 0.0 and not (hold and start.speed > 0.0):
            a = 0.0
        rows.append((s, v, a))
    station, speed, acceleration = np.array(rows).T.copy()
    return station, speed, acceleration


def _to_stop(v: float, left: float, braking: float, following: FollowingConfig) -> float:
    """Acceleration [m/s2] of the last metres before a stop, which ends at rest in finite time.

    The constant deceleration that is needed, `v^2 / (2 left)`, once it is 0.8 of what is meant;
    drive where it is less than half of that.
    """
    if left < 0.05:
        return -_HOLD_DECELERATION
    needed = v * v / (2.0 * left)
    share = needed / braking
    if share < 0.5:
        return following.acceleration_max * (1.0 - 2.0 * share)
    return -needed if share > 0.8 else -0.8 * braking * (share - 0.5) / 0.3


def _behind(
    v: float,
    way: float,
    time: float,
    cap_here: float,
    to_cap: float,
    leads: list[Lead],
    following: FollowingConfig,
) -> float:
    """Acceleration that every leader allows [m/s2].

    On the free road the cap is followed as it stands, rising parts as well: the free term of car
    following would lag a rising reference by `v / (4 a)`, some 5 s. Behind a leader that term gets
    a desired speed high enough not to lag either.
    """
    wanted = math.inf
    desired = _desired_speed(v, cap_here, to_cap, following)
    for lead in leads:
        if time > lead.until:
            continue
        lead_way, lead_speed = lead.at(time)
        fading = lead.acceleration * math.exp(-0.5 * time) if lead_speed > 0.0 else 0.0
        gap = lead.gap + lead_way - way
        behind = follow_acceleration(v, desired, gap, lead_speed, fading, following)
        wanted = min(wanted, behind)
    return wanted


def _desired_speed(v: float, cap: float, to_cap: float, following: FollowingConfig) -> float:
    """Desired speed whose free term, `a (1 - (v / desired)^n)`, is no less than `to_cap` [m/s]."""
    share = min(max(to_cap / following.acceleration_max, 0.0), 0.9)
    return max(cap, v / (1.0 - share) ** (1.0 / following.exponent))
