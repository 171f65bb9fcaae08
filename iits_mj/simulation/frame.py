"""What one instant of a drive looks like to those who watch it."""

from __future__ import annotations

import dataclasses
import math
import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

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
from traffic_bridge import LightAhead, PureSim, Recorder, Traffic

# --- What ends a drive from the truck's own side: no road any more, on its side, off the road ---

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


# --- What the traffic's lights and signs say to the truck, as messages ---

# A changed limit further ahead than this is not seen yet [m].
SIGHT = 500.0
# Stop lines of the lanes of one crossing lie within this [m].
SAME_LINE = 15.0
# A line is told of until the front bumper is this far behind it: who stops on it must still see it;
# more than what the truck drives in a cycle [m].
BEHIND = 4.0


def read_signals(
    traffic: Traffic | None, ego: EgoState, route: Route, footprint: EgoFootprint
) -> RoadSignals:
    """The next light, or the one that the front is just over, and the limits set near the truck.

    Only traffic that SUMO runs has any: a PureSim, which InterSim and MixedSim are, also inside a
    recorder.

    Args:
      traffic: that runs, None for an empty road.
      ego: the truck.
      route: its road.
      footprint: its size.
    """
    if isinstance(traffic, Recorder):
        traffic = traffic.traffic
    if not isinstance(traffic, PureSim):
        return RoadSignals()
    signals = traffic.signals
    front = ego.station + footprint.front_overhang
    light = signals.light_ahead(front - BEHIND)
    lane = int(route.lane_at(ego.station, ego.offset))
    own = signals.light_ahead(front - BEHIND, lane) if light is not None and lane >= 0 else None
    # Lanes may be numbered otherwise at the line: a line is never driven over for that.
    if own is not None and light is not None and own.station < light.station + SAME_LINE:
        light = own
    zones = tuple(
        SpeedZone(rule.start, rule.end, rule.limit, rule.lane)
        for rule in signals.limits.rules
        if rule.end > ego.station - SIGHT and rule.start < ego.station + SIGHT
    )
    return RoadSignals(None if light is None else _light(light), zones)


def _light(light: LightAhead) -> TrafficLight:
    following = None if light.next_letter is None else _state(light.next_letter)
    return TrafficLight(light.station, _state(light.letter), light.next_switch, following)


def _state(letter: str) -> LightState:
    """Of a SUMO letter: "o" and "O" are off; "u" is red with yellow; "s" is a green arrow."""
    if letter in "gGoO":
        return LightState.GREEN
    if letter == "s":
        return LightState.STOP
    return LightState.YELLOW if letter in "yY" else LightState.RED


# --- What one instant of a drive looks like to those who watch it ---

if TYPE_CHECKING:
    from iits_mj.simulation.loop import Simulation


_SLOWEST = 1.0  # [m/s]


@dataclass(frozen=True, slots=True)
class Frame:
    """One instant of a drive.

    Attributes:
      time: simulation time [s].
      ego: the truck now; scene: what the stack saw at the beginning of this 100 ms cycle.
      trajectory: the plan being followed; command: what the truck is being sent.
      decision: the last decision of the decision maker.
      lane: the truck's lane from the right, -1 outside every lane; lane_count: lanes here.
      grade: of the road at the steer axle, dz/ds; curvature: of the route [1/m], positive left.
      speed_limit: of the road [m/s]; reference_speed: asked of the truck [m/s].
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
        """To the vehicle ahead [s]; inf without one, and below 1 m/s, where it says nothing."""
        speed = self.ego.speed
        return self.gap_ahead / speed if speed > _SLOWEST else math.inf


class Observer(Protocol):
    """Somebody who watches a drive.

    Attributes:
      period: time between two calls of `observe` [s], a whole number of physics steps.
    """

    period: float

    def observe(self, simulation: Simulation, frame: Frame) -> None:
        """Called at the start and after every period; may only call `simulation.stop`."""
