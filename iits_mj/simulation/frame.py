"""A drive at one instant: `DriveFrame`, the signals that the driver sees, and what ends a drive."""

from __future__ import annotations

import dataclasses
import math
import operator
from dataclasses import dataclass
from typing import NamedTuple

from iits_mj.core.errors import Error
from iits_mj.core.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    SpeedZone,
    TrafficLight,
    Trajectory,
    VehicleCommand,
)
from iits_mj.road import Route
from traffic_bridge import LightAhead, Traffic

# A drive ends when the front bumper is this close to the end of the route [m].
END_MARGIN = 5.0
# No truck recovers from this roll; the physics stays sound for a while and diverges when the truck
# lies on its roof [rad].
ROLL_OVER = 1.2
# The truck has left the road when it is this far off it: the rear bumper before the road's start,
# or the steer axle's centre beside the paved surface of both directions with shoulders [m].
LEAVE_MARGIN = 5.0
# A changed speed limit further away than this is not seen [m].
SIGHT = 500.0
# Stop lines of the lanes of one crossing lie within this [m].
SAME_LINE = 15.0
# A stop line is reported until the front bumper is this far beyond it, so that a truck that stops
# on the line still sees it; more than the truck drives in a cycle [m].
BEHIND = 4.0
# Below this speed a time gap says nothing [m/s].
_SLOWEST = 1.0

_numbers = operator.attrgetter(
    *(field.name for field in dataclasses.fields(EgoState) if field.name != "brake_pressures")
)


@dataclass(frozen=True, slots=True)
class DriveFrame:
    """One instant of a drive.

    Attributes:
      time: simulation time [s].
      ego: the truck now; scene: what the driver saw at the start of this 100 ms cycle.
      trajectory: the plan that is followed; command: what the truck is sent.
      decision: the last decision of the decision maker.
      lane: the truck's lane from the right, -1 outside every lane; lane_count: lanes here.
      grade: of the road at the steer axle, dz/ds; curvature: of the route [1/m], positive left.
      speed_limit: of the road [m/s]; reference_speed: requested of the truck [m/s].
      gap_ahead, gap_behind: bumper to bumper in the truck's lane [m], inf without a vehicle.
      box_distance: to the nearest other vehicle, box to box [m], inf without one.
      distance: driven since the start [m]; lane_changes, refused: counted since the start.
    """

    time: float
    ego: EgoState
    scene: Scene
    trajectory: Trajectory
    command: VehicleCommand
    decision: Decision
    lane: int
    lane_count: int
    grade: float
    curvature: float
    speed_limit: float
    reference_speed: float
    gap_ahead: float
    gap_behind: float
    box_distance: float
    distance: float
    lane_changes: int
    refused: int

    @property
    def time_gap(self) -> float:
        """Time gap to the vehicle ahead [s]; inf without one and below 1 m/s."""
        speed = self.ego.speed
        return self.gap_ahead / speed if speed > _SLOWEST else math.inf


class DivergedError(Error):
    """The simulation diverged, or a number of the truck's state is not finite."""


class Ending(NamedTuple):
    """Why a drive is over, in words, and whether that is a failure."""

    reason: str
    failed: bool


def check_finite(ego: EgoState) -> None:
    """Checks that every number of a state is finite.

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
    """Returns a roll-over or the end of the route, None when neither is reached."""
    if abs(ego.roll) > ROLL_OVER:
        return Ending(f"rolled over at t = {ego.time:.2f} s", failed=True)
    if ego.station + footprint.front_overhang >= route.length - END_MARGIN:
        return Ending("reached the end of the route", failed=False)
    return None


def find_leaving(ego: EgoState, route: Route, footprint: EgoFootprint) -> Ending | None:
    """Returns where the truck left the road, before its start or sideways; None while it is on it.

    The physics continues the road's plane there; the real terrain is not known.
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


def read_signals(
    traffic: Traffic | None, ego: EgoState, route: Route, footprint: EgoFootprint
) -> RoadSignals:
    """Returns the next light (or the one just passed) and the changed limits near the truck.

    Args:
      traffic: the running traffic, None for an empty road.
      ego: the truck.
      route: its road.
      footprint: its size.
    """
    signals = None if traffic is None else traffic.signal_controller()
    if signals is None:
        return RoadSignals()
    front = ego.station + footprint.front_overhang
    light = signals.light_ahead(front - BEHIND)
    lane = int(route.lane_at(ego.station, ego.offset))
    own = signals.light_ahead(front - BEHIND, lane) if light is not None and lane >= 0 else None
    # Lanes may be numbered differently at the line; the truck must not run it for that reason.
    if own is not None and light is not None and own.station < light.station + SAME_LINE:
        light = own
    zones = tuple(
        SpeedZone(rule.start, rule.end, rule.limit, rule.lane)
        for rule in signals.limits.rules
        if rule.end > ego.station - SIGHT and rule.start < ego.station + SIGHT
    )
    return RoadSignals(None if light is None else _light_message(light), zones)


def _light_message(light: LightAhead) -> TrafficLight:
    following = None if light.next_letter is None else _light_state(light.next_letter)
    return TrafficLight(light.station, _light_state(light.letter), light.next_switch, following)


def _light_state(letter: str) -> LightState:
    """Returns the state of a SUMO letter: "o", "O" off; "u" red with yellow; "s" green arrow."""
    if letter in "gGoO":
        return LightState.GREEN
    if letter == "s":
        return LightState.STOP
    return LightState.YELLOW if letter in "yY" else LightState.RED
