"""Puts replayed vehicles into a running SUMO simulation, whose traffic reacts to them."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.modes.teleported_vehicle import END, LaneOverlap, TeleportedVehicle
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.session import Session

# Parts of names in SUMO: of replayed vehicles, and of their copies in a second lane.
PREFIX = "replayed."
OVERLAP_SUFFIX = ".overlap"
CENTERED = 0.25  # [m] from its lane's center, within which a vehicle reaches into no other lane
# [s] before a recorded lane change in which a vehicle occupies its target lane, as if it indicated.
INDICATED = 3.0


class _Place(NamedTuple):
    """A vehicle after the next step: its lane and columns of its frame."""

    lane: int
    x: float
    y: float
    yaw: float
    speed: float
    station: float
    offset: float
    length: float
    width: float

    @property
    def front(self) -> float:
        """Station of the front bumper, SUMO's reference point [m]."""
        return self.station + 0.5 * self.length

    @property
    def front_point(self) -> tuple[float, float]:
        """X and y of the front bumper, map frame [m]."""
        ahead = 0.5 * self.length
        return self.x + ahead * math.cos(self.yaw), self.y + ahead * math.sin(self.yaw)


class Source(Protocol):
    """Vehicles whose places are given; `InterpolatedRecording` and `Actors` are sources."""

    @property
    def duration(self) -> float:
        """Time after which there are none [s]."""

    def at(self, time: float) -> VehicleFrame:
        """The vehicles at a time [s]; soon after the present, only their lanes matter."""


class ReplayedVehicles:
    """Moves replayed vehicles in SUMO to their recorded places.

    A vehicle that reaches into a second lane, or soon changes to it, occupies both. `step` is the
    length of a traffic step [s]; `prefix` begins the names in SUMO.
    """

    def __init__(
        self,
        session: Session,
        lanes: RouteLanes,
        replay: Source,
        step: float,
        prefix: str = PREFIX,
    ) -> None:
        self._prefix = prefix
        self._session = session
        self._lanes = lanes
        self._replay = replay
        self._step = step
        self._overlap = LaneOverlap(lanes)
        self._teleported: dict[str, TeleportedVehicle] = {}

    def place(self, time: float) -> None:
        """Moves all vehicles to their places at a time [s], the end of the next step."""
        wanted = self._wanted(time)
        with self._session.guard("placing the replayed vehicles"):
            for name in sorted(self._teleported.keys() - wanted.keys()):
                self._teleported.pop(name).remove()
            for name, place in wanted.items():
                if name not in self._teleported:
                    size = place.length, place.width
                    self._teleported[name] = TeleportedVehicle(
                        self._session, self._lanes, name, self._step, size
                    )
                self._overlap.put(
                    self._teleported[name],
                    place.lane,
                    place.front,
                    place.offset,
                    place.front_point,
                    place.yaw,
                    place.speed,
                )

    def _wanted(self, time: float) -> dict[str, _Place]:
        """The places of the vehicles by their names in SUMO."""
        frame = self._replay.at(time)
        soon = self._replay.at(min(time + INDICATED, self._replay.duration))
        ahead = dict(zip(soon.ids, soon.lanes.tolist(), strict=True))
        wanted: dict[str, _Place] = {}
        rows = frame.columns(*_Place._fields[1:]).T.tolist()
        for name, lane, row in zip(frame.ids, frame.lanes.tolist(), rows, strict=True):
            place = _Place(lane, *row)
            if lane < 0:
                wanted[self._prefix + name] = place
                continue
            if place.front >= self._lanes.route.length - END:
                continue
            wanted[self._prefix + name] = place
            second = self._second_lane(place, ahead.get(name, lane))
            if second >= 0:
                wanted[self._prefix + name + OVERLAP_SUFFIX] = place._replace(lane=second)
        return wanted

    def _second_lane(self, place: _Place, goal: int) -> int:
        """The other lane that a vehicle reaches into or soon changes to, -1 for none."""
        if abs(goal - place.lane) == 1 and goal >= 0 and self._overlap.table(goal, place.front):
            return goal
        table = self._overlap.table(place.lane, place.front)
        if table is not None:
            center = table.at(table.position_of(place.front))[1]
            if abs(place.offset - center) < CENTERED:
                return -1
        edges = self._overlap.edges(place.width, (place.offset,))
        under = self._overlap.under(place.front, edges)
        return self._overlap.second(place.lane, place.front, under)
