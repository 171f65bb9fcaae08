"""Applies the lane-change model MOBIL (see `mobil`) in a running simulation."""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left, insort
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import lru_cache

from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.lane_graph import LaneGraph, Onward
from traffic_bridge.network.net_file import NetLane
from traffic_bridge.session import Session
from traffic_bridge.vehicles.demand import MOBIL_MODE
from traffic_bridge.vehicles.mobil import MARGIN, LaneNeighbors, MobilDriver, incentive
from traffic_bridge.vehicles.registry import Vehicles
from traffic_bridge.vehicles.types import VehicleType

REACH = 300.0  # [m]: vehicles farther away do not matter
PERIOD = 1.0  # [s] between rounds of decisions
LOOK_AHEAD = 400.0  # [m]: no vehicle changes to a lane that ends within this distance
ENTRY = 1.0  # [m] from the beginning of a lane to the rear of a vehicle inserted there, at most
REST = 6.0  # [s] between two lane changes of a vehicle


@dataclass(slots=True)
class LanePosition:
    """A vehicle on a lane: driver, lane, position of the front bumper [m], edges that follow."""

    driver: MobilDriver
    lane: NetLane
    position: float
    onward: Onward


class Occupancy:
    """The vehicles of one instant on their lanes.

    A vehicle's neighbors are those along its further way, past the ends of edges and through
    junctions, so that gaps agree with SUMO's car-following. This class does not use SUMO.

    Args:
      graph: of the net.
      places: of the vehicles.
      duration: of the sideways motion of a lane change [s].

    Attributes:
      places: by vehicle name.
    """

    def __init__(
        self,
        graph: LaneGraph,
        places: Iterable[LanePosition],
        duration: float = TrafficConfig.lane_change_duration,
    ) -> None:
        self._graph = graph
        self._duration = duration
        self.places = {place.driver.name: place for place in places}
        self._leaving: list[tuple[str, LanePosition, float]] = []
        self._rows: dict[str, list[tuple[float, str]]] = {}
        for name, place in self.places.items():
            self._rows.setdefault(place.lane.id, []).append((place.position, name))
        for row in self._rows.values():
            row.sort()

    def note_leaving(self, name: str, lane: str, time: float) -> None:
        """Notes that a vehicle still occupies the lane that it leaves, for a time [s]."""
        self._leaving.append((lane, self.places[name], time))

    def is_clear(self, place: LanePosition, lane: NetLane) -> bool:
        """Whether a vehicle can change to a lane without contact with one that leaves this lane."""
        for left, other, time in self._leaving:
            if left != lane.id or other is place:
                continue
            ahead = other.position - other.driver.type.length - place.position
            behind = place.position - place.driver.type.length - other.position
            used = time * (place.driver.speed - other.driver.speed)
            if max(ahead - max(used, 0.0), behind + min(used, 0.0)) < MARGIN:
                return False
        return True

    def move(self, name: str, lane: NetLane) -> None:
        """Moves a vehicle to another lane of its edge; it leaves the old lane gradually."""
        place = self.places[name]
        self.note_leaving(name, place.lane.id, self._duration)
        self._rows[place.lane.id].remove((place.position, name))
        insort(self._rows.setdefault(lane.id, []), (place.position, name))
        place.lane = lane

    def neighbors(self, place: LanePosition, lane: NetLane) -> LaneNeighbors:
        """The leader and follower of a vehicle on a lane of its edge.

        A vehicle whose front bumper is level or farther on is ahead.
        """
        row = self._rows.get(lane.id, [])
        k = bisect_left(row, (place.position, place.driver.name if lane is place.lane else ""))
        mine = k < len(row) and row[k][1] == place.driver.name
        gap_ahead, speed_ahead = self._ahead(place, lane, row, k + mine)
        gap_behind, follower = self._behind(place, lane, row, k - 1)
        return LaneNeighbors(gap_ahead, speed_ahead, gap_behind, follower)

    def _ahead(
        self, place: LanePosition, lane: NetLane, row: list[tuple[float, str]], k: int
    ) -> tuple[float, float]:
        distance = -place.position  # from the front bumper to the beginning of `lane`
        while k >= len(row):
            distance += lane.length
            if distance > REACH:
                return math.inf, 0.0
            after = self._graph.after(lane, place.onward)
            if after is None:
                # The end of a lane is a stopped leader, unless the vehicle's way ends there too.
                ends = not lane.internal and place.onward(lane.edge) is None
                return (math.inf if ends else distance), 0.0
            lane, k = after, 0
            row = self._rows.get(lane.id, [])
        position, name = row[k]
        leader = self.places[name].driver
        if leader is place.driver:  # once around a roundabout
            return math.inf, 0.0
        return distance + position - leader.type.length, leader.speed

    def _behind(
        self, place: LanePosition, lane: NetLane, row: list[tuple[float, str]], k: int
    ) -> tuple[float, MobilDriver | None]:
        rear = place.position - place.driver.type.length
        if k >= 0:
            position, name = row[k]
            return rear - position, self.places[name].driver
        # Where lanes join, the nearest vehicle on any of them counts.
        best: tuple[float, MobilDriver | None] = (math.inf, None)
        todo, known = [(rear, lane)], {lane.id}
        while todo:
            way, lane = todo.pop()
            for before in self._graph.before(lane):
                if before.id in known:
                    continue
                known.add(before.id)
                row = self._rows.get(before.id, [])
                if row:
                    position, name = row[-1]
                    gap = way + before.length - position
                    if gap < min(best[0], REACH) and name != place.driver.name:
                        best = gap, self.places[name].driver
                elif way + before.length < REACH:
                    todo.append((way + before.length, before))
        return best


def decide(
    graph: LaneGraph, occupancy: Occupancy, may_change: Callable[[LanePosition, NetLane], bool]
) -> dict[str, NetLane]:
    """Decides one round of lane changes: vehicle name -> target lane.

    The vehicles decide in the order of their names, and each decision includes the earlier ones, so
    the result does not depend on SUMO's order and two vehicles never take the same gap. No vehicle
    changes to a place that another one is still leaving. With equal incentives a vehicle takes the
    right lane.

    Args:
      graph: of the net.
      occupancy: the vehicles; updated with the new lanes.
      may_change: whether a vehicle may change to an adjacent lane.
    """
    changes: dict[str, NetLane] = {}
    for name in sorted(occupancy.places):
        place = occupancy.places[name]
        if not place.driver.movable or place.lane.internal:
            continue
        here: LaneNeighbors | None = None
        best, most = None, 0.0
        for side in (-1, 1):
            target = graph.lanes.get(place.lane.neighbor(side))
            if target is None or not may_change(place, target):
                continue
            if not occupancy.is_clear(place, target):
                continue
            here = here or occupancy.neighbors(place, place.lane)
            there = occupancy.neighbors(place, target)
            value = incentive(place.driver, here, there, to_right=side < 0)
            if value is not None and value > most:
                best, most = target, value
        if best is not None:
            occupancy.move(name, best)
            changes[name] = best
    return changes


class LaneChanger:
    """Decides on the lane changes of all vehicles once a second, by MOBIL.

    It moves the vehicles with the lane-change mode `MOBIL_MODE`; all others (the truck and its
    shadow, stopped and replayed vehicles) are obstacles. SUMO only moves vehicles to the lanes on
    which their way continues.

    Near an entrance of the traffic vehicles do not change lanes: in SUMO a vehicle leaves its lane
    at once, and SUMO would insert the next vehicle where the last one is still shown.
    """

    def __init__(
        self, session: Session, graph: LaneGraph, vehicles: Vehicles, config: TrafficConfig
    ) -> None:
        self._api = session.api
        self._graph = graph
        self._vehicles = vehicles
        self._config = config
        # Time and side (+1 left) of the last lane change of each vehicle.
        self._changed: dict[str, tuple[float, int]] = {}
        self._until = PERIOD
        self._entries: frozenset[str] = frozenset()
        self._near_entry: dict[str, float] = {}
        longest = max(kind.length for kind in config.types)
        self._entry_zone = ENTRY + longest + config.speed_limit * config.lane_change_duration
        # The rear of a vehicle in the zone may still be on the lane before.
        self._entry_reach = self._entry_zone + longest
        self._ways: dict[str, Onward] = {}
        self._obstacle = lru_cache(maxsize=64)(self._obstacle_of_length)

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left."""
        self._changed.pop(name, None)

    def step(self, time: float, entries: Callable[[], Collection[str]] = tuple) -> None:
        """Advances one traffic step; decides on lane changes if a round is due.

        Args:
          time: of the traffic [s].
          entries: returns the edges at whose beginnings vehicles may now be inserted.
        """
        self._until -= self._config.step_length
        if self._until > 1e-9:
            return
        self._until = PERIOD
        vehicle = self._api.vehicle
        self._note_entries(frozenset(entries()))
        permitted: dict[str, bool] = {}

        def may_change(place: LanePosition, target: NetLane) -> bool:
            if time - self._changed.get(place.driver.name, (-math.inf, 0))[0] < REST:
                return False
            if self._is_near_entry(place):
                return False
            if target.id not in permitted:
                permitted[target.id] = self._is_open(target)
            return permitted[target.id] and self._goes_on(place, target)

        duration = self._config.lane_change_duration
        occupancy = self.occupancy()
        before = {name: place.lane.index for name, place in occupancy.places.items()}
        for name, (begun, side) in self._changed.items():
            left = begun + duration - time
            if left > 0.0 and name in occupancy.places:
                occupancy.note_leaving(name, occupancy.places[name].lane.neighbor(-side), left)
        for name, lane in decide(self._graph, occupancy, may_change).items():
            vehicle.changeLane(name, lane.index, PERIOD)
            self._changed[name] = time, lane.index - before[name]

    def occupancy(self) -> Occupancy:
        """The vehicles that are now on lanes."""
        vehicle, lanes = self._api.vehicle, self._graph.lanes
        places = []
        for name in vehicle.getIDList():
            lane = lanes.get(vehicle.getLaneID(name))
            if lane is None:
                continue
            speed = vehicle.getSpeed(name)
            # The target of SUMO's IDM: the desired speed within the lane's limit.
            desired = vehicle.getAllowedSpeed(name)
            if name in self._vehicles:
                kind = self._vehicles.type_of(name)
                movable = vehicle.getLaneChangeMode(name) == MOBIL_MODE
            else:
                kind, movable = self._obstacle(vehicle.getLength(name)), False
                desired = max(speed, desired)
            driver = MobilDriver(name, speed, desired, kind, movable)
            onward = self._way(vehicle.getRouteID(name))
            places.append(LanePosition(driver, lane, vehicle.getLanePosition(name), onward))
        return Occupancy(self._graph, places, self._config.lane_change_duration)

    def _obstacle_of_length(self, length: float) -> VehicleType:
        """The type of the truck, its shadow and replayed vehicles: the last one of the config."""
        return dataclasses.replace(self._config.types[-1], length=length)

    def _way(self, route: str) -> Onward:
        if route not in self._ways:
            edges = self._api.route.getEdges(route)
            # If a route visits an edge twice, the first visit counts.
            following = dict(zip(reversed(edges[:-1]), reversed(edges[1:]), strict=True))
            self._ways[route] = following.get
        return self._ways[route]

    def _note_entries(self, entries: frozenset[str]) -> None:
        if entries != self._entries:
            self._entries = entries
            self._near_entry = self._graph.from_entries(entries, self._entry_reach)

    def _is_near_entry(self, place: LanePosition) -> bool:
        begin = self._near_entry.get(place.lane.id, math.inf)
        return begin + place.position - place.driver.type.length < self._entry_zone

    def _is_open(self, lane: NetLane) -> bool:
        closed = self._api.lane.getDisallowed(lane.id)
        return "passenger" not in closed and "all" not in closed

    def _goes_on(self, place: LanePosition, lane: NetLane) -> bool:
        """Whether a lane leads along the vehicle's way for the distance `LOOK_AHEAD`."""
        distance = lane.length - place.position
        while distance < LOOK_AHEAD:
            after = self._graph.after(lane, place.onward)
            if after is None:
                return not lane.internal and place.onward(lane.edge) is None
            lane = after
            distance += lane.length
        return True
