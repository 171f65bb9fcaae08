"""Roads: OpenDRIVE files, exact geometry, and the route that the truck drives on."""

from iits_mj.road.lanes import RouteSegment, RouteSignal
from iits_mj.road.reference_line import RoadPoint
from iits_mj.road.route import TABLE_COLUMNS, RoadMap, Route

__all__ = ["TABLE_COLUMNS", "RoadMap", "RoadPoint", "Route", "RouteSegment", "RouteSignal"]
