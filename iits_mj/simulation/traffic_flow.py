"""Measures density, flow and speed of the traffic around the truck, and its level of service."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from iits_mj.simulation.frame import DriveFrame
from traffic_bridge.vehicles.service_level import in_cars, level_of
from traffic_bridge.vehicles.types import HEAVY

# Road ahead of and behind the truck whose traffic is measured [m]; traffic sources report more.
REACH = 300.0
_NO_VEHICLES = ("pedestrian", "obstacle")


@dataclass(frozen=True, slots=True)
class TrafficFlow:
    """Mean traffic of the truck's direction, lane by lane, without the truck.

    Attributes:
      density: [vehicles per m and lane]; speed: [m/s], nan without vehicles.
      level: of service by the Highway Capacity Manual, "A" to "F"; "" before the first frame.
    """

    density: float
    speed: float
    level: str

    @property
    def flow(self) -> float:
        """Vehicles per second and lane; 0 without vehicles."""
        return self.density * self.speed if self.density > 0.0 else 0.0

    def to_text(self) -> str:
        """Returns the figures with the units of road traffic."""
        if not self.density > 0.0:
            return "none around the truck"
        return (
            f"{1e3 * self.density:.1f} vehicles/km and lane, {3600.0 * self.flow:.0f} vehicles/h "
            f"and lane, {3.6 * self.speed:.1f} km/h (level of service {self.level})"
        )


@dataclass(slots=True)
class FlowMeter:
    """Adds up the traffic around the truck, frame by frame.

    Density and flow follow Edie's definitions: time spent and distance driven by all vehicles, over
    the area of road and time.

    Args:
      route: the truck's road.
    """

    route: Route
    _stations: FloatArray = field(init=False)
    _lane_length: FloatArray = field(init=False)  # of all lanes up to the stations [m]
    _vehicles: int = 0
    _heavy: int = 0
    _speeds: float = 0.0
    _length: float = 0.0

    def __post_init__(self) -> None:
        """Tabulates the length of all lanes."""
        starts = self.route.section_starts()
        counts = [self.route.lane_count(start) for start in starts]
        self._stations = np.array([*starts, self.route.length])
        steps = np.array(counts) * np.diff(self._stations)
        self._lane_length = np.concatenate([[0.0], np.cumsum(steps)])

    def add(self, frame: DriveFrame) -> None:
        """Adds one frame."""
        station = frame.ego.station
        low, high = station - REACH, station + REACH
        begin, end = np.interp((low, high), self._stations, self._lane_length)
        self._length += float(end - begin)
        vehicles = VehicleFrame.of(frame.scene.vehicles)
        if not len(vehicles):
            return
        place = vehicles.column("station")
        rides = np.array([kind not in _NO_VEHICLES for kind in vehicles.kinds])
        near = np.flatnonzero((place >= low) & (place <= high) & (vehicles.lanes >= 0) & rides)
        self._vehicles += len(near)
        self._heavy += sum(vehicles.kinds[i] in HEAVY for i in near)
        self._speeds += float(vehicles.column("speed")[near].sum())

    @property
    def flow(self) -> TrafficFlow:
        """The mean so far."""
        if self._length <= 0.0:
            return TrafficFlow(0.0, math.nan, "")
        density = self._vehicles / self._length
        if not self._vehicles:
            return TrafficFlow(0.0, math.nan, level_of(0.0))
        level = level_of(in_cars(density, self._heavy / self._vehicles))
        return TrafficFlow(density, self._speeds / self._vehicles, level)
