"""Replayed vehicles as guests of a running SUMO, for the traffic there to mind."""

from __future__ import annotations

import math
from typing import NamedTuple

from iits_mj.road import Route
from traffic_bridge.lanes import RouteLanes
from traffic_bridge.placed import PlacedVehicle
from traffic_bridge.replay import Replay
from traffic_bridge.session import Session

PREFIX = "guest."
# A vehicle counts as being in a second lane as well from this overlap on [m].
OVERLAP = 0.3
# Time before a recorded lane change from which a vehicle claims the lane it goes to, as one that
# indicates [s].
INDICATED = 3.0
END = 1.0  # [m] before the end of the route: SUMO would let a vehicle arrive and forget it


class _Place(NamedTuple):
    """Where a guest is after the coming step: front bumper, sideways place, speed and heading."""

    lane: int
    station: float
    offset: float
    speed: float
    x: float
    y: float
    yaw: float


class Guests:
    """Keeps replayed vehicles in SUMO where they are recorded.

    One that reaches into a second lane stands in both, and does so already before it changes lanes.

    Args:
      session: the running SUMO.
      lanes: of the route.
      route: the ego's road.
      replay: who is where.
      step: length of a step [s].
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, route: Route, replay: Replay, step: float
    ) -> None:
        self._session = session
        self._lanes = lanes
        self._route = route
        self._replay = replay
        self._step = step
        self._placed: dict[str, PlacedVehicle] = {}

    def place(self, time: float) -> None:
        """Has everybody at the place of a time [s] after the coming step; who is gone, leaves."""
        frame = self._replay.at(time)
        soon = self._replay.at(min(time + INDICATED, self._replay.duration))
        ahead = dict(zip(soon.ids, soon.lanes.tolist(), strict=True))
        wanted: dict[str, tuple[_Place, tuple[float, float]]] = {}
        names = ("x", "y", "yaw", "speed", "station", "offset", "length", "width")
        rows = frame.columns(*names).T.tolist()
        for name, lane, row in zip(frame.ids, frame.lanes.tolist(), rows, strict=True):
            x, y, yaw, speed, station, offset, length, width = row
            front = station + 0.5 * length
            if lane >= 0 and front >= self._route.length - END:
                continue
            place = _Place(lane, front, offset, max(speed, 0.0), x, y, yaw)
            wanted[PREFIX + name] = place, (length, width)
            second = self._second_lane(place, width, ahead.get(name, lane)) if lane >= 0 else -1
            if second >= 0:
                beside = place._replace(lane=second)
                wanted[f"{PREFIX}{name}.beside"] = beside, (length, width)
        with self._session.guard("placing the replayed vehicles"):
            for name in sorted(self._placed.keys() - wanted.keys()):
                self._placed.pop(name).remove()
            for name, (place, size) in wanted.items():
                if name not in self._placed:
                    self._placed[name] = PlacedVehicle(
                        self._session, self._lanes, name, self._step, size
                    )
                self._put(self._placed[name], place, size[0])

    def _second_lane(self, place: _Place, width: float, goal: int) -> int:
        """The other lane that a vehicle reaches into or is about to go to, -1 for none."""
        if abs(goal - place.lane) == 1 and goal >= 0 and self._lanes.find(goal, place.station):
            return goal
        half = 0.5 * width - OVERLAP
        for side in (half, -half):
            other = self._route.lane_at(place.station, place.offset + side)
            if other not in (-1, place.lane) and self._lanes.find(other, place.station):
                return int(other)
        return -1

    def _put(self, placed: PlacedVehicle, place: _Place, length: float) -> None:
        if place.lane >= 0:
            lane, station = place.lane, place.station
            table = self._lanes.covering(lane, station) or self._lanes.find(lane, station)
            if table is not None:
                position = table.position_of(station)
                side = place.offset - table.at(position)[1]
                placed.put(table, position, side, place.speed)
                return
        ahead = 0.5 * length
        x = place.x + ahead * math.cos(place.yaw)
        y = place.y + ahead * math.sin(place.yaw)
        placed.move(*self._lanes.to_sumo(x, y), place.yaw, place.speed)
