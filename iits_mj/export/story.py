"""A scenario in the making, of scenariogeneration's parts: entities, triggers, events.

Each event has the name of that of the drive, and its action "NAME action" ends when that one ends.
Vehicles that the Intelligent Driver Model drives have the controller `MODEL`, which other
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
from xml.etree.ElementTree import Element

from iits_mj.core.errors import InputError
from iits_mj.export.openscenario import (
    EGO,
    add_truck,
    at_time,
    body_of,
    reference_of,
    scenario_element,
    speed_action,
    xosc_package,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.road_frames import RoadFrames
from iits_mj.simulation.config import DriveConfig
from traffic_bridge.scenario import actions as do
from traffic_bridge.scenario.actors import REST, size_of
from traffic_bridge.scenario.conditions import ROLES, SIGNAL, TRUCK, Condition
from traffic_bridge.scenario.openscenario_actions import COMMAND
from traffic_bridge.scenario.openscenario_entities import MODEL
from traffic_bridge.scenario.openscenario_places import road_at
from traffic_bridge.scenario.openscenario_triggers import TOUCH
from traffic_bridge.scenario.paths import points_on_route
from traffic_bridge.signals import events as sumo
from traffic_bridge.signals.events import Event
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
      route: its road; station: of its front at the beginning [m], None: it is placed later.
      lane: from the outside; reactive: it has the controller `MODEL`.
    """

    back: float
    front: float
    route: Route
    station: float | None = None
    lane: int = 0
    reactive: bool = False


class Story:
    """A scenario in the making.

    Attributes:
      events: of the drive by names, which are all different.
      ego: the truck; ego_front, speed: of it at the beginning [m], [m/s].
      members: by the names of the entities.
      remarks: what other simulators leave out.
    """

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
        self.types = {kind.name: kind for kind in (*default_types(), *road_user_types())}
        self.entities, self.init = xosc.Entities(), xosc.Init()
        self._act = xosc.Act("act", at_time(0.0), xosc.Trigger("stop"))
        self._stop, self._variables = xosc.Trigger("stop"), dict[str, float | str]()
        station, lane = config.start_station, config.start_lane
        limit = float(route.speed_limit(station, lane))
        self.speed = min(config.start_speed, config.speed, limit)
        size = parameters.footprint
        front, rear = size.front_overhang, reference_of(parameters.units[0])
        self.ego_front = station + front
        ends = size.length - front - rear, front + rear
        self.ego = Member(*ends, route, self.ego_front, lane)
        self.members = {EGO: self.ego}
        add_truck(self.entities, parameters)
        position = self.lane_position(route, station - rear, lane)
        self.init.add_init_action(EGO, xosc.TeleportAction(position))
        self.init.add_init_action(EGO, speed_action(self.speed))

    def element(self, path: Path) -> Element:
        """Returns the root of the file."""
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
        return scenario_element(path, self.entities, board, declared)

    def fail(self, event: Event, message: str) -> NoReturn:
        """Raises InputError that names an event."""
        raise InputError(f"OpenSCENARIO: event {event.title!r}: {message}")

    def groups(self, event: Event) -> list[list[Any]]:
        """The groups of conditions on which an event begins."""
        if event.at_station is not None:
            way = max(event.at_station - self.config.start_station, 0.0)
            return [[self._when(self.xosc.TraveledDistanceCondition(rounded(way)), EGO)]]
        if event.when is None:
            return [[at_time(event.at_time or 0.0)]]
        found: list[list[Any]] = []
        for group in event.when:
            parts = (self._alternatives(event, condition) for condition in group)
            found += [list(itertools.chain(*chosen)) for chosen in itertools.product(*parts)]
        return found

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

    def _when(self, condition: Any, entity: str = "", like: Condition | None = None) -> Any:
        """A condition, of an entity or by value, with delay and edge of one of an event."""
        xosc, name, edge = self.xosc, type(condition).__name__, "none"
        if like is not None and like.edge != edge:
            edge = {"either": "risingOrFalling"}.get(like.edge, like.edge)
        timing = 0.0 if like is None else like.delay, getattr(xosc.ConditionEdge, edge)
        if entity:
            return xosc.EntityTrigger(name, *timing, condition, entity)
        return xosc.ValueTrigger(name, *timing, condition)

    def _state(self, kind: str, name: str, state: str) -> Any:
        """A condition on the state of an element."""
        xosc = self.xosc
        kinds = getattr(xosc.StoryboardElementType, kind), name
        return xosc.StoryboardElementStateCondition(
            *kinds, getattr(xosc.StoryboardElementState, state)
        )

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
        xosc, of, measure = self.xosc, "", str(condition.measure)
        rules = ("greaterThan", "lessThan", "equalTo")
        given = zip(rules, (condition.above, condition.below, condition.equals), strict=True)
        limits: list[tuple[str, Any]] = [each for each in given if each[1] is not None]
        if (len(limits) > 1 or measure == "ahead") and condition.edge != "none":
            self.fail(event, f"a condition with edge {condition.edge!r} needs one limit")
        if condition.measure is not None:
            of = self.entity(event, condition.of)
        to = "" if condition.to is None else self.entity(event, condition.to)
        if condition.event is not None:
            made = [self._of_event(event, condition)]
        elif condition.variable is not None:
            made = self._of_variable(condition.variable, condition.text, limits)
        elif condition.lasting:
            if measure != "speed" or condition.below != REST:
                self.fail(event, f"lasting is written for speeds below {REST:g} m/s only")
            made = [xosc.StandStillCondition(condition.lasting)]
        elif measure == "ahead":
            return self._ahead(of, to, condition)
        elif measure in ("station", "lane", "offset"):
            made = [self._on_route(event, condition, of)]
        elif condition.point is not None:
            self.fail(event, "a distance to a point has no counterpart: use station")
        elif measure == "clearance" and limits != [("lessThan", TOUCH)]:
            self.fail(event, f"clearance is written below {TOUCH:g} m only: a collision")
        else:
            if measure == "time":
                limits, of = [(INCLUSIVE.get(rule, rule), value) for rule, value in limits], ""
            elif measure == "speed_difference":  # of the entity that triggers to the other one
                limits = [(OPPOSITE.get(rule, rule), -value) for rule, value in limits]
            compared = COMPARED[measure]
            made = [compared(xosc, to, value, getattr(xosc.Rule, rule)) for rule, value in limits]
        return [[self._when(each, of, condition) for each in made]]

    def _of_variable(
        self, name: str, text: str | None, limits: Sequence[tuple[str, Any]]
    ) -> list[Any]:
        xosc = self.xosc
        if name.startswith(SIGNAL) and text is not None:
            return [xosc.TrafficSignalCondition(name.removeprefix(SIGNAL), text)]
        self._variables.setdefault(name, 0.0 if text is None else text)
        limits = limits if text is None else [("equalTo", text)]
        return [xosc.VariableCondition(name, v, getattr(xosc.Rule, rule)) for rule, v in limits]

    def _of_event(self, event: Event, condition: Condition) -> Any:
        """A condition on the state of another event."""
        other = self.events[str(condition.event)]
        several = isinstance(other, (sumo.LaneClosure, sumo.SlowConvoy))
        name = f"{other.title} 1" if several else other.title
        ends = (other.duration, other.until) != (None, None)
        by_action = isinstance(other, (do.Maneuver, do.CrossRoad, do.SetValue)) and not ends
        if condition.state == "begun":
            if self.at_start(other) and isinstance(other, INITIAL):
                return self.xosc.SimulationTimeCondition(0.0, self.xosc.Rule.greaterOrEqual)
            return self._state("event", name, "startTransition")
        if by_action or isinstance(other, do.LateralManeuver):
            return self._state("action", ACTION.format(name), "completeState")
        if ends and isinstance(other, ENDING):
            return self._state("event", f"{name} ends", "startTransition")
        return self.fail(event, f"event {name!r} never ends")

    def _on_route(self, event: Event, condition: Condition, of: str) -> Any:
        """A condition on the place of a road user on the truck's route."""
        xosc, member, route = self.xosc, self.members[of], self.route
        low, high, measure = condition.above, condition.below, condition.measure
        if member.station is None or member.route is not route:
            self.fail(event, f"{measure} of {of!r}, which is placed later or elsewhere")
        if condition.equals is not None and measure != "lane":
            self.fail(event, f"{measure} equals: use above and below")
        ref = member.station - member.front
        if measure == "station" and high is None and low is not None:
            return xosc.TraveledDistanceCondition(rounded(max(low - member.station, 0.0)))
        ends = (0.0, route.length) if measure == "station" else route.surface_edges(ref)
        if measure == "lane":
            # From the right edge of the lowest one to the left edge of the highest one.
            lanes = [k for k in range(route.lane_count(ref)) if _meets(condition, k)]
            if not lanes:
                self.fail(event, f"no lane at {ref:.0f} m meets the condition")
            low = float(route.lane_offset(lanes[0], ref) - 0.5 * route.lane_width(lanes[0], ref))
            high = float(route.lane_offset(lanes[-1], ref) + 0.5 * route.lane_width(lanes[-1], ref))
        low, high = float(ends[0] if low is None else low), float(ends[1] if high is None else high)
        middle, half, kind = 0.5 * (low + high), 0.5 * (high - low), "lateral"
        place = ref, middle
        if measure == "station":
            kind, place = "longitudinal", (middle - member.front, float(
                route.lane_offset(member.lane, middle)
            ))  # fmt: skip
        more = {"distance_type": getattr(xosc.RelativeDistanceType, kind), "freespace": False}
        at = self.position(route, *place)
        return xosc.DistanceCondition(
            rounded(half), xosc.Rule.lessThan, at, **more, **on_road(xosc)
        )

    def _ahead(self, of: str, to: str, condition: Condition) -> list[list[Any]]:
        """Conditions on how far a road user is ahead of another one, which has no sign there.

        A time gap is only that of a road user ahead.
        """
        xosc, made = self.xosc, list[list[Any]]()
        below = None if condition.below is None else -condition.below
        for limit, first, second in ((condition.above, of, to), (below, to, of)):
            if limit is None:
                continue
            way = limit + self.members[first].front - self.members[second].front
            fixed = {"freespace": False, **on_road(xosc)}
            behind = xosc.TimeHeadwayCondition(second, FAR, xosc.Rule.lessThan, **fixed)
            rule = xosc.Rule.greaterThan if way >= 0.0 else xosc.Rule.lessThan
            kind = xosc.RelativeDistanceType.longitudinal
            far = xosc.RelativeDistanceCondition(rounded(abs(way)), rule, kind, second, **fixed)
            parts = [self._when(each, first, condition) for each in (behind, far)]
            choice = [parts] if way >= 0.0 else [parts[:1], parts[1:]]
            made = [[*a, *b] for a in made for b in choice] if made else choice
        return made

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

    def acts(self, event: Event, action: Any, actor: str = EGO) -> None:
        """Adds an event of one action."""
        self.event(event.title, actor, [(event.title, action)], self.trigger(event))

    def after(self, name: str, actor: str, actions: Sequence[tuple[str, Any]], action: str) -> None:
        """Adds an event that begins when an action is complete."""
        made = self._state("action", ACTION.format(action), "completeState")
        self.event(name, actor, actions, self._when(made))

    def ending(self, event: Event, actor: str, action: Any) -> None:
        """Adds an action at the end that an event has by its time."""
        name = f"{event.title} ends"
        if event.until is not None or (event.duration and self.at_start(event)):
            trigger = at_time(float(event.until or event.duration or 0.0))
        elif event.duration is not None:
            made = self._state("event", event.title, "startTransition")
            trigger = self._when(made, "", Condition(event=event.title, delay=event.duration))
        else:
            return
        self.event(name, actor, [(name, action)], trigger)

    def at_start(self, event: Event) -> bool:
        """Whether an event begins at the start of the drive."""
        given = [getattr(event, field) for field in TIMES]
        return given in ([None] * 3, [0.0, None, None])

    def command(self, event: Event) -> None:
        """Writes an event that OpenSCENARIO lacks as a command."""
        xosc, values = self.xosc, event.as_dict()
        if isinstance(event, do.Maneuver):
            self.entity(event, event.actor)
        content = json.dumps({n: v for n, v in values.items() if n not in (*TIMES, "name")})
        action = xosc.UserDefinedAction(xosc.CustomCommandAction(COMMAND, content))
        self.acts(event, action)
        self.remarks.append(
            f"{event.title} ({event.kind}) is a command of {COMMAND}, which others leave out"
        )

    def position(self, route: Route, station: float, offset: float) -> Any:
        """A LanePosition at a place of a route [m]."""
        road, s, _ = road_at(route, min(max(station, 0.0), route.length))
        frame = self._frames[road]
        s = min(max(s, 0.0), frame.length)
        point = route.evaluate(station, offset)
        t = frame.locate(float(point.x), float(point.y), s)[1]
        lane = min(frame.lanes(s), key=lambda each: max(each[1] - t, t - each[2]))[0]
        return self.xosc.LanePosition(rounded(s), rounded(t - frame.center_at(lane, s)), lane, road)

    def lane_position(self, route: Route, station: float, lane: int, aside: float = 0.0) -> Any:
        """A LanePosition beside the center of a lane of a route [m]."""
        return self.position(route, station, float(route.lane_offset(lane, station)) + aside)

    def member(
        self,
        event: Event,
        name: str,
        kind: str,
        size: dict[str, float] | None = None,
        **more: Any,
    ) -> Member:
        """Adds an entity of a type."""
        if kind not in self.types:
            self.fail(event, f"type {kind!r}: allowed are {', '.join(self.types)}")
        if name in self.members:
            self.fail(event, f"there are two vehicles {name!r}")
        values = size_of(self.types[kind]) | (size or {})
        shape = [float(values[axis]) for axis in ("length", "width", "height")]
        body, ahead = body_of(name, values["kind"], shape)
        half = 0.5 * shape[0]
        made = Member(half - ahead, half + ahead, **{"route": self.route, **more})
        controller = None
        if made.reactive:
            xosc = self.xosc
            controller = xosc.Controller(MODEL, None, xosc.ControllerType.longitudinal)
        self.entities.add_scenario_object(name, body, controller)
        self.members[name] = made
        return made

    def appear(
        self, event: Event, name: str, position: Any, speed: Any, then: Sequence[tuple[str, Any]]
    ) -> None:
        """Lets an entity appear at a position, with an action that gives its speed, and others."""
        xosc = self.xosc
        if not self.at_start(event):
            added = (f"add {name}", xosc.AddEntityAction(name, position)), (f"start {name}", speed)
            self.event(event.title, name, [*added, *then], self.trigger(event))
            return
        self.init.add_init_action(name, xosc.TeleportAction(position))
        self.init.add_init_action(name, speed)
        if then:
            self.event(event.title, name, then, self.trigger(event))

    def variable(self, name: str, value: float | str, change: str | None = None) -> Any:
        """An action that sets a variable, or changes it, see `SetValue`."""
        self._variables.setdefault(name, value)
        if change is None:
            return self.xosc.VariableSetAction(name, value)
        kinds = {"add": self.xosc.VariableAddAction, "multiply": self.xosc.VariableMultiplyAction}
        return kinds[change](name, value)

    def stop(self, event: Event) -> None:
        """Ends the drive with an event."""
        for group in self.groups(event):
            self._stop.add_conditiongroup(self._group(group, "stop"))

    def profile(self, speed: float, rate: float, jerk: float, entity: str | None = None) -> Any:
        """An action to a speed, or to a difference to that of an entity, with limits."""
        xosc, rate, jerk = self.xosc, rounded(rate), rounded(jerk)
        limits = xosc.DynamicsConstraints(rate, rate, None, jerk, jerk)
        follow = xosc.FollowingMode.follow
        return xosc.SpeedProfileAction([rounded(speed)], follow, None, limits, entity)

    def transition(self, shape: str, dimension: str, value: float) -> Any:
        """The course of a change."""
        xosc = self.xosc
        kinds = getattr(xosc.DynamicsShapes, shape), getattr(xosc.DynamicsDimension, dimension)
        return xosc.TransitionDynamics(*kinds, rounded(value))

    def own_speed(self, actor: str) -> Any:
        """An action with which a vehicle keeps its speed."""
        step = self.transition("step", "time", 0.0)
        return self.xosc.RelativeSpeedAction(0.0, actor, step, continuous=False)

    def model(self, active: bool) -> Any:
        """An action that lets the controller of a vehicle drive, or not."""
        return self.xosc.ActivateControllerAction(longitudinal=active)

    def dynamics(self, event: do.LateralManeuver) -> Any:
        """The course of a lane change."""
        names = ("time", "rate", "distance")
        given = (event.duration, event.lateral_speed, event.distance)
        for kind, value in zip(names, given, strict=True):
            if value is not None:
                return self.transition(event.shape, kind, value)
        return self.fail(event, "lateral_acceleration has no counterpart: give duration")

    def aside(self, offset: float, way: float, span: float, shape: str) -> Any:
        """A motion to an offset from the lane's center over a way [m] in a time [s]."""
        xosc = self.xosc
        bound = do.BENDS[shape] * abs(way) / span**2
        return xosc.AbsoluteLaneOffsetAction(
            rounded(offset), getattr(xosc.DynamicsShapes, shape), bound, False
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
            positions.append(xosc.WorldPosition(*map(rounded, place), rounded(turn)))
        path = xosc.Trajectory(f"path of {name}", closed=False)
        path.add_shape(xosc.Polyline(list(times or []), positions))
        timing = (xosc.ReferenceContext.relative, 1.0, 0.0) if times else ()
        follow = xosc.FollowingMode.position
        return xosc.FollowTrajectoryAction(path, follow, *timing), positions[0]


def on_road(xosc: Any) -> dict[str, Any]:
    """Measured along the road."""
    return {"coordinate_system": xosc.CoordinateSystem.road}


# Conditions by measures of one or two bodies: of the other entity, a limit and a rule.
COMPARED: dict[str, Callable[[Any, str, float, Any], Any]] = {
    "time": lambda xosc, _, limit, rule: xosc.SimulationTimeCondition(limit, rule),
    "speed": lambda xosc, _, limit, rule: xosc.SpeedCondition(limit, rule),
    "acceleration": lambda xosc, _, limit, rule: xosc.AccelerationCondition(limit, rule),
    "speed_difference": lambda xosc, to, limit, rule: xosc.RelativeSpeedCondition(limit, rule, to),
    "time_gap": lambda xosc, to, limit, rule: xosc.TimeHeadwayCondition(
        to, limit, rule, **on_road(xosc)
    ),
    "ttc": lambda xosc, to, limit, rule: xosc.TimeToCollisionCondition(
        limit, rule, entity=to, **on_road(xosc)
    ),
    "gap": lambda xosc, to, limit, rule: xosc.RelativeDistanceCondition(
        limit, rule, xosc.RelativeDistanceType.longitudinal, to, **on_road(xosc)
    ),
    "distance": lambda xosc, to, limit, rule: xosc.RelativeDistanceCondition(
        limit, rule, xosc.RelativeDistanceType.euclidianDistance, to, freespace=False
    ),
    "clearance": lambda xosc, to, *_: xosc.CollisionCondition(to),
}
# Kinds of events that are in Init if they begin at once, and those with an event at their end.
INITIAL = (
    *(do.PlaceVehicle, do.FrictionChange, do.Wind),
    *(sumo.StoppedVehicle, sumo.LaneClosure, sumo.SlowConvoy),
)
ENDING = (do.PlaceVehicle, do.Brake, do.ChangeSpeed, sumo.StoppedVehicle, sumo.LaneClosure)


def rounded(value: float | None) -> Any:
    """A number as files have it."""
    return None if value is None else round(float(value), DIGITS)


def _meets(condition: Condition, value: float) -> bool:
    if condition.equals is not None:
        return value == condition.equals
    low = -math.inf if condition.above is None else condition.above
    return low < value < (math.inf if condition.below is None else condition.below)
