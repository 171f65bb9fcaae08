"""Limits of changing signs, laid over a lane's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.road_preview import LanePath
from iits_mj.errors import InputError
from iits_mj.messages import SpeedZone


def with_zones(path: LanePath, zones: Sequence[SpeedZone]) -> LanePath:
    """The path with the limits of the zones; where two overlap the later one holds.

    Between the path's stations limits are interpolated: a lower one reaches to the next station on
    both sides, so that the truck is down to it at the sign and keeps it to the end.

    Raises:
      InputError: a zone's limit is no positive number, or its ends are none.
    """
    if not zones:
        return path
    limit = path.speed_limit.copy()
    lanes = np.full(len(limit), path.lane) if path.rows is None else path.rows
    step = float(path.station[1] - path.station[0])
    for zone in zones:
        if not zone.limit > 0.0 or np.isnan([zone.start, zone.end]).any():
            raise InputError(
                f"speed zone of {zone.limit} m/s from {zone.start} to {zone.end} m: "
                "the limit must be positive and the ends numbers"
            )
        here = np.full(len(lanes), True) if zone.lane is None else lanes == zone.lane
        inside = here & (path.station >= zone.start) & (path.station < zone.end)
        near = here & (path.station > zone.start - step) & (path.station < zone.end + step)
        limit[inside] = zone.limit
        limit[near] = np.minimum(limit[near], zone.limit)
    return replace(path, speed_limit=limit)
