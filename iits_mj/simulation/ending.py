"""What ends a drive from the truck's own side: no road any more, on its side, off the road."""

from __future__ import annotations

import dataclasses
import math
import operator
from typing import NamedTuple

from iits_mj.errors import Error
from iits_mj.messages import EgoFootprint, EgoState
from iits_mj.road import Route

# A drive ends when the front bumper is this close to the end of the route [m].
END_MARGIN = 5.0
# Nothing brings a truck back that is tilted this much; the physics goes on to be good for a while,
# and diverges when the truck lies on its roof [rad].
ROLL_OVER = 1.2
# The truck has left the road when it is this far beyond it: the rear bumper beyond its begin, the
# steer axle's centre beside the paved surface, of both directions and with the shoulders [m].
LEAVE_MARGIN = 5.0


_numbers = operator.attrgetter(
    *(field.name for field in dataclasses.fields(EgoState) if field.name != "brake_pressures")
)


class DivergedError(Error):
    """The simulation diverged, or a number of the truck's state is not finite."""


class Ending(NamedTuple):
    """Why a drive is over, in words, and whether that is a failure."""

    reason: str
    failed: bool


def check_finite(ego: EgoState) -> None:
    """Holds every number of a state to be finite.

    Raises:
      DivergedError: one is not.
    """
    if all(map(math.isfinite, (*_numbers(ego), *ego.brake_pressures))):
        return
    for field in dataclasses.fields(ego):
        value = getattr(ego, field.name)
        values = value if isinstance(value, tuple) else (value,)
        if not all(map(math.isfinite, values)):
            raise DivergedError(
                f"the simulation diverged: {field.name} = {value!r} at t = {ego.time:.2f} s"
            )


def find_ending(ego: EgoState, route: Route, footprint: EgoFootprint) -> Ending | None:
    """A roll-over or the end of the route; None while neither has come."""
    if abs(ego.roll) > ROLL_OVER:
        return Ending(f"rolled over at t = {ego.time:.2f} s", failed=True)
    if ego.station + footprint.front_overhang >= route.length - END_MARGIN:
        return Ending("reached the end of the route", failed=False)
    return None


def find_leaving(ego: EgoState, route: Route, footprint: EgoFootprint) -> Ending | None:
    """That the truck left the road at its begin or sideways; None while it is on it.

    For the physics the road's plane goes on there; what is really there, it does not know.
    """
    at = f"at t = {ego.time:.2f} s, {LEAVE_MARGIN:g} m"
    if ego.station + footprint.front_overhang - footprint.length < -LEAVE_MARGIN:
        return Ending(f"left the road {at} before its begin", failed=True)
    right, left = route.surface_edges(ego.station)
    if ego.offset < float(right) - LEAVE_MARGIN:
        return Ending(f"left the road {at} to the right of it", failed=True)
    if ego.offset > float(left) + LEAVE_MARGIN:
        return Ending(f"left the road {at} to the left of it", failed=True)
    return None
