"""Reads ASAM OpenSCENARIO XML 1.0 to 1.3: the start of the truck, and the events of the traffic.

Element and attribute names are those of the standard. Everything that is not read is refused with
its element, file and line. Not used are controllers, colors, time of day and weather other than
wind, and the actions of the ego: it is the truck, and its own driver decides.
"""

from __future__ import annotations

import functools
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
from iits_mj.road import RoadMap, Route
from traffic_bridge.scenario.actors import REST
from traffic_bridge.scenario.conditions import ROLES, SIGNAL, TRUCK
from traffic_bridge.scenario.openscenario_file import Catalogs, Node, read_root
from traffic_bridge.scenario.openscenario_places import Places, Pose, road_at, words_of
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
# Mean over greatest rate of the shapes of a change.
MEANS = {"linear": 1.0, "sinusoidal": 2.0 / math.pi, "cubic": 2.0 / 3.0}
ARTICULATED = 12.0  # [m]: least length of a truck with trailers that has a body of its own
SAME = 1e-3  # [m], [s]
INSTANT = 1e-6  # [s] after a time that a condition excludes
SHORTEST = 0.1  # [s] of a change to the side
# Elements of the ego that the truck's own driver replaces.
DRIVERS = ("ControllerAction", "ActivateControllerAction")
PLANE = ("cartesianDistance", "euclidianDistance")
ROUTES = ("AssignRouteAction", "AcquirePositionAction")
PRIORITIES = ("overwrite", "override", "parallel")

Values = dict[str, Any]
AnyGroups = list[list[Values]]  # one must hold; of a group all conditions


class Start(NamedTuple):
    """Start of the truck: station of its steer axle [m], lane from the right, speed [m/s]."""

    station: float
    lane: int
    speed: float


class Entity(NamedTuple):
    """A road user: type, size with its trailers, and from its reference point to its front [m]."""

    node: Node
    type: str
    size: Values
    front: float

    @property
    def center(self) -> float:
        """From its reference point to the center of its box [m]."""
        return self.front - 0.5 * float(self.size["length"])

    @property
    def walks(self) -> bool:
        """Whether it is no vehicle."""
        return self.type in ("pedestrian", "obstacle")


class _Spot(NamedTuple):
    """Station and offset of a reference point [m] on a road, the truck's or in words `along`."""

    station: float
    offset: float
    along: str | None = None


class _Step(NamedTuple):
    """An action of an event for one actor, with the name of the event that is made of it."""

    name: str
    action: Node
    actor: str
    event: Node
    act: str
    family: int


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
      map: OpenDRIVE file.
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
            *("FileHeader", "ParameterDeclarations", "VariableDeclarations", "CatalogLocations"),
            *("RoadNetwork", "Entities", "Storyboard"),
        )
        self._declared = {
            node.get("name"): node
            for group in ("ParameterDeclarations", "VariableDeclarations")
            for node in (root.find(group) or ())
        }
        network = root.child("RoadNetwork").only("LogicFile", "SceneGraphFile")
        self.map = root.path.parent / network.child("LogicFile").get("filepath")
        self._catalogs = Catalogs(root)
        objects = root.child("Entities").only("ScenarioObject")
        self._entities = {each.get("name"): self._entity(each) for each in objects}
        self._towed: set[str] = set()
        for name in list(self._entities):
            self._entities[name] = self._with_trailers(name)
        self.ego = self._ego(objects, ego)
        board = root.child("Storyboard").only("Init", "Story", "StopTrigger")
        init = board.child("Init").child("Actions").only("Private", "GlobalAction", "UserDefined")
        self._init = init
        self._stop = board.find("StopTrigger")
        self._starts: dict[str, Node] = {}
        self._routes: dict[str, Node] = {}
        self._trajectories: dict[str, Node] = {}
        self._places: Places | None = None
        self._speeds: dict[str, Node] = {}
        for private in init:
            if private.tag == "Private":
                self._read_private(private)
        self._known: dict[str, _Spot] = {}
        self._variables: dict[str, Node] = {}
        self._steps: list[_Step] = []
        self._acts: list[tuple[str, Node]] = []
        # Names of the events that belong to an element of the storyboard, by its kind and name.
        self._elements: dict[tuple[str, str], list[str]] = {}
        # Maneuvers of the events, whose elements are meant first by the conditions in them.
        self._families: dict[str, int] = {}
        self._family = -1
        self._names: set[str] = set(self._entities) | set(ROLES) | {TRUCK}
        self._skipped: list[str] = []
        for story in board:
            if story.tag == "Story":
                self._read_story(story.scoped())
        self.notes = tuple(self._remarks(board))

    def _remarks(self, board: Node) -> Iterator[str]:
        if self._skipped:
            names = ", ".join(dict.fromkeys(self._skipped))
            yield f"the truck's own driver replaces the events of {self.ego}: {names}"
        if self.ego in self._trajectories:
            yield f"the truck's own driver replaces the trajectory of {self.ego}"
        waiting = dict.fromkeys(
            node.get("storyboardElementRef")
            for node in board.all("StoryboardElementStateCondition")
            if self._is_replaced(node)
        )
        if waiting:
            yield f"conditions on these events of {self.ego} never hold: {', '.join(waiting)}"

    @functools.cached_property
    def route(self) -> str:
        """The road of the ego in the words of `route_choice`.

        Raises:
          InputError, MapError: the map of the file cannot be used, or the ego is on none of its
            driving lanes.
        """
        node = self._start(self.ego)
        if node.tag == "LanePosition" and self.ego not in self._routes:
            return words_of([f"{node.get('roadId')}_{node.get('laneId')}"])
        self._places = Places(RoadMap.from_opendrive(self.map), self._catalogs)
        pose = self._turn_along(self.ego, self._places.pose(node))
        lane = self._places.driving_lane(pose)
        if not lane:
            node.fail("the ego is on no driving lane that leads where it faces")
        return self._words(self.ego, lane)

    def start(self, route: Route, footprint: EgoFootprint) -> Start:
        """Returns the start of the truck, whose front is that of the file's ego."""
        self._use(route)
        spot = self._spot(self.ego, route)
        station = spot.station + self._entities[self.ego].front - footprint.front_overhang
        lane = route.lane_at(spot.station, spot.offset)
        if lane < 0:
            self._start(self.ego).fail("the ego is not on a lane of its route")
        return Start(station, lane, self._speed(self.ego))

    def events(self, route: Route) -> tuple[Event, ...]:
        """Returns the events of the traffic on the truck's road.

        Raises:
          InputError: an entity is not on the map, or an element is not supported.
        """
        self._use(route)
        made = [
            made
            for node in self._init
            if node.tag == "GlobalAction"
            for made in self._global(node, route)
        ]
        for name, entity in self._entities.items():
            if name != self.ego and name not in self._towed:
                made.extend(self._placed(name, entity, route))
        for act, node in self._acts:
            trigger = node.find("StartTrigger")
            groups = [] if trigger is None else self._trigger(trigger, route)
            made.append(_event(node, {"event": "milestone", "name": act}, groups))
        for step in self._steps:
            trigger = step.event.find("StartTrigger")
            self._family = step.family
            groups = self._trigger(trigger, route) if trigger is not None else [[]]
            if not groups and trigger is not None and trigger.find("ConditionGroup") is not None:
                continue  # it waits for an event of the ego
            begun = {"event": step.act, "state": "begun"}
            groups = [[begun, *group] for group in groups or [[]]]
            made.append(_event(step.event, self._values(step, route), groups))
        self._family = -1
        if self._stop is not None:
            groups = self._trigger(self._stop, route, stop=True)
            if groups:
                made.append(_event(self._stop, {"event": "end_drive"}, groups))
        # Variables have their first values before any condition.
        first = [
            _event(node, {"event": "set_value", "variable": name, "value": node.value("value")})
            for name, node in self._variables.items()
        ]
        return (*first, *made)

    def _use(self, route: Route) -> None:
        """Takes the map of the truck's route."""
        if self._places is None or self._places.frames.road_map is not route.road_map:
            self._places, self._known = Places(route.road_map, self._catalogs), {}

    @property
    def _on_map(self) -> Places:
        assert self._places is not None
        return self._places

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
        front = box.child("Center").number("x") + 0.5 * size["length"]
        return Entity(node, kind, size, front)

    def _with_trailers(self, name: str) -> Entity:
        """An entity with the length of its whole combination."""
        entity = self._entities[name]
        body = self._catalogs.resolve(next(iter(entity.node)))
        place, rear, towed = 0.0, entity.front - float(entity.size["length"]), False
        while (trailer := self._trailer(body)) is not None:
            coupler = trailer.child("TrailerCoupler").number("dx")
            place += body.child("TrailerHitch").number("dx") - coupler
            box = trailer.child("BoundingBox")
            half = 0.5 * box.child("Dimensions").number("length", low=0.1)
            rear, towed = min(place + box.child("Center").number("x") - half, rear), True
            body = trailer
        if not towed:
            return entity
        length = entity.front - rear
        kind = "articulated" if entity.type == "truck" and length >= ARTICULATED else entity.type
        return entity._replace(type=kind, size=entity.size | {"length": length})

    def _trailer(self, body: Node) -> Node | None:
        """The vehicle that another one tows, None if it tows none."""
        found = body.find("Trailer")
        each = None if found is None else next(iter(found), None)
        if each is None:
            return None
        if each.tag == "Trailer":
            return self._catalogs.resolve(next(iter(each)))
        name = each.get("entityRef")
        if not name:
            return None
        self._towed.add(self._reference(each))
        return self._catalogs.resolve(next(iter(self._entities[name].node)))

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

    def _read_private(self, private: Node) -> None:
        name = self._reference(private)
        for action in private.only("PrivateAction"):
            kind = next(iter(action))
            if kind.tag == "TeleportAction":
                self._starts[name] = next(iter(kind.child("Position")))
            elif kind.tag == "LongitudinalAction" and kind.find("SpeedAction") is not None:
                self._speeds[name] = kind.child("SpeedAction")
            elif kind.tag == "RoutingAction":
                routing = next(iter(kind))
                if routing.tag == "FollowTrajectoryAction":
                    self._trajectories[name] = routing
                elif routing.tag in ROUTES:
                    self._routes[name] = routing
                else:
                    routing.refuse()
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

    def _start(self, name: str) -> Node:
        """The position at which an entity starts."""
        if name in self._starts:
            return self._starts[name]
        if name in self._trajectories:
            vertex = next(iter(_polyline(self._trajectories[name], self._catalogs)))
            return next(iter(vertex.child("Position")))
        return self._entities[name].node.fail("has no TeleportAction in Init")

    def _words(self, name: str, lane: str) -> str:
        """The road of an entity that starts in a lane, in the words of `route_choice`."""
        routing = self._routes.get(name)
        return words_of([lane] if routing is None else [lane, *self._waypoints(routing)])

    def _waypoints(self, routing: Node) -> list[str]:
        """The lanes over which an action leads, as ROAD_LANE."""
        if routing.tag == "AcquirePositionAction":
            points = [next(iter(routing.child("Position")))]
        else:
            points = self._on_map.waypoints(next(iter(routing)))
        return [self._on_map.lane_name(each) for each in points]

    def _turn_along(self, name: str, pose: Pose) -> Pose:
        """A pose with the heading of the trajectory that begins there, if there is one."""
        if name in self._starts or name not in self._trajectories:
            return pose
        vertices = list(_polyline(self._trajectories[name], self._catalogs))[:2]
        ends = [self._on_map.pose(next(iter(each.child("Position")))) for each in vertices]
        return pose._replace(heading=math.atan2(ends[1].y - ends[0].y, ends[1].x - ends[0].x))

    def _pose(self, name: str, route: Route) -> Pose:
        """Where the reference point of an entity is at the start, and where it faces."""
        node = self._start(name)
        if not node.tag.startswith("Relative"):
            return self._turn_along(name, self._on_map.pose(node))
        spot = self._spot(name, route)
        track = self._track(spot, node, route)
        road, s, direction = road_at(track, spot.station)
        point = track.evaluate(spot.station, spot.offset)
        _, t = self._on_map.frames[road].locate(float(point.x), float(point.y), s)
        turn = node.find("Orientation")
        pose = self._on_map.at(road, s, t, direction)
        own = 0.0 if turn is None else turn.number("h", 0.0)
        absolute = turn is not None and turn.get("type", "absolute") == "absolute"
        return pose._replace(heading=own if absolute else pose.heading + own)

    def _track(self, spot: _Spot, node: Node, route: Route) -> Route:
        """The road on which a spot is."""
        return route if spot.along is None else self._on_map.along(spot.along, node)

    def _spot(self, name: str, route: Route) -> _Spot:
        """Where the reference point of an entity is at the start, on the road that it drives on.

        The offset is NaN where it is on no road that leads where it faces.
        """
        if name not in self._known:
            node = self._start(name)
            self._known[name] = _Spot(math.nan, math.nan)  # marks a reference to itself
            self._known[name] = self._find_spot(name, node, route)
        spot = self._known[name]
        if math.isnan(spot.station):
            self._start(name).fail("the position refers to itself")
        return spot

    def _find_spot(self, name: str, node: Node, route: Route) -> _Spot:
        if node.tag.startswith("Relative"):
            return self._relative(node, route)
        pose = self._turn_along(name, self._on_map.pose(node))
        if name == self.ego or name not in self._routes:
            if (found := _on(route, pose)) is not None:
                return found
            if name == self.ego:
                node.fail("the position is not on the route of the truck, or faces against it")
        lane = self._on_map.driving_lane(pose)
        if lane:
            words = self._words(name, lane)
            own = _on(self._on_map.along(words, node), pose)
            if own is not None:
                return own._replace(along=words)
        if name in self._routes and not self._entities[name].walks:
            self._routes[name].fail("does not begin in the driving lane in which the entity starts")
        return _Spot(0.0, math.nan)

    def _relative(self, node: Node, route: Route) -> _Spot:
        if node.tag not in ("RelativeRoadPosition", "RelativeLanePosition"):
            node.refuse()
        other = self._spot(self._reference(node), route)
        if math.isnan(other.offset):
            node.fail("refers to an entity that is on no road")
        track = self._track(other, node, route)
        station = other.station + node.number("ds")
        if not 0.0 <= station <= track.length:
            node.fail(f"the position is not on the road of the other one, of {track.length:.1f} m")
        if node.tag == "RelativeRoadPosition":
            return other._replace(station=station, offset=other.offset + node.number("dt"))
        lane = track.lane_at(other.station, other.offset) + round(node.number("dLane"))
        if not track.lane_exists(lane, station):
            node.fail("there is no such lane on the route")
        offset = float(track.lane_offset(lane, station)) + node.number("offset", 0.0)
        return other._replace(station=station, offset=offset)

    def _station(self, node: Node, route: Route, track: Route) -> float:
        """The station of a position on a road, the truck's or another one [m]."""
        if node.tag.startswith("Relative"):
            spot = self._relative(node, route)
            if self._track(spot, node, route) is track:
                return spot.station
        else:
            pose = self._on_map.pose(node)
            found = _on(track, pose, facing=False)
            if found is not None:
                return found.station
        return node.fail("the position is not on the road of the entity")

    def _speed(self, name: str) -> float:
        """Speed at the start [m/s]."""
        action = self._speeds.get(name)
        if action is None:
            return 0.0
        target = next(iter(action.child("SpeedActionTarget")))
        if target.tag == "AbsoluteTargetSpeed":
            return target.number("value")
        if target.tag != "RelativeTargetSpeed":
            target.refuse()
        other, value = self._speed(self._reference(target)), target.number("value")
        return other * value if target.get("speedTargetValueType") == "factor" else other + value

    def _placed(self, name: str, entity: Entity, route: Route) -> Iterator[Event]:
        """An entity at its start, with what it does from there."""
        node = self._start(name)
        values = {
            "event": "place_vehicle",
            "name": name,
            "speed": self._speed(name),
            "type": entity.type,
            "reactive": False,
            **entity.size,
        }
        spot = self._spot(name, route)
        if entity.walks or math.isnan(spot.offset):
            yield _event(node, values | self._standing(entity, self._pose(name, route)))
        else:
            yield _event(node, values | self._driving(entity, spot, node, route))
        speed = self._speeds.get(name)
        if (
            speed is not None
            and next(iter(speed.child("SpeedActionTarget"))).get("continuous", "false") == "true"
        ):
            made = {"name": self._new_name(f"speed of {name}"), "actor": name}
            yield _event(speed, made | self._change_speed(speed))
        if name in self._trajectories:
            action = self._trajectories[name]
            made = {"name": self._new_name(f"trajectory of {name}"), "actor": name}
            yield _event(action, made | self._trajectory(action, entity, route, at_start=True))

    def _driving(self, entity: Entity, spot: _Spot, node: Node, route: Route) -> Values:
        """The place of a vehicle on a road."""
        track = self._track(spot, node, route)
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
        on = self._on_map.way_on(center, pose.heading)
        return {"points": _points([(center.x, center.y, center.z), *on]), "stays": entity.walks}

    def _trajectory(
        self, action: Node, entity: Entity, route: Route, at_start: bool = False
    ) -> Values:
        """The event of a FollowTrajectoryAction."""
        if action.number("initialDistanceOffset", 0.0) != 0.0:
            action.fail("initialDistanceOffset is not read")
        vertices = list(_polyline(action, self._catalogs))
        poses = [self._on_map.pose(next(iter(each.child("Position")))) for each in vertices]
        times = _times(action, vertices, at_start)
        if times is None:  # places that follow each other twice add nothing
            apart = [
                k == 0 or math.dist(each[:2], poses[k - 1][:2]) > SAME
                for k, each in enumerate(poses)
            ]
            poses = list(itertools.compress(poses, apart))
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
        if entity.walks or _on(route, last) is None:
            points.extend(self._on_map.way_on(poses[-1], last.heading))
        return values | {"points": _points(points)} | ({} if times is None else {"times": times})

    def _global(self, action: Node, route: Route) -> Iterator[Event]:
        """The friction and the wind of an environment, or the new value of a variable."""
        kind = next(iter(action))
        if kind.tag != "EnvironmentAction":
            yield _event(kind, self._set_value(kind))
            return
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

    def _set_value(self, kind: Node) -> Values:
        """The event of an action on a parameter, a variable or a traffic signal."""
        if kind.tag in ("ParameterAction", "VariableAction"):
            name = kind.get("parameterRef" if kind.tag == "ParameterAction" else "variableRef")
            action = next(iter(kind))
            if action.tag != "SetAction":
                action.refuse()
            return {"event": "set_value", "variable": name, "value": action.value("value")}
        if kind.tag != "InfrastructureAction":
            kind.refuse()
        signal = next(iter(kind.child("TrafficSignalAction")))
        if signal.tag != "TrafficSignalStateAction":
            signal.refuse()
        return {
            "event": "set_value",
            "variable": f"{SIGNAL}{signal.get('name')}",
            "value": signal.get("state"),
        }

    # The storyboard.

    def _read_story(self, story: Node) -> None:
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
                    self._read_group(group, (story, act, group), name)

    def _read_group(self, group: Node, parents: Sequence[Node], act: str) -> None:
        _once(group)
        actors = group.child("Actors")
        if actors.get("selectTriggeringEntities", "false") == "true":
            actors.fail("selectTriggeringEntities is not read")
        names = [self._reference(each) for each in actors.only("EntityRef")]
        for node in group.only("Actors", "CatalogReference", "Maneuver"):
            if node.tag == "Actors":
                continue
            maneuver = self._catalogs.resolve(node)
            family = len(self._steps)
            for event in maneuver.only("ParameterDeclarations", "Event"):
                if event.tag != "Event":
                    continue
                _once(event)
                event.only("Action", "StartTrigger")
                if event.get("priority") not in PRIORITIES:
                    event.fail(f"priority must be one of {', '.join(PRIORITIES)}")
                made = []
                for action in event:
                    if action.tag != "Action":
                        continue
                    private = action.find("PrivateAction") is not None
                    for actor in names if private else ("",):
                        if actor == self.ego:
                            self._skipped.append(event.get("name"))
                            self._elements.setdefault(("action", action.get("name")), [])
                            continue
                        name = self._new_name(event.get("name"))
                        self._steps.append(_Step(name, action, actor, event, act, family))
                        self._families[name] = family
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
        values: Values = {"name": step.name}
        if not step.actor:
            return values | self._set_value(next(iter(step.action.child("GlobalAction"))))
        values["actor"] = step.actor
        kind = next(iter(step.action.child("PrivateAction")))
        if kind.tag == "SynchronizeAction":
            return values | self._synchronize(kind, route, step.actor)
        if kind.tag not in ("LongitudinalAction", "LateralAction", "RoutingAction"):
            next(iter(kind), kind).refuse()
        action = next(iter(kind))
        if action.tag == "LongitudinalDistanceAction":
            return values | self._keep_distance(action)
        if action.tag == "FollowTrajectoryAction":
            return values | self._trajectory(action, self._entities[step.actor], route)
        if action.tag in ROUTES:
            lane = self._on_map.driving_lane(self._pose(step.actor, route))
            if not lane:
                action.fail("the entity does not start in a driving lane")
            words = words_of([lane, *self._waypoints(action)])
            self._on_map.along(words, action)
            return values | {"event": "follow_path", "along": words}
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
        elif shape != "step" and shape in MEANS and dimension == "rate":
            values["acceleration"] = MEANS[shape] * abs(dynamics.number("value"))
        elif shape != "step":
            dynamics.fail(f"{shape} over {dimension} is not read: time or rate")
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
            return values | self._relative_lane(target, actor, route)
        spot = self._spot(actor, route)
        if math.isnan(spot.offset):
            target.fail("the entity is on no road")
        track = self._track(spot, target, route)
        road, s, _ = road_at(track, spot.station)
        lane = self._on_map.lane(target, road, s, round(target.number("value")))
        place = self._on_map.at(road, s, self._on_map.frames[road].center_at(lane, s))
        at, offset = track.locate(place.x, place.y, spot.station)
        if (found := track.lane_at(at, offset)) < 0:
            # A lane of the other direction: as far beside its own one.
            own = float(track.lane_offset(track.lane_at(spot.station, spot.offset), spot.station))
            return values | {"event": "swerve", "offset": offset - own, "back": False}
        return values | {"lane": found}

    def _relative_lane(self, target: Node, actor: str, route: Route) -> Values:
        """The target of a lane change relative to a road user.

        Beyond the lanes of its own direction it is a distance to the center of the next lanes.
        """
        count = round(target.number("value"))
        values: Values = {"to": self._body(target), "relative_lane": count}
        spot = self._spot(actor, route)
        if values["to"] != actor or math.isnan(spot.offset):
            return values
        track = self._track(spot, target, route)
        lane = track.lane_at(spot.station, spot.offset)
        if lane < 0 or track.lane_exists(lane + count, spot.station):
            return values
        road, s, direction = road_at(track, spot.station)
        frame = self._on_map.frames[road]
        centers = sorted(direction * 0.5 * (low + high) for _, low, high in frame.lanes(s))
        point = track.evaluate(spot.station, spot.offset)
        own = frame.locate(float(point.x), float(point.y), s)[1]
        index = min(range(len(centers)), key=lambda k: abs(centers[k] - direction * own)) + count
        if not 0 <= index < len(centers):
            target.fail(f"there is no lane {count:+d} beside that of {actor}")
        return {
            "event": "swerve",
            "offset": centers[index] - centers[index - count],
            "back": False,
        }

    def _synchronize(self, action: Node, route: Route, actor: str) -> Values:
        master = self._reference(action, "masterEntityRef")
        stations = {}
        for key, name, child in (
            ("station", actor, "TargetPosition"),
            ("to_station", master, "TargetPositionMaster"),
        ):
            spot = self._spot(name, route)
            if math.isnan(spot.offset):
                action.fail(f"{name} is on no road")
            track = self._track(spot, action, route)
            at = self._station(next(iter(action.child(child))), route, track)
            stations[key] = at + self._entities[name].front
        values: Values = {
            "event": "synchronize",
            "to": TRUCK if master == self.ego else master,
            **stations,
        }
        tolerances = {"targetTolerance": "tolerance", "targetToleranceMaster": "to_tolerance"}
        for name, field in tolerances.items():
            if action.has(name):
                values[field] = action.number(name)
        final = action.find("FinalSpeed")
        if final is not None:
            speed = next(iter(final.only("AbsoluteSpeed", "RelativeSpeedToMaster")))
            if any(True for _ in speed):
                next(iter(speed)).refuse()
            relative = speed.tag == "RelativeSpeedToMaster"
            if relative and speed.get("speedTargetValueType") != "delta":
                speed.fail("speedTargetValueType is not read: delta")
            values["speed_difference" if relative else "speed"] = speed.number("value")
        return values

    def _keep_distance(self, action: Node) -> Values:
        if action.get("displacement", "trailingReferencedEntity") != "trailingReferencedEntity":
            action.fail("displacement is not read: trailingReferencedEntity")
        timed = action.has("timeGap")
        values: Values = {
            "event": "keep_distance",
            "to": self._body(action),
            "time_gap" if timed else "gap": action.number("timeGap" if timed else "distance"),
            "freespace": action.get("freespace") == "true",
            "continuous": action.get("continuous") == "true",
        }
        limits = action.find("DynamicConstraints")
        names = {
            "maxAcceleration": "acceleration",
            "maxDeceleration": "deceleration",
            "maxSpeed": "fastest",
        }
        for name, field in names.items():
            if limits is not None and limits.has(name):
                values[field] = limits.number(name)
        return values

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
        references = {
            "ParameterCondition": "parameterRef",
            "VariableCondition": "variableRef",
            "TrafficSignalCondition": "name",
        }
        if node.tag in references:
            name = node.get(references[node.tag])
            if node.tag == "TrafficSignalCondition":
                return [[base | {"variable": f"{SIGNAL}{name}", "text": node.get("state")}]]
            self._declare(node, name)
            if isinstance(node.value("value"), str):
                if node.get("rule") != "equalTo":
                    node.fail("a text is compared with the rule equalTo")
                return [[base | {"variable": name, "text": node.get("value")}]]
            return [[base | {"variable": name} | _limit(node)]]
        if node.tag != "StoryboardElementStateCondition":
            node.refuse()
        if self._is_replaced(node):
            return []
        state, kind = node.get("state"), node.get("storyboardElementType")
        if state not in STATES:
            node.fail(f"state {state!r} is not read: {', '.join(STATES)}")
        reached, name = STATES[state], node.get("storyboardElementRef").rpartition("::")[2]
        found = self._elements.get((kind, name))
        if (kind, reached) == ("act", "begun"):
            found = self._elements.get(("act start", name))
        if not found:
            node.fail(f"there is no {kind} {name!r} with events of the traffic")
        # Elements of the same maneuver are meant before others of the same name.
        found = [each for each in found if self._families.get(each) == self._family] or found
        if len(found) > 1:
            base = base | {"edge": "none"}
        made = [base | {"event": each, "state": reached} for each in found]
        return [made] if reached == "ended" else [[each] for each in made]

    def _is_replaced(self, node: Node) -> bool:
        """Whether a condition waits for an event of the ego, which its own driver replaces."""
        kind, name = node.get("storyboardElementType"), node.get("storyboardElementRef")
        key = kind, name.rpartition("::")[2]
        return self._elements.get(key) == []

    def _declare(self, node: Node, name: str) -> None:
        """Lets a parameter or a variable begin with its declared value."""
        if name not in self._declared:
            node.fail(f"{name} is not declared{did_you_mean(name, self._declared)}")
        self._variables[name] = self._declared[name]

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
            spot = self._spot(name, route)
            if spot.along is not None or math.isnan(spot.offset):
                node.fail("the traveled distance of an entity off the truck's route is not read")
            front = spot.station + self._entities[name].front
            return {"measure": "station", "of": of, "above": front + node.number("value")}
        if tag == "StandStillCondition":
            return {"measure": "speed", "of": of, "below": REST, "lasting": node.number("duration")}
        if tag in ("ReachPositionCondition", "DistanceCondition"):
            return self._by_position(node, of, route)
        values: Values = {"of": of, "freespace": node.get("freespace") == "true"}
        kind = node.get("relativeDistanceType", "longitudinal")
        if tag == "RelativeDistanceCondition" and kind in PLANE:
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

    def _by_position(self, node: Node, of: str, route: Route) -> Values:
        """A condition on the distance of an entity to a position."""
        position = next(iter(node.child("Position")))
        front = self._entities[self.ego if of == TRUCK else of].front
        kind = node.get("relativeDistanceType", "euclidianDistance")
        if node.tag == "ReachPositionCondition" or kind in PLANE:
            if node.get("freespace", "false") == "true":
                node.fail("freespace to a position is not read")
            pose = self._on_map.pose(position)
            limits = (
                {"below": node.number("tolerance")}
                if node.tag == "ReachPositionCondition"
                else _limit(node)
            )
            point = (pose.x, pose.y)
            return {"measure": "distance", "of": of, "point": point, "back": front, **limits}
        if kind != "longitudinal" or node.get("freespace", "false") == "true":
            node.fail(f"relativeDistanceType {kind!r}, or freespace, to a position is not read")
        limit = _limit(node)
        if "below" not in limit:
            node.fail("rule must be lessThan or lessOrEqual")
        at = self._station(position, route, route) + front
        bounds = {"above": at - limit["below"], "below": at + limit["below"]}
        return {"measure": "station", "of": of, **bounds}


def _polyline(action: Node, catalogs: Catalogs) -> Iterator[Node]:
    """The vertices of the trajectory of a FollowTrajectoryAction."""
    reference = action.find("TrajectoryRef")
    holder = action if reference is None else reference
    found = holder.find("Trajectory") or holder.find("CatalogReference")
    if found is None:
        action.fail("has no Trajectory")
    trajectory = catalogs.resolve(found)
    if trajectory.get("closed", "false") == "true":
        trajectory.fail("closed trajectories are not read")
    shape = next(iter(trajectory.child("Shape")))
    if shape.tag != "Polyline":
        shape.refuse()
    yield from shape.only("Vertex")


def _times(action: Node, vertices: Sequence[Node], at_start: bool) -> list[float] | None:
    """Times of the vertices since the beginning of the event [s]; None: it has none."""
    reference = action.find("TimeReference")
    timing = None if reference is None else next(iter(reference), None)
    if timing is None or timing.tag == "None":
        return None
    if timing.get("domainAbsoluteRelative") != "relative" and not at_start:
        timing.fail("absolute times are read in Init only: relative")
    scale, offset = timing.number("scale"), timing.number("offset")
    return [scale * each.number("time") + offset for each in vertices]


def _points(points: Sequence[tuple[float, float, float]]) -> list[list[float]]:
    """Points to the millimeter, without those that a straight piece between others has."""
    table = np.round(np.array(points), 3)
    return table.tolist()


def _on(track: Route, pose: Pose, facing: bool = True) -> _Spot | None:
    """Where a pose is on a road; None if it is not on it, or faces against it."""
    station, offset = track.locate(pose.x, pose.y)
    point = track.evaluate(station, offset)
    away = math.hypot(float(point.x) - pose.x, float(point.y) - pose.y)
    right, left = (float(edge) for edge in track.surface_edges(station))
    inside = 0.0 <= station <= track.length and right - SAME <= offset <= left + SAME
    against = abs(wrap_angle(pose.heading - float(point.heading))) > 0.5 * math.pi
    if away > 1.0 or not inside or (facing and against):
        return None
    return _Spot(station, offset)


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
