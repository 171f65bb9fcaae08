"""Scenarios of events as ASAM OpenSCENARIO XML 1.3, with their map as OpenDRIVE."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from iits_mj.export.openscenario import EGO, check_target, speed_action, write_scenario
from iits_mj.export.parametric import with_parameters
from iits_mj.export.story import TIMES, Story, on_road, rounded
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.parts import configured_events, placed, traffic_speed
from traffic_bridge.scenario import actions as do
from traffic_bridge.scenario.actors import APPROACH
from traffic_bridge.scenario.conditions import SIGNAL, TRUCK
from traffic_bridge.scenario.maneuvers import HOLD_JERK, HOLD_RATE
from traffic_bridge.scenario.openscenario_actions import BEHIND
from traffic_bridge.scenario.openscenario_entities import AHEAD
from traffic_bridge.scenario.parameters import assignments, scope_of
from traffic_bridge.scenario.reading import check_references, read_parameters
from traffic_bridge.signals import events as sumo
from traffic_bridge.signals.events import Event
from traffic_bridge.signals.obstructions import closure_places, convoy_places


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

    def told(changed: Mapping[str, float]) -> tuple[Story, Element]:
        """The scenario with other values of some parameters, and its file."""
        param = tuple(f"{name}={value}" for name, value in {**values, **changed}.items())
        story = _story(dataclasses.replace(config, param=param), route, parameters)
        return story, story.element(path)

    assert config.events is not None
    declared, given = read_parameters(config.events), assignments(config.param)
    values = scope_of(declared, given, str(config.events))
    story, root = told({})
    remarks = with_parameters(root, declared, values, lambda changed: told(changed)[1])
    return (*write_scenario(path, route, root), (*story.remarks, *remarks))


def _story(config: DriveConfig, route: Route, parameters: TruckParameters) -> Story:
    """The events of a drive as a scenario."""
    events = configured_events(config)
    check_references(events)
    story = Story(placed(config, route, parameters.footprint), route, parameters, events)
    for event in story.events.values():
        write, actor = WRITERS.get(type(event)), EGO
        if isinstance(event, do.Maneuver):
            if event.actor in (TRUCK, EGO):
                story.fail(event, "moves the truck, which has its own driver")
            actor = story.entity(event, event.actor)
        made = NO_COUNTERPART if write is None else write(story, event, actor)
        if made is NO_COUNTERPART:
            story.command(event)
        elif made is not None:
            story.acts(event, made, actor)
    return story


# The writers of the kinds of events, for the entity of the actor: one returns the event's action,
# None if it has written all itself, or this if OpenSCENARIO has no counterpart.
NO_COUNTERPART = object()


def _place(story: Story, event: do.PlaceVehicle, _: str) -> None:
    xosc, ego, name, gap = story.xosc, story.ego, str(event.name), event.gap
    front, lane, route = event.station, event.lane, story.route
    if event.along is not None:
        route = route.road_map.route(along=event.along)
    if lane is None:
        lane = ego.lane + (event.relative_lane or 0)
    speed, difference = event.speed, event.speed_difference or 0.0
    if speed is None:
        speed = max(story.speed + difference, 0.0)
    size = {n: v for n in ("length", "width", "height") if (v := getattr(event, n)) is not None}
    more = {"route": route, "lane": lane, "reactive": event.reactive and speed > 0.0}
    member = story.member(event, name, event.type, size, **more)
    if gap is not None:
        # From the truck's reference point to that of the vehicle.
        way = ego.front + gap + member.back if gap >= 0.0 else gap - ego.back - member.front
        front = story.ego_front - ego.front + way + member.front
    starts = speed_action(speed)
    then: list[tuple[str, Any]] = []
    if event.points is not None:
        action, position = story.trajectory(name, event.points, None, event.frame)
        then.append((f"way of {name}", action))
    elif story.at_start(event) or (gap is None and None not in (event.lane, event.speed)):
        assert front is not None
        position = story.lane_position(route, front - member.front, lane, event.offset or 0.0)
        story.members[name] = member._replace(station=front)
    elif gap is None or event.lane is not None:
        story.fail(event, "give station, lane and speed, or gap and relative_lane")
    else:
        aside = event.relative_lane or 0, EGO, event.offset or 0.0
        position = xosc.RelativeLanePosition(*aside, ds=rounded(way))
        if event.speed is None:
            step = story.transition("step", "time", 0.0)
            starts = xosc.RelativeSpeedAction(difference, EGO, step, continuous=False)
    story.appear(event, name, position, starts, then)
    if event.stays and then:
        story.after(f"{name} stands", name, [(f"{name} stands", speed_action(0.0))], then[0][0])
    story.ending(event, name, xosc.DeleteEntityAction(name))


def _cut_in(story: Story, event: do.CutIn, actor: str) -> None:
    xosc, title = story.xosc, event.title
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
        way, limits = f"way of {title}", {"acceleration": APPROACH, "deceleration": APPROACH}
        there = do.KeepDistance(
            actor=actor,
            gap=event.gap,
            ahead=True,
            continuous=False,
            **limits,  # type: ignore[arg-type]
        )
        approach = _keep_distance(story, there, actor)
        story.event(title, actor, [(way, approach)], story.trigger(event))
        story.after(f"lane change of {title}", actor, actions, way)
    if reactive:
        story.after(f"{title} ends", actor, [(f"{title} with model", story.model(True))], title)


def _change_lane(story: Story, event: do.ChangeLane, actor: str) -> Any:
    xosc, dynamics, member = story.xosc, story.dynamics(event), story.members[actor]
    if event.lane is None:
        to = actor if event.to is None else story.entity(event, event.to)
        return xosc.RelativeLaneChangeAction(event.relative_lane, to, dynamics)
    if member.station is None:
        story.fail(event, f"lane of {actor!r}, which is placed later: give relative_lane")
    place = story.lane_position(member.route, member.station - member.front, event.lane)
    return xosc.AbsoluteLaneChangeAction(int(place.lane_id), dynamics)


def _brake(story: Story, event: do.Brake, actor: str) -> None:
    _speed(story, event, actor, story.profile(event.to_speed, event.deceleration, event.jerk))


def _change_speed(story: Story, event: do.ChangeSpeed, actor: str) -> None:
    xosc, given = story.xosc, (event.speed, event.speed_difference, event.speed_factor)
    to = None if event.speed is not None else story.entity(event, event.to)
    value = next(each for each in given if each is not None)
    if event.shape is None and not event.continuous and event.speed_factor is None:
        action = story.profile(value, event.acceleration, event.jerk, to)
        return _speed(story, event, actor, action)
    shape = event.shape or "linear"
    dimension, size = "rate", event.acceleration * do.STEEPEST.get(shape, 1.0)
    if event.time is not None or shape == "step":
        dimension, size = "time", event.time or 0.0
    elif event.distance is not None:
        dimension, size = "distance", event.distance
    dynamics = story.transition(shape, dimension, size)
    action = xosc.AbsoluteSpeedAction(rounded(value), dynamics)
    if to is not None:
        values = xosc.SpeedTargetValueType
        kind = values.delta if event.speed_factor is None else values.factor
        action = xosc.RelativeSpeedAction(rounded(value), to, dynamics, kind, event.continuous)
    return _speed(story, event, actor, action)


def _speed(story: Story, event: do.Brake | do.ChangeSpeed, actor: str, action: Any) -> None:
    """A change of speed; with a duration the model then goes on with its former desired speed."""
    title, reactive = event.title, story.members[actor].reactive
    actions = [(title, action)]
    if reactive and event.duration is not None:
        actions.insert(0, (f"{title} without model", story.model(False)))
    story.event(title, actor, actions, story.trigger(event))
    story.ending(event, actor, story.model(True) if reactive else story.own_speed(actor))


def _swerve(story: Story, event: do.Swerve, actor: str) -> None:
    way, shape = event.offset, event.shape
    if event.distance is not None:
        story.fail(event, "distance has no counterpart: give duration")
    if event.lateral_speed is not None:
        span = do.STEEPEST[shape] * abs(way) / event.lateral_speed
    elif event.lateral_acceleration is not None:
        span = math.sqrt(do.BENDS[shape] * abs(way) / event.lateral_acceleration)
    else:
        span = float(event.duration or 0.0) * (0.5 if event.back else 1.0)
    _aside(story, event, actor, (span, shape), (span, shape) if event.back else None)


def _drift(story: Story, event: do.Drift, actor: str) -> None:
    out = abs(event.offset) / event.lateral_speed, "linear"
    _aside(story, event, actor, out, (event.recovery, "sinusoidal") if event.recovery else None)


def _aside(
    story: Story,
    event: do.Swerve | do.Drift,
    actor: str,
    out: tuple[float, str],
    back: tuple[float, str] | None,
) -> None:
    """A motion to the side, and back, each with a time [s] and a shape."""
    way, title = event.offset, event.title
    first = f"{title} out" if back else title
    story.event(title, actor, [(first, story.aside(way, way, *out))], story.trigger(event))
    if back:
        story.after(f"{title} back", actor, [(title, story.aside(0.0, way, *back))], first)


def _keep_distance(story: Story, event: do.KeepDistance, actor: str) -> Any:
    to = story.entity(event, event.to)
    most = None if event.fastest == do.SPEED_MAX else event.fastest
    gap = event.gap
    if not event.freespace:
        if gap is None:
            story.fail(event, "a time_gap needs freespace: the other one has no counterpart")
        gap += story.members[actor].front - story.members[to].front
    limits = event.acceleration, event.deceleration, most, rounded(gap), rounded(event.time_gap)
    place = getattr(story.xosc.LongitudinalDisplacement, AHEAD if event.ahead else BEHIND)
    more = {"displacement": place, **on_road(story.xosc)}
    flags = event.freespace, event.continuous
    return story.xosc.LongitudinalDistanceAction(to, *flags, *limits, **more)


def _synchronize(story: Story, event: do.Synchronize, actor: str) -> Any:
    xosc, to, places = story.xosc, story.entity(event, event.to), []
    for name, station in ((to, event.to_station), (actor, event.station)):
        member = story.members[name]
        places.append(story.lane_position(member.route, station - member.front, member.lane))
    final = None
    if event.speed is not None:
        final = xosc.AbsoluteSpeed(event.speed)
    elif event.speed_difference is not None:
        delta = xosc.SpeedTargetValueType.delta
        final = xosc.RelativeSpeedToMaster(event.speed_difference, delta)
    return xosc.SynchronizeAction(to, *places, event.to_tolerance, event.tolerance, final)


def _follow_path(story: Story, event: do.FollowPath, actor: str) -> Any:
    points, times = event.points or (), event.times
    whole = event.goal in (None, len(points) - 1) and len(times or points) == len(points)
    if not points or not whole:
        return NO_COUNTERPART
    return story.trajectory(actor, points, times, event.frame)[0]


def _cross(story: Story, event: do.CrossRoad, _: str) -> Any:
    name, route, station = str(event.name), story.route, event.station
    if station is None:
        if not story.at_start(event):
            return NO_COUNTERPART  # its place depends on where the truck is then
        station = story.ego_front + float(event.gap or 0.0)
    right, left = (float(edge) for edge in route.surface_edges(station))
    begin, way = (right, left - right) if event.side == "right" else (left, right - left)
    if event.distance is not None:
        way = math.copysign(event.distance, way)
    story.member(event, name, event.type)
    ends = [route.evaluate(station, begin), route.evaluate(station, begin + way)]
    points = [(float(p.x), float(p.y), float(p.z)) for p in ends]
    action, place = story.trajectory(name, points, None, "map")
    story.appear(event, name, place, speed_action(event.speed), [(event.title, action)])
    last = speed_action(0.0) if event.distance else story.xosc.DeleteEntityAction(name)
    story.after(f"{event.title} ends", name, [(f"{event.title} ends", last)], event.title)
    return None


def _set_value(story: Story, event: do.SetValue, _: str) -> Any:
    name, value = event.variable, event.value
    if name.startswith(SIGNAL):
        return story.xosc.TrafficSignalStateAction(name.removeprefix(SIGNAL), str(value))
    return story.variable(name, value, event.change)


def _friction(story: Story, event: do.FrictionChange, _: str) -> Any:
    part = event.friction_right, event.start, event.end, event.until, event.duration
    if part != (None, 0.0, sumo.LONGEST, None, None):
        return NO_COUNTERPART
    lane = float(story.route.lane_offset(story.ego.lane, story.ego_front))
    factor = event.friction / float(story.route.friction(story.ego_front, lane))
    return _environment(story, event, roadcondition=story.xosc.RoadCondition(rounded(factor)))


def _wind(story: Story, event: do.Wind, _: str) -> Any:
    if (event.shape, event.until, event.duration) != ("steady", None, None):
        return NO_COUNTERPART
    heading = float(story.route.heading(story.ego_front))  # type: ignore[arg-type]
    # The file has where it blows to, from the map's x axis.
    direction = (math.radians(event.direction) + heading + math.pi) % math.tau
    wind = story.xosc.Wind(rounded(direction), event.speed)
    return _environment(story, event, weather=story.xosc.Weather(wind=wind))


def _environment(story: Story, event: Event, **parts: Any) -> Any:
    xosc = story.xosc
    action = xosc.EnvironmentAction(xosc.Environment(event.title, **parts))
    if not story.at_start(event):
        return action
    story.init.add_global_action(action)
    return None


def _stopped_vehicle(story: Story, event: sumo.StoppedVehicle, _: str) -> None:
    _in_lane(story, event, event.type, {event.title: event.station})
    if (event.until, event.duration) != (None, None):
        speed = traffic_speed(story.config, story.route)
        rate = story.types[event.type].acceleration
        story.ending(event, event.title, story.profile(speed, rate, HOLD_JERK))


def _lane_closure(story: Story, event: sumo.LaneClosure, _: str) -> None:
    kind = story.types["truck"]
    places = enumerate(closure_places(event, kind.length), 1)
    ends = {"until": event.until, "duration": event.duration}
    _in_lane(story, event, kind.name, {f"{event.title} {k}": s for k, s in places}, **ends)


def _convoy(story: Story, event: sumo.SlowConvoy, _: str) -> Any:
    if (event.until, event.duration) != (None, None):
        return NO_COUNTERPART
    places = enumerate(convoy_places(event, story.types[event.type]), 1)
    names = {f"{event.title} {k}": station for k, station in places}
    return _in_lane(story, event, event.type, names, speed=event.speed)


def _in_lane(
    story: Story,
    event: sumo.StoppedVehicle | sumo.LaneClosure | sumo.SlowConvoy,
    kind: str,
    stations: dict[str, float],
    **more: float | None,
) -> None:
    """Vehicles of a type with their front bumpers at stations [m] of the event's lane, by names."""
    values = {"type": kind, "lane": event.lane, "speed": 0.0, "reactive": False, **more}
    values |= {name: getattr(event, name) for name in TIMES}
    for name, station in stations.items():
        _place(story, do.PlaceVehicle(name=name, station=station, **values), EGO)  # type: ignore[arg-type]


WRITERS: dict[type[Event], Callable[[Story, Any, str], Any]] = {
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
    do.RemoveVehicle: lambda story, _, actor: story.xosc.DeleteEntityAction(actor),
    do.SetValue: _set_value,
    do.Milestone: lambda story, event, _: story.variable(event.title, 1.0),
    do.EndDrive: lambda story, event, _: story.stop(event),
    do.FrictionChange: _friction,
    do.Wind: _wind,
    sumo.StoppedVehicle: _stopped_vehicle,
    sumo.LaneClosure: _lane_closure,
    sumo.SlowConvoy: _convoy,
}
