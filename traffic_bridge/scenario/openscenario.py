"""Reads ASAM OpenSCENARIO XML 1.0 to 1.3: the start of the truck, and the events of the traffic.

Element and attribute names are those of the standard. Everything that is not read is refused with
its element, file and line. Not used are controllers, colors, time of day and weather other than
wind, and the actions of the ego: it is the truck, and its own driver decides.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.checks import did_you_mean
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.road import Route
from iits_mj.road.road_frames import RoadFrames
from traffic_bridge.scenario.conditions import ROLES, TRUCK
from traffic_bridge.scenario.openscenario_file import Catalogs, Node, read_root
from traffic_bridge.scenario.reading import event_of
from traffic_bridge.signals.events import Event

EGOS = ("ego", "hero")
# Types of road users by the vehicle's category in the file.
CATEGORIES = {
    "car": "car",
    "van": "van",
    "truck": "truck",
    "bus": "truck",
    "semitrailer": "articulated",
    "trailer": "articulated",
    "motorbike": "bicycle",
    "bicycle": "bicycle",
}
LIMITS = {
    "greaterThan": "above",
    "greaterOrEqual": "above",
    "lessThan": "below",
    "lessOrEqual": "below",
    "equalTo": "equals",
}
EDGES = {"none": "none", "rising": "rising", "falling": "falling", "risingOrFalling": "either"}
STATES = {"startTransition": "begun", "endTransition": "ended", "completeState": "ended"}
INSTANT = 1e-6  # [s] after a time that a condition excludes
SHORTEST = 0.1  # [s] of a change to the side
# Elements of the ego that the truck's own driver replaces.
DRIVERS = ("ControllerAction", "ActivateControllerAction")
PRIORITIES = ("overwrite", "override", "parallel")

Values = dict[str, Any]
AnyGroups = list[list[Values]]  # one must hold; of a group all conditions


class Start(NamedTuple):
    """Start of the truck: station of its steer axle [m], lane from the right, speed [m/s]."""

    station: float
    lane: int
    speed: float


class Entity(NamedTuple):
    """A road user: type, size, and from its reference point to its front [m]."""

    node: Node
    type: str
    size: Values
    front: float


class _Spot(NamedTuple):
    """Station and offset of a reference point [m]."""

    station: float
    offset: float


class _Step(NamedTuple):
    """An action of an event for one actor, with the name of the event that is made of it."""

    name: str
    action: Node
    actor: str
    event: Node
    act: str


def read_scenario(path: str | Path, ego: str | None = None) -> OpenScenario:
    """Reads a scenario.

    Args:
      path: of the .xosc file.
      ego: name of the entity that is the truck; None: the first one named Ego or Hero.

    Raises:
      InputError: the file cannot be read, the entity is not in it, or an element of it is not
        supported.
    """
    return OpenScenario(read_root(Path(path)), ego)


class OpenScenario:
    """A scenario; use `read_scenario`.

    Attributes:
      map: OpenDRIVE file; route: the road of the ego in the words of `route_choice`.
      ego: name of the entity that is the truck.
      notes: what the truck's own driver replaces, in words.
    """

    def __init__(self, root: Node, ego: str | None) -> None:
        header = root.child("FileHeader")
        version = header.get("revMajor"), header.get("revMinor")
        if version[0] != "1" or version[1] not in ("0", "1", "2", "3"):
            header.fail(f"is OpenSCENARIO {'.'.join(version)}; versions 1.0 to 1.3 are supported")
        root = root.scoped()
        root.only(
            *("FileHeader", "ParameterDeclarations", "CatalogLocations", "RoadNetwork"),
            *("Entities", "Storyboard"),
        )
        network = root.child("RoadNetwork").only("LogicFile", "SceneGraphFile")
        self.map = root.path.parent / network.child("LogicFile").get("filepath")
        self._catalogs = Catalogs(root)
        objects = root.child("Entities").only("ScenarioObject")
        self._entities = {each.get("name"): self._entity(each) for each in objects}
        self.ego = self._ego(objects, ego)
        board = root.child("Storyboard").only("Init", "Story", "StopTrigger")
        init = board.child("Init").child("Actions").only("Private", "GlobalAction", "UserDefined")
        self._init = init
        self._stop = board.find("StopTrigger")
        self._places: dict[str, Node] = {}
        self._speeds: dict[str, Node] = {}
        for private in init:
            if private.tag == "Private":
                self._read_private(private)
        self._known: dict[str, _Spot] = {}
        self._steps: list[_Step] = []
        self._acts: list[tuple[str, Node]] = []
        # Names of the events that belong to an element of the storyboard, by its kind and name.
        self._elements: dict[tuple[str, str], list[str]] = {}
        self._names: set[str] = set(self._entities) | set(ROLES) | {TRUCK}
        skipped: list[str] = []
        for story in board:
            if story.tag == "Story":
                self._read_story(story.scoped(), skipped)
        self.notes: tuple[str, ...] = ()
        if skipped:
            self.notes = (
                f"the truck's own driver replaces the events of {self.ego}: {', '.join(skipped)}",
            )
        lane = self._place(self.ego).child("LanePosition")
        self.route = f"turns:{lane.get('roadId')}_{lane.get('laneId')}"

    def start(self, route: Route, footprint: EgoFootprint) -> Start:
        """Returns the start of the truck, whose front is that of the file's ego."""
        spot = self._spot(self.ego, route)
        station = spot.station + self._entities[self.ego].front - footprint.front_overhang
        lane = route.lane_at(spot.station, spot.offset)
        if lane < 0:
            self._place(self.ego).fail("the ego is not on a lane of its route")
        return Start(station, lane, self._speed(self.ego))

    def events(self, route: Route) -> tuple[Event, ...]:
        """Returns the events of the traffic on the truck's road.

        Raises:
          InputError: an entity is not on the route, or an element is not supported.
        """
        made = [
            made
            for node in self._init
            if node.tag == "GlobalAction"
            for made in self._global(node, route)
        ]
        for name, entity in self._entities.items():
            if name != self.ego and not self._is_trailer(name):
                made.append(self._placed(name, entity, route))
        for act, node in self._acts:
            trigger = node.find("StartTrigger")
            groups = [] if trigger is None else self._trigger(trigger, route)
            made.append(_event(node, {"event": "milestone", "name": act}, groups))
        for step in self._steps:
            trigger = step.event.find("StartTrigger")
            groups = self._trigger(trigger, route) if trigger is not None else [[]]
            begun = {"event": step.act, "state": "begun"}
            groups = [[begun, *group] for group in groups or [[]]]
            made.append(_event(step.event, self._values(step, route), groups))
        if self._stop is not None:
            groups = self._trigger(self._stop, route, stop=True)
            if groups:
                made.append(_event(self._stop, {"event": "end_drive"}, groups))
        return tuple(made)

    # Entities and their start.

    def _entity(self, node: Node) -> Entity:
        node.only("CatalogReference", "Vehicle", "Pedestrian", "MiscObject", "ObjectController")
        if node.get("name") in (TRUCK, *ROLES):
            node.fail(f"the name {node.get('name')!r} has another meaning: rename the entity")
        body = self._catalogs.resolve(next(iter(node)))
        if body.tag == "Vehicle":
            category = body.get("vehicleCategory")
            if category not in CATEGORIES:
                body.fail(f"vehicleCategory {category!r} is not read: {', '.join(CATEGORIES)}")
            kind = CATEGORIES[category]
        elif body.tag in ("Pedestrian", "MiscObject"):
            kind = "pedestrian" if body.tag == "Pedestrian" else "obstacle"
        else:
            body.fail("is no vehicle, pedestrian or object")
        box = body.child("BoundingBox")
        size = {n: box.child("Dimensions").number(n) for n in ("length", "width", "height")}
        return Entity(node, kind, size, box.child("Center").number("x") + 0.5 * size["length"])

    def _ego(self, objects: Node, wanted: str | None) -> str:
        if wanted is not None:
            if wanted not in self._entities:
                objects.fail(
                    f"there is no entity {wanted!r}{did_you_mean(wanted, self._entities)}; there "
                    f"are {', '.join(self._entities)}"
                )
            return wanted
        for name in self._entities:
            if name.lower() in EGOS:
                return name
        names = ", ".join(self._entities)
        return objects.fail(f"no entity is named Ego or Hero; choose one of {names}")

    def _is_trailer(self, name: str) -> bool:
        """Whether an entity is a trailer of the ego, which the truck has already."""
        body = self._catalogs.resolve(next(iter(self._entities[self.ego].node)))
        trailer = body.find("Trailer")
        reference = None if trailer is None else trailer.find("TrailerRef")
        return reference is not None and reference.get("entityRef", "") == name

    def _read_private(self, private: Node) -> None:
        name = self._reference(private)
        for action in private.only("PrivateAction"):
            kind = next(iter(action))
            if kind.tag == "TeleportAction":
                self._places[name] = kind.child("Position")
            elif kind.tag == "LongitudinalAction" and kind.find("SpeedAction") is not None:
                self._speeds[name] = kind.child("SpeedAction")
            elif kind.tag not in DRIVERS or name != self.ego:
                next(iter(kind), kind).refuse()

    def _reference(self, node: Node, attribute: str = "entityRef") -> str:
        name = node.get(attribute)
        if name not in self._entities:
            node.fail(f"there is no entity {name!r}{did_you_mean(name, self._entities)}")
        return name

    def _body(self, node: Node, attribute: str = "entityRef") -> str:
        """The name by which events know an entity."""
        name = self._reference(node, attribute)
        return TRUCK if name == self.ego else name

    def _place(self, name: str) -> Node:
        if name not in self._places:
            self._entities[name].node.fail("has no TeleportAction in Init")
        return self._places[name]

    def _spot(self, name: str, route: Route) -> _Spot:
        """Where the reference point of an entity is at the start."""
        if name not in self._known:
            place = self._place(name)
            self._known[name] = _Spot(math.nan, math.nan)  # marks a reference to itself
            self._known[name] = self._locate(next(iter(place)), route)
        spot = self._known[name]
        if math.isnan(spot.station):
            self._place(name).fail("the position refers to itself")
        return spot

    def _locate(self, node: Node, route: Route) -> _Spot:
        spot = self._located(node, route)
        if not 0.0 <= spot.station <= route.length:
            node.fail(f"the position is not on the route of the truck, of {route.length:.1f} m")
        return spot

    def _located(self, node: Node, route: Route) -> _Spot:
        if node.tag in ("RelativeRoadPosition", "RelativeLanePosition"):
            other = self._spot(self._reference(node), route)
            station = other.station + node.number("ds")
            self._check_heading(node, route, station, float(route.heading(np.array(station))))
            if node.tag == "RelativeRoadPosition":
                return _Spot(station, other.offset + node.number("dt"))
            lane = route.lane_at(other.station, other.offset) + round(node.number("dLane"))
            if not route.lane_exists(lane, station):
                node.fail("there is no such lane on the route")
            shift = node.number("offset", 0.0)
            return _Spot(station, float(route.lane_offset(lane, station)) + shift)
        if node.tag == "WorldPosition":
            x, y = node.number("x"), node.number("y")
            heading = node.number("h", 0.0)
        elif node.tag in ("LanePosition", "RoadPosition"):
            x, y, heading = self._on_road(node, route)
        else:
            node.refuse()
        station, offset = route.locate(x, y)
        point = route.evaluate(station, offset)
        if math.hypot(float(point.x) - x, float(point.y) - y) > 1.0:
            node.fail("the position is not on the route of the truck")
        self._check_heading(node, route, station, heading)
        return _Spot(station, offset)

    def _on_road(self, node: Node, route: Route) -> tuple[float, float, float]:
        """X, y [m] and heading [rad] of a position on a road of the map."""
        name, s = node.get("roadId"), node.number("s")
        if all(segment.road_id != name for segment in route.segments):
            names = ", ".join(segment.road_id for segment in route.segments)
            node.fail(f"road {name!r} is not on the route of the truck, which has {names}")
        frame = RoadFrames(route.road_map)[name]
        if not 0.0 <= s <= frame.length:
            node.fail(f"s = {s:g} m: road {name!r} has 0 to {frame.length:.1f} m")
        sense = 1
        if node.tag == "RoadPosition":
            t = node.number("t")
        else:
            lane = round(node.number("laneId"))
            if not frame.kind(s, lane):
                node.fail(f"road {name!r} has no lane {lane} at s = {s:g} m")
            sense = frame.road.travel(lane)
            t = frame.center_at(lane, s) + node.number("offset", 0.0)
        point = frame.surface(np.array([s]), np.array([t]))
        heading = float(point.heading[0]) + (math.pi if sense < 0 else 0.0)
        return float(point.x[0]), float(point.y[0]), heading

    def _check_heading(self, node: Node, route: Route, station: float, heading: float) -> None:
        """Refuses what does not point along the route."""
        turn = node.find("Orientation")
        if turn is not None:
            own = turn.number("h", 0.0)
            heading = own + (heading if turn.get("type", "absolute") == "relative" else 0.0)
        if abs(wrap_angle(heading - float(route.heading(np.array(station))))) > 0.5 * math.pi:
            node.fail("oncoming road users are not supported: it must face along the route")

    def _speed(self, name: str) -> float:
        """Speed at the start [m/s]."""
        action = self._speeds.get(name)
        if action is None:
            return 0.0
        target = next(iter(action.child("SpeedActionTarget")))
        if target.tag == "AbsoluteTargetSpeed":
            return target.number("value")
        if target.tag != "RelativeTargetSpeed" or target.get("continuous") == "true":
            target.fail("with continuous is not read in Init")
        other, value = self._speed(self._reference(target)), target.number("value")
        return other * value if target.get("speedTargetValueType") == "factor" else other + value

    def _placed(self, name: str, entity: Entity, route: Route) -> Event:
        spot, place = self._spot(name, route), self._place(name)
        front = spot.station + entity.front
        center = front - 0.5 * entity.size["length"]
        lane = min(
            (k for k in range(route.lane_count(center)) if route.lane_exists(k, center)),
            key=lambda k: abs(float(route.lane_offset(k, center)) - spot.offset),
        )
        shift = spot.offset - float(route.lane_offset(lane, center))
        values = {
            "event": "place_vehicle",
            "name": name,
            "station": front,
            "lane": lane,
            "speed": self._speed(name),
            "type": entity.type,
            "reactive": False,
            **({"offset": shift} if abs(shift) > 0.01 else {}),
            **entity.size,
        }
        return _event(place, values)

    def _global(self, action: Node, route: Route) -> Iterator[Event]:
        """The friction and the wind of an environment."""
        kind = next(iter(action))
        if kind.tag != "EnvironmentAction":
            kind.refuse()
        node = self._catalogs.resolve(next(iter(kind)))
        node.only("ParameterDeclarations", "TimeOfDay", "Weather", "RoadCondition")
        road, weather = node.find("RoadCondition"), node.find("Weather")
        start = self._spot(self.ego, route)
        if road is not None:
            friction = route.friction(start.station, start.offset)
            friction *= road.number("frictionScaleFactor")
            yield _event(road, {"event": "friction", "friction": friction})
        wind = None if weather is None else weather.find("Wind")
        if wind is not None:
            # The file has where it blows to, from the map's x axis.
            heading = float(route.heading(np.array(start.station)))
            origin = wrap_angle(wind.number("direction") + math.pi - heading)
            values = {"event": "wind", "shape": "steady", "speed": wind.number("speed")}
            yield _event(wind, {**values, "direction": math.degrees(origin)})

    # The storyboard.

    def _read_story(self, story: Node, skipped: list[str]) -> None:
        for act in story.only("ParameterDeclarations", "Act"):
            if act.tag != "Act":
                continue
            act.only("ManeuverGroup", "StartTrigger", "StopTrigger")
            stop = act.find("StopTrigger")
            if stop is not None and any(True for _ in stop):
                stop.refuse()
            name = self._new_name(act.get("name"))
            self._acts.append((name, act))
            self._elements["act start", act.get("name")] = [name]
            for group in act:
                if group.tag == "ManeuverGroup":
                    self._read_group(group, (story, act, group), name, skipped)

    def _read_group(
        self, group: Node, parents: Sequence[Node], act: str, skipped: list[str]
    ) -> None:
        _once(group)
        actors = group.child("Actors")
        if actors.get("selectTriggeringEntities", "false") == "true":
            actors.fail("selectTriggeringEntities is not read")
        names = [self._reference(each) for each in actors.only("EntityRef")]
        for node in group.only("Actors", "CatalogReference", "Maneuver"):
            if node.tag == "Actors":
                continue
            maneuver = self._catalogs.resolve(node).scoped()
            for event in maneuver.only("ParameterDeclarations", "Event"):
                if event.tag != "Event":
                    continue
                _once(event)
                event.only("Action", "StartTrigger")
                if event.get("priority") not in PRIORITIES:
                    event.fail(f"priority must be one of {', '.join(PRIORITIES)}")
                own = [name for name in names if name != self.ego]
                if len(own) < len(names):
                    skipped.append(event.get("name"))
                made = []
                actions = [action for action in event if action.tag == "Action"]
                for action, actor in itertools.product(actions, own):
                    name = self._new_name(event.get("name"))
                    self._steps.append(_Step(name, action, actor, event, act))
                    self._elements.setdefault(("action", action.get("name")), []).append(name)
                    made.append(name)
                for each in (*parents, maneuver, event):
                    kind = each.tag[:1].lower() + each.tag[1:]
                    self._elements.setdefault((kind, each.get("name")), []).extend(made)

    def _new_name(self, wanted: str) -> str:
        """A name of an event that no other has."""
        name, number = wanted, 2
        while name in self._names:
            name, number = f"{wanted} {number}", number + 1
        self._names.add(name)
        return name

    def _values(self, step: _Step, route: Route) -> Values:
        """The event of an action."""
        private = step.action.child("PrivateAction")
        kind = next(iter(private))
        if kind.tag not in ("LongitudinalAction", "LateralAction"):
            next(iter(kind), kind).refuse()
        action = next(iter(kind))
        values = {"name": step.name, "actor": step.actor}
        if action.tag == "SpeedAction":
            return values | self._change_speed(action)
        if action.tag == "LaneChangeAction":
            return values | self._change_lane(action, route, step.actor)
        if action.tag == "LaneOffsetAction":
            return values | _change_offset(action)
        return action.refuse()

    def _change_speed(self, action: Node) -> Values:
        values: Values = {"event": "change_speed"}
        dynamics = action.child("SpeedActionDynamics")
        shape, dimension = dynamics.get("dynamicsShape"), dynamics.get("dynamicsDimension")
        values["shape"] = shape
        if shape != "step" and dimension == "time":
            values["time"] = dynamics.number("value")
        elif shape != "step" and (shape, dimension) == ("linear", "rate"):
            values["acceleration"] = abs(dynamics.number("value"))
        elif shape != "step":
            dynamics.fail(f"{shape} over {dimension} is not read: time, or a rate that is linear")
        target = next(iter(action.child("SpeedActionTarget")))
        if target.tag == "AbsoluteTargetSpeed":
            return values | {"speed": target.number("value")}
        if target.tag != "RelativeTargetSpeed":
            target.refuse()
        factor = target.get("speedTargetValueType") == "factor"
        return values | {
            "to": self._body(target),
            "speed_factor" if factor else "speed_difference": target.number("value"),
            "continuous": target.get("continuous") == "true",
        }

    def _change_lane(self, action: Node, route: Route, actor: str) -> Values:
        if float(action.get("targetLaneOffset", "0")) != 0.0:
            action.fail("targetLaneOffset is not read")
        dynamics = action.child("LaneChangeActionDynamics")
        values = {"event": "change_lane", **_lateral(dynamics)}
        target = next(iter(action.child("LaneChangeTarget")))
        if target.tag == "RelativeTargetLane":
            return values | {
                "to": self._body(target),
                "relative_lane": round(target.number("value")),
            }
        station = self._spot(actor, route).station
        segment = max(
            (each for each in route.segments if each.station_start <= station),
            key=lambda each: each.station_start,
            default=route.segments[0],
        )
        lane = round(target.number("value"))
        frame = RoadFrames(route.road_map)[segment.road_id]
        s = segment.s_start + segment.direction * (station - segment.station_start)
        if not frame.kind(s, lane):
            target.fail(f"road {segment.road_id!r} has no lane {lane}")
        point = frame.surface(np.array([s]), np.array([frame.center_at(lane, s)]))
        at, offset = route.locate(float(point.x[0]), float(point.y[0]), station)
        if (found := route.lane_at(at, offset)) < 0:
            target.fail(f"lane {lane} is not a lane of the route")
        return values | {"lane": found}

    # Triggers.

    def _trigger(self, trigger: Node, route: Route, stop: bool = False) -> AnyGroups:
        """The groups of a trigger; a stop leaves out collisions, which end every drive."""
        groups: AnyGroups = []
        for group in trigger.only("ConditionGroup"):
            parts = list(group.only("Condition"))
            if stop and any(self._is_collision(part) for part in parts):
                continue
            for chosen in itertools.product(*(self._condition(part, route) for part in parts)):
                groups.append([condition for each in chosen for condition in each])
        return groups

    def _is_collision(self, condition: Node) -> bool:
        found = condition.find("ByEntityCondition")
        if found is None or found.child("EntityCondition").find("CollisionCondition") is None:
            return False
        return any(each.get("entityRef") == self.ego for each in found.child("TriggeringEntities"))

    def _condition(self, node: Node, route: Route) -> AnyGroups:
        edge = node.get("conditionEdge")
        if edge not in EDGES:
            node.fail(f"conditionEdge {edge!r}: allowed are {', '.join(EDGES)}")
        base: Values = {"edge": EDGES[edge], "delay": node.number("delay", 0.0)}
        kind = next(iter(node))
        if kind.tag == "ByValueCondition":
            return self._by_value(next(iter(kind)), base)
        triggering = kind.child("TriggeringEntities")
        entities = [self._body(each) for each in triggering.only("EntityRef")]
        if len(entities) > 1 and edge != "none":
            triggering.fail(f"several entities with conditionEdge {edge!r} are not read")
        condition = next(iter(kind.child("EntityCondition")))
        made = [base | self._by_entity(condition, name, route) for name in entities]
        every = triggering.get("triggeringEntitiesRule") == "all"
        return [made] if every else [[each] for each in made]

    def _by_value(self, node: Node, base: Values) -> AnyGroups:
        if node.tag == "SimulationTimeCondition":
            # The event's comparison is inclusive.
            shift = {"greaterThan": INSTANT, "lessThan": -INSTANT}.get(node.get("rule"), 0.0)
            values = {name: value + shift for name, value in _limit(node).items()}
            return [[base | {"measure": "time"} | values]]
        if node.tag != "StoryboardElementStateCondition":
            node.refuse()
        state, kind = node.get("state"), node.get("storyboardElementType")
        if state not in STATES:
            node.fail(f"state {state!r} is not read: {', '.join(STATES)}")
        reached, name = STATES[state], node.get("storyboardElementRef").rpartition("::")[2]
        found = self._elements.get((kind, name))
        if (kind, reached) == ("act", "begun"):
            found = self._elements.get(("act start", name))
        if not found:
            node.fail(f"there is no {kind} {name!r} with events of the traffic")
        if len(found) > 1:
            base = base | {"edge": "none"}
        made = [base | {"event": each, "state": reached} for each in found]
        return [made] if reached == "ended" else [[each] for each in made]

    def _by_entity(self, node: Node, of: str, route: Route) -> Values:
        tag = node.tag
        if tag in ("SpeedCondition", "AccelerationCondition"):
            if node.get("direction", "longitudinal") != "longitudinal":
                node.fail(f"direction {node.get('direction')!r} is not read")
            measure = "speed" if tag == "SpeedCondition" else "acceleration"
            return {"measure": measure, "of": of} | _limit(node)
        if tag == "RelativeSpeedCondition":
            bodies = {"of": self._body(node), "to": of}
            return {"measure": "speed_difference", **bodies, **_limit(node)}
        if tag == "TraveledDistanceCondition":
            name = self.ego if of == TRUCK else of
            front = self._spot(name, route).station + self._entities[name].front
            return {"measure": "station", "of": of, "above": front + node.number("value")}
        values: Values = {"of": of, "freespace": node.get("freespace") == "true"}
        kind = node.get("relativeDistanceType", "longitudinal")
        if tag == "RelativeDistanceCondition" and kind in (
            "cartesianDistance",
            "euclidianDistance",
        ):
            if values.pop("freespace"):
                node.fail(f"{kind} with freespace is not read")
            return {**values, "measure": "distance", "to": self._body(node), **_limit(node)}
        measures = {
            "TimeHeadwayCondition": "time_gap",
            "TimeToCollisionCondition": "ttc",
            "RelativeDistanceCondition": "gap",
        }
        if tag not in measures:
            node.refuse()
        if kind != "longitudinal":
            node.fail(f"relativeDistanceType {kind!r} is not read")
        other = node
        if tag == "TimeToCollisionCondition":
            other = next(iter(node.child("TimeToCollisionConditionTarget")))
            if other.tag != "EntityRef":
                other.refuse()
        return {**values, "measure": measures[tag], "to": self._body(other), **_limit(node)}


def _limit(node: Node) -> Values:
    rule = node.get("rule")
    if rule not in LIMITS:
        node.fail(f"rule {rule!r} is not read: {', '.join(LIMITS)}")
    return {LIMITS[rule]: node.number("value")}


def _lateral(dynamics: Node) -> Values:
    shape = dynamics.get("dynamicsShape")
    if shape == "step":
        return {"shape": "linear", "duration": SHORTEST}
    if dynamics.get("dynamicsDimension") != "time":
        dynamics.fail(f"dynamicsDimension {dynamics.get('dynamicsDimension')!r} is not read: time")
    return {"shape": shape, "duration": max(dynamics.number("value"), SHORTEST)}


def _change_offset(action: Node) -> Values:
    if action.get("continuous", "false") == "true":
        action.fail("continuous is not read")
    dynamics = action.child("LaneOffsetActionDynamics")
    target = next(iter(action.child("LaneOffsetTarget")))
    if target.tag != "AbsoluteTargetLaneOffset":
        target.refuse()
    offset, shape = target.number("value"), dynamics.get("dynamicsShape")
    # Greatest second derivative of the unit shapes.
    steepest = {"sinusoidal": 0.5 * math.pi**2, "cubic": 6.0}
    duration = SHORTEST
    if shape in steepest:
        bound = dynamics.number("maxLateralAcc", low=0.01)
        duration = max(math.sqrt(steepest[shape] * abs(offset) / bound), SHORTEST)
    elif shape != "step":
        dynamics.fail(f"dynamicsShape {shape!r} is not read: step, {', '.join(steepest)}")
    values = {"event": "swerve", "offset": offset, "back": False, "duration": duration}
    return values | {"shape": shape if shape in steepest else "linear"}


def _once(node: Node) -> None:
    if node.get("maximumExecutionCount", "1") != "1":
        node.fail("maximumExecutionCount: only 1 is read")


def _event(node: Node, values: Mapping[str, Any], groups: AnyGroups | None = None) -> Event:
    """The event of a mapping, which begins on groups of conditions; errors name the node."""
    try:
        return event_of({**values, **({"when": groups} if groups else {})})
    except InputError as error:
        node.fail(str(error))
