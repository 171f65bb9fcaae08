"""Puts a truck at the start that was asked for."""

from __future__ import annotations

from iits_mj.errors import InputError
from iits_mj.messages import EgoFootprint
from iits_mj.road import Route
from iits_mj.simulation.config import TruckStart
from iits_mj.simulation.ending import END_MARGIN

_ROOM = 10.0


def check_start(start: TruckStart, route: Route, footprint: EgoFootprint) -> None:
    """Holds a start against the route.

    Raises:
      InputError: it is not on the route, or its lane does not exist there.
    """
    first, last = footprint.length, route.length - END_MARGIN - _ROOM
    if not first <= start.start_station <= last:
        raise InputError(
            f"start-station {start.start_station:g} m is not on the route; use "
            f"{first:.0f} to {last:.0f} m of its {route.length:.0f} m"
        )
    lanes = route.lane_count(start.start_station)
    if not 0 <= start.start_lane < lanes:
        raise InputError(
            f"start-lane {start.start_lane} does not exist at station "
            f"{start.start_station:g} m; use 0 to {lanes - 1}"
        )
