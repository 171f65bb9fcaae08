"""Positions, routes and trajectories of OpenSCENARIO files on the roads of a map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, MapError
from iits_mj.road import RoadMap, Route
from iits_mj.road.geometry import Spiral
from iits_mj.road.road_frames import RoadFrames
from traffic_bridge.scenario.openscenario_file import Catalogs, Node

NEAR = 1.0  # [m]: a position that is farther from a road is not on it
CURVE_STEP = 1.0  # [m] between places of a curve
SPACING = 2.0  # [m] between the points of a way along a lane
FLAT = 0.01  # [m]: points that are so near to a straight piece are left out
STRAIGHT_ON = 100.0  # [m] that a road user can go who faces across its road
LANEWISE = 0.7  # cosine of the angle to the road of one who goes along it

Point = tuple[float, float, float]


class Pose(NamedTuple):
    """A place on the map: x, y, z [m], heading [rad]; road, s and t [m], "" where no road is."""

    x: float
    y: float
    z: float
    heading: float
    road: str = ""
    s: float = 0.0
    t: float = 0.0

    def ahead(self, way: float) -> Pose:
        """Returns the place straight ahead by a way [m]."""
        x = self.x + way * math.cos(self.heading)
        return self._replace(x=x, y=self.y + way * math.sin(self.heading))


class Places:
    """The positions of a file on a map.

    Args:
      road_map: the map.
      catalogs: of the file.
    """

    def __init__(self, road_map: RoadMap, catalogs: Catalogs) -> None:
        self.frames = RoadFrames(road_map)
        self._map, self._catalogs = road_map, catalogs
        self._routes: dict[str, Route] = {}

    def along(self, words: str, node: Node) -> Route:
        """Returns the road in the words of `route_choice`; errors name the node."""
        if words not in self._routes:
            try:
                self._routes[words] = self._map.route(along=words)
            except (InputError, MapError) as error:
                node.fail(str(error))
        return self._routes[words]

    def pose(self, node: Node) -> Pose:
        """Returns the place of a position that does not depend on a road user.

        It faces along its lane, unless it has an orientation.
        """
        if node.tag == "WorldPosition":
            x, y = node.number("x"), node.number("y")
            return self.under(x, y, node.number("h", 0.0), node)
        if node.tag == "RoutePosition":
            return self._on_route(node)
        if node.tag not in ("LanePosition", "RoadPosition"):
            node.refuse()
        road, s = node.get("roadId"), node.number("s")
        if road not in self._map.roads:
            node.fail(f"the map has no road {road!r}")
        frame = self.frames[road]
        if not 0.0 <= s <= frame.length:
            node.fail(f"s = {s:g} m: road {road!r} has 0 to {frame.length:.1f} m")
        sense = 1
        if node.tag == "RoadPosition":
            t = node.number("t")
        else:
            lane = self.lane(node, road, s, round(node.number("laneId")))
            sense = frame.road.travel(lane)
            t = frame.center_at(lane, s) + node.number("offset", 0.0)
        return turned(self.at(road, s, t, sense), node)

    def at(self, road: str, s: float, t: float, sense: int = 1) -> Pose:
        """Returns the place at (s, t) of a road [m], facing along s or, with -1, against it."""
        point = self.frames[road].surface(np.array([s]), np.array([t]))
        heading = float(point.heading[0]) + (math.pi if sense < 0 else 0.0)
        x, y, z = float(point.x[0]), float(point.y[0]), float(point.z[0])
        return Pose(x, y, z, wrap_angle(heading), road, s, t)

    def lane(self, node: Node, road: str, s: float, lane: int) -> int:
        """Returns a lane; errors name the node if the road does not have it."""
        if not self.frames[road].kind(s, lane):
            node.fail(f"road {road!r} has no lane {lane} at s = {s:g} m")
        return lane

    def driving_lane(self, pose: Pose) -> str:
        """Returns the driving lane that leads where a pose faces, as ROAD_LANE; "": none there."""
        if not pose.road:
            return ""
        frame = self.frames[pose.road]
        section = frame.road.sections[frame.section(pose.s)]
        found = [
            (max(low - pose.t, pose.t - high, 0.0), lane)
            for lane, low, high in frame.lanes(pose.s)
            if (record := section.lane(lane)) is not None and record.is_driving
        ]
        outside, lane = min(found, default=(math.inf, 0))
        if outside > NEAR:
            return ""
        along = self.at(pose.road, pose.s, pose.t, frame.road.travel(lane)).heading
        return f"{pose.road}_{lane}" if math.cos(pose.heading - along) > 0.0 else ""

    def waypoints(self, route: Node) -> list[Node]:
        """Returns the positions of the waypoints of a route, or of the catalog's one."""
        found = self._catalogs.resolve(route)
        if found.tag != "Route" or found.flag("closed"):
            found.fail("is no open route")
        points = list(found.only("ParameterDeclarations", "Waypoint"))
        return [p.child("Position").first() for p in points if p.tag == "Waypoint"]

    def curve(self, shape: Node) -> tuple[list[Pose], list[float] | None]:
        """Returns places on the shape of a trajectory, and their times [s] if all have one.

        Those of a clothoid or of NURBS are `CURVE_STEP` or less apart.
        """
        nodes = list(shape.all("Position"))
        if shape.tag == "Polyline":
            holders = list(shape.only("Vertex"))
            # Only the last one needs its road.
            poses = [self._vertex(each.first(), each is nodes[-1]) for each in nodes]
            timed = all(each.has("time") for each in holders)
            return poses, [each.number("time") for each in holders] if timed else None
        first = self.pose(nodes[0].first()) if nodes else shape.fail("has no Position")
        if shape.tag == "Clothoid":
            table = _clothoid(shape, first)
        elif shape.tag == "Nurbs":
            holders = list(shape.only("ControlPoint", "Knot"))
            controls = [each for each in holders if each.tag == "ControlPoint"]
            knots = [each.number("value") for each in holders if each.tag == "Knot"]
            rows = []
            for node, holder in zip(nodes, controls, strict=True):
                pose = self._vertex(node.first(), False)
                time = holder.number("time") if holder.has("time") else math.nan
                rows.append((pose.x, pose.y, time, holder.number("weight", 1.0, low=1e-6)))
            table = _nurbs(shape, np.array(rows), np.array(knots))
        else:
            shape.refuse()
        turns = np.unwrap(np.arctan2(np.gradient(table[:, 1]), np.gradient(table[:, 0])))
        poses = [
            self.under(x, y, turn, nodes[-1].first())
            for (x, y, _), turn in zip(table.tolist(), turns.tolist(), strict=True)
        ]
        times = table[:, 2]
        return poses, None if np.isnan(times).any() else times.tolist()

    def _vertex(self, node: Node, last: bool) -> Pose:
        if node.tag == "WorldPosition" and node.has("z") and not last:
            x, y, z = (node.number(axis) for axis in "xyz")
            return Pose(x, y, z, node.number("h", 0.0))
        return self.pose(node)

    def lane_name(self, position: Node) -> str:
        """Returns the driving lane of a position, as ROAD_LANE."""
        name = self.driving_lane(self.pose(position))
        if not name:
            position.fail("the position is on no driving lane")
        return name

    def way_on(self, pose: Pose, heading: float) -> list[Point]:
        """Returns points on the way on from a pose: beside the road to its end, or straight on.

        Args:
          pose: the beginning, which is not among the points.
          heading: of the road user there [rad].
        """
        straight = pose._replace(heading=heading).ahead(STRAIGHT_ON)
        if not pose.road:
            return [straight[:3]]
        frame = self.frames[pose.road]
        start = min(max(frame.locate(pose.x, pose.y)[0], 0.0), frame.length)
        forward = math.cos(heading - self.at(pose.road, start, pose.t).heading)
        end = frame.length if forward > 0.0 else 0.0
        count = math.ceil(abs(end - start) / SPACING)
        if abs(forward) < LANEWISE or not count:
            return [straight[:3]]
        lanes = [lane for lane, low, high in frame.lanes(start) if low <= pose.t <= high]
        points = []
        for s in np.linspace(start, end, count + 1)[1:].tolist():
            t = pose.t
            if lanes and frame.kind(s, lanes[0]):
                t += frame.center_at(lanes[0], s) - frame.center_at(lanes[0], start)
            points.append(self.at(pose.road, s, t)[:3])
        return thinned(points)

    def _on_route(self, node: Node) -> Pose:
        """The place of a RoutePosition."""
        points = self.waypoints(node.child("RouteRef").first())
        first = self.pose(points[0])
        holder = node.child("InRoutePosition")
        place = holder.first("FromLaneCoordinates", "FromRoadCoordinates")
        route = self.along(words_of([self.lane_name(each) for each in points]), node)
        station = route.locate(first.x, first.y)[0] + place.number("pathS", low=0.0)
        if station > route.length:
            place.fail(f"pathS ends behind the route of {route.length:.1f} m")
        road, s, direction = road_at(route, station)
        if place.tag == "FromRoadCoordinates":
            pose = self.at(road, s, place.number("t"), direction)
        else:
            lane = self.lane(place, road, s, round(place.number("laneId")))
            t = self.frames[road].center_at(lane, s) + place.number("laneOffset", 0.0)
            pose = self.at(road, s, t, direction)
        return turned(pose, node)

    def under(self, x: float, y: float, heading: float, node: Node) -> Pose:
        """Returns the place of a point, on the road whose direction is nearest to the heading."""
        best, found = math.inf, Pose(x, y, node.number("z", 0.0), heading)
        for road in self._map.roads:
            s, t = self.frames[road].locate(x, y)
            if not 0.0 <= s <= self.frames[road].length:
                continue
            spans = [(low, high) for _, low, high in self.frames[road].lanes(s)]
            place = self.at(road, s, t)
            outside = min((max(low - t, t - high, 0.0) for low, high in spans), default=math.inf)
            if outside > NEAR or math.hypot(place.x - x, place.y - y) > 0.1:
                continue
            turn = outside + abs(math.sin(heading - place.heading))
            if turn < best - 1e-6:
                best, found = turn, place._replace(heading=heading)
        return found


def shape_of(action: Node, catalogs: Catalogs) -> Node:
    """Returns the shape of the trajectory of a FollowTrajectoryAction."""
    reference = action.find("TrajectoryRef")
    holder = action if reference is None else reference
    found = holder.find("Trajectory") or holder.find("CatalogReference")
    if found is None:
        action.fail("has no Trajectory")
    trajectory = catalogs.resolve(found)
    if trajectory.flag("closed"):
        trajectory.fail("closed trajectories are not read")
    return trajectory.child("Shape").first()


def _clothoid(shape: Node, start: Pose) -> FloatArray:
    """Rows of x, y [m] and time [s], NaN without one, on a curve of linear curvature."""
    length = shape.number("length", low=CURVE_STEP, high=1e5)
    prime = "curvaturePrime" if shape.has("curvaturePrime") else "curvatureDot"
    bend, rate = shape.number("curvature"), shape.number(prime)
    way = np.linspace(0.0, length, math.ceil(length / CURVE_STEP) + 1)
    curve = Spiral(0.0, start.x, start.y, start.heading, length, bend, bend + rate * length)
    point = curve.evaluate(way)
    timed = shape.has("startTime") and shape.has("stopTime")
    ends = [shape.number(name) if timed else math.nan for name in ("startTime", "stopTime")]
    times = np.linspace(ends[0], ends[1], len(way))
    return np.column_stack((point.x, point.y, times))


def _nurbs(shape: Node, controls: FloatArray, knots: FloatArray) -> FloatArray:
    """Rows of x, y [m] and time [s] on non-uniform rational B-splines.

    L. Piegl, W. Tiller, "The NURBS Book", 2nd ed., 1997, section 4.2: the spline of the weighted
    points over that of the weights.

    Args:
      shape: for messages, with its order.
      controls: x, y, time and weight of the points, shape (n, 4).
      knots: n + order numbers that do not fall.
    """
    from scipy.interpolate import BSpline

    order = round(shape.number("order", low=2.0, high=16.0))
    if len(controls) < order or len(knots) != len(controls) + order or (np.diff(knots) < 0.0).any():
        shape.fail(
            f"order {order}: {len(controls)} control points need {len(controls) + order} knots "
            f"that do not fall, and there are {len(knots)}"
        )
    weight = controls[:, 3:]
    spline = BSpline(knots, np.hstack((controls[:, :3] * weight, weight)), order - 1)
    way = float(np.hypot(*np.diff(controls[:, :2], axis=0).T).sum())
    count = max(math.ceil(way / CURVE_STEP), 2)
    found = spline(np.linspace(knots[order - 1], knots[-order], count + 1))
    table: FloatArray = found[:, :3] / found[:, 3:]
    return table


def turned(pose: Pose, node: Node) -> Pose:
    """Returns a pose with the orientation of its node."""
    turn = node.find("Orientation")
    if turn is None:
        return pose
    own = turn.number("h", 0.0)
    relative = turn.get("type", "absolute") == "relative"
    return pose._replace(heading=wrap_angle(own + (pose.heading if relative else 0.0)))


def words_of(lanes: Sequence[str]) -> str:
    """Returns the words of `route_choice` for a way over lanes ROAD_LANE."""
    names: list[str] = []
    for name in lanes:
        if not names or names[-1].rpartition("_")[0] != name.rpartition("_")[0]:
            names.append(name)
    return f"turns:{names[0]}" if len(names) == 1 else f"roads:{','.join(names)}"


def road_at(route: Route, station: float) -> tuple[str, float, int]:
    """Returns road, s [m] and direction of travel at a station of a route."""
    segment = max(
        (each for each in route.segments if each.station_start <= station),
        key=lambda each: each.station_start,
        default=route.segments[0],
    )
    s = segment.s_start + segment.direction * (station - segment.station_start)
    return segment.road_id, s, segment.direction


def thinned(points: Sequence[Point]) -> list[Point]:
    """Returns points without those that are nearly on the straight pieces between the others."""
    kept = list(points[:1])
    table = np.array(points)
    first = 0
    for last in range(2, len(points)):
        between, piece = table[first + 1 : last] - table[first], table[last] - table[first]
        along = np.clip(between @ piece / max(float(piece @ piece), 1e-12), 0.0, 1.0)
        if np.linalg.norm(between - along[:, None] * piece, axis=1).max() > FLAT:
            first = last - 1
            kept.append(points[first])
    return [*kept, *points[-1:]] if len(points) > 1 else kept
