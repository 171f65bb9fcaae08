"""Scenarios of events as ASAM OpenSCENARIO XML 1.3, with their map as OpenDRIVE."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from iits_mj.export.openscenario import EGO, check_target, speed_action
from iits_mj.export.story import Story, rounded
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.parts import configured_events, placed, traffic_speed
from traffic_bridge.scenario import actions as do
from traffic_bridge.scenario.actors import APPROACH
from traffic_bridge.scenario.conditions import SIGNAL
from traffic_bridge.scenario.maneuvers import HOLD_JERK, HOLD_RATE
from traffic_bridge.scenario.openscenario_actions import BEHIND
from traffic_bridge.scenario.openscenario_entities import AHEAD
from traffic_bridge.scenario.reading import check_references
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
    events = configured_events(config)
    check_references(events)
    story = Story(placed(config, route, parameters.footprint), route, parameters, events)
    for event in story.events.values():
        write = WRITERS.get(type(event))
        if write is None or write(story, event) is False:
            story.command(event)
    return (*story.write(path), tuple(story.remarks))


# The writers of the kinds of events; one that returns False leaves the event to a command.


def _place(story: Story, event: do.PlaceVehicle) -> bool | None:
    xosc, ego, name = story.xosc, story.ego, str(event.name)
    front, lane, at_start = event.station, event.lane, story.at_start(event)
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
            event.relative_lane or 0, EGO, event.offset or 0.0, ds=rounded(way)
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


def _cut_in(story: Story, event: do.CutIn) -> None:
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
            *(EGO, True, False, APPROACH, APPROACH, None, rounded(event.gap)),
            coordinate_system=xosc.CoordinateSystem.road,
            displacement=getattr(xosc.LongitudinalDisplacement, AHEAD),
        )
        way = f"way of {title}"
        story.event(title, actor, [(way, approach)], story.trigger(event))
        story.after(f"lane change of {title}", actor, actions, way)
    if reactive:
        story.after(f"{title} ends", actor, [(f"{title} with model", story.model(True))], title)


def _change_lane(story: Story, event: do.ChangeLane) -> None:
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
    story.acts(event, action, actor)


def _brake(story: Story, event: do.Brake) -> None:
    _speed(story, event, story.profile(event.to_speed, event.deceleration, event.jerk))


def _change_speed(story: Story, event: do.ChangeSpeed) -> None:
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
        getattr(xosc.DynamicsShapes, shape), dimension[0], rounded(dimension[1])
    )
    if to is None:
        action = xosc.AbsoluteSpeedAction(rounded(value), dynamics)
    else:
        values = xosc.SpeedTargetValueType
        kind = values.delta if event.speed_factor is None else values.factor
        action = xosc.RelativeSpeedAction(rounded(value), to, dynamics, kind, event.continuous)
    _speed(story, event, action)


def _speed(story: Story, event: do.Brake | do.ChangeSpeed, action: Any) -> None:
    """A change of speed; with a duration the model then goes on with its former desired speed."""
    actor, title = story.entity(event, event.actor), event.title
    reactive = story.members[actor].reactive
    actions = [(title, action)]
    if reactive and event.duration is not None:
        actions.insert(0, (f"{title} without model", story.model(False)))
    story.event(title, actor, actions, story.trigger(event))
    story.ending(event, actor, [story.model(True) if reactive else story.own_speed(actor)])


def _swerve(story: Story, event: do.Swerve) -> None:
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


def _drift(story: Story, event: do.Drift) -> None:
    actor, title = story.entity(event, event.actor), event.title
    way = event.offset
    out = story.aside(way, way, abs(way) / event.lateral_speed, "linear")
    first = f"{title} out" if event.recovery else title
    story.event(title, actor, [(first, out)], story.trigger(event))
    if event.recovery:
        back = story.aside(0.0, way, event.recovery, "sinusoidal")
        story.after(f"{title} back", actor, [(title, back)], first)


def _keep_distance(story: Story, event: do.KeepDistance) -> None:
    xosc, actor, to = story.xosc, story.entity(event, event.actor), story.entity(event, event.to)
    most = None if event.fastest == do.SPEED_MAX else event.fastest
    shift = 0.0 if event.freespace else story.members[actor].front - story.members[to].front
    if shift and event.gap is None:
        story.fail(event, "a time_gap between the front bumpers has no counterpart: use freespace")
    action = xosc.LongitudinalDistanceAction(
        *(to, event.freespace, event.continuous, event.acceleration, event.deceleration, most),
        *(rounded(None if event.gap is None else event.gap + shift), rounded(event.time_gap)),
        coordinate_system=xosc.CoordinateSystem.road,
        displacement=getattr(xosc.LongitudinalDisplacement, AHEAD if event.ahead else BEHIND),
    )
    story.acts(event, action, actor)


def _synchronize(story: Story, event: do.Synchronize) -> None:
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
    story.acts(event, action, actor)


def _follow_path(story: Story, event: do.FollowPath) -> bool | None:
    actor = story.entity(event, event.actor)
    if event.points is None or event.goal not in (None, len(event.points) - 1):
        return False
    if event.times is not None and len(event.times) < len(event.points):
        return False
    action, _ = story.trajectory(actor, event.points, event.times, event.frame)
    story.acts(event, action, actor)
    return None


def _cross(story: Story, event: do.CrossRoad) -> bool | None:
    name, route = str(event.name), story.route
    station = event.station
    if station is None:
        if not story.at_start(event):
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


def _remove(story: Story, event: do.RemoveVehicle) -> None:
    actor = story.entity(event, event.actor)
    action = story.xosc.DeleteEntityAction(actor)
    story.acts(event, action, actor)


def _set_value(story: Story, event: do.SetValue) -> None:
    name, value = event.variable, event.value
    action = story.variable(name, value)
    if name.startswith(SIGNAL):
        state = str(value)
        action = story.xosc.TrafficSignalStateAction(name.removeprefix(SIGNAL), state)
    story.acts(event, action)


def _milestone(story: Story, event: do.Milestone) -> None:
    action = story.variable(event.title, 1.0)
    story.acts(event, action)


def _friction(story: Story, event: do.FrictionChange) -> bool | None:
    xosc, part = story.xosc, (event.friction_right, event.start, event.end)
    if part != (None, 0.0, sumo.LONGEST) or (event.until, event.duration) != (None, None):
        return False
    station = float(story.ego.station or 0.0)
    lane = float(story.route.lane_offset(story.ego.lane, station))
    factor = event.friction / float(story.route.friction(station, lane))
    environment = xosc.Environment(event.title, roadcondition=xosc.RoadCondition(rounded(factor)))
    _environment(story, event, environment)
    return None


def _wind(story: Story, event: do.Wind) -> bool | None:
    if event.shape != "steady" or (event.until, event.duration) != (None, None):
        return False
    xosc = story.xosc
    heading = float(story.route.heading(float(story.ego.station or 0.0)))  # type: ignore[arg-type]
    # The file has where it blows to, from the map's x axis.
    direction = (math.radians(event.direction) + heading + math.pi) % math.tau
    weather = xosc.Weather(wind=xosc.Wind(rounded(direction), event.speed))
    _environment(story, event, xosc.Environment(event.title, weather=weather))
    return None


def _environment(story: Story, event: Event, environment: Any) -> None:
    action = story.xosc.EnvironmentAction(environment)
    if story.at_start(event):
        story.init.add_global_action(action)
    else:
        story.acts(event, action)


def _stand(story: Story, event: sumo.StoppedVehicle) -> None:
    name = event.title
    _standing(story, event, event.type, event.lane, [event.station], [name])
    if (event.until, event.duration) != (None, None):
        speed = traffic_speed(story.config, story.route)
        rate = story.types[event.type].acceleration
        story.ending(event, name, [story.profile(speed, rate, HOLD_JERK)])


def _close_lane(story: Story, event: sumo.LaneClosure) -> None:
    kind = story.types["truck"]
    stations = closure_places(event, kind.length)
    names = [f"{event.title} {k}" for k in range(1, len(stations) + 1)]
    _standing(story, event, kind.name, event.lane, stations, names)
    story.delete(event, names)


def _standing(
    story: Story,
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


def _convoy(story: Story, event: sumo.SlowConvoy) -> bool | None:
    if not story.at_start(event) or (event.until, event.duration) != (None, None):
        return False
    places = []
    for k, station in enumerate(convoy_places(event, story.types[event.type]), 1):
        name = f"{event.title} {k}"
        member = story.member(
            event, name, event.type, station=station, lane=event.lane, speed=event.speed
        )
        place = story.lane_position(story.route, station - member.front, event.lane)
        places.append((name, place, speed_action(event.speed)))
    story.appear(event, places)
    return None


WRITERS: dict[type[Event], Callable[[Story, Any], Any]] = {
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
