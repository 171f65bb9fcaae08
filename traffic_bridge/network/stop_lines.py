"""Where vehicles stop before a junction, and which turns are too tight for long vehicles.

A lane of SUMO ends at its junction, but drivers stop at the line or the light of the map before it,
and road authorities set lines back so that long vehicles can turn past the vehicles that wait. So
each lane stops at the farther of both: the map's own line or light, and the place at which a
standing vehicle clears an articulated truck of 16.5 m on any turn of the junction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.core.boxes import Boxes
from iits_mj.road.elements import STOP_LINE, Road
from traffic_bridge.mirror.articulation import Articulation
from traffic_bridge.network.net_file import NetConnection, NetFile, NetLane, distances_along
from traffic_bridge.vehicles.types import default_types

TURNS = "lrLR"  # SUMO's letters of turns
SPACING = 0.5  # [m] of the places along a turn
BEFORE, BEHIND = 30.0, 50.0  # [m] of a turn's way before and behind the junction
BEND = 3.0  # [m] over which the tightest bend is measured
TIGHTEST = 6.0  # [m], radius of the tightest turn that an articulated truck can drive
# The articulated truck: length and width, steer axle behind the front bumper, wheelbase, length of
# the semitrailer ahead of the kingpin [m] (a usual combination within 96/53/EC).
LENGTH, WIDTH, STEER_AXLE, WHEELBASE, NOSE = 16.5, 2.55, 1.4, 3.6, 1.6
TRACTOR_END = 6.0  # [m] of the tractor's rear behind its front bumper
CROSSES = 1.0  # [m] between the centers of lanes that cross or join
# A vehicle that waits: half of its length, width, and room to the truck [m].
HALF, WAITING_WIDTH, ROOM = 2.5, 2.1, 0.3
FARTHEST = 12.0  # [m] of a line before the junction
SHARE = 0.4  # of a lane's length, the most that lies behind its line
NEAR = 20.0  # [m] before the junction in which lines and lights of the map belong to it
VEHICLE_LIGHTS = ("1000001", "1000009", "1000010", "1000011")  # lights with lamps for vehicles


def stop_offsets(net: NetFile, roads: Mapping[str, Road]) -> dict[str, float]:
    """Distances of the stop lines before the ends of the lanes that lead into junctions [m].

    Args:
      net: of the map.
      roads: of the map, by id.

    Returns:
      The distances by lane, only those that are not zero, rounded to a centimeter.
    """
    found: dict[str, float] = {}
    for links in junction_links(net).values():
        turns = [link for link in links if link.turn in TURNS]
        if not turns:
            continue
        lanes = [net.lanes[name] for name in sorted({link.start for link in links})]
        for lane in lanes:
            lines, lights = lines_of_map(net, lane, roads)
            found[lane.id] = max(lines or lights, default=0.0)
        for link in turns:
            for name, distance in swept_lanes(net, link, lanes).items():
                found[name] = max(found[name], distance)
    return {
        name: round(min(offset, FARTHEST, SHARE * net.lanes[name].length), 2)
        for name, offset in found.items()
        if offset > 0.0
    }


def junction_links(net: NetFile) -> dict[str, list[NetConnection]]:
    """The connections through each junction, from the lanes before it."""
    junctions: dict[str, list[NetConnection]] = {}
    for link in net.connections:
        if link.via and not link.start.startswith(":"):
            junctions.setdefault(link.via.rsplit("_", 2)[0], []).append(link)
    return junctions


def turn_radius(net: NetFile, link: NetConnection) -> float:
    """Radius of the tightest bend of a connection, at the lane's center [m]; inf for none."""
    if link.turn not in TURNS:
        return math.inf
    x, y = _way(net, link)
    course = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    span = round(BEND / SPACING)
    if len(course) <= span:
        return math.inf
    turned = float(np.abs(course[span:] - course[:-span]).max())
    return BEND / turned if turned > 0.0 else math.inf


def meets(net: NetFile, one: NetConnection, other: NetConnection) -> bool:
    """Whether an articulated truck on one of two connections touches a car on the other.

    Connections whose lanes cross or join do not count: SUMO itself lets one vehicle wait there.
    """
    ways = [_way(net, link) for link in (one, other)]
    apart = np.hypot(*(ways[0][:, :, None] - ways[1][:, None]))
    if apart.min() < CROSSES:
        return False
    for long, short in (ways, ways[::-1]):
        dx, dy = np.gradient(short, axis=1)
        cars = Boxes(
            short[0], short[1], np.arctan2(dy, dx), np.array(2.0 * HALF), np.array(WAITING_WIDTH)
        )
        units = [unit for steered in (True, False) for unit in _units(long, steered)]
        if any(unit.touch(cars, ROOM).any() for unit in units):
            return True
    return False


def _way(net: NetFile, link: NetConnection) -> FloatArray:
    """Points every `SPACING` on the centers of the lanes of a connection, shape (2, n) [m]."""
    inside, via = [], link.via
    while via:
        inside.append(net.lanes[via].shape)
        via = net.inside.get(via, "")
    before = net.lanes[link.start].shape
    points = np.vstack([before, *inside, net.lanes[link.end].shape])
    apart = np.hypot(*np.diff(points, axis=0).T)
    points = points[np.concatenate([[True], apart > 1e-3])]
    along = distances_along(points)
    begin = float(distances_along(before)[-1])
    end = begin + sum(float(distances_along(shape)[-1]) for shape in inside)
    at = np.arange(max(begin - BEFORE, 0.0), min(end + BEHIND, float(along[-1])), SPACING)
    return np.stack([np.interp(at, along, points[:, k]) for k in (0, 1)])


def swept_lanes(net: NetFile, link: NetConnection, lanes: list[NetLane]) -> dict[str, float]:
    """Distances from the ends of other lanes that a turning truck needs to be free [m], by lane."""
    radius, way = turn_radius(net, link), _way(net, link)
    (articulated,) = (kind for kind in default_types() if kind.name == "articulated")
    units: list[Boxes] = []
    if radius >= TIGHTEST:
        units += _units(way, steered=True)
    if radius >= articulated.turning_radius:
        units += _units(way, steered=False)
    found = {}
    for lane in lanes:
        if lane.edge == net.lanes[link.start].edge:
            continue
        along = distances_along(lane.shape)
        back = np.arange(0.0, min(FARTHEST, float(along[-1]) - 2.0 * HALF), SPACING)
        ends = [
            [np.interp(along[-1] - back - far, along, lane.shape[:, k]) for k in (0, 1)]
            for far in (0.0, 2.0 * HALF)
        ]
        (x, y), (rear_x, rear_y) = ends
        waiting = Boxes(
            0.5 * (x + rear_x),
            0.5 * (y + rear_y),
            np.arctan2(y - rear_y, x - rear_x),
            np.array(2.0 * HALF),
            np.array(WAITING_WIDTH),
        )
        touched = np.zeros(len(back), dtype=bool)
        for unit in units:
            touched |= unit.touch(waiting, ROOM).any(axis=0)
        if touched.any():
            found[lane.id] = float(back[touched].max()) + SPACING
    return found


def _units(way: FloatArray, steered: bool) -> tuple[Boxes, Boxes]:
    """Boxes of tractor and semitrailer on a way.

    Args:
      way: points, shape (2, n) [m].
      steered: the steer axle follows the way, as the ego truck's does; else the box's center does,
        as that of the traffic's trucks.
    """
    truck = Articulation.of_length(LENGTH)
    kingpin_from_front = 0.5 * LENGTH - truck.kingpin
    if steered:
        tractor = _pulled(way, WHEELBASE)
        front = way + STEER_AXLE * _ahead(tractor)
        kingpin = front - kingpin_from_front * _ahead(tractor)
        trailer = _pulled(kingpin, truck.kingpin + truck.axles)
    else:
        trailer = _pulled(way, truck.axles)
        kingpin = way + truck.kingpin * _ahead(trailer)
        dx, dy = np.gradient(kingpin, axis=1)
        tractor = np.arctan2(dy, dx)
        front = kingpin + kingpin_from_front * _ahead(tractor)
    length = LENGTH - kingpin_from_front + NOSE
    middle = front - 0.5 * TRACTOR_END * _ahead(tractor)
    behind = kingpin + (NOSE - 0.5 * length) * _ahead(trailer)
    return (
        Boxes(middle[0], middle[1], tractor, np.array(TRACTOR_END), np.array(WIDTH)),
        Boxes(behind[0], behind[1], trailer, np.array(length), np.array(WIDTH)),
    )


def _ahead(yaw: FloatArray) -> FloatArray:
    """Unit vectors of headings, shape (2, n)."""
    return np.stack([np.cos(yaw), np.sin(yaw)])


def _pulled(way: FloatArray, distance: float) -> FloatArray:
    """Yaw of a link that is pulled by its front point along a way, see `Articulation.pulled`."""
    link = Articulation(0.0, distance)
    steps = np.diff(way, axis=1)
    courses, lengths = np.arctan2(steps[1], steps[0]).tolist(), np.hypot(*steps).tolist()
    yaw = [courses[0]]
    for course, length in zip(courses, lengths, strict=True):
        yaw.append(link.pulled(yaw[-1], course, length) if length > 0.0 else yaw[-1])
    return np.array(yaw)


def lines_of_map(
    net: NetFile, lane: NetLane, roads: Mapping[str, Road]
) -> tuple[list[float], list[float]]:
    """Distances of the map's stop lines, and of its lights, before the end of a lane [m]."""
    road = roads.get(lane.origin[0]) if lane.origin is not None else None
    if road is None or lane.origin is None:
        return [], []
    facing = ("+", "none") if road.travel(lane.origin[1]) > 0 else ("-", "none")
    along = distances_along(lane.shape)
    lines: list[float] = []
    lights: list[float] = []
    for signal in road.signals:
        if signal.orientation not in facing:
            continue
        chosen = lines if signal.kind == STOP_LINE else lights
        if chosen is lights and not (signal.dynamic and signal.kind in VEHICLE_LIGHTS):
            continue
        point = road.plan.evaluate(signal.s)
        place = np.array([float(point.x), float(point.y)]) + net.offset
        end = lane.shape[-1]
        # Along the last part of the lane, whose bend does not matter here.
        rear = np.array([np.interp(along[-1] - NEAR, along, lane.shape[:, k]) for k in (0, 1)])
        course = math.atan2(*(end - rear)[::-1])
        before = float((end - place) @ (math.cos(course), math.sin(course)))
        across = abs(wrap_angle(float(point.heading) - course))
        if 0.0 < before < NEAR and min(across, math.pi - across) < 0.5:
            chosen.append(before)
    return lines, lights
