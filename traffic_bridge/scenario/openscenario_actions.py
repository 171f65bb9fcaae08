"""The actions of OpenSCENARIO files, and the starts of their entities, as events."""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge.scenario.actions import BENDS, SCENARIO_EVENTS, STEEPEST
from traffic_bridge.scenario.conditions import SIGNAL, TRUCK
from traffic_bridge.scenario.openscenario_entities import (
    AHEAD,
    CATEGORIES,
    ROUTES,
    UNUSED,
    VALUE_TYPE,
    Entities,
    Entity,
    Spot,
    Values,
    on,
    speed_target,
)
from traffic_bridge.scenario.openscenario_file import Node
from traffic_bridge.scenario.openscenario_places import Pose, road_at, shape_of, words_of
from traffic_bridge.scenario.reading import event_of
from traffic_bridge.signals.events import Event

SLOWEST_CHANGE = 0.05  # [m/s2]: a speed that changes more slowly stays
SHORTEST = 0.1  # [s], [m] of a change
LATERAL_ACCELERATION = 0.5  # [m/s2] of a lane offset without maxLateralAcc (judgement)
STEP = 4e-3  # [m]: places of a trajectory that are nearer to each other are one

AnyGroups = list[list[Values]]  # one must hold; of a group all conditions


class Actions:
    """Makes events of actions.

    Args:
      entities: of the file.
      new_name: returns a name like a wanted one that no other event has.
    """

    def __init__(self, entities: Entities, new_name: Callable[[str], str]) -> None:
        self._entities = entities
        # The same names each time.
        self._new_name = functools.cache(new_name)

    def placed(self, name: str, entity: Entity, groups: AnyGroups | None = None) -> Iterator[Event]:
        """Yields an entity at its start, with what it does from there, on groups of conditions."""
        node = self._entities.start(name)
        values = {
            "event": "place_vehicle",
            "name": name,
            "speed": self._entities.speed(name),
            "type": entity.type,
            "reactive": entity.reactive,
            **entity.size,
        }
        relative = groups is not None and node.tag == "RelativeLanePosition"
        if relative and self._entities.body(node) == TRUCK:
            yield scenario_event(node, values | self._beside_truck(node, name, entity), groups)
            return
        spot = self._entities.spot(name)
        if entity.walks or math.isnan(spot.offset):
            values |= self._standing(entity, self._entities.pose(name))
        else:
            values |= self._driving(entity, spot, node)
        yield scenario_event(node, values, groups)
        speed = self._entities.speeds.get(name)
        if speed is not None and speed.child("SpeedActionTarget").first().flag("continuous"):
            made = {"name": self._new_name(f"speed of {name}"), "actor": name}
            yield scenario_event(speed, made | self._change_speed(speed))
        if name in self._entities.trajectories:
            action = self._entities.trajectories[name]
            made = {"name": self._new_name(f"trajectory of {name}"), "actor": name}
            yield scenario_event(action, made | self._trajectory(action, entity, at_start=True))

    def _beside_truck(self, node: Node, name: str, entity: Entity) -> Values:
        """The place of a vehicle that is added relative to where the truck is then."""
        ego = self._entities.members[self._entities.ego]
        way = node.number("ds" if node.has("ds") else "dsLane")
        length = float(entity.size["length"])
        gap = way + entity.front - length - ego.front
        if gap < 0.0:
            gap = way + entity.front - (ego.front - float(ego.size["length"]))
            if gap >= 0.0:
                node.fail("a place beside the truck is not read: ahead of it or behind it")
        values: Values = {"gap": gap, "relative_lane": round(node.number("dLane"))}
        if (offset := node.number("offset", 0.0)) != 0.0:
            values["offset"] = offset
        speed = self._entities.speeds.get(name)
        if speed is not None:
            target, field, value = speed_target(speed)
            other = field != "speed" and self._entities.body(target) != TRUCK
            if other or field == "speed_factor":
                target.fail("is read as a difference to the speed of the ego")
            values |= {"speed": None, field: value}
        return values

    def _driving(self, entity: Entity, spot: Spot, node: Node) -> Values:
        """The place of a vehicle on a road."""
        track = self._entities.track(spot, node)
        front = spot.station + entity.front
        center = front - 0.5 * float(entity.size["length"])
        lane = min(
            (k for k in range(track.lane_count(center)) if track.lane_exists(k, center)),
            key=lambda k: abs(float(track.lane_offset(k, center)) - spot.offset),
        )
        shift = spot.offset - float(track.lane_offset(lane, center))
        return {
            "station": front,
            "lane": lane,
            **({"offset": shift} if abs(shift) > 0.01 else {}),
            **({"along": spot.along} if spot.along is not None else {}),
        }

    def _standing(self, entity: Entity, pose: Pose) -> Values:
        """The way of a road user that is on no road or walks: on beside the road, or straight."""
        center = pose.ahead(entity.center)
        on = self._entities.places.way_on(center, pose.heading)
        return {"points": _points([(center.x, center.y, center.z), *on]), "stays": entity.walks}

    def _trajectory(self, action: Node, entity: Entity, at_start: bool = False) -> Values:
        """The event of a FollowTrajectoryAction."""
        if action.number("initialDistanceOffset", 0.0) != 0.0:
            action.fail("initialDistanceOffset is not read")
        shape = shape_of(action, self._entities.catalogs)
        poses, times = self._entities.places.curve(shape)
        poses, times = _apart(poses, _times(action, times, at_start))
        if len(poses) < 2:
            action.fail("a trajectory needs two places")
        centers = []
        for before, pose, after in zip(
            [poses[0], *poses[:-1]], poses, [*poses[1:], poses[-1]], strict=True
        ):
            heading = math.atan2(after.y - before.y, after.x - before.x)
            centers.append(pose._replace(heading=heading).ahead(entity.center))
        last = centers[-1]
        points = [(each.x, each.y, each.z) for each in centers]
        values: Values = {"event": "follow_path", "goal": len(points) - 1, "stays": entity.walks}
        if entity.walks or on(self._entities.route, last) is None:
            points.extend(self._entities.places.way_on(poses[-1], last.heading))
        return values | {"points": _points(points)} | ({} if times is None else {"times": times})

    def of_world(self, kind: Node, name: str = "") -> Iterator[tuple[Node, Values]]:
        """Yields the events of a global action, of which an environment may have several.

        Args:
          kind: element in the GlobalAction.
          name: of the event; "": that of its kind.
        """
        named: Values = {"name": name} if name else {}
        if kind.tag == "TrafficAction":
            yield kind, self._swarm(kind)
            return
        if kind.tag == "EntityAction" and kind.find("DeleteEntityAction") is not None:
            gone = self._entities.reference(kind)
            if gone == self._entities.ego:
                kind.fail("the truck cannot be removed")
            yield kind, named | {"event": "remove_vehicle", "actor": gone}
            return
        if kind.tag != "EnvironmentAction":
            yield kind, named | self._set_value(kind)
            return
        if named:  # what begins with the action, whatever the environment has
            yield kind, named | {"event": "set_value", "variable": "environment", "value": name}
        node = self._entities.catalogs.resolve(kind.first())
        node.only("ParameterDeclarations", "TimeOfDay", "Weather", "RoadCondition")
        road, weather = node.find("RoadCondition"), node.find("Weather")
        start = self._entities.spot(self._entities.ego)
        route = self._entities.route
        if road is not None:
            friction = route.friction(start.station, start.offset)
            friction *= road.number("frictionScaleFactor")
            yield road, {"event": "friction", "friction": friction}
        wind = None if weather is None else weather.find("Wind")
        if wind is not None:
            # The file has where it blows to, from the map's x axis.
            heading = float(route.heading(np.array(start.station)))
            origin = wrap_angle(wind.number("direction") + math.pi - heading)
            values = {"event": "wind", "shape": "steady", "speed": wind.number("speed")}
            yield wind, {**values, "direction": math.degrees(origin)}

    def _swarm(self, kind: Node) -> Values:
        action = kind.first("TrafficSwarmAction")
        center = action.find("CentralObject") or action.child("CentralSwarmObject")
        attribute = "entityRef" if center.has("entityRef") else "name"
        mix: dict[str, float] = {}
        definition = action.find("TrafficDefinition")
        categories = None if definition is None else definition.find("VehicleCategoryDistribution")
        for entry in categories or ():
            category = entry.get("category")
            if category not in CATEGORIES:
                entry.fail(f"category {category!r} is not read: {', '.join(CATEGORIES)}")
            weight = mix.get(CATEGORIES[category], 0.0) + entry.number("weight", low=0.0)
            mix[CATEGORIES[category]] = weight
        return {
            "event": "swarm",
            "name": self._new_name(kind.get("trafficName", "swarm")),
            "to": self._entities.body(center, attribute),
            "count": round(action.number("numberOfVehicles")),
            "inner": action.number("innerRadius"),
            "half_length": action.number("semiMajorAxis"),
            "half_width": action.number("semiMinorAxis"),
            "ahead": action.number("offset", 0.0),
            "speed": action.number("velocity"),
            **({"mix": mix} if mix else {}),
        }

    def _set_value(self, kind: Node) -> Values:
        """The event of an action on a parameter, a variable, a monitor or a traffic signal."""
        if kind.tag in REFERENCES:
            values: Values = {"event": "set_value", "variable": kind.get(REFERENCES[kind.tag])}
            action = kind.first("SetAction", "ModifyAction")
            if action.tag == "SetAction":
                return values | {"value": action.value("value")}
            rule = action.child("Rule").first(*CHANGES)
            return values | {"value": rule.number("value"), "change": CHANGES[rule.tag]}
        if kind.tag == "SetMonitorAction":
            monitor = f"monitor {kind.get('monitorRef')}"
            return {"event": "set_value", "variable": monitor, "value": kind.get("value")}
        if kind.tag != "InfrastructureAction":
            kind.refuse()
        signal = kind.child("TrafficSignalAction").first("TrafficSignalStateAction")
        name = f"{SIGNAL}{signal.get('name')}"
        return {"event": "set_value", "variable": name, "value": signal.get("state")}

    def values(self, node: Node, name: str, actor: str) -> Values:
        """Returns the event of a private action for one actor, with its name."""
        kind = node.child("PrivateAction").first()
        action = kind
        if kind.tag in GROUPED:
            action = next(iter(kind), kind)
        driver = activation(kind)
        if driver is not None and self._entities.members[actor].reactive:
            made: Values = {"event": "activate_driver", "active": driver.flag("longitudinal")}
        elif kind.tag in UNUSED:
            made = {"event": "set_value", "variable": f"{kind.tag} unused", "value": 0.0}
        elif action.tag in PRIVATE:
            made = PRIVATE[action.tag](self, action, actor)
        else:
            action.refuse()
        alone = made["event"] in ("milestone", "set_value")
        return {"name": name, **({} if alone else {"actor": actor}), **made}

    def _teleport(self, action: Node, actor: str) -> Values:
        """The event of a TeleportAction to a place in a lane."""
        node = action.child("Position").first()
        spot = self._entities.spot_of(node)
        if spot is None:
            node.fail("is on no driving lane that leads where it faces")
        return {"event": "teleport", **self._driving(self._entities.members[actor], spot, node)}

    def _follow_trajectory(self, action: Node, actor: str) -> Values:
        return self._trajectory(action, self._entities.members[actor])

    def _follow_route(self, action: Node, actor: str) -> Values:
        lane = self._entities.places.driving_lane(self._entities.pose(actor))
        if not lane:
            action.fail("the entity does not start in a driving lane")
        words = words_of([lane, *self._entities.waypoints(action)])
        self._entities.places.along(words, action)
        return {"event": "follow_path", "along": words}

    def _profile(self, action: Node, actor: str) -> Values:
        """The event of a SpeedProfileAction: to one speed within limits, or speeds at times."""
        del actor
        entries = list(action.all("SpeedProfileEntry"))
        action.only("DynamicConstraints", "SpeedProfileEntry").child("SpeedProfileEntry")
        limits = action.find("DynamicConstraints")
        given = {} if limits is None else _given(limits, {**LIMITS, "maxAccelerationRate": "jerk"})
        to = {"to": self._entities.body(action)} if action.has("entityRef") else {}
        timed = any(entry.has("time") for entry in entries)
        if len(entries) > 1 or timed or action.get("followingMode") == "position":
            if not all(entry.has("time") for entry in entries):
                action.fail("is read with a time in each of several entries, or with one without")
            times = itertools.accumulate(entry.number("time", low=SHORTEST) for entry in entries)
            speeds = [entry.number("speed") for entry in entries]
            rows = [list(row) for row in zip(times, speeds, strict=True)]
            return {"event": "follow_speeds", "speeds": rows, **to, "relative": bool(to)}
        if action.get("followingMode") != "follow":
            action.fail("followingMode must be follow or position")
        field = "speed_difference" if to else "speed"
        return {"event": "change_speed", field: entries[0].number("speed"), **to, **given}

    def _change_speed(self, action: Node, actor: str = "") -> Values:
        del actor
        values: Values = {"event": "change_speed"}
        dynamics = action.child("SpeedActionDynamics")
        shape, dimension = dynamics.get("dynamicsShape"), dynamics.get("dynamicsDimension", "")
        values["shape"] = shape
        if shape != "step" and dimension == "time":
            values["time"] = dynamics.number("value")
        elif shape != "step" and shape in STEEPEST and dimension == "rate":
            rate = abs(dynamics.number("value")) / STEEPEST[shape]
            if rate < SLOWEST_CHANGE:
                # Nothing happens, and the action does not end.
                return {"event": "milestone"}
            values["acceleration"] = rate
        elif shape != "step" and dimension == "distance":
            values["distance"] = max(dynamics.number("value"), SHORTEST)
        elif shape != "step":
            dynamics.fail(f"{shape} over {dimension} is not read: time, rate or distance")
        target, field, value = speed_target(action)
        values[field] = value
        if field != "speed":
            values |= {"to": self._entities.body(target), "continuous": target.flag("continuous")}
        return values

    def _change_lane(self, action: Node, actor: str) -> Values:
        if float(action.get("targetLaneOffset", "0")) != 0.0:
            action.fail("targetLaneOffset is not read")
        dynamics = action.child("LaneChangeActionDynamics")
        values = {"event": "change_lane", **_lateral(dynamics)}
        target = action.child("LaneChangeTarget").first()
        if target.tag == "RelativeTargetLane":
            return values | self._relative_lane(target, actor)
        spot, track = self._on_road(actor, target)
        road, s, _ = road_at(track, spot.station)
        places = self._entities.places
        lane = places.lane(target, road, s, round(target.number("value")))
        place = places.at(road, s, places.frames[road].center_at(lane, s))
        at, offset = track.locate(place.x, place.y, spot.station)
        if (found := track.lane_at(at, offset)) < 0:
            # A lane of the other direction: as far beside its own one.
            own = float(track.lane_offset(track.lane_at(spot.station, spot.offset), spot.station))
            return values | {"event": "swerve", "offset": offset - own, "back": False}
        return values | {"lane": found}

    def _on_road(self, name: str, node: Node) -> tuple[Spot, Route]:
        """Where an entity starts on a road, and that road."""
        spot = self._entities.spot(name)
        if math.isnan(spot.offset):
            node.fail(f"{name} is on no road")
        return spot, self._entities.track(spot, node)

    def _relative_lane(self, target: Node, actor: str) -> Values:
        """The target of a lane change relative to a road user.

        Beyond the lanes of its own direction it is a distance to the center of the next lanes.
        """
        count = round(target.number("value"))
        values: Values = {"to": self._entities.body(target), "relative_lane": count}
        spot = self._entities.spot(actor)
        if values["to"] != actor or math.isnan(spot.offset):
            return values
        track = self._entities.track(spot, target)
        lane = track.lane_at(spot.station, spot.offset)
        if lane < 0 or track.lane_exists(lane + count, spot.station):
            return values
        road, s, direction = road_at(track, spot.station)
        frame = self._entities.places.frames[road]
        centers = sorted(direction * 0.5 * (low + high) for _, low, high in frame.lanes(s))
        point = track.evaluate(spot.station, spot.offset)
        own = frame.locate(float(point.x), float(point.y), s)[1]
        index = min(range(len(centers)), key=lambda k: abs(centers[k] - direction * own)) + count
        if not 0 <= index < len(centers):
            target.fail(f"there is no lane {count:+d} beside that of {actor}")
        way = centers[index] - centers[index - count]
        return {"event": "swerve", "offset": way, "back": False}

    def _synchronize(self, action: Node, actor: str) -> Values:
        master = self._entities.reference(action, "masterEntityRef")
        stations = {}
        for key, name, child in (
            ("station", actor, "TargetPosition"),
            ("to_station", master, "TargetPositionMaster"),
        ):
            _, track = self._on_road(name, action)
            at = self._entities.station(action.child(child).first(), track)
            stations[key] = at + self._entities.members[name].front
        to = self._entities.body(action, "masterEntityRef")
        values: Values = {"event": "synchronize", "to": to, **stations}
        tolerances = {"targetTolerance": "tolerance", "targetToleranceMaster": "to_tolerance"}
        values |= _given(action, tolerances)
        final = action.find("FinalSpeed")
        if final is not None:
            speed = final.first("AbsoluteSpeed", "RelativeSpeedToMaster")
            if any(True for _ in speed):
                speed.first().refuse()
            relative = speed.tag == "RelativeSpeedToMaster"
            if relative and speed.get(*VALUE_TYPE) != "delta":
                speed.fail("speedTargetValueType is not read: delta")
            values["speed_difference" if relative else "speed"] = speed.number("value")
        return values

    def _keep_distance(self, action: Node, actor: str) -> Values:
        del actor
        timed = action.has("timeGap")
        values: Values = {
            "event": "keep_distance",
            "to": self._entities.body(action),
            "time_gap" if timed else "gap": action.number("timeGap" if timed else "distance"),
            "freespace": action.flag("freespace"),
            "continuous": action.flag("continuous"),
        }
        if (place := action.get("displacement", BEHIND)) != BEHIND:
            values["ahead"] = place == AHEAD or action.fail(f"displacement is not read: {BEHIND}")
        if (limits := action.find("DynamicConstraints")) is not None:
            values |= _given(limits, {**LIMITS, "maxSpeed": "fastest"})
        return values


# Of the groups of private actions the action counts.
GROUPED = ("LongitudinalAction", "LateralAction", "RoutingAction")
PRIVATE: dict[str, Callable[[Actions, Node, str], Values]] = {
    "SynchronizeAction": Actions._synchronize,
    "TeleportAction": Actions._teleport,
    "SpeedAction": Actions._change_speed,
    "SpeedProfileAction": Actions._profile,
    "LongitudinalDistanceAction": Actions._keep_distance,
    "LaneChangeAction": Actions._change_lane,
    "LaneOffsetAction": lambda _, action, __: _change_offset(action),
    "FollowTrajectoryAction": Actions._follow_trajectory,
    **dict.fromkeys(ROUTES, Actions._follow_route),
}
REFERENCES = {"ParameterAction": "parameterRef", "VariableAction": "variableRef"}
CHANGES = {"AddValue": "add", "MultiplyByValue": "multiply"}
LIMITS = {"maxAcceleration": "acceleration", "maxDeceleration": "deceleration"}
COMMAND = "iits_mj"  # type of the custom commands that are events of this package
BEHIND = "trailingReferencedEntity"


def _given(node: Node, names: Mapping[str, str]) -> Values:
    """The numbers that a node has, by the names of the fields."""
    return {field: node.number(name) for name, field in names.items() if node.has(name)}


def own_values(node: Node) -> Values | None:
    """Returns the fields of an event of this package in a UserDefinedAction.

    None: it is a command of another program, or of an event that SUMO's traffic plays.
    """
    command = node.child("CustomCommandAction")
    if command.get("type", "") != COMMAND:
        return None
    try:
        values = json.loads(command.element.text or "")
        kind = values["event"]
    except (ValueError, TypeError, KeyError):
        command.fail("is no table of an event as JSON")
    return values if kind in {event.kind for event in SCENARIO_EVENTS} else None


def activation(kind: Node) -> Node | None:
    """Returns the ActivateControllerAction of a private action about longitudinal motion."""
    found = kind if kind.tag == "ActivateControllerAction" else None
    if kind.tag == "ControllerAction":
        found = kind.find("ActivateControllerAction")
    return found if found is not None and found.has("longitudinal") else None


def _times(action: Node, given: Sequence[float] | None, at_start: bool) -> list[float] | None:
    """Times of a curve's places since the beginning of the event [s]; None: it has none."""
    reference = action.find("TimeReference")
    timing = None if reference is None else next(iter(reference), None)
    if timing is None or timing.tag == "None":
        return None
    if timing.get("domainAbsoluteRelative") != "relative" and not at_start:
        timing.fail("absolute times are read in Init only: relative")
    scale, offset = timing.number("scale"), timing.number("offset")
    if given is None:
        timing.fail("the trajectory has no times")
    return [scale * time + offset for time in given]


def _apart(
    poses: Sequence[Pose], times: Sequence[float] | None
) -> tuple[list[Pose], list[float] | None]:
    """Places, and their times, without those at which one has not moved on.

    No two places may be the same: where a road user stands, the place at the end of that time is
    moved ahead by half of `STEP`.
    """
    kept: list[Pose] = []
    at: list[float] = []
    begun = 0  # number of kept places when the last one was reached
    for k, pose in enumerate(poses):
        if not kept or math.dist(pose[:2], kept[begun - 1][:2]) > STEP:
            kept.append(pose)
            begun = len(kept)
        elif times is None:
            continue
        elif len(kept) == begun:
            kept.append(kept[-1].ahead(0.5 * STEP))
        else:
            at.pop()
        if times is not None:
            at.append(times[k])
    return kept, None if times is None else at


def _points(points: Sequence[tuple[float, float, float]]) -> list[list[float]]:
    """Points to the millimeter."""
    table = np.round(np.array(points), 3)
    return table.tolist()


def _lateral(dynamics: Node) -> Values:
    shape = dynamics.get("dynamicsShape")
    if shape == "step":
        return {"shape": "linear", "duration": SHORTEST}
    dimension, value = dynamics.get("dynamicsDimension"), abs(dynamics.number("value"))
    if dimension == "rate":
        return {"shape": shape, "lateral_speed": value}
    if dimension == "distance":
        return {"shape": shape, "distance": max(value, SHORTEST)}
    if dimension != "time":
        dynamics.fail(f"dynamicsDimension {dimension!r}: allowed are time, rate, distance")
    return {"shape": shape, "duration": max(value, SHORTEST)}


def _change_offset(action: Node) -> Values:
    dynamics = action.child("LaneOffsetActionDynamics")
    holder = action.child("LaneOffsetTarget")
    target = holder.first("AbsoluteTargetLaneOffset", "RelativeTargetLaneOffset")
    offset, shape = target.number("value"), dynamics.get("dynamicsShape")
    values: Values = {"event": "swerve", "offset": offset, "back": False}
    if shape == "step":
        return values | {"shape": "linear", "duration": SHORTEST}
    if shape not in BENDS:
        dynamics.fail(f"dynamicsShape {shape!r} is not read: step, {', '.join(BENDS)}")
    bound = dynamics.number("maxLateralAcc", LATERAL_ACCELERATION, low=0.01)
    return values | {"shape": shape, "lateral_acceleration": bound}


def scenario_event(node: Node, values: Mapping[str, Any], groups: AnyGroups | None = None) -> Event:
    """Returns the event of a mapping that begins on groups of conditions; errors name the node."""
    try:
        return event_of({**values, **({"when": groups} if groups else {})})
    except InputError as error:
        node.fail(str(error))
