"""Paint of a net that its map does not have: stop lines, and the stripes of crossings.

SUMO's vehicles stop at the lines that `stop_lines` sets, and persons cross where `walkways` has
crossings. A picture shows them there, unless the map has paint of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.road import Route
from iits_mj.road.road_frames import RoadFrames
from traffic_bridge.network.lane_surface import LaneSurfaces
from traffic_bridge.network.net_file import NetLane
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.stop_lines import junction_links, lines_of_map
from traffic_bridge.network.walkways import Crossing, paint_of, read_crossings

WIDTH = 0.5  # [m] of a stop line, along the lane
SAME = 1.0  # [m] along the road between a crossing of the net and that of the map on it


@dataclass(frozen=True)
class Markings:
    """Corners of painted rectangles, each of shape (4, 3) or, of a crossing, (n, 3) [m].

    Attributes:
      stop_lines: at lights; yield_lines: where vehicles give way; crossings: of pedestrians.
    """

    stop_lines: tuple[FloatArray, ...] = ()
    yield_lines: tuple[FloatArray, ...] = ()
    crossings: tuple[FloatArray, ...] = ()


def net_markings(route: Route, walkways: bool = False) -> Markings:
    """Returns the paint of a route's net that its map does not have.

    Args:
      route: on the map.
      walkways: whether the net has crossings for pedestrians.

    Raises:
      MapError, TrafficError, InputError: as of `build_network`.
    """
    road_map = route.road_map
    if not road_map.content.junctions:
        return Markings()
    net = build_network(route, whole=False, walkways=walkways)
    surfaces = LaneSurfaces(net, RoadFrames(road_map))
    stops: list[FloatArray] = []
    yields: list[FloatArray] = []
    for links in junction_links(net).values():
        for name in sorted({link.start for link in links}):
            own, lane = [link for link in links if link.start == name], net.lanes[name]
            lit, gives_way = any(link.light for link in own), all(link.yields for link in own)
            own_lines, _ = lines_of_map(net, lane, road_map.roads)
            if lane.is_driving and (lit or gives_way) and not own_lines:
                (stops if lit else yields).append(_across(surfaces, lane))
    crossings: tuple[FloatArray, ...] = ()
    if walkways:
        found = read_crossings(net.path, road_map.roads)
        offset = np.array(net.offset)
        crossings = tuple(
            _on_road(surfaces, one, net.lanes, offset)
            for one in found
            if (way := paint_of(one.axis - offset, one.roads, road_map.roads)) is None
            or np.hypot(*way) > SAME
        )
    return Markings(tuple(stops), tuple(yields), crossings)


def _across(surfaces: LaneSurfaces, lane: NetLane) -> FloatArray:
    """Corners of the stop line of a lane (4, 3) [m]."""
    begin = lane.length - max(lane.stop_offset, WIDTH)
    along = begin + WIDTH * np.array([0.0, 0.0, 1.0, 1.0])
    point = surfaces.at(lane.id, along, 0.5 * lane.width * np.array([-1.0, 1.0, 1.0, -1.0]))
    return np.column_stack([point.x, point.y, point.z])


def _on_road(
    surfaces: LaneSurfaces, crossing: Crossing, lanes: dict[str, NetLane], offset: FloatArray
) -> FloatArray:
    """Outline of a crossing on the road that it crosses (n, 3), map frame [m]."""
    middle = crossing.outline.mean(axis=0)
    ends = [
        (float(np.hypot(*(lane.shape[end] - middle))), name, end)
        for name, lane in lanes.items()
        for end in (0, -1)
        if lane.edge in crossing.edges
    ]
    _, name, end = min(ends)
    point = surfaces.at(name, np.array([0.0 if end == 0 else lanes[name].length]))
    x, y, z, heading, grade, bank = (float(value[0]) for value in point)
    outline = crossing.outline - offset
    away = outline - (x, y)
    along = away @ (np.cos(heading), np.sin(heading))
    aside = away @ (-np.sin(heading), np.cos(heading))
    return np.column_stack([outline, z + grade * along + np.tan(bank) * aside])
