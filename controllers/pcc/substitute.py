"""What is driven where the optimizer has no answer: last plan, schedule, cruise; no solver needed.

The first that holds is taken: it begins at the truck's speed, keeps the limits and stays behind the
vehicle ahead. The cruise at v_ref within all limits always does, as well as the truck can.
"""

from __future__ import annotations

import numpy as np

from controllers.pcc.fence import Leader, approach_speeds, braking_speeds, fence_of
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import cruise_from
from controllers.pcc.trip import Trip
from iits_mj.core.arrays import FloatArray
from iits_mj.errors import PlanningError
from iits_mj.messages import SpeedProfile

_KEEP = 500.0  # [m] that a kept plan must still cover
_KEEP_SPEED = 1.0  # [m/s] by which a kept plan may miss the truck's speed
_SOON = 1.0  # [s] by which a kept plan may pass the fence too early


def substitute(
    trip: Trip, road: RoadProfile, speed: float, leader: Leader | None, last: SpeedProfile | None
) -> tuple[FloatArray, str]:
    """Node speeds (n + 1,) of the first of last plan, schedule and cruise that holds, and its name.

    Args:
      trip: under way.
      road: ahead.
      speed: at its first node [m/s].
      leader: vehicle ahead, if any.
      last: the last plan, if any.
    """
    schedule, start = trip.ahead_of(float(road.station[0])), float(road.station[0])
    if last is not None and last.station[-1] - start > _KEEP:
        held = np.interp(road.station, last.station, last.speed)
        if _holds(trip, road, held, speed, leader):
            return held, "kept"
    if schedule is not None:
        held = np.asarray(schedule.speed_at(road.station))
        if _holds(trip, road, held, speed, leader):
            return held, "schedule"
    slowest = braking_speeds(trip.vehicle, road, speed)
    try:
        held = cruise_from(trip.vehicle, road, trip.config.v_ref, speed, slowest)
    except PlanningError:
        # Not even that can be driven: ask for the limits and let the truck do its best.
        held = np.minimum(road.v_limit, trip.config.v_ref)
    if leader is not None:
        held = np.minimum(held, approach_speeds(road, speed, leader, trip.receding.fence))
    return held, "cruise"


def _holds(
    trip: Trip, road: RoadProfile, held: FloatArray, speed: float, leader: Leader | None
) -> bool:
    """Whether speeds begin at the truck's, keep the limits and stay behind the leader."""
    near = abs(held[0] - speed) < _KEEP_SPEED
    lawful = bool((held[1:] <= road.v_limit[1:] + 1e-6).all())
    settings = trip.receding.fence
    if not (near and lawful) or leader is None:
        return near and lawful
    if leader.pace < settings.jam:
        return False
    try:
        fence = fence_of(trip.vehicle, road, speed, leader, settings)
    except PlanningError:
        return False
    return fence.kept(road, held, _SOON)
