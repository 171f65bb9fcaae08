"""MapNetwork: the friendly map of where traffic drives."""

from __future__ import annotations

from iits_mj.road import RoadMap
from traffic_bridge.lane_surface import LaneSurface, LaneSurfaces
from traffic_bridge.net_file import NetFile
from traffic_bridge.network import Network, build_network
from traffic_bridge.road_frames import RoadFrames


class MapNetwork:
    """The roads of a map and SUMO's lanes on them; static, no SUMO runs.

    Attributes:
      road_map: the map.
      network: its SUMO net file.
    """

    def __init__(self, road_map: RoadMap, network: Network) -> None:
        """Use `of`."""
        self.road_map = road_map
        self.network = network
        self.net = NetFile.read(network.path)
        self.frames = RoadFrames(road_map)
        self.surfaces = LaneSurfaces(self.net, self.frames)

    @classmethod
    def of(cls, road_map: RoadMap) -> MapNetwork:
        """The network of a map, made by netconvert when it is not in the cache.

        Raises:
          MapError: netconvert cannot use the map.
          TrafficError: netconvert is missing, or the net does not belong to the map.
        """
        return cls(road_map, build_network(road_map))

    def surface(self, lane: str, spacing: float = 1.0) -> LaneSurface:
        """Where a SUMO lane lies: samples `spacing` metres apart, see `LaneSurface`.

        Args:
          lane: SUMO lane id, on any road or inside a junction.
          spacing: at most, between samples [m].

        Raises:
          InputError: no such lane, or the spacing is not positive.
        """
        return self.surfaces.surface(lane, spacing)
