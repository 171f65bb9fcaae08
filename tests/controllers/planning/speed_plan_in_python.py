"""Python form of the compiled speed plan, see `iits_mj/kernels/speed_plan.cc`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from controllers.planning.config import FollowingConfig, Powers, SpeedConfig
from controllers.planning.following import Lead, braking_profile, curve_speed
from controllers.planning.road_preview import LanePath, RoadPreview, strongest
from controllers.planning.speed_caps import LAUNCH_ACCELERATION, LAUNCH_SPEED
from controllers.planning.speed_plan import HOLD_REACH, SpeedState
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import SpeedProfile
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters

_LOOK_AHEAD = (1.0, 0.4)
_LAST_SPEED = 2.0
_HOLD_DECELERATION = 1.2
LEAST_ROOM = 0.1


def speed_cap(
    path: LanePath, preview: RoadPreview, config: SpeedConfig, wanted: FloatArray
) -> FloatArray:
    """Greatest comfortable speed along a path at a wanted speed [m/s], shape of path.station."""
    curvature = np.interp(path.station, preview.station, preview.curvature)
    bend = curvature / np.maximum(1.0 - curvature * np.nan_to_num(path.offset), 0.2)
    cap = np.minimum(wanted, path.speed_limit)
    cap = np.minimum(cap, curve_speed(strongest(bend), config.curve_acceleration))
    return braking_profile(path.station, cap, config.following.preview_deceleration)


def reference(station: FloatArray, profile: SpeedProfile, here: float, speed: float) -> FloatArray:
    """Reference speed at even stations [m/s] for a truck at a station [m] and a speed [m/s]."""
    square = np.interp(station, profile.station, profile.speed**2)
    if speed < LAUNCH_SPEED:
        ahead, step = station - here, float(station[1] - station[0])
        near = (ahead >= 0.0) & (ahead < 200.0)
        most = float(square[near].max()) if near.any() else 0.0
        launch = speed**2 + 2.0 * LAUNCH_ACCELERATION * np.maximum(ahead, step)
        square = np.maximum(square, np.minimum(launch, most))
    return np.asarray(np.sqrt(square))


def lead_at(lead: Lead, time: float) -> tuple[float, float]:
    """Distance driven since now [m] and speed [m/s], by `a(t) = a exp(-t / 2 s)`."""
    fade = 2.0 * (1.0 - math.exp(-0.5 * time))
    speed = lead.speed + lead.acceleration * fade
    if speed <= 0.0 < -lead.acceleration:
        return lead.speed**2 / max(-2.0 * lead.acceleration, 1e-3), 0.0
    way = lead.speed * time + lead.acceleration * 2.0 * (time - fade)
    return max(way, 0.0), max(speed, 0.0)


def idm_acceleration(
    speed: float, desired: float, gap: float, lead_speed: float, config: FollowingConfig
) -> float:
    """Acceleration of the improved IDM [m/s2]: its free term is -b above the desired speed."""
    a, b = config.acceleration_max, config.deceleration
    desired = max(desired, 0.1)
    if speed <= desired:
        free = a * (1.0 - (speed / desired) ** config.exponent)
    else:
        free = -b * (1.0 - (desired / speed) ** (a * config.exponent / b))
    wanted = config.standstill_gap + max(
        0.0,
        speed * config.time_gap + speed * (speed - lead_speed) / (2.0 * math.sqrt(a * b)),
    )
    ratio = wanted / max(gap, 0.1)
    if ratio >= 1.0:
        return a * (1.0 - ratio**2) + min(free, 0.0)
    if speed > desired or free <= 1e-6:
        return free
    return free * (1.0 - ratio ** (2.0 * a / free))


def follow_acceleration(
    speed: float,
    desired: float,
    gap: float,
    lead_speed: float,
    lead_acceleration: float,
    config: FollowingConfig,
) -> float:
    """Acceleration of the ACC model [m/s2]: IDM with the constant-acceleration heuristic.

    Source: Kesting, Treiber and Helbing, Phil. Trans. R. Soc. A 368 (2010), equations 2.6 to 2.8.
    """
    idm = idm_acceleration(speed, desired, gap, lead_speed, config)
    if not math.isfinite(gap):
        return idm
    # The heuristic stops at the standstill gap, too: the source has the bare gap.
    gap = max(gap - config.standstill_gap, 0.1)
    lead = min(lead_acceleration, config.acceleration_max)
    closing = speed - lead_speed
    if lead < 0.0 and lead_speed * closing <= -2.0 * gap * lead:
        heuristic = speed**2 * lead / (lead_speed**2 - 2.0 * gap * lead)
    else:
        heuristic = lead - max(closing, 0.0) ** 2 / (2.0 * gap)
    if idm >= heuristic:
        return idm
    regain = config.regain_deceleration
    tempered = heuristic + regain * math.tanh((idm - heuristic) / regain)
    return (1.0 - config.coolness) * idm + config.coolness * tempered


def required_deceleration(gap: float, speed: float, lead_speed: float, margin: float) -> float:
    """Constant deceleration that just avoids closing the gap to `margin`, positive [m/s2]."""
    closing = speed - lead_speed
    if closing <= 0.0:
        return 0.0
    return closing**2 / (2.0 * max(gap - margin, LEAST_ROOM))


def most_urgent(leads: list[Lead], speed: float, config: SpeedConfig) -> float:
    """Greatest deceleration that any leader requires of the truck now, positive [m/s2].

    A braking leader counts with its speed after the brakes' reaction time, and the truck must not
    reach it even if it stops.
    """
    worst = 0.0
    for lead in leads:
        way, lead_speed = lead_at(lead, config.reaction_time)
        gap = lead.gap + way - speed * config.reaction_time
        needed = required_deceleration(gap, speed, lead_speed, config.emergency_margin)
        if lead.acceleration < -1.0:
            # Both stop: the leader's stopping distance adds to the room.
            room = gap - config.emergency_margin + lead_speed**2 / (-2.0 * lead.acceleration)
            needed = max(needed, speed**2 / (2.0 * max(room, LEAST_ROOM)))
        worst = max(worst, needed)
    return worst


def power_acceleration(speed: float, mass: float, grade: float, config: SpeedConfig) -> float:
    """Acceleration that the engine's power allows at a speed [m/s2], 0.05 m/s2 at least.

    With this least value the plan demands full power where the truck cannot hold its speed.
    """
    return _power_left(mass, grade, config)(speed)


def _power_left(mass: float, grade: float, config: SpeedConfig) -> Callable[[float], float]:
    """`power_acceleration` over speed."""
    power, rolling_resistance, drag = config.powers or Powers.of(TruckParameters.load())
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
    """Station, speed and acceleration at steps + 1 instants, the first being now."""
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
    # Before this station the stop does not bound the speed.
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
            # If the truck stops within the step, it moves only until then.
            s += moved if v_next > 0.0 or a >= 0.0 else v * v / (-2.0 * a)
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
        # At a hold the brakes stay on: the truck may come to rest later than the plan.
        if v <= 0.0 and a < 0.0 and not (hold and start.speed > 0.0):
            a = 0.0
        rows.append((s, v, a))
    station, speed, acceleration = np.array(rows).T.copy()
    return station, speed, acceleration


def _to_stop(v: float, left: float, braking: float, following: FollowingConfig) -> float:
    """Acceleration over the last meters before a stop [m/s2], which ends in finite time.

    The needed constant deceleration, `v^2 / (2 left)`, if it exceeds 0.8 of the wanted one; a
    positive acceleration if it is less than half of the wanted one.
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

    On the free road the plan follows the cap exactly, also where it rises: the free term of car
    following would lag a rising reference by `v / (4 a)`, some 5 s. Behind a leader the desired
    speed of that term is high enough not to lag either.
    """
    wanted = math.inf
    desired = _desired_speed(v, cap_here, to_cap, following)
    for lead in leads:
        if time > lead.until:
            continue
        lead_way, lead_speed = lead_at(lead, time)
        fading = lead.acceleration * math.exp(-0.5 * time) if lead_speed > 0.0 else 0.0
        gap = lead.gap + lead_way - way
        behind = follow_acceleration(v, desired, gap, lead_speed, fading, following)
        wanted = min(wanted, behind)
    return wanted


def _desired_speed(v: float, cap: float, to_cap: float, following: FollowingConfig) -> float:
    """Desired speed whose free term, `a (1 - (v / desired)^n)`, is no less than `to_cap` [m/s]."""
    share = min(max(to_cap / following.acceleration_max, 0.0), 0.9)
    return max(cap, v / (1.0 - share) ** (1.0 / following.exponent))
