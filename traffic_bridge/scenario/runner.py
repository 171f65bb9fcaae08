"""Plays the events of a scenario in a running traffic."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from iits_mj.core.errors import InputError, MapError
from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.stop_lines import VEHICLE_LIGHTS
from traffic_bridge.overrides import Undo
from traffic_bridge.scenario import actions as do
from traffic_bridge.scenario.actors import (
    DIMENSIONS,
    END,
    Actor,
    Actors,
    Course,
    Plan,
    SpeedPlan,
    Track,
    beside_road,
    on_road,
    size_of,
)
from traffic_bridge.scenario.conditions import (
    ROUNDING,
    SIGNAL,
    TRUCK,
    Body,
    Situation,
    Trigger,
    gap,
)
from traffic_bridge.scenario.maneuvers import begin, follow, synchronize, target_lane
from traffic_bridge.scenario.paths import Path, points_on_route
from traffic_bridge.scenario.swarm import RunningSwarm
from traffic_bridge.signals.events import Event
from traffic_bridge.signals.lights import LightAhead
from traffic_bridge.vehicles.idm import IdmParameters
from traffic_bridge.vehicles.types import road_user_types

COLORS = ("red", "yellow", "green")  # lamps of a light from the top
CLEAR = 1.0  # [m] before and behind a vehicle that appears
CARGO = "obstacle"  # type of a lost load


@dataclass
class EventRecord:
    """A begun event.

    Attributes:
      event: with its values; actor: id of its vehicle, "" for none.
      begun, ended: traffic times [s]; ended is None while it lasts.
    """

    event: Event
    actor: str
    begun: float
    ended: float | None = None


class OtherEvents(Protocol):
    """Events that the traffic simulation itself carries out, such as those of SUMO's lights."""

    def ready(self, event: Event) -> bool:
        """Whether an event can begin now."""

    def begin(self, event: Event, time: float) -> Undo:
        """Begins an event at a time [s]; returns a function that undoes it."""


@dataclass
class _Running:
    """A begun event that has not ended: at its end [s] it is undone, or its plans end it."""

    record: EventRecord
    end: float = math.inf
    undo: Undo = lambda: None
    plans: list[Plan] = field(default_factory=list)


class Scenario:
    """The events with conditions, with actors, or of the truck, in one running traffic.

    Args:
      config: with the events; its other events are the caller's.
      route: the truck's road.
      others: carries out other events that have conditions; None if there are none.
      take: called with the id of a vehicle that becomes an actor, to remove it from the traffic
        simulation; returns its desired speed [m/s].
      seed: of the places of swarms.

    Attributes:
      actors: the road users that move on a plan.
      records: of the begun events in their order, also of those that the caller adds.
    """

    def __init__(
        self,
        config: TrafficConfig,
        route: Route,
        others: OtherEvents | None = None,
        take: Callable[[TrackedVehicle], float] = lambda row: row.speed,
        seed: int = 0,
    ) -> None:
        self.actors = Actors()
        self.records: list[EventRecord] = []
        self._config, self._route = config, route
        self._others, self._take = others, take
        self._types = {kind.name: kind for kind in (*config.types, *road_user_types())}
        self._pending = [
            (event, None if event.when is None else Trigger(event.when))
            for event in config.events
            if is_of_scenario(event)
        ]
        self._running: list[_Running] = []
        words = (getattr(event, "along", None) for event, _ in self._pending)
        # The roads other than the truck's.
        self._roads = {text: route.road_map.route(along=text) for text in words if text is not None}
        self._seed = seed
        self._swarms: list[RunningSwarm] = []
        self._last: Situation | None = None

    def __len__(self) -> int:
        """Number of its events, begun or not."""
        return len(self._pending) + len(self.records)

    @property
    def truck_events(self) -> list[EventRecord]:
        """The events of the truck's world and parts that have begun and not ended."""
        return [r for r in self.records if isinstance(r.event, do.TruckEvent) and r.ended is None]

    def light_ahead(self, station: float) -> LightAhead | None:
        """Returns the next light of the map at or after a station [m] whose state events have set.

        It is the variable "signal ID": the lamps from the top, such as "on;off;off", or "red",
        "yellow" or "green".
        """
        if self._last is None:
            return None
        for found in self._route.signals:
            signal = found.signal
            state = self._last.values.get(f"{SIGNAL}{signal.id}")
            letter = _lamp(state) if signal.kind in VEHICLE_LIGHTS else None
            if letter is not None and found.station >= station:
                lane = self._route.lane_at(found.station, found.offset)
                return LightAhead(signal.id, 0, letter, found.station, lane, None, None)
        return None

    @property
    def faults(self) -> list[do.Fault]:
        """The faults that have not begun."""
        return [event for event, _ in self._pending if isinstance(event, do.Fault)]

    def advance(self, time: float, ego: EgoState | None) -> None:
        """Moves the actors by one step of the traffic, which ends at a time [s].

        Args:
          time: at the end of the step [s].
          ego: the truck then.
        """
        last = self._last
        if last is None or not self.actors.members:
            return
        bodies = list(last.bodies.values())
        if last.truck is not None:
            bodies.append(last.truck)
        self.actors.advance(
            time, self._config.step_length, bodies, self._situation(time, ego).truck
        )

    def observe(self, time: float, ego: EgoState | None, others: VehicleFrame) -> VehicleFrame:
        """Ends and begins events after a step; returns all vehicles, sorted by id.

        Args:
          time: of the traffic [s].
          ego: the truck.
          others: the vehicles of the traffic simulation; actors among them are left out.
        """
        if not len(self):
            return others
        self._end(time)
        situation = self._situation(time, ego, others)
        if self._swarms:
            for swarm in self._swarms:
                swarm.update(situation)
            self.actors.show()
            situation = self._situation(time, ego, others)
        self._last = self._begin(situation, others)
        frame = self._last.vehicles
        return frame if ego is None else frame.near(ego.x, ego.y, self._config.view_range)

    def _situation(
        self, time: float, ego: EgoState | None, others: VehicleFrame | None = None
    ) -> Situation:
        """Truck, actors and the vehicles of the traffic simulation; without these no vehicle."""
        frame, own = others or VehicleFrame.empty(), self.actors.at(-math.inf)
        if others is not None and len(own):
            frame = VehicleFrame.joined(others.without(self.actors.members), own)
        states: dict[str, str] = {}
        values: dict[str, float | str] = {}
        for record in self.records:
            states[record.event.title] = "begun" if record.ended is None else "ended"
            if isinstance(event := record.event, do.SetValue):
                values[event.variable] = event.changed(values.get(event.variable))
        config = self._config
        return Situation(
            *(time, self._route, config.footprint, ego, frame, states),
            values=values,
            step=config.step_length,
        )

    def _end(self, time: float) -> None:
        """Ends the events whose time or whose plans are over."""
        for running in list(self._running):
            over = running.end <= time + ROUNDING
            if over:
                running.undo()
            if over or (running.plans and all(plan.done for plan in running.plans)):
                running.record.ended = time
                self._running.remove(running)

    def _begin(self, situation: Situation, others: VehicleFrame) -> Situation:
        """Begins the events that are due, in their order; each sees those before it.

        Returns:
          The situation afterwards.
        """
        time, ego = situation.time, situation.ego
        waiting = []
        for event, trigger in self._pending:
            if event.until is not None and event.until <= time + ROUNDING:
                continue
            if trigger is not None:
                due = trigger.step(situation)
            elif event.at_station is not None:
                due = ego is not None and ego.station >= event.at_station
            else:
                due = (event.at_time or 0.0) <= time + ROUNDING
            running = self._start(event, situation) if due else None
            if running is None:
                waiting.append((event, trigger))
                continue
            self.records.append(running.record)
            self._running.append(running)
            self.actors.show()
            situation = self._situation(time, ego, others)
        self._pending = waiting
        return situation

    def _start(self, event: Event, situation: Situation) -> _Running | None:
        """Begins an event; None if it cannot begin now."""
        time = situation.time
        if isinstance(event, do.Maneuver):
            running = self._maneuver(event, situation)
        elif isinstance(event, do.PlaceVehicle):
            running = self._place(event, situation)
        elif isinstance(event, do.CrossRoad):
            running = self._cross(event, situation)
        elif isinstance(event, do.Swarm):
            running = self._begin_swarm(event, situation)
        elif isinstance(event, (do.TruckEvent, do.Milestone, do.SetValue)):
            running = _Running(EventRecord(event, "", time))
            if isinstance(event, do.SetValue):
                running.plans = [Plan(done=True)]
        else:
            assert self._others is not None
            if not self._others.ready(event):
                return None
            undo = self._others.begin(event, time)
            running = _Running(EventRecord(event, "", time), undo=undo)
        if running is None or isinstance(event, do.LateralManeuver):
            return running
        if event.until is not None:
            running.end = event.until
        elif event.duration is not None:
            running.end = time + event.duration
        if running.end < math.inf:
            running.plans = []
        return running

    def _place(self, event: do.PlaceVehicle, situation: Situation) -> _Running | None:
        truck, kind = situation.truck, self._types[event.type]
        placed = event.points is not None or None not in (event.station, event.lane)
        if truck is None and not (placed and event.speed is not None):
            return None
        speed = event.speed
        if speed is None:
            speed = max(truck.speed + (event.speed_difference or 0.0), 0.0)  # type: ignore[union-attr]
        size = size_of(kind) | {n: value for n in DIMENSIONS if (value := getattr(event, n))}
        spot = self._spot(event, truck, size["length"])
        if spot is None:
            return None
        track, place, lane = spot
        row = self._row(track, str(event.name), place, speed=speed, **size)
        running = self._add(event, row, lane, situation, event.reactive and speed > 0.0)
        if running is not None:
            actor = self.actors.members[row.id]
            actor.take(track, place, lane, event.stays)
            if event.offset is not None:
                actor.stay_aside(event.offset)
        return running

    def _spot(
        self, event: do.PlaceVehicle, truck: Body | None, length: float
    ) -> tuple[Track, tuple[float, float], int] | None:
        """Track, station and offset on it [m], and lane where a vehicle appears; None: nowhere."""
        if event.points is not None:
            return self._path(event, length)[0], (0.0, 0.0), 0
        lane = event.lane
        if lane is None:
            lane = truck.lane + (event.relative_lane or 0)  # type: ignore[union-attr]
        track = self._route if event.along is None else self._roads[event.along]
        if event.station is not None:
            station = event.station - 0.5 * length
        elif event.gap >= 0.0:  # type: ignore[operator]
            station = truck.front + event.gap + 0.5 * length  # type: ignore
        else:
            station = truck.rear + event.gap - 0.5 * length  # type: ignore
        inside = 0.5 * length < station < track.length - 0.5 * length
        if event.along is not None:  # the rear may still be before the beginning of its road
            inside = 0.0 <= event.station < track.length  # type: ignore[operator]
        if not inside or lane < 0 or not track.lane_exists(lane, max(station, 0.0)):
            return None
        offset = float(track.lane_offset(lane, station)) + (event.offset or 0.0)
        return track, (station, offset), lane

    def _row(
        self, track: Track, name: str, place: tuple[float, float], **more: Any
    ) -> TrackedVehicle:
        """A road user at a station and an offset of a track."""
        if isinstance(track, Route) and track is self._route:
            return on_road(track, name, *place, **more)
        return beside_road(self._route, name, track.evaluate(*place), 0.0, None, **more)

    def _path(self, event: do.PlaceVehicle | do.FollowPath, span: float) -> tuple[Path, list[int]]:
        """The path of an event's points, and the numbers of these among the path's."""
        assert event.points is not None
        points, numbers = event.points, list(range(len(event.points)))
        if event.frame == "route":
            points, numbers = points_on_route(self._route, points)
        return Path(points, span, self._route), numbers

    def _add(
        self,
        event: Event,
        row: TrackedVehicle,
        lane: int,
        situation: Situation,
        reactive: bool,
        clear: float = CLEAR,
    ) -> _Running | None:
        """Makes an actor of a row; None if its place is not free."""
        name, half = row.id, 0.5 * row.length + clear
        if name in situation.bodies or name in self.actors.members:
            return None
        place = Body(name, row.station + half, row.station - half, *([0.0] * 10))  # type: ignore
        for body in (situation.truck, *situation.bodies.values()):
            if body is None or gap(place, body) > 0.0:
                continue
            if abs(body.offset - row.offset) < 0.5 * (body.width + row.width):
                return None
        driver = self._driver(row, row.speed) if reactive else None
        self.actors.members[name] = Actor(row, self._route, lane, driver)
        remove = lambda: self._remove(name)  # noqa: E731
        return _Running(EventRecord(event, name, situation.time), undo=remove)

    def _begin_swarm(self, event: do.Swarm, situation: Situation) -> _Running | None:
        """Begins a swarm; None while its body is not there."""
        if situation.find(event.to) is None:
            return None
        number = sum(isinstance(record.event, do.Swarm) for record in self.records)
        random = np.random.default_rng([self._seed, number])
        swarm = RunningSwarm(event, random, self._route.road_map, self._join, self._remove)
        self._swarms.append(swarm)
        swarm.update(situation)

        def undo() -> None:
            self._swarms.remove(swarm)
            swarm.leave()

        return _Running(EventRecord(event, "", situation.time), undo=undo)

    def _join(
        self, name: str, lane: str, place: tuple[float, float], kind: str, speed: float
    ) -> TrackedVehicle | None:
        """Adds a vehicle at a point of a lane ROAD_LANE; None where its road is too short."""
        words, size = f"turns:{lane}", size_of(self._types[kind])
        try:
            road = self._roads[words] = self._roads.get(words) or self._route.road_map.route(
                along=words
            )
        except (InputError, MapError):
            return None  # the road has links that cannot be driven
        station, offset = road.locate(*place)
        index = road.lane_at(station, offset)
        if index < 0 or not 0.0 < station < road.length - 0.5 * size["length"] - END:
            return None
        row = self._row(road, name, (station, offset), speed=speed, **size)
        driver = self._driver(row, speed)
        actor = Actor(row, self._route, index, driver, road, (station, offset))
        actor.join_route()
        self.actors.members[name] = actor
        return row

    def _remove(self, name: str) -> None:
        self.actors.members.pop(name, None)
        self.actors.show()

    def _driver(self, row: TrackedVehicle, desired: float) -> IdmParameters:
        like = [kind for kind in self._types.values() if kind.kind == row.kind]
        return IdmParameters.of_type((like or list(self._types.values()))[0], max(desired, 0.1))

    def _actor(self, name: str, situation: Situation) -> Actor | None:
        """The actor of a role or an id; a vehicle of the traffic becomes one."""
        body = situation.find(name)
        if body is None or name == TRUCK:
            return None
        known = self.actors.members.get(body.name)
        if known is not None:
            return known
        row = situation.vehicles.find(body.name)
        if row is None or row.lane < 0:
            return None
        actor = Actor(row, self._route, row.lane, self._driver(row, self._take(row)))
        self.actors.members[row.id] = actor
        return actor

    def _cross(self, event: do.CrossRoad, situation: Situation) -> _Running | None:
        route, kind = self._route, self._types[event.type]
        if event.station is not None:
            station = event.station
        elif situation.truck is not None:
            station = situation.truck.front + event.gap  # type: ignore[operator]
        else:
            return None
        name = str(event.name)
        if name in situation.bodies or not 0.0 <= station <= route.length:
            return None
        right, left = (float(edge) for edge in route.surface_edges(station))
        begin, way = (right, left - right) if event.side == "right" else (left, right - left)
        if event.distance is not None:
            way = math.copysign(event.distance, way)
        ends = [route.evaluate(station, begin), route.evaluate(station, begin + way)]
        path = Path([(p.x, p.y) for p in ends], kind.length, route)  # type: ignore[misc]
        row = self._row(path, name, (0.0, 0.0), speed=event.speed, **size_of(kind))
        stays = event.distance is not None
        member = Actor(row, route, 0, None, path, (0.0, 0.0), stays)
        member.course = Course(goal=path.length)
        self.actors.members[name] = member
        return _Running(EventRecord(event, name, situation.time), plans=[member.course])

    def _maneuver(self, event: do.Maneuver, situation: Situation) -> _Running | None:
        body, truck = situation.find(event.actor), situation.truck
        if body is None or (body.lane < 0 and body.name not in self.actors.members):
            return None
        relative = isinstance(event, do.ChangeSpeed) and event.speed is None
        relative |= isinstance(event, do.FollowSpeeds) and event.relative
        if (relative and situation.find(event.to) is None) or (  # type: ignore[attr-defined]
            truck is None and isinstance(event, do.CutIn)
        ):
            return None
        members = self.actors.members
        known = members.get(body.name)
        own = lambda name: self._lane_beside(known, name)  # noqa: E731
        target = target_lane(event, body, situation, known, own)
        if target is None:
            return None
        actor = self._actor(body.name, situation)
        if actor is None:
            return None
        refers = isinstance(event, (do.CutIn, do.LoseCargo)) or (
            isinstance(event, do.ChangeLane) and event.to is not None and own(event.to) is None
        )
        # Such a maneuver takes place on the truck's route.
        if refers and actor.track is not self._route and not actor.join_route():
            return None
        record = EventRecord(event, actor.name, situation.time)
        if isinstance(event, do.RemoveVehicle):
            return self._take_away(record)
        if isinstance(event, do.LoseCargo):
            return self._lose_cargo(event, actor, situation)
        if isinstance(event, do.Teleport):
            return self._teleport(event, actor, record)
        if isinstance(event, do.FollowPath):
            return self._follow_path(event, actor, record)
        if isinstance(event, do.Synchronize):
            plans = synchronize(event, actor, lambda: self._front_of(event.to))
            return _Running(record, plans=plans)
        plans, undo = begin(event, actor, target, situation)
        return _Running(record, undo=undo, plans=plans)

    def _take_away(self, record: EventRecord) -> _Running:
        """Removes an actor, and ends the events that are about it."""
        for running in list(self._running):
            if running.record.actor == record.actor:
                running.record.ended = record.begun
                self._running.remove(running)
        self._remove(record.actor)
        return _Running(record, plans=[Plan(done=True)])

    def _lane_beside(self, actor: Actor | None, name: str) -> int | None:
        """Lane of a road user on an actor's own road; None if it is not on it."""
        other = self.actors.members.get(name)
        same = actor is not None and other is not None and other.track is actor.track
        return other.lane if same and other is not None else None

    def _front_of(self, name: str) -> tuple[float, float] | None:
        """Station of a front bumper on its own road [m], and the speed [m/s]."""
        member = self.actors.members.get(name)
        if member is not None:
            return member.front, member.speed
        body = None if self._last is None else self._last.find(name)
        return None if body is None else (body.front, body.pace)

    def _teleport(self, event: do.Teleport, actor: Actor, record: EventRecord) -> _Running | None:
        track = self._route if event.along is None else self._roads[event.along]
        station = event.station - 0.5 * actor.row.length
        if not 0.0 <= event.station < track.length or not track.lane_exists(event.lane, station):
            return None
        actor.take(track, (station, float(track.lane_offset(event.lane, station))), event.lane)
        if event.offset:
            actor.stay_aside(event.offset)
        return _Running(record, plans=[Plan(done=True)])

    def _follow_path(
        self, event: do.FollowPath, actor: Actor, record: EventRecord
    ) -> _Running | None:
        if event.points is not None:
            path, numbers = self._path(event, actor.row.length)
            return _Running(record, plans=follow(event, actor, path, numbers))
        road, row = self._roads[str(event.along)], actor.vehicle()
        place = road.locate(row.x, row.y)
        lane = road.lane_at(*place)
        if lane < 0:
            return None
        actor.take(road, place, lane)
        actor.course = Course(goal=road.length - 0.5 * row.length - 2.0 * CLEAR)
        return _Running(record, plans=[actor.course])

    def _lose_cargo(
        self, event: do.LoseCargo, actor: Actor, situation: Situation
    ) -> _Running | None:
        kind = self._types[CARGO]
        station = actor.station - 0.5 * actor.row.length - 0.5 * kind.length - CLEAR
        if station < kind.length:
            return None
        more = {"speed": actor.speed, **size_of(kind)}
        row = on_road(self._route, str(event.name), station, actor.offset, **more)
        running = self._add(event, row, actor.lane, situation, reactive=False, clear=0.0)
        if running is not None:
            box = self.actors.members[row.id]
            box.plan_speed(SpeedPlan(rate=event.deceleration, jerk=1e3))
            # It slides on its own line.
            box.stay_aside(box.shift)
            running.plans = [box.speed_plan]  # type: ignore[list-item]
        return running


def _lamp(state: float | str | None) -> str | None:
    """The letter of a light of three lamps; None where no lamp is known to burn."""
    lamps = str(state).lower().split(";")
    if len(lamps) == len(COLORS) and "on" in lamps:
        # Of red and yellow together the upper one counts.
        return COLORS[lamps.index("on")][0]
    return lamps[0][0] if lamps[0] in COLORS else None


def is_of_scenario(event: Event) -> bool:
    """Whether `Scenario` plays an event; the traffic simulation plays the others."""
    return event.when is not None or isinstance(event, (do.SceneEvent, do.TruckEvent))
