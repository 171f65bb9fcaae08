"""The entities of OpenSCENARIO files: types, sizes, and their starts on the roads of a map."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any, NamedTuple

from iits_mj.core.angles import wrap_angle
from iits_mj.core.checks import did_you_mean
from iits_mj.road import RoadMap, Route
from traffic_bridge.scenario.actions import SHAPES
from traffic_bridge.scenario.conditions import ROLES, TRUCK
from traffic_bridge.scenario.openscenario_file import Catalogs, Node
from traffic_bridge.scenario.openscenario_places import (
    Places,
    Pose,
    road_at,
    shape_of,
    turned,
    words_of,
)

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
AHEAD = "leadingReferencedEntity"
ALONG_ROAD = ("RelativeRoadPosition", "RelativeLanePosition")
BESIDE = ("RelativeObjectPosition", "RelativeWorldPosition")
# Private actions that are accepted and ignored: visibility, controllers, lamps and doors.
UNUSED = ("VisibilityAction", "ControllerAction", "ActivateControllerAction", "AppearanceAction")
# Name of the controller of a vehicle that the Intelligent Driver Model drives.
MODEL = "IntelligentDriverModel"
ROUTES = ("AssignRouteAction", "AcquirePositionAction")
VALUE_TYPE = "speedTargetValueType", "delta"
# [m]: the greatest length of a rigid truck, Council Directive 96/53/EC, annex I; a longer one, or a
# longer combination with a truck, has the body of an articulated truck.
ARTICULATED = 12.0
TRAILERS_MAX = 10
SAME = 1e-3  # [m], [s]

Values = dict[str, Any]


class Entity(NamedTuple):
    """A road user: type, size with its trailers, and from its reference point to its front [m].

    A `reactive` one has the controller `MODEL`.
    """

    node: Node
    type: str
    size: Values
    front: float
    reactive: bool = False

    @property
    def center(self) -> float:
        """From its reference point to the center of its box [m]."""
        return self.front - 0.5 * float(self.size["length"])

    @property
    def walks(self) -> bool:
        """Whether it is no vehicle."""
        return self.type in ("pedestrian", "obstacle")


class Spot(NamedTuple):
    """Station and offset of a reference point [m] on a road, the truck's or in words `along`."""

    station: float
    offset: float
    along: str | None = None


class Entities:
    """The entities of a file, on the map of the truck's route.

    Args:
      root: of the file.
      init: actions of its start.
      ego: name of the entity that is the truck; None: the first one named Ego or Hero.
      map_path: OpenDRIVE file.

    Attributes:
      members: by name; ego: name of the truck; towed: names of trailers of others.
      starts, speeds, distances, routes, trajectories: elements of the start, by name.
      catalogs: of the file.
      unused: what has no effect here, in words.
    """

    def __init__(self, root: Node, init: Node, ego: str | None, map_path: Path) -> None:
        self.catalogs, self._map = Catalogs(root), map_path
        self._route: Route | None = None
        self._places: Places | None = None
        self._known: dict[str, Spot] = {}
        self._asked: set[str] = set()  # whose pose is being found
        self.starts: dict[str, Node] = {}
        self.routes: dict[str, Node] = {}
        self.trajectories: dict[str, Node] = {}
        self.speeds: dict[str, Node] = {}
        self.distances: dict[str, Node] = {}
        self.towed: set[str] = set()
        self.unused: dict[str, None] = {}
        group = root.child("Entities").only("ScenarioObject", "EntitySelection")
        objects = [each for each in group if each.tag == "ScenarioObject"]
        self.members = {each.get("name"): self._entity(each) for each in objects}
        self._selections = {
            each.get("name"): [self.reference(m) for m in each.child("Members").only("EntityRef")]
            for each in group
            if each.tag == "EntitySelection"
        }
        for name in list(self.members):
            self.members[name] = self._with_trailers(name)
        self.ego = self._ego(group, ego)
        gone: list[str] = []
        for node in init:
            if node.tag == "Private":
                self._read_private(node)
            elif (action := node.find("EntityAction")) is not None:
                if action.find("AddEntityAction") is not None:
                    self.add(action)
                else:
                    gone.append(self.reference(action))
        for name in gone:
            self.starts.pop(name, None)
            self.trajectories.pop(name, None)

    def use(self, route: Route) -> None:
        """Takes the truck's route, and its map."""
        if self._route is not route:
            self._route, self._known = route, {}
            self._places = Places(route.road_map, self.catalogs)

    @property
    def route(self) -> Route:
        """The truck's route."""
        assert self._route is not None
        return self._route

    @property
    def places(self) -> Places:
        """The positions on the map, that of the file unless a route with another one is in use."""
        if self._places is None:
            self._places = Places(RoadMap.from_opendrive(self._map), self.catalogs)
        return self._places

    @functools.cached_property
    def ego_words(self) -> str:
        """The road of the ego in the words of `route_choice`.

        Raises:
          InputError, MapError: the map of the file cannot be used, or the ego is on none of its
            driving lanes.
        """
        node = self.start(self.ego)
        if node.tag == "LanePosition" and self.ego not in self.routes:
            return words_of([f"{node.get('roadId')}_{node.get('laneId')}"])
        place = node
        while place.tag in (*ALONG_ROAD, *BESIDE) and len(self._asked) <= len(self.members):
            self._asked.add(self.reference(place))
            place = self.start(self.reference(place))  # on the same road
        self._asked.clear()
        lane = self.places.driving_lane(self.turn_along(self.ego, self.places.pose(place)))
        if not lane:
            node.fail("the ego is on no driving lane that leads where it faces")
        return self.words(self.ego, lane)

    def front(self, name: str) -> float:
        """Returns the distance from the reference point of an entity, or TRUCK, to its front."""
        return self.members[self.ego if name == TRUCK else name].front

    def _entity(self, node: Node) -> Entity:
        node.only("CatalogReference", "Vehicle", "Pedestrian", "MiscObject", "ObjectController")
        if node.get("name") in (TRUCK, *ROLES):
            node.fail(f"the name {node.get('name')!r} has another meaning: rename the entity")
        body = self.catalogs.resolve(node.first())
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
        if body.tag == "Vehicle" and category == "truck" and size["length"] > ARTICULATED:
            kind = "articulated"  # no rigid one is so long
        own = node.find("ObjectController")
        controllers = [] if own is None else [each.get("name", "") for each in own]
        return Entity(node, kind, size, front, MODEL in controllers)

    def _with_trailers(self, name: str) -> Entity:
        """An entity with the length of its whole combination."""
        entity = self.members[name]
        body = self.catalogs.resolve(entity.node.first())
        place, rear, towed = 0.0, entity.front - float(entity.size["length"]), 0
        while (trailer := self._trailer(body)) is not None:
            if towed == TRAILERS_MAX:
                body.fail(f"tows more than {TRAILERS_MAX} trailers, or itself")
            coupler = trailer.child("TrailerCoupler").number("dx")
            place += body.child("TrailerHitch").number("dx") - coupler
            box = trailer.child("BoundingBox")
            half = 0.5 * box.child("Dimensions").number("length", low=0.1)
            rear, towed = min(place + box.child("Center").number("x") - half, rear), towed + 1
            body = trailer
        if not towed:
            return entity
        length = entity.front - rear
        kind = "articulated" if entity.type == "truck" and length > ARTICULATED else entity.type
        return entity._replace(type=kind, size=entity.size | {"length": length})

    def _trailer(self, body: Node) -> Node | None:
        """The vehicle that another one tows, None if it tows none."""
        found = body.find("Trailer")
        each = None if found is None else next(iter(found), None)
        if each is None:
            return None
        if each.tag == "Trailer":
            return self.catalogs.resolve(each.first())
        name = each.get("entityRef")
        if not name:
            return None
        self.towed.add(self.reference(each))
        return self.catalogs.resolve(self.members[name].node.first())

    def _ego(self, objects: Node, wanted: str | None) -> str:
        if wanted is not None:
            if wanted not in self.members:
                objects.fail(
                    f"there is no entity {wanted!r}{did_you_mean(wanted, self.members)}; there "
                    f"are {', '.join(self.members)}"
                )
            return wanted
        for name in self.members:
            if name.lower() in EGOS:
                return name
        names = ", ".join(self.members)
        return objects.fail(f"no entity is named Ego or Hero; choose one of {names}")

    def _read_private(self, private: Node) -> None:
        for name in self.several(private):
            self._read_start(private, name)

    def _read_start(self, private: Node, name: str) -> None:
        for action in private.only("PrivateAction"):
            kind = action.first()
            if kind.tag == "TeleportAction":
                self.starts[name] = kind.child("Position").first()
            elif kind.tag == "LongitudinalAction" and kind.find("SpeedAction") is not None:
                self.speeds[name] = kind.child("SpeedAction")
                dynamics = self.speeds[name].find("SpeedActionDynamics") or action
                if (shape := dynamics.get("dynamicsShape", "step")) not in (*SHAPES, "step"):
                    dynamics.fail(f"dynamicsShape {shape!r}: allowed are {', '.join(SHAPES)}, step")
            elif kind.tag == "LongitudinalAction":
                self.distances[name] = kind.child("LongitudinalDistanceAction")
            elif kind.tag == "RoutingAction":
                routing = kind.first("FollowTrajectoryAction", *ROUTES)
                found = self.routes if routing.tag in ROUTES else self.trajectories
                found[name] = routing
            elif kind.tag in UNUSED:
                self.not_used(kind, name)
            else:
                next(iter(kind), kind).refuse()

    def add(self, node: Node) -> str:
        """Takes the start of an entity from the EntityAction that adds it; returns its name."""
        name = self.reference(node)
        if name == self.ego or name in self.starts:
            node.fail(f"{name} is there from the beginning, or added twice")
        self.starts[name] = node.child("AddEntityAction", "Position").first()
        return name

    def starts_with(self, action: Node, name: str) -> bool:
        """Takes the speed that an action gives at once to an entity that its event adds."""
        speed = next(action.all("SpeedAction"), None)
        if speed is None or speed.child("SpeedActionDynamics").get("dynamicsShape") != "step":
            return False
        self.speeds[name] = speed
        return True

    def reference(self, node: Node, attribute: str = "entityRef") -> str:
        """Returns the entity to which a node refers."""
        name = node.get(attribute)
        if name not in self.members:
            node.fail(f"there is no entity {name!r}{did_you_mean(name, self.members)}")
        return name

    def several(self, node: Node) -> list[str]:
        """Returns the entities to which a node refers: one, or those of a selection."""
        return self._selections.get(node.get("entityRef")) or [self.reference(node)]

    def not_used(self, kind: Node, name: str) -> None:
        """Notes an action of an entity that has no effect here; the ego has its own driver."""
        if name != self.ego:
            self.unused[f"{kind.tag} of {name}"] = None

    def body(self, node: Node, attribute: str = "entityRef") -> str:
        """Returns the name by which events know an entity."""
        name = self.reference(node, attribute)
        return TRUCK if name == self.ego else name

    @property
    def lost(self) -> list[str]:
        """The entities of which the file says no place, and that are no trailers nor the ego."""
        there = {*self.starts, *self.trajectories, *self.towed, self.ego}
        return [name for name in self.members if name not in there]

    def start(self, name: str) -> Node:
        """Returns the position at which an entity starts."""
        if name in self.starts:
            return self.starts[name]
        if name in self.trajectories:
            shape = shape_of(self.trajectories[name], self.catalogs)
            return next(shape.all("Position")).first()
        return self.members[name].node.fail("has no TeleportAction in Init")

    def words(self, name: str, lane: str) -> str:
        """Returns the road of an entity that starts in a lane, in the words of `route_choice`."""
        routing = self.routes.get(name)
        return words_of([lane] if routing is None else [lane, *self.waypoints(routing)])

    def waypoints(self, routing: Node) -> list[str]:
        """Returns the lanes over which an action leads, as ROAD_LANE."""
        if routing.tag == "AcquirePositionAction":
            points = [routing.child("Position").first()]
        else:
            points = self.places.waypoints(routing.first())
        return [self.places.lane_name(each) for each in points]

    def turn_along(self, name: str, pose: Pose) -> Pose:
        """Returns a pose with the heading of the trajectory that begins there, if there is one."""
        if name in self.starts or name not in self.trajectories:
            return pose
        ends = self.places.curve(shape_of(self.trajectories[name], self.catalogs))[0][:2]
        return pose._replace(heading=math.atan2(ends[1].y - ends[0].y, ends[1].x - ends[0].x))

    def pose(self, name: str) -> Pose:
        """Returns where the reference point of an entity is at the start, and where it faces."""
        node = self.start(name)
        if node.tag in ALONG_ROAD:
            return self._relative_pose(node)
        if node.tag in BESIDE:
            return self._pose_beside(name, node)
        return self.turn_along(name, self.places.pose(node))

    def _pose_beside(self, name: str, node: Node) -> Pose:
        """The pose of a position relative to an entity, along that one's axes or the map's."""
        if name in self._asked:
            node.fail("the position refers to itself")
        self._asked.add(name)
        other = self.pose(self.reference(node))
        self._asked.discard(name)
        turn = other.heading if node.tag == "RelativeObjectPosition" else 0.0
        dx, dy = node.number("dx"), node.number("dy")
        x = other.x + dx * math.cos(turn) - dy * math.sin(turn)
        y = other.y + dx * math.sin(turn) + dy * math.cos(turn)
        return turned(self.places.under(x, y, other.heading, node), node)

    def _relative_pose(self, node: Node) -> Pose:
        """The pose of a position relative to an entity, along that one's road or turned."""
        spot = self.relative(node)
        track = self.track(spot, node)
        road, s, direction = road_at(track, spot.station)
        point = track.evaluate(spot.station, spot.offset)
        _, t = self.places.frames[road].locate(float(point.x), float(point.y), s)
        return turned(self.places.at(road, s, t, direction), node)

    def track(self, spot: Spot, node: Node) -> Route:
        """Returns the road on which a spot is."""
        return self.route if spot.along is None else self.places.along(spot.along, node)

    def spot(self, name: str) -> Spot:
        """Returns where the reference point of an entity is at the start, on its own road.

        The offset is NaN where it is on no road that leads where it faces.
        """
        if name not in self._known:
            node = self.start(name)
            self._known[name] = Spot(math.nan, math.nan)  # marks a reference to itself
            spot = self._find_spot(name, node)
            self._known[name] = self._at_distance(name, spot)
        spot = self._known[name]
        if math.isnan(spot.station):
            self.start(name).fail("the position refers to itself")
        return spot

    def _at_distance(self, name: str, spot: Spot) -> Spot:
        """The place of an entity that starts at a distance to another one in its lane."""
        action = self.distances.get(name)
        if action is None:
            return spot
        other, reference = self.spot(self.reference(action)), self.reference(action)
        if math.isnan(spot.offset) or math.isnan(other.offset) or spot.along != other.along:
            action.fail(f"{name} and {reference} are not on the same road")
        behind = action.get("displacement", "trailingReferencedEntity") != AHEAD
        gap = (
            action.number("distance", low=0.0)
            if action.has("distance")
            else action.number("timeGap", low=0.0) * self.speed(name if behind else reference)
        )
        own, its = self.members[name], self.members[reference]
        if action.flag("freespace"):
            length = float(own.size["length"]), float(its.size["length"])
            reach = (
                its.front - length[1] - own.front if behind else its.front - own.front + length[0]
            )
        else:
            reach = its.front - own.front
        return spot._replace(station=other.station + reach + (-gap if behind else gap))

    def _find_spot(self, name: str, node: Node) -> Spot:
        pose = self.pose(name)
        if node.tag in ALONG_ROAD:
            spot = self.relative(node)
            heading = float(self.track(spot, node).evaluate(spot.station).heading)
            if math.cos(pose.heading - heading) > 0.0:
                return spot
        found = self._spot_at(pose, node, name)
        if found is not None:
            return found
        if name == self.ego:
            node.fail("the position is not on the route of the truck, or faces against it")
        if name in self.routes and not self.members[name].walks:
            self.routes[name].fail("does not begin in the driving lane in which the entity starts")
        return Spot(0.0, math.nan)

    def spot_of(self, node: Node) -> Spot | None:
        """Returns the place of a position that depends on no entity; None if it is on no road."""
        return self._spot_at(self.places.pose(node), node)

    def _spot_at(self, pose: Pose, node: Node, name: str = "") -> Spot | None:
        """A pose on the truck's route, or on the own road of an entity that begins there."""
        found = None if name != self.ego and name in self.routes else on(self.route, pose)
        lane = self.places.driving_lane(pose)
        if found is not None or name == self.ego or not lane:
            return found
        words = self.words(name, lane)
        own = on(self.places.along(words, node), pose)
        return None if own is None else own._replace(along=words)

    def relative(self, node: Node) -> Spot:
        """Returns the place of a position relative to an entity."""
        other = self.spot(self.reference(node))
        if math.isnan(other.offset):
            node.fail("refers to an entity that is on no road")
        track = self.track(other, node)
        station = other.station + node.number("ds" if node.has("ds") else "dsLane")
        if not 0.0 <= station <= track.length:
            node.fail(f"the position is not on the road of the other one, of {track.length:.1f} m")
        if node.tag == "RelativeRoadPosition":
            return other._replace(station=station, offset=other.offset + node.number("dt"))
        lane = track.lane_at(other.station, other.offset) + round(node.number("dLane"))
        if not track.lane_exists(lane, station):
            node.fail("there is no such lane on the route")
        offset = float(track.lane_offset(lane, station)) + node.number("offset", 0.0)
        return other._replace(station=station, offset=offset)

    def station(self, node: Node, track: Route) -> float:
        """Returns the station of a position on a road, the truck's or another one [m]."""
        if node.tag in ALONG_ROAD:
            spot = self.relative(node)
            if self.track(spot, node) is track:
                return spot.station
        else:
            pose = self.places.pose(node)
            found = on(track, pose, facing=False)
            if found is not None:
                return found.station
        return node.fail("the position is not on the road of the entity")

    def speed(self, name: str, asked: tuple[str, ...] = ()) -> float:
        """Returns the speed at the start [m/s]; `asked` are entities whose speed depends on it."""
        action = self.speeds.get(name)
        if action is None:
            return 0.0
        if name in asked:
            action.fail("the speed refers to itself")
        target, field, value = speed_target(action)
        if field == "speed":
            return value
        other = self.speed(self.reference(target), (*asked, name))
        return other * value if field == "speed_factor" else other + value


def speed_target(action: Node) -> tuple[Node, str, float]:
    """Returns the target of a speed action, the field of a `ChangeSpeed` for it, and its value."""
    holder = action.child("SpeedActionTarget")
    target = holder.first("AbsoluteTargetSpeed", "RelativeTargetSpeed")
    field = "speed"
    if target.tag == "RelativeTargetSpeed":
        factor = target.get(*VALUE_TYPE) == "factor"
        field = "speed_factor" if factor else "speed_difference"
    return target, field, target.number("value")


def on(track: Route, pose: Pose, facing: bool = True) -> Spot | None:
    """Returns where a pose is on a road; None if it is not on it, or faces against it."""
    if pose.road and all(segment.road_id != pose.road for segment in track.segments):
        return None  # it is on another road, such as one on a bridge over this one
    station, offset = track.locate(pose.x, pose.y)
    point = track.evaluate(station, offset)
    away = math.hypot(float(point.x) - pose.x, float(point.y) - pose.y)
    right, left = (float(edge) for edge in track.surface_edges(station))
    inside = 0.0 <= station <= track.length and right - SAME <= offset <= left + SAME
    against = abs(wrap_angle(pose.heading - float(point.heading))) > 0.5 * math.pi
    if away > 1.0 or not inside or (facing and against):
        return None
    return Spot(station, offset)
