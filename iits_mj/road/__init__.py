"""Roads: OpenDRIVE in and out, exact geometry, and the route the truck drives on."""

from iits_mj.road.reference_line import RoadPoint
from iits_mj.road.road_map import RoadMap
from iits_mj.road.roadside import RouteSegment, RouteSignal
from iits_mj.road.route import TABLE_COLUMNS, Route

__all__ = ["TABLE_COLUMNS", "RoadMap", "RoadPoint", "Route", "RouteSegment", "RouteSignal"]
