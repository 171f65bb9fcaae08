"""Traffic controller: lights, limits, obstructions, events and departures of a running traffic."""

from __future__ import annotations

import math

from iits_mj.core.errors import InputError
from traffic_bridge.config import Departure, TrafficConfig
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.overrides import Undo
from traffic_bridge.scenario.actions import SceneEvent, TruckEvent
from traffic_bridge.scenario.runner import EventRecord, is_of_scenario
from traffic_bridge.session import Session
from traffic_bridge.signals.events import (
    Event,
    LaneClosure,
    LightOverride,
    LightProgramRun,
    SlowConvoy,
    SpeedLimit,
    StoppedVehicle,
    VehicleChange,
)
from traffic_bridge.signals.lamps import SignalLamps
from traffic_bridge.signals.lights import LightPhase, TrafficLights, lines_without_light
from traffic_bridge.signals.limits import SpeedLimits
from traffic_bridge.signals.merging import MergeGuide
from traffic_bridge.signals.obstructions import SCRIPTED, Obstructions
from traffic_bridge.vehicles.demand import MOBIL_MODE
from traffic_bridge.vehicles.registry import Vehicles
from traffic_bridge.vehicles.scripted import SUMO_MODE, Manner, ScriptedVehicle, ScriptedVehicles

ROUNDING = 1e-9  # [s]: times of steps are sums of tenths


class TrafficController:
    """Lights, limits, closures and events; PureSim and InterSim offer it as `traffic.signals`.

    Args:
      session: the running SUMO.
      lanes: of the route.
      vehicles: the registry for scripted vehicles.
      config: step length, lane-change model, events and departures.

    Attributes:
      traffic_lights, limits, obstructions, events: the parts that do the work.
      lights, state, set_state, programs, phases, phase, set_phase, define_program, run_program,
        light_ahead: methods of `TrafficLights`; lights is `names`, light_ahead is `ahead`.
      lamps: method `letters` of `SignalLamps`.
      lines: stations of the stop lines on the ego's route before junctions without a light [m];
        only for the scope "map", in which vehicles cross.
      set_speed_limit, lift_speed_limit, reset_speed_limits, speed_limit: `set`, `lift`, `reset` and
        `at` of `SpeedLimits`.
      close_lane, open_lane, stop_vehicle, convoy, release: methods of `Obstructions`.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, config: TrafficConfig
    ) -> None:
        self._lanes = lanes
        self._vehicles = vehicles
        self._config = config
        mode = MOBIL_MODE if config.lane_change == "mobil" else SUMO_MODE
        self._scripted = ScriptedVehicles(session, lanes, vehicles, mode)
        self._guide = MergeGuide(session, lanes, vehicles, config.step_length)
        lights = self.traffic_lights = TrafficLights(session, lanes)
        limits = self.limits = SpeedLimits(session, lanes, vehicles, config.step_length)
        parts = self.obstructions = Obstructions(lanes, self._scripted, self._guide, config)
        self._departures = sorted(config.departures, key=lambda departure: departure.time)
        self._departed = 0
        self.events = EventRunner(config.events, lights, limits, parts, vehicles)
        self.lines = lines_without_light(lanes) if config.scope == "map" else ()
        self.lamps = SignalLamps(session, lanes).letters
        self.lights, self.light_ahead = lights.names, lights.ahead
        self.state, self.set_state = lights.state, lights.set_state
        self.phase, self.set_phase, self.phases = lights.phase, lights.set_phase, lights.phases
        self.programs, self.define_program = lights.programs, lights.define_program
        self.run_program = lights.run_program
        self.set_speed_limit, self.lift_speed_limit = limits.set, limits.lift
        self.reset_speed_limits, self.speed_limit = limits.reset, limits.at
        self.close_lane, self.open_lane = parts.close_lane, parts.open_lane
        self.stop_vehicle, self.convoy = parts.stop_vehicle, parts.convoy
        self.release = parts.release

    def begin(self, ego_station: float | None) -> None:
        """Checks all events and departures against net and route; begins those due at time zero.

        Raises:
          InputError: an event or departure names a lane, light or type that does not exist.
        """
        for number, departure in enumerate(self._departures):
            self._scripted.check(self._departing(number, departure))
        self.events.check()
        self.events.step(0.0, ego_station)

    def step(self, time: float, ego_station: float | None) -> None:
        """Applies events, departures and limits that are due before a step of the traffic.

        Args:
          time: of the traffic [s].
          ego_station: of the truck's steer axle [m]; None without a truck.
        """
        self.events.step(time, ego_station)
        while (
            self._departed < len(self._departures)
            and self._departures[self._departed].time <= time + ROUNDING
        ):
            departure = self._departures[self._departed]
            self._scripted.place([self._departing(self._departed, departure)])
            self._departed += 1
        self._scripted.step()
        self._vehicles.apply_type_overrides()
        self._guide.step()
        self.limits.step()

    def _departing(self, number: int, departure: Departure) -> ScriptedVehicle:
        kind = self._config.type_of(departure.type)
        station = departure.station
        if station is None:
            first = self._lanes.within(0.0, math.inf, departure.lane)
            begin = min((float(table.station[0]) for table in first), default=0.0)
            station = max(begin, 0.0) + kind.length + 0.5
        speed = departure.speed
        if speed is None:
            speed = kind.desired_speed_mean * self._config.speed_limit
        return ScriptedVehicle(
            f"{kind.name}.d{number:05d}", kind.name, departure.lane, station, speed, Manner.FREE
        )


class EventRunner:
    """Begins and ends the events of a configuration in a running traffic.

    It begins those without conditions itself, and others when a `Scenario` asks for it.

    Attributes:
      records: of the begun events.
    """

    def __init__(
        self,
        events: tuple[Event, ...],
        lights: TrafficLights,
        limits: SpeedLimits,
        obstructions: Obstructions,
        vehicles: Vehicles,
    ) -> None:
        self._lights = lights
        self._limits = limits
        self._obstructions = obstructions
        self._vehicles = vehicles
        self._all = [event for event in events if not isinstance(event, (SceneEvent, TruckEvent))]
        self._pending = [event for event in self._all if not is_of_scenario(event)]
        self.records: list[EventRecord] = []
        # Changes of vehicles that have not appeared yet: the event and its end [s].
        self._waiting: list[tuple[VehicleChange, float]] = []
        self._active: list[tuple[float, EventRecord, Undo]] = []

    def check(self) -> None:
        """Checks every event against the net and the route, before the drive begins.

        Raises:
          InputError: a lane, light, program or type does not exist; the message names the event.
        """
        for event in self._all:
            try:
                self._check(event)
            except InputError as error:
                raise InputError(f"event {event.kind}: {error}") from error

    def step(self, time: float, ego_station: float | None) -> None:
        """Ends the events that are over and begins those that are due; see the controller."""
        if not (self._active or self._waiting or self._pending):
            return
        over = [entry for entry in self._active if entry[0] <= time + ROUNDING]
        self._active = [entry for entry in self._active if entry[0] > time + ROUNDING]
        for _, record, undo in over:
            undo()
            record.ended = time
        self._waiting = [entry for entry in self._waiting if entry[1] > time + ROUNDING]
        present = [entry for entry in self._waiting if self._has_vehicles(entry[0].target)]
        self._waiting = [entry for entry in self._waiting if entry not in present]
        for change, last in present:
            self._begin_at(change, time, last)
        pending = [event for event in self._pending if not _is_past(event, time)]
        due = [event for event in pending if _is_due(event, time, ego_station)]
        self._pending = [event for event in pending if event not in due]
        for event in due:
            end = event.until
            if end is None:
                end = math.inf if event.duration is None else time + event.duration
            if isinstance(event, VehicleChange) and not self._has_vehicles(event.target):
                self._waiting.append((event, end))
            else:
                self._begin_at(event, time, end)

    def _begin_at(self, event: Event, time: float, end: float) -> None:
        undo = self.begin(event, time)
        record = EventRecord(event, "", time)
        self.records.append(record)
        if end < math.inf:
            self._active.append((end, record, undo))

    def ready(self, event: Event) -> bool:
        """Whether an event can begin: the vehicles that it changes are on the road."""
        return not isinstance(event, VehicleChange) or self._has_vehicles(event.target)

    def begin(self, event: Event, time: float) -> Undo:
        """Carries out an event at a time [s]; returns a function that undoes it.

        Raises:
          InputError: it is not possible now; the message names the event.
        """
        try:
            return self._begin(event)
        except InputError as error:
            raise InputError(f"event {event.kind} at {time:.1f} s: {error}") from error

    def _check(self, event: Event) -> None:
        parts = self._obstructions
        match event:
            case LightOverride():
                links = len(self._lights.state(event.light))
                if len(event.state) not in (1, links):
                    raise InputError(
                        f"state {event.state!r} of traffic light {event.light!r}: "
                        f"1 or {links} letters"
                    )
            case LightProgramRun(phases=()):
                self._lights.phases(event.light, event.program)
            case LightProgramRun():
                phases = [LightPhase(*phase) for phase in event.phases]
                self._lights.define_program(event.light, event.program, phases)
            case SpeedLimit():
                self._limits.check(event)
            case LaneClosure():
                parts.check_closure(event)
            case StoppedVehicle():
                vehicle = (event.type, event.lane, event.station)
                parts.check(ScriptedVehicle("", *vehicle, 0.0, Manner.STANDING))
            case SlowConvoy():
                for member in parts.convoy_group(0, event):
                    parts.check(member)
            case VehicleChange():
                self._check_target(event.target)

    def _begin(self, event: Event) -> Undo:
        """Carries out an event; returns a function that undoes it."""
        parts, limits = self._obstructions, self._limits
        match event:
            case LightOverride():
                return self._lights.hold_state(event.light, event.state)
            case LightProgramRun():
                return self._lights.hold_program(event.light, event.program)
            case SpeedLimit():
                limit = limits.set(event.limit, event.start, event.end, event.lane)
                return lambda: limits.lift(limit)
            case LaneClosure():
                closure = parts.close_lane(event.lane, event.start, event.end, event.notice)
                return lambda: parts.open_lane(closure)
            case StoppedVehicle():
                notice = event.notice if event.hazard else None
                standing = parts.stop_vehicle(event.station, event.lane, event.type, notice)
                return lambda: parts.release(standing)
            case SlowConvoy():
                group = parts.convoy(
                    event.station, event.speed, event.lane, event.count, event.type
                )
                return lambda: parts.release(group)
            case VehicleChange():
                return self._vehicles.change(event.target, **dict(event.parameters))
        raise InputError(f"event {event!r}: unknown kind of event")

    def _has_vehicles(self, target: str) -> bool:
        """Whether there is a type, or a vehicle on the road, of this name."""
        if target in self._vehicles:
            self._vehicles.drop_lost()
        return target in self._vehicles or any(t.name == target for t in self._vehicles.types())

    def _check_target(self, target: str) -> None:
        """Refuses a target that is neither a type's name nor a possible vehicle's name."""
        types = [kind.name for kind in self._vehicles.types()]
        family, dot, _ = target.partition(".")
        if target not in types and not (dot and family in (*types, *SCRIPTED)):
            raise InputError(
                f"target {target!r}: allowed are the types {', '.join(types)}, and names of "
                f"vehicles, which begin with their type's, {', '.join(SCRIPTED)}, and a dot"
            )


def _is_due(event: Event, time: float, ego_station: float | None) -> bool:
    if event.at_station is not None:
        return ego_station is not None and ego_station >= event.at_station
    return (event.at_time or 0.0) <= time + ROUNDING


def _is_past(event: Event, time: float) -> bool:
    return event.until is not None and event.until <= time + ROUNDING
