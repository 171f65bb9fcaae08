"""Scenarios of events as ASAM OpenSCENARIO XML 1.3: triggers, actions, and the map as OpenDRIVE.

Each event is one of the same name, whose action "NAME action" ends when the event ends. Vehicles that the Intelligent Driver Model drives have the controller `MODEL`, which other
simulators replace by their own.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from iits_mj.core.errors import InputError
from iits_mj.export.openscenario import (
    EGO,
    add_truck,
    at_time,
    body_of,
    check_target,
    reference_of,
    speed_action,
    write_scenario,
    xosc_package,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.road_frames import RoadFrames
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.parts import configured_events, placed, traffic_speed
from traffic_bridge.scenario import actions as do
from traffic_bridge.scenario.actors import APPROACH, REST, size_of
from traffic_bridge.scenario.conditions import ROLES, SIGNAL, TRUCK, Condition
from traffic_bridge.scenario.maneuvers import HOLD_JERK, HOLD_RATE
from traffic_bridge.scenario.openscenario_actions import BEHIND, COMMAND
from traffic_bridge.scenario.openscenario_entities import AHEAD, MODEL
from traffic_bridge.scenario.openscenario_places import road_at
from traffic_bridge.scenario.paths import points_on_route
from traffic_bridge.scenario.reading import check_references
from traffic_bridge.signals import events as sumo
from traffic_bridge.signals.events import Event
from traffic_bridge.signals.obstructions import closure_places, convoy_places
from traffic_bridge.vehicles.types import default_types, road_user_types

# Conditions on times include their limits.
INCLUSIVE = {"greaterThan": "greaterOrEqual", "lessThan": "lessOrEqual"}
OPPOSITE = {"greaterThan": "lessThan", "lessThan": "greaterThan"}
ACTION = "{} action"  # name of the action of a name; all elements have different names
FAR = 1e4  # [s] of a time gap: whatever is ahead is nearer
DIGITS = 6
TIMES = ("at_time", "at_station", "when")  # fields of an event that say when it begins


class Member(NamedTuple):
    """A road user of the file.

    Attributes:
      back, front: from its reference point back to its rear and on to its front [m].
      route: its road; station: of its front at the beginning [m]; lane: from the right.
      reactive: it has the controller `MODEL`; speed: at the beginning [m/s].
    """

    back: float
    front: float
    route: Route
    station: float | None
    lane: int
    reactive: bool
    speed: float


def write_events(
    path: Path, config: DriveConfig, route: Route, parameters: TruckParameters
) -> tuple[Path, Path, tuple[str, ...]]:
    """Writes the events of a drive as FILE.xosc, and its map as FILE.xodr beside it.

    Args:
      path: of the file, ending with .xosc.
      config: of the drive, with its file of events.
      route: of the truck.
      parameters: of the truck.

    Returns:
      The two paths, and what other simulators leave out, in words.

    Raises:
      InputError: scenariogeneration is missing, a file cannot be used or written, or OpenSCENARIO
        has nothing for an event or a condition.
    """
    check_target(path, route)
    events = configured_events(config)
    check_references(events)
    story = _Story(placed(config, route, parameters.footprint), route, parameters, events)
    for event in story.events.values():
        story.add(event)
    return (*story.write(path), tuple(story.remarks))


class _Story:
    """A scenario in the making."""

    def __init__(
        self,
        config: DriveConfig,
        route: Route,
        parameters: TruckParameters,
        events: Sequence[Event],
    ) -> None:
        self.xosc = xosc = xosc_package()
        self.route, self.config, self.remarks = route, config, list[str]()
        self.events: dict[str, Event] = {}
        for event in events:
            if event.title in self.events:
                numbers = (f"{event.title} {k}" for k in itertools.count(2))
                name = next(each for each in numbers if each not in self.events)
                event = dataclasses.replace(event, name=name)
            self.events[event.title] = event
        self._frames = RoadFrames(route.road_map)
        self._types = {kind.name: kind for kind in (*default_types(), *road_user_types())}
        self.entities, self.init = xosc.Entities(), xosc.Init()
        self._act = xosc.Act("act", at_time(0.0), xosc.Trigger("stop"))
        self._stop, self._variables = xosc.Trigger("stop"), dict[str, float | str]()
        station, lane = config.start_station, config.start_lane
        limit = float(route.speed_limit(station, lane))
        speed = min(config.start_speed, config.speed, limit)
        size = parameters.footprint
        front, rear = size.front_overhang, reference_of(parameters.units[0])
        self.ego = Member(
            size.length - front - rear, front + rear, route, station + front, lane, False, speed
        )
        self.members = {EGO: self.ego}
        add_truck(self.entities, parameters)
        self._start(EGO, self.lane_position(route, station - rear, lane), speed)

    def add(self, event: Event) -> None:
        """Writes an event."""
        write = WRITERS.get(type(event))
        if write is None or write(self, event) is False:
            self._command(event)

    def write(self, path: Path) -> tuple[Path, Path]:
        """Writes the file and the map."""
        xosc = self.xosc
        self._stop.add_conditiongroup(self._group([at_time(self.config.duration)], "stop"))
        board = xosc.StoryBoard(self.init, self._stop)
        if self._act.maneuvergroup:
            story = xosc.Story("story")
            story.add_act(self._act)
            board.add_story(story)
        declared = xosc.VariableDeclarations()
        for name, value in self._variables.items():
            text = isinstance(value, str)
            kind = xosc.ParameterType.string if text else xosc.ParameterType.double
            # No condition holds before an event sets the variable.
            declared.add_variable(xosc.Variable(name, kind, "" if text else "NaN"))
        return write_scenario(path, self.route, self.entities, board, declared)

    def fail(self, event: Event, message: str) -> NoReturn:
        """Raises InputError that names an event."""
        raise InputError(f"OpenSCENARIO: event {event.title!r}: {message}")

    # Triggers.

    def groups(self, event: Event) -> list[list[Any]]:
        """The groups of conditions on which an event begins."""
        if event.when is not None:
            found: list[list[Any]] = []
            for group in event.when:
                parts = (self._alternatives(event, condition) for condition in group)
                found += [list(itertools.chain(*chosen)) for chosen in itertools.product(*parts)]
            return found
        if event.at_station is not None:
            way = event.at_station + self.ego.front - self.ego_reference
            condition = self.xosc.TraveledDistanceCondition(_r(way - float(self.ego.station or 0)))
            return [[self._by_entity(EGO, condition)]]
        return [[at_time(event.at_time or 0.0)]]

    @property
    def ego_reference(self) -> float:
        """From the truck's reference point to its steer axle [m]."""
        return self.ego.front - (float(self.ego.station or 0.0) - self.config.start_station)

    def trigger(self, event: Event) -> Any:
        """The start trigger of an event."""
        made = self.xosc.Trigger()
        for group in self.groups(event):
            made.add_conditiongroup(self._group(group, "start"))
        return made

    def _group(self, conditions: Sequence[Any], point: str) -> Any:
        group = self.xosc.ConditionGroup(point)
        for k, condition in enumerate(conditions):
            condition.name += f" {k}" if k else ""
            group.add_condition(condition)
        return group

    def _by_entity(self, name: str, condition: Any, source: Condition | None = None) -> Any:
        xosc, kind = self.xosc, type(condition).__name__
        return xosc.EntityTrigger(kind, *_timing(xosc, source), condition, name)

    def entity(self, event: Event, name: str) -> str:
        """The entity that an event or a condition names."""
        if name in ROLES:
            self.fail(event, f"the role {name!r} has no counterpart: name a vehicle of the events")
        name = EGO if name == TRUCK else name
        if name not in self.members:
            names = ", ".join((TRUCK, *(each for each in self.members if each != EGO)))
            self.fail(event, f"{name!r} is no vehicle of an event before it; there are {names}")
        return name

    def _alternatives(self, event: Event, condition: Condition) -> list[list[Any]]:
        """Lists of conditions, one of which must hold, for one of an event."""
        xosc = self.xosc
        if condition.event is not None:
            return [[self._of_event(event, condition)]]
        limits: list[tuple[str, Any]] = [
            (rule, limit)
            for rule, limit in (
                ("greaterThan", condition.above),
                ("lessThan", condition.below),
                ("equalTo", condition.equals),
            )
            if limit is not None
        ]
        timing = _timing(xosc, condition)
        if (len(limits) > 1 or condition.measure == "ahead") and condition.edge != "none":
            self.fail(event, f"a condition with edge {condition.edge!r} needs one limit")
        if condition.variable is not None:
            name, text = condition.variable, condition.text
            if name.startswith(SIGNAL) and text is not None:
                made = xosc.TrafficSignalCondition(name.removeprefix(SIGNAL), text)
                return [[xosc.ValueTrigger("signal", *timing, made)]]
            limits = limits if text is None else [("equalTo", text)]
            self._variables.setdefault(name, 0.0 if text is None else text)
            values = (xosc.VariableCondition(name, v, getattr(xosc.Rule, r)) for r, v in limits)
            return [[xosc.ValueTrigger("variable", *timing, each) for each in values]]
        measure, of = str(condition.measure), self.entity(event, condition.of)
        if condition.lasting and not (measure == "speed" and condition.below == REST):
            self.fail(event, f"lasting is written for speeds below {REST:g} m/s only")
        if condition.lasting:
            made = xosc.StandStillCondition(condition.lasting)
            return [[self._by_entity(of, made, condition)]]
        if measure == "time":
            rules = [getattr(xosc.Rule, INCLUSIVE.get(r, r)) for r, _ in limits]
            made = [
                xosc.SimulationTimeCondition(v, rule)
                for rule, (_, v) in zip(rules, limits, strict=True)
            ]
            return [[xosc.ValueTrigger("time", *timing, each) for each in made]]
        if measure in ("station", "lane", "offset"):
            made = self._on_route(event, condition, of)
            return [[self._by_entity(of, made, condition)]]
        if condition.point is not None:
            self.fail(event, "a distance to a point has no counterpart: use station")
        to = "" if condition.to is None else self.entity(event, condition.to)
        if measure == "ahead":
            return self._ahead(of, to, condition)
        return [[self._by_entity(of, self._compared(measure, to, *limit), condition)
                 for limit in limits]]  # fmt: skip

    def _compared(self, measure: str, to: str, name: str, limit: float) -> Any:
        """A condition on a measure of one or two bodies, with the name of a rule."""
        xosc, rule = self.xosc, getattr(self.xosc.Rule, name)
        road, types = xosc.CoordinateSystem.road, xosc.RelativeDistanceType
        match measure:
            case "speed":
                return xosc.SpeedCondition(limit, rule)
            case "acceleration":
                return xosc.AccelerationCondition(limit, rule)
            case "speed_difference":
                # Of the entity that triggers to the other one.
                rule = getattr(xosc.Rule, OPPOSITE.get(name, name))
                return xosc.RelativeSpeedCondition(-limit, rule, to)
            case "time_gap":
                return xosc.TimeHeadwayCondition(to, limit, rule, coordinate_system=road)
            case "ttc":
                more = {"entity": to, "coordinate_system": road}
                return xosc.TimeToCollisionCondition(limit, rule, **more)
            case "distance":
                plane = types.euclidianDistance
                return xosc.RelativeDistanceCondition(limit, rule, plane, to, freespace=False)
        kind, more = types.longitudinal, {"coordinate_system": road}
        return xosc.RelativeDistanceCondition(limit, rule, kind, to, **more)

    def _of_event(self, event: Event, condition: Condition) -> Any:
        """A condition on the state of another event."""
        xosc, other = self.xosc, self.events[str(condition.event)]
        kinds, states = xosc.StoryboardElementType, xosc.StoryboardElementState
        name, ends = other.title, (other.duration, other.until) != (None, None)
        if condition.state == "begun":
            if self._at_start(other) and isinstance(other, do.PlaceVehicle):
                return at_time(0.0)
            found = kinds.event, name, states.startTransition
        elif isinstance(other, do.LateralManeuver) or (
            isinstance(other, (do.Maneuver, do.CrossRoad, do.SetValue)) and not ends
        ):
            found = kinds.action, ACTION.format(name), states.completeState
        elif ends:
            found = kinds.event, f"{name} ends", states.startTransition
        else:
            self.fail(event, f"event {name!r} never ends")
        made = xosc.StoryboardElementStateCondition(*found)
        return xosc.ValueTrigger(f"{name} {condition.state}", *_timing(xosc, condition), made)

    def _on_route(self, event: Event, condition: Condition, of: str) -> Any:
        """A condition on the place of a road user on the truck's route."""
        xosc, member, low, high = self.xosc, self.members[of], condition.above, condition.below
        station = member.station
        if station is None or member.route is not self.route:
            self.fail(event, f"{condition.measure} of {of!r}, which is placed later or elsewhere")
        ref = station - member.front
        if condition.measure == "station" and high is None and low is not None:
            return xosc.TraveledDistanceCondition(_r(low - station))
        lowest, highest = 0.0, self.route.length
        if condition.measure == "lane":
            # From the right edge of the lowest one to the left edge of the highest one.
            lanes = [k for k in range(self.route.lane_count(ref)) if _meets(condition, k)]
            if not lanes:
                self.fail(event, f"no lane at {ref:.0f} m meets the condition")
            low, high = (
                float(self.route.lane_offset(k, ref) + side * self.route.lane_width(k, ref))
                for k, side in ((lanes[0], -0.5), (lanes[-1], 0.5))
            )
        elif condition.measure == "offset":
            lowest, highest = (float(edge) for edge in self.route.surface_edges(ref))
        elif condition.equals is not None:
            self.fail(event, "station equals: use above and below")
        low, high = lowest if low is None else low, highest if high is None else high
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        types, road = xosc.RelativeDistanceType, xosc.CoordinateSystem.road
        if condition.measure == "station":
            offset = float(self.route.lane_offset(member.lane, middle))
            place = self.position(self.route, middle - member.front, offset)
            kind = types.longitudinal
        else:
            place, kind = self.position(self.route, ref, middle), types.lateral
        rest = {"distance_type": kind, "coordinate_system": road, "freespace": False}
        return xosc.DistanceCondition(_r(half), xosc.Rule.lessThan, place, **rest)

    def _ahead(self, of: str, to: str, condition: Condition) -> list[list[Any]]:
        """Conditions on how far a road user is ahead of another one, which has no sign there.

        A time gap is only that of a road user ahead.
        """
        made: list[list[Any]] = []
        for limit, first, second in (
            (condition.above, of, to),
            (None if condition.below is None else -condition.below, to, of),
        ):
            if limit is None:
                continue
            way = limit + self.members[first].front - self.members[second].front
            xosc, rules, road = self.xosc, self.xosc.Rule, self.xosc.CoordinateSystem.road
            fixed = {"freespace": False, "coordinate_system": road}
            behind = xosc.TimeHeadwayCondition(second, FAR, rules.lessThan, **fixed)
            rule = rules.greaterThan if way >= 0.0 else rules.lessThan
            kind = xosc.RelativeDistanceType.longitudinal
            far = xosc.RelativeDistanceCondition(_r(abs(way)), rule, kind, second, **fixed)
            parts = [self._by_entity(first, each, condition) for each in (behind, far)]
            choice = [parts] if way >= 0.0 else [parts[:1], parts[1:]]
            made = [[*a, *b] for a in made for b in choice] if made else choice
        return made

    # Storyboard.

    def event(
        self, name: str, actor: str, actions: Sequence[tuple[str, Any]], trigger: Any
    ) -> None:
        """Adds a maneuver group of one event."""
        xosc = self.xosc
        made = xosc.Event(name, xosc.Priority.parallel)
        for each, action in actions:
            made.add_action(ACTION.format(each), action)
        made.add_trigger(trigger)
        maneuver = xosc.Maneuver(f"{name} maneuver")
        maneuver.add_event(made)
        group = xosc.ManeuverGroup(f"{name} group")
        group.add_actor(actor)
        group.add_maneuver(maneuver)
        self._act.add_maneuver_group(group)

    def after(self, name: str, actor: str, actions: Sequence[tuple[str, Any]], action: str) -> None:
        """Adds an event that begins when an action is complete."""
        xosc = self.xosc
        state = xosc.StoryboardElementState.completeState
        kind = xosc.StoryboardElementType.action
        made = xosc.StoryboardElementStateCondition(kind, ACTION.format(action), state)
        trigger = xosc.ValueTrigger(f"{action} is complete", *_timing(xosc), made)
        self.event(name, actor, actions, trigger)

    def ending(self, event: Event, actor: str, actions: Sequence[Any]) -> None:
        """Adds the actions at the end that an event has by its time."""
        xosc, name = self.xosc, f"{event.title} ends"
        if event.until is not None or (event.duration and self._at_start(event)):
            trigger = at_time(float(event.until or event.duration or 0.0))
        elif event.duration is not None:
            state = xosc.StoryboardElementState.startTransition
            kind = xosc.StoryboardElementType.event
            made = xosc.StoryboardElementStateCondition(kind, event.title, state)
            _, edge = _timing(xosc)
            trigger = xosc.ValueTrigger(name, _r(event.duration), edge, made)
        else:
            return
        named = [(f"{name} {k}" if k else name, each) for k, each in enumerate(actions)]
        self.event(name, actor, named, trigger)

    def _at_start(self, event: Event) -> bool:
        given = [getattr(event, field) for field in TIMES]
        return given in ([None] * 3, [0.0, None, None])

    def _command(self, event: Event) -> None:
        """Writes an event that OpenSCENARIO lacks as a command."""
        xosc, values = self.xosc, event.as_dict()
        if isinstance(event, do.Maneuver):
            self.entity(event, event.actor)
        content = json.dumps({n: v for n, v in values.items() if n not in (*TIMES, "name")})
        action = xosc.UserDefinedAction(xosc.CustomCommandAction(COMMAND, content))
        self.event(event.title, EGO, [(event.title, action)], self.trigger(event))
        self.remarks.append(
            f"{event.title} ({event.kind}) is a command of {COMMAND}, which others leave out"
        )

    # Places.

    def position(self, route: Route, station: float, offset: float) -> Any:
        """A LanePosition at a place of a route [m]."""
        road, s, _ = road_at(route, min(max(station, 0.0), route.length))
        frame = self._frames[road]
        s = min(max(s, 0.0), frame.length)
        point = route.evaluate(station, offset)
        t = frame.locate(float(point.x), float(point.y), s)[1]
        lane = min(frame.lanes(s), key=lambda each: max(each[1] - t, t - each[2]))[0]
        return self.xosc.LanePosition(_r(s), _r(t - frame.center_at(lane, s)), lane, road)

    def lane_position(self, route: Route, station: float, lane: int, aside: float = 0.0) -> Any:
        """A LanePosition beside the center of a lane of a route [m]."""
        return self.position(route, station, float(route.lane_offset(lane, station)) + aside)

    def _start(self, name: str, position: Any, speed: float) -> None:
        self.init.add_init_action(name, self.xosc.TeleportAction(position))
        self.init.add_init_action(name, speed_action(speed))

    def member(
        self,
        event: Event,
        name: str,
        kind: str,
        size: dict[str, float] | None = None,
        **more: Any,
    ) -> Member:
        """Adds an entity of a type."""
        if kind not in self._types:
            self.fail(event, f"type {kind!r}: allowed are {', '.join(self._types)}")
        if name in self.members:
            self.fail(event, f"there are two vehicles {name!r}")
        values = size_of(self._types[kind]) | (size or {})
        shape = [float(values[axis]) for axis in ("length", "width", "height")]
        body, ahead = body_of(name, values["kind"], shape)
        half = 0.5 * shape[0]
        fields = {"route": self.route, "station": None, "lane": 0, "reactive": False, "speed": 0.0}
        made = Member(half - ahead, half + ahead, **{**fields, **more})
        controller = None
        if made.reactive:
            xosc = self.xosc
            controller = xosc.Controller(MODEL, None, xosc.ControllerType.longitudinal)
        self.entities.add_scenario_object(name, body, controller)
        self.members[name] = made
        return made

    def appear(
        self,
        event: Event,
        places: Sequence[tuple[str, Any, Any]],
        then: Sequence[tuple[str, Any]] = (),
    ) -> None:
        """Lets entities appear at places, with actions that give their speeds.

        Args:
          event: of them.
          places: name, position and SpeedAction of each.
          then: names and actions of the first one from there on.
        """
        xosc, title = self.xosc, event.title
        if self._at_start(event):
            for name, position, speed in places:
                self.init.add_init_action(name, xosc.TeleportAction(position))
                self.init.add_init_action(name, speed)
            if then:
                self.event(title, places[0][0], then, self.trigger(event))
            return
        actions: list[tuple[str, Any]] = []
        for name, position, speed in places:
            actions += [(f"add {name}", xosc.AddEntityAction(name, position))]
            actions += [(f"start {name}", speed)] if len(places) == 1 else []
        self.event(title, places[0][0], [*actions, *then], self.trigger(event))

    def delete(self, event: Event, names: Sequence[str]) -> None:
        """Lets entities disappear at the end of an event."""
        self.ending(event, names[0], [self.xosc.DeleteEntityAction(name) for name in names])

    # Actions.

    def variable(self, name: str, value: float | str) -> Any:
        """An action that sets a variable."""
        self._variables.setdefault(name, value)
        return self.xosc.VariableSetAction(name, value)

    def stop(self, event: Event) -> None:
        """Ends the drive with an event."""
        for group in self.groups(event):
            self._stop.add_conditiongroup(self._group(group, "stop"))

    def profile(self, speed: float, rate: float, jerk: float, entity: str | None = None) -> Any:
        """An action to a speed, or to a difference to that of an entity, with limits."""
        xosc, rate, jerk = self.xosc, _r(rate), _r(jerk)
        limits = xosc.DynamicsConstraints(rate, rate, None, jerk, jerk)
        follow = xosc.FollowingMode.follow
        return xosc.SpeedProfileAction([_r(speed)], follow, None, limits, entity)

    def own_speed(self, actor: str) -> Any:
        """An action with which a vehicle keeps its speed."""
        xosc = self.xosc
        step = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0)
        return xosc.RelativeSpeedAction(0.0, actor, step, continuous=False)

    def model(self, active: bool) -> Any:
        """An action that lets the controller of a vehicle drive, or not."""
        return self.xosc.ActivateControllerAction(longitudinal=active)

    def dynamics(self, event: do.LateralManeuver) -> Any:
        """The course of a lane change."""
        xosc = self.xosc
        given = {
            "time": event.duration,
            "rate": event.lateral_speed,
            "distance": event.distance,
        }
        for kind, value in given.items():
            if value is not None:
                shape = getattr(xosc.DynamicsShapes, event.shape)
                dimension = getattr(xosc.DynamicsDimension, kind)
                return xosc.TransitionDynamics(shape, dimension, _r(value))
        return self.fail(event, "lateral_acceleration has no counterpart: give duration")

    def aside(self, offset: float, way: float, span: float, shape: str) -> Any:
        """A motion to an offset from the lane's center over a way [m] in a time [s]."""
        xosc = self.xosc
        bound = do.BENDS[shape] * abs(way) / span**2
        return xosc.AbsoluteLaneOffsetAction(
            _r(offset), getattr(xosc.DynamicsShapes, shape), bound, False
        )

    def trajectory(
        self, name: str, places: Any, times: Sequence[float] | None, frame: str
    ) -> tuple[Any, Any]:
        """An action along places of an entity's center, and the first position."""
        xosc, member = self.xosc, self.members[name]
        points = [tuple(place) for place in places]
        if frame == "route":
            points, numbers = points_on_route(self.route, points)
            points = points if times is None else [points[k] for k in numbers]
        back, positions = 0.5 * (member.front - member.back), []
        for before, (x, y, *z), after in zip(
            [points[0], *points[:-1]], points, [*points[1:], points[-1]], strict=True
        ):
            turn = math.atan2(after[1] - before[1], after[0] - before[0])
            place = x - back * math.cos(turn), y - back * math.sin(turn), *(z or [None])
            positions.append(xosc.WorldPosition(*map(_r, place), _r(turn)))
        path = xosc.Trajectory(f"path of {name}", closed=False)
        path.add_shape(xosc.Polyline(list(times or []), positions))
        timing = (xosc.ReferenceContext.relative, 1.0, 0.0) if times else ()
        follow = xosc.FollowingMode.position
        return xosc.FollowTrajectoryAction(path, follow, *timing), positions[0]


def _r(value: float | None) -> Any:
    return None if value is None else round(float(value), DIGITS)


def _timing(xosc: Any, condition: Condition | None = None) -> tuple[float, Any]:
    """Delay and edge of a condition."""
    if condition is None:
        return 0.0, xosc.ConditionEdge.none
    edge = {"either": "risingOrFalling"}.get(condition.edge, condition.edge)
    return condition.delay, getattr(xosc.ConditionEdge, edge)


def _meets(condition: Condition, value: float) -> bool:
    if condition.equals is not None:
        return value == condition.equals
    low = -math.inf if condition.above is None else condition.above
    return low < value < (math.inf if condition.below is None else condition.below)


# The writers of the kinds of events; one that returns False leaves the event to a command.


def _place(story: _Story, event: do.PlaceVehicle) -> bool | None:
    xosc, ego, name = story.xosc, story.ego, str(event.name)
    front, lane, at_start = event.station, event.lane, story._at_start(event)
    route = story.route
    if event.along is not None:
        route = route.road_map.route(along=event.along)
    ego_front = float(ego.station or 0.0)
    if lane is None:
        lane = ego.lane + (event.relative_lane or 0)
    speed = event.speed
    if speed is None:
        speed = max(ego.speed + (event.speed_difference or 0.0), 0.0)
    size = {n: v for n in ("length", "width", "height") if (v := getattr(event, n)) is not None}
    reactive = event.reactive and speed > 0.0
    member = story.member(
        event, name, event.type, size, route=route, lane=lane, reactive=reactive, speed=speed
    )
    gap = event.gap
    if gap is not None:
        # From the truck's reference point to that of the vehicle.
        way = ego.front + gap + member.back if gap >= 0.0 else gap - ego.back - member.front
        front = ego_front - ego.front + way + member.front
    starts = speed_action(speed)
    then: list[tuple[str, Any]] = []
    if event.points is not None:
        action, position = story.trajectory(name, event.points, None, event.frame)
        then.append((f"way of {name}", action))
    elif at_start or (gap is None and None not in (event.lane, event.speed)):
        assert front is not None
        position = story.lane_position(route, front - member.front, lane, event.offset or 0.0)
        story.members[name] = member._replace(station=front)
    elif gap is None or event.lane is not None:
        story.fail(event, "give station, lane and speed, or gap and relative_lane")
    else:
        position = xosc.RelativeLanePosition(
            event.relative_lane or 0, EGO, event.offset or 0.0, ds=_r(way)
        )
        if event.speed is None:
            step = xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0
            dynamics = xosc.TransitionDynamics(*step)
            starts = xosc.RelativeSpeedAction(
                event.speed_difference or 0.0, EGO, dynamics, continuous=False
            )
    story.appear(event, [(name, position, starts)], then)
    story.delete(event, [name])
    return None


def _cut_in(story: _Story, event: do.CutIn) -> None:
    xosc, actor, title = story.xosc, story.entity(event, event.actor), event.title
    reactive = story.members[actor].reactive
    change = xosc.RelativeLaneChangeAction(0, EGO, story.dynamics(event))
    difference = event.speed_difference
    if event.gap is not None:
        difference = difference or 0.0
    speed = story.own_speed(actor)
    if difference is not None:
        speed = story.profile(difference, HOLD_RATE, HOLD_JERK, EGO)
    # At constant speed, without the model, which then goes on with this speed as its desired one.
    actions = [(title, change), (f"speed of {title}", speed)]
    actions += [(f"{title} without model", story.model(False))] if reactive else []
    if event.gap is None:
        story.event(title, actor, actions, story.trigger(event))
    else:
        approach = xosc.LongitudinalDistanceAction(
            *(EGO, True, False, APPROACH, APPROACH, None, _r(event.gap)),
            coordinate_system=xosc.CoordinateSystem.road,
            displacement=getattr(xosc.LongitudinalDisplacement, AHEAD),
        )
        way = f"way of {title}"
        story.event(title, actor, [(way, approach)], story.trigger(event))
        story.after(f"lane change of {title}", actor, actions, way)
    if reactive:
        story.after(f"{title} ends", actor, [(f"{title} with model", story.model(True))], title)


def _change_lane(story: _Story, event: do.ChangeLane) -> None:
    xosc, actor = story.xosc, story.entity(event, event.actor)
    dynamics, member = story.dynamics(event), story.members[actor]
    if event.lane is None:
        to = actor if event.to is None else story.entity(event, event.to)
        action = xosc.RelativeLaneChangeAction(event.relative_lane, to, dynamics)
    elif member.station is None:
        story.fail(event, f"lane of {actor!r}, which is placed later: give relative_lane")
    else:
        place = story.lane_position(member.route, member.station - member.front, event.lane)
        action = xosc.AbsoluteLaneChangeAction(int(place.lane_id), dynamics)
    story.event(event.title, actor, [(event.title, action)], story.trigger(event))


def _brake(story: _Story, event: do.Brake) -> None:
    _speed(story, event, story.profile(event.to_speed, event.deceleration, event.jerk))


def _change_speed(story: _Story, event: do.ChangeSpeed) -> None:
    xosc = story.xosc
    to = None if event.speed is not None else story.entity(event, event.to)
    value = next(
        v for v in (event.speed, event.speed_difference, event.speed_factor) if v is not None
    )
    if event.shape is None and not event.continuous and event.speed_factor is None:
        action = story.profile(value, event.acceleration, event.jerk, to)
        _speed(story, event, action)
        return
    kinds, shape = xosc.DynamicsDimension, event.shape or "linear"
    dimension: tuple[Any, float] = (kinds.rate, event.acceleration * do.STEEPEST.get(shape, 1.0))
    if event.time is not None or shape == "step":
        dimension = kinds.time, event.time or 0.0
    elif event.distance is not None:
        dimension = kinds.distance, event.distance
    dynamics = xosc.TransitionDynamics(
        getattr(xosc.DynamicsShapes, shape), dimension[0], _r(dimension[1])
    )
    if to is None:
        action = xosc.AbsoluteSpeedAction(_r(value), dynamics)
    else:
        values = xosc.SpeedTargetValueType
        kind = values.delta if event.speed_factor is None else values.factor
        action = xosc.RelativeSpeedAction(_r(value), to, dynamics, kind, event.continuous)
    _speed(story, event, action)


def _speed(story: _Story, event: do.Brake | do.ChangeSpeed, action: Any) -> None:
    """A change of speed; with a duration the model then goes on with its former desired speed."""
    actor, title = story.entity(event, event.actor), event.title
    reactive = story.members[actor].reactive
    actions = [(title, action)]
    if reactive and event.duration is not None:
        actions.insert(0, (f"{title} without model", story.model(False)))
    story.event(title, actor, actions, story.trigger(event))
    story.ending(event, actor, [story.model(True) if reactive else story.own_speed(actor)])


def _swerve(story: _Story, event: do.Swerve) -> None:
    actor, title = story.entity(event, event.actor), event.title
    way, shape = event.offset, event.shape
    if event.distance is not None:
        story.fail(event, "distance has no counterpart: give duration")
    if event.lateral_speed is not None:
        span = do.STEEPEST[shape] * abs(way) / event.lateral_speed
    elif event.lateral_acceleration is not None:
        span = math.sqrt(do.BENDS[shape] * abs(way) / event.lateral_acceleration)
    else:
        span = float(event.duration or 0.0) * (0.5 if event.back else 1.0)
    out = story.aside(way, way, span, shape)
    first = f"{title} out" if event.back else title
    story.event(title, actor, [(first, out)], story.trigger(event))
    if event.back:
        back = story.aside(0.0, way, span, shape)
        story.after(f"{title} back", actor, [(title, back)], first)


def _drift(story: _Story, event: do.Drift) -> None:
    actor, title = story.entity(event, event.actor), event.title
    way = event.offset
    out = story.aside(way, way, abs(way) / event.lateral_speed, "linear")
    first = f"{title} out" if event.recovery else title
    story.event(title, actor, [(first, out)], story.trigger(event))
    if event.recovery:
        back = story.aside(0.0, way, event.recovery, "sinusoidal")
        story.after(f"{title} back", actor, [(title, back)], first)


def _keep_distance(story: _Story, event: do.KeepDistance) -> None:
    xosc, actor, to = story.xosc, story.entity(event, event.actor), story.entity(event, event.to)
    most = None if event.fastest == do.SPEED_MAX else event.fastest
    shift = 0.0 if event.freespace else story.members[actor].front - story.members[to].front
    if shift and event.gap is None:
        story.fail(event, "a time_gap between the front bumpers has no counterpart: use freespace")
    action = xosc.LongitudinalDistanceAction(
        *(to, event.freespace, event.continuous, event.acceleration, event.deceleration, most),
        *(_r(None if event.gap is None else event.gap + shift), _r(event.time_gap)),
        coordinate_system=xosc.CoordinateSystem.road,
        displacement=getattr(xosc.LongitudinalDisplacement, AHEAD if event.ahead else BEHIND),
    )
    story.event(event.title, actor, [(event.title, action)], story.trigger(event))


def _synchronize(story: _Story, event: do.Synchronize) -> None:
    xosc, actor, to = story.xosc, story.entity(event, event.actor), story.entity(event, event.to)
    places = []
    for name, station in ((to, event.to_station), (actor, event.station)):
        member = story.members[name]
        places.append(story.lane_position(member.route, station - member.front, member.lane))
    final = None
    if event.speed is not None:
        final = xosc.AbsoluteSpeed(event.speed)
    elif event.speed_difference is not None:
        delta = xosc.SpeedTargetValueType.delta
        final = xosc.RelativeSpeedToMaster(event.speed_difference, delta)
    action = xosc.SynchronizeAction(to, *places, event.to_tolerance, event.tolerance, final)
    story.event(event.title, actor, [(event.title, action)], story.trigger(event))


def _follow_path(story: _Story, event: do.FollowPath) -> bool | None:
    actor = story.entity(event, event.actor)
    if event.points is None or event.goal not in (None, len(event.points) - 1):
        return False
    if event.times is not None and len(event.times) < len(event.points):
        return False
    action, _ = story.trajectory(actor, event.points, event.times, event.frame)
    story.event(event.title, actor, [(event.title, action)], story.trigger(event))
    return None


def _cross(story: _Story, event: do.CrossRoad) -> bool | None:
    name, route = str(event.name), story.route
    station = event.station
    if station is None:
        if not story._at_start(event):
            return False  # its place depends on where the truck is then
        station = float(story.ego.station or 0.0) + float(event.gap or 0.0)
    right, left = (float(edge) for edge in route.surface_edges(station))
    begin, way = (right, left - right) if event.side == "right" else (left, right - left)
    if event.distance is not None:
        way = math.copysign(event.distance, way)
    story.member(event, name, event.type, speed=event.speed)
    ends = [route.evaluate(station, begin), route.evaluate(station, begin + way)]
    points = [(float(p.x), float(p.y), float(p.z)) for p in ends]
    action, place = story.trajectory(name, points, None, "map")
    story.appear(event, [(name, place, speed_action(event.speed))], [(event.title, action)])
    last = speed_action(0.0) if event.distance else story.xosc.DeleteEntityAction(name)
    story.after(f"{event.title} ends", name, [(f"{event.title} ends", last)], event.title)
    return None


def _remove(story: _Story, event: do.RemoveVehicle) -> None:
    actor = story.entity(event, event.actor)
    action = story.xosc.DeleteEntityAction(actor)
    story.event(event.title, actor, [(event.title, action)], story.trigger(event))


def _set_value(story: _Story, event: do.SetValue) -> None:
    name, value = event.variable, event.value
    action = story.variable(name, value)
    if name.startswith(SIGNAL):
        state = str(value)
        action = story.xosc.TrafficSignalStateAction(name.removeprefix(SIGNAL), state)
    story.event(event.title, EGO, [(event.title, action)], story.trigger(event))


def _milestone(story: _Story, event: do.Milestone) -> None:
    action = story.variable(event.title, 1.0)
    story.event(event.title, EGO, [(event.title, action)], story.trigger(event))


def _friction(story: _Story, event: do.FrictionChange) -> bool | None:
    xosc, part = story.xosc, (event.friction_right, event.start, event.end)
    if part != (None, 0.0, sumo.LONGEST) or (event.until, event.duration) != (None, None):
        return False
    station = float(story.ego.station or 0.0)
    lane = float(story.route.lane_offset(story.ego.lane, station))
    factor = event.friction / float(story.route.friction(station, lane))
    environment = xosc.Environment(event.title, roadcondition=xosc.RoadCondition(_r(factor)))
    _environment(story, event, environment)
    return None


def _wind(story: _Story, event: do.Wind) -> bool | None:
    if event.shape != "steady" or (event.until, event.duration) != (None, None):
        return False
    xosc = story.xosc
    heading = float(story.route.heading(float(story.ego.station or 0.0)))  # type: ignore[arg-type]
    # The file has where it blows to, from the map's x axis.
    direction = (math.radians(event.direction) + heading + math.pi) % math.tau
    weather = xosc.Weather(wind=xosc.Wind(_r(direction), event.speed))
    _environment(story, event, xosc.Environment(event.title, weather=weather))
    return None


def _environment(story: _Story, event: Event, environment: Any) -> None:
    action = story.xosc.EnvironmentAction(environment)
    if story._at_start(event):
        story.init.add_global_action(action)
    else:
        story.event(event.title, EGO, [(event.title, action)], story.trigger(event))


def _stand(story: _Story, event: sumo.StoppedVehicle) -> None:
    name = event.title
    _standing(story, event, event.type, event.lane, [event.station], [name])
    if (event.until, event.duration) != (None, None):
        speed = traffic_speed(story.config, story.route)
        rate = story._types[event.type].acceleration
        story.ending(event, name, [story.profile(speed, rate, HOLD_JERK)])


def _close_lane(story: _Story, event: sumo.LaneClosure) -> None:
    kind = story._types["truck"]
    stations = closure_places(event, kind.length)
    names = [f"{event.title} {k}" for k in range(1, len(stations) + 1)]
    _standing(story, event, kind.name, event.lane, stations, names)
    story.delete(event, names)


def _standing(
    story: _Story,
    event: Event,
    kind: str,
    lane: int,
    stations: Sequence[float],
    names: Sequence[str],
) -> None:
    places = []
    for name, station in zip(names, stations, strict=True):
        member = story.member(event, name, kind, station=station, lane=lane)
        place = story.lane_position(story.route, station - member.front, lane)
        places.append((name, place, speed_action(0.0)))
    story.appear(event, places)


def _convoy(story: _Story, event: sumo.SlowConvoy) -> bool | None:
    if not story._at_start(event) or (event.until, event.duration) != (None, None):
        return False
    places = []
    for k, station in enumerate(convoy_places(event, story._types[event.type]), 1):
        name = f"{event.title} {k}"
        member = story.member(
            event, name, event.type, station=station, lane=event.lane, speed=event.speed
        )
        place = story.lane_position(story.route, station - member.front, event.lane)
        places.append((name, place, speed_action(event.speed)))
    story.appear(event, places)
    return None


WRITERS: dict[type[Event], Callable[[_Story, Any], Any]] = {
    do.PlaceVehicle: _place,
    do.CutIn: _cut_in,
    do.ChangeLane: _change_lane,
    do.Brake: _brake,
    do.ChangeSpeed: _change_speed,
    do.Swerve: _swerve,
    do.Drift: _drift,
    do.KeepDistance: _keep_distance,
    do.Synchronize: _synchronize,
    do.FollowPath: _follow_path,
    do.CrossRoad: _cross,
    do.RemoveVehicle: _remove,
    do.SetValue: _set_value,
    do.Milestone: _milestone,
    do.EndDrive: lambda story, event: story.stop(event),
    do.FrictionChange: _friction,
    do.Wind: _wind,
    sumo.StoppedVehicle: _stand,
    sumo.LaneClosure: _close_lane,
    sumo.SlowConvoy: _convoy,
}
