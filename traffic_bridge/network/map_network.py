"""MapNetwork: the roads, lanes, junctions and paths of a map, without starting SUMO."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from iits_mj.road.road_frames import RoadFrames
from traffic_bridge.network.lane_graph import MapPath, MapPaths
from traffic_bridge.network.lane_surface import LaneSurface, LaneSurfaces
from traffic_bridge.network.map_lookup import MapLookup, Place
from traffic_bridge.network.net_file import NetConnection, NetFile, NetJunction, NetLight
from traffic_bridge.network.nets import build_network


@dataclass(frozen=True)
class MapLane:
    """One of SUMO's lanes and its place on the map.

    Attributes:
      id: SUMO's; edge: its edge; index: from the right.
      road: OpenDRIVE's road id; lane: OpenDRIVE's lane id where the lane begins; "" and 0 for the
        short joints that SUMO puts between edges.
      begin, end: stations of the road at the lane's beginning and end, in travel [m].
      length: in SUMO's measure of positions [m]; width: [m].
      speed: limit [m/s]; inside junctions the speed that the bend allows.
      kind: OpenDRIVE's lane type.
      internal: inside one of SUMO's junctions.
      driving: open to cars and trucks.
    """

    id: str
    edge: str
    index: int
    road: str
    lane: int
    begin: float
    end: float
    length: float
    width: float
    speed: float
    kind: str
    internal: bool
    driving: bool


@dataclass(frozen=True)
class MapRoad:
    """A road of the map: SUMO's edges on it, and OpenDRIVE's junction id ("" outside)."""

    id: str
    name: str
    length: float
    junction: str
    edges: tuple[str, ...]


class MapNetwork(MapLookup):
    """The roads of a map, SUMO's lanes on them, and the paths through it.

        network = MapNetwork.of(RoadMap.from_opendrive("town.xodr"))
        place = network.locate(x, y, heading)
        network.path(place.edge, network.exits[0]).edges

    Attributes:
      road_map: the map, which defines all positions.
      net: its SUMO net.
      lanes: every lane by SUMO's id, junction-internal ones included.
      connections: from lane to lane, with their turn and the light that controls them.
      junctions: SUMO's nodes by id, in the map's coordinates.
      lights: programs of the traffic lights.
      entrances, exits: edges where traffic enters and leaves the map.
    """

    def __init__(self, road_map: RoadMap, net: NetFile) -> None:
        """The network of a map and its net; `of` makes the net."""
        frames = RoadFrames(road_map)
        super().__init__(frames, LaneSurfaces(net, frames))
        self.road_map = road_map
        self.net = net
        self.connections: tuple[NetConnection, ...] = net.connections
        self.lights: tuple[NetLight, ...] = net.lights

    @classmethod
    def of(cls, road_map: RoadMap) -> MapNetwork:
        """The network of a map, made by netconvert unless it is in the cache.

        Raises:
          MapError: netconvert cannot use the map.
          TrafficError: netconvert is missing, or the net does not belong to the map.
        """
        return cls(road_map, build_network(road_map))

    @cached_property
    def lanes(self) -> dict[str, MapLane]:
        """Every lane by SUMO's id."""
        return {name: self._lane(name) for name in self.surfaces.lanes}

    @cached_property
    def roads(self) -> dict[str, MapRoad]:
        """Every road by its id."""
        edges: dict[str, list[str]] = {name: [] for name in self.road_map.roads}
        for lane in self.lanes.values():
            if lane.road and lane.edge not in edges[lane.road]:
                edges[lane.road].append(lane.edge)
        return {
            name: MapRoad(name, road.name, road.length, road.junction or "", tuple(edges[name]))
            for name, road in self.road_map.roads.items()
        }

    @cached_property
    def junctions(self) -> dict[str, NetJunction]:
        """SUMO's nodes by id; x and y are the map's."""
        x, y = self.net.offset
        return {
            node.id: NetJunction(node.id, node.kind, node.x - x, node.y - y)
            for node in self.net.junctions
        }

    def surface(self, lane: str, spacing: float = 1.0) -> LaneSurface:
        """Samples of a SUMO lane's position, `spacing` meters apart; see `LaneSurface`.

        Args:
          lane: SUMO lane id, on any road or inside a junction.
          spacing: at most, between samples [m].

        Raises:
          InputError: there is no such lane, or the spacing is not positive.
        """
        return self.surfaces.surface(lane, spacing)

    @cached_property
    def paths(self) -> MapPaths:
        """The graph of the map's edges."""
        return MapPaths(self.net)

    @property
    def entrances(self) -> tuple[str, ...]:
        """Edges where traffic enters the map: no other edge leads to them."""
        return self.paths.entrances

    @property
    def exits(self) -> tuple[str, ...]:
        """Edges where traffic leaves the map: they lead to no other edge."""
        return self.paths.exits

    def routes(self) -> tuple[MapPath, ...]:
        """The quickest path from every entrance to every exit that can be reached from it."""
        return self.paths.routes()

    def path(self, start: str | Place | None, end: str | Place | None) -> MapPath:
        """The quickest path between two edges (or the edges of two places).

        Raises:
          InputError: there is no such edge or no path, or a place has no edge.
        """
        return self.paths.path(_edge(start), _edge(end))

    def reachable(self, start: str | Place | None) -> frozenset[str]:
        """All edges that can be reached from an edge (or the edge of a place), itself included.

        Raises:
          InputError: there is no such edge.
        """
        return self.paths.reachable(_edge(start))

    def _lane(self, name: str) -> MapLane:
        lane = self.surfaces.lanes[name]
        stretch = self.surfaces.stretch(name)
        road, number, begin, end = "", 0, 0.0, 0.0
        if stretch is not None:
            road = stretch.frame.road.id
            begin, end = float(stretch.s[0]), float(stretch.s[-1])
            number = stretch.lanes[min(stretch.lanes) if end > begin else max(stretch.lanes)]
        return MapLane(
            name, lane.edge, lane.index, road, number, begin, end, lane.length, lane.width,
            lane.speed, lane.kind, lane.internal, lane.is_driving,
        )  # fmt: skip


def _edge(place: str | Place | None) -> str:
    if isinstance(place, str):
        return place
    if place is None:
        raise InputError("a path needs a place on a road: the point lies beside every road")
    if not place.edge or place.edge.startswith(":"):
        raise InputError(
            f"the place on lane {place.lane} of road {place.road!r} at {place.station:g} m is on "
            "no edge of its own; take one before or after the junction"
        )
    return place.edge
