"""A drive at one instant, the road signals that the driver sees, and the ends of a drive."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

from controllers.emergency_braking import EmergencyReport
from iits_mj.core.errors import Error
from iits_mj.core.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    SignalLamp,
    SpeedZone,
    TrafficLight,
    Trajectory,
    VehicleCommand,
    not_finite,
)
from iits_mj.road import Route
from traffic_bridge import LightAhead, RepSim, Traffic

# A drive ends when the front bumper is this close to the end of the route [m].
END_MARGIN = 5.0
# A truck does not recover from this roll [rad]. The physics stays valid for a while longer and
# diverges when the truck lies on its roof.
ROLL_OVER = 1.2
# The truck has left the road when its rear bumper is this far before the road's start, or the steer
# axle's centre this far beside the pavement of both directions, shoulders included [m].
LEAVE_MARGIN = 5.0
# The driver sees changed speed limits up to this distance [m].
SIGHT = 500.0
# Stop lines of the lanes of one crossing lie within this [m].
SAME_LINE = 15.0
# A stop line is reported until the front bumper is this far beyond it [m]: a truck that stops on
# the line still sees it, and no cycle is long enough to skip it.
BEHIND = 4.0
# Below this speed a time gap has no meaning [m/s].
_SLOWEST = 1.0


@dataclass(frozen=True, slots=True)
class DriveFrame:
    """State of a drive at one instant.

    Attributes:
      time: simulation time [s].
      ego: the truck now; scene: the driver's scene at the start of this 100 ms cycle.
      trajectory: the plan that is followed; command: the command that reaches the truck.
      decision: the last decision of the decision maker.
      lane: the truck's lane from the outside, -1 outside every lane; lane_count: lanes here.
      grade: of the road at the steer axle, dz/ds; curvature: of the route [1/m], positive left.
      speed_limit: of the road [m/s]; reference_speed: requested of the truck [m/s].
      gap_ahead, gap_behind: bumper to bumper in the truck's lane [m], inf without a vehicle.
      box_distance: to the nearest other vehicle, box to box [m], inf without one.
      distance: driven since the start [m]; lane_changes, refused: counted since the start.
      emergency: report of the emergency braking, None without one.
      steering_wheel_torque: of the driver, left positive [N m]; nan where it is not known.
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
    emergency: EmergencyReport | None = None
    steering_wheel_torque: float = math.nan

    @property
    def time_gap(self) -> float:
        """Time gap to the vehicle ahead [s]; inf without one and below 1 m/s."""
        speed = self.ego.speed
        return self.gap_ahead / speed if speed > _SLOWEST else math.inf


class DivergedError(Error):
    """The simulation diverged, or a number of the truck's state is not finite."""


class Impact(NamedTuple):
    """A collision of the truck.

    Attributes:
      time: of the first contact [s]; vehicle: id; body: of the truck that is touched.
      speed: magnitude of the difference of both velocities [m/s].
    """

    time: float
    vehicle: str
    body: str
    speed: float


class Ending(NamedTuple):
    """Reason why a drive is over, and whether it is a failure."""

    reason: str
    failed: bool


def check_finite(ego: EgoState) -> None:
    """Checks that every number of a state is finite.

    Raises:
      DivergedError: a number is not finite; names it.
    """
    found = not_finite(ego)
    if found:
        raise DivergedError(f"the simulation diverged: {found} at t = {ego.time:.2f} s")


def find_ending(ego: EgoState, route: Route, footprint: EgoFootprint) -> Ending | None:
    """Returns a roll-over or an end of the route that the truck has reached; None without them."""
    if abs(ego.roll) > ROLL_OVER:
        return Ending(f"rolled over at t = {ego.time:.2f} s", failed=True)
    if ego.station + footprint.front_overhang >= route.length - END_MARGIN:
        return Ending("reached the end of the route", failed=False)
    if ego.station + footprint.front_overhang - footprint.length < -LEAVE_MARGIN:
        text = f"left the road at t = {ego.time:.2f} s, {LEAVE_MARGIN:g} m before its begin"
        return Ending(text, failed=True)
    return None


def find_leaving(ego: EgoState, route: Route) -> Ending | None:
    """Returns the end of a drive that left the road sideways; else None.

    Beyond the road the physics continues the road's plane; the real terrain is unknown.
    """
    at = f"at t = {ego.time:.2f} s, {LEAVE_MARGIN:g} m"
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

    Without traffic, or without events in it, there are none. Without SUMO the lights are those
    whose states the events set; recorded traffic has the recorded lamps, for pictures.
    """
    signals = None if traffic is None else traffic.signal_controller()
    front = ego.station + footprint.front_overhang
    if signals is None:
        scenario = None if traffic is None else traffic.running_scenario()
        shown = None if scenario is None else scenario.light_ahead(front - BEHIND)
        lamps = traffic.lamps if isinstance(traffic, RepSim) else ()
        return RoadSignals(None if shown is None else _light_message(shown), lamps=lamps)
    light = signals.light_ahead(front - BEHIND)
    lane = int(route.lane_at(ego.station, ego.offset))
    own = signals.light_ahead(front - BEHIND, lane) if light is not None and lane >= 0 else None
    # Lane numbers may change before the line; without this the truck could run a light.
    if own is not None and light is not None and own.station < light.station + SAME_LINE:
        light = own
    zones = tuple(
        SpeedZone(rule.start, rule.end, rule.limit, rule.lane)
        for rule in signals.limits.rules
        if rule.end > ego.station - SIGHT and rule.start < ego.station + SIGHT
    )
    lines = tuple(line for line in signals.lines if -BEHIND <= line - front <= SIGHT)
    message = None if light is None else _light_message(light)
    return RoadSignals(message, zones, lines, _lamps(signals.lamps()))


@functools.lru_cache(maxsize=4)
def _lamps(letters: tuple[tuple[str, str], ...]) -> tuple[SignalLamp, ...]:
    """The lamps that signals show; a light that is switched off ("O") has none."""
    return tuple(
        SignalLamp(name, LightState.YELLOW if letter == "o" else _light_state(letter))
        for name, letter in letters
        if letter != "O"
    )


def _light_message(light: LightAhead) -> TrafficLight:
    following = None if light.next_letter is None else _light_state(light.next_letter)
    return TrafficLight(light.station, _light_state(light.letter), light.next_switch, following)


def _light_state(letter: str) -> LightState:
    """Returns the state of a SUMO letter, "o" and "O" being off, "u" red with yellow.

    "s" is a green arrow that requires a stop.
    """
    if letter in "gGoO":
        return LightState.GREEN
    if letter == "s":
        return LightState.STOP
    return LightState.YELLOW if letter in "yY" else LightState.RED
