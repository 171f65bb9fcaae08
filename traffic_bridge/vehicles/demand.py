"""Puts vehicles on the road: random flows at the entrances, and initial traffic."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator

import numpy as np

from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.net_file import NetLane
from traffic_bridge.network.route_lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.signals.limits import SpeedLimits
from traffic_bridge.vehicles.ego_room import EgoRoom
from traffic_bridge.vehicles.map_demand import (
    JUNCTION_GAP,
    PERIOD,
    MapDemand,
    Occupied,
    Sight,
    Trip,
)
from traffic_bridge.vehicles.registry import Vehicles
from traffic_bridge.vehicles.service_level import LevelTraffic
from traffic_bridge.vehicles.types import VehicleType

LANE_END = 300.0  # [m] before the end of a lane that closes, without new vehicles
# [m] before a junction in which SUMO must choose the speed of a new vehicle (it may have to yield).
JUNCTION_AHEAD = 150.0
# SUMO's lane-change mode under MOBIL: SUMO only leaves lanes that end (bit 0), and makes requested
# lane changes unless they cause an immediate collision (bit 8).
MOBIL_MODE = 0b01_0000_0001


class Demand:
    """Puts vehicles on the road.

    Random numbers are drawn in a fixed order and number per step, so that the flow does not depend
    on the ego as long as the entrance is free.
    """

    def __init__(
        self,
        session: Session,
        lanes: RouteLanes,
        vehicles: Vehicles,
        config: TrafficConfig,
        rng: np.random.Generator,
        limits: SpeedLimits,
    ) -> None:
        self._session = session
        self._limits = limits
        self._api = session.api
        self._lanes = lanes
        self._vehicles = vehicles
        self._config = config
        self._rng = rng
        self._probability = config.probability * config.step_length
        self._count = 0
        steady = config.steady
        self._level = (
            None if steady is None else LevelTraffic(config.shares, config.speed_limit, steady)
        )
        kinds, weights = zip(*config.weights, strict=True)
        self._kinds = list(kinds)
        self._light = next((name for name in kinds if config.type_of(name).kind == "car"), "")
        shares = np.cumsum(np.asarray(weights, dtype=float) / sum(weights))
        self._shares: list[float] = (shares / shares[-1]).tolist()
        self._entrances = [lanes.of_edge(lanes.edges[0])]
        self._define_routes("along", lanes.edges)
        self._map: MapDemand | None = None
        if config.scope == "map":
            # A generator of its own keeps the draws of the flow along the route in every scope.
            (self._map_rng,) = rng.spawn(1)
            self._map = MapDemand(lanes.net, lanes.graph, config, self._map_rng)
            self._occupied: dict[str, Occupied] = {}
            self._full, self._next_check = False, 0
            vehicles.when_forgotten(self._map.forget)
        elif lanes.oncoming_edges:
            self._entrances.append(lanes.of_edge(lanes.oncoming_edges[0]))
            self._define_routes("against", lanes.oncoming_edges)

    def fill(self, ego: EgoRoom | None) -> None:
        """Populates the road with the density of the steady flow, with room for the ego.

        Args:
          ego: the space that the truck needs; None: no truck.
        """
        config = self._config
        here = 0.0 if ego is None else ego.station
        low, high = here - config.fill_behind, here + config.fill_ahead
        ways = [(1, self._lanes.edges)]
        if self._map is not None:
            self._occupied = {lane.id: Occupied() for lane in self._map.lanes}
        else:
            ways.append((-1, self._lanes.oncoming_edges))
        for direction, edges in ways:
            for index, edge in enumerate(edges):
                for table in self._lanes.of_edge(edge):
                    self._fill_lane(table, index, direction, low, high, ego)
        if self._map is not None and config.probability > 0.0:
            self._fill_elsewhere(self._map, low, high, ego)

    def _fill_lane(
        self,
        table: LaneTable,
        index: int,
        direction: int,
        low: float,
        high: float,
        ego: EgoRoom | None,
    ) -> None:
        config, graph = self._config, self._lanes.graph
        if config.probability <= 0.0:
            return
        edges = self._lanes.edges if direction > 0 else self._lanes.oncoming_edges
        end = min(table.length, graph.reach(table.id, edges[index:]) - LANE_END)
        for position, vehicle, desired in self._draw_along(
            table, end, config.speed_limit, self._rng
        ):
            station, _ = table.at(position)
            inside = low <= station <= high and position > vehicle.length + 1.0
            if inside and not _meets(ego, table, position, vehicle):
                route = f"{'along' if direction > 0 else 'against'}.{index}"
                limit = graph.entry_speed(table.id, position, edges[index:])
                self._add(vehicle, desired, route, table, f"{position:.3f}", limit)

    def spawn(self, ego_station: float | None, sight: Sight | None = None) -> None:
        """Inserts the vehicles that arrive in one step, except near the ego.

        Args:
          ego_station: of the truck [m]; None: no truck.
          sight: the truck's place on the map; only used in the scope "map".
        """
        probability = self._probability
        if probability <= 0.0:
            return
        if self._map is not None:
            self._balance(self._map, sight)
            self._spawn_elsewhere(self._map, probability, ego_station)
        for way, entrance in enumerate(self._entrances):
            if not entrance:
                continue
            draws = self._rng.random(len(entrance)).tolist()
            if min(draws) >= probability:
                continue
            near = self._is_near(ego_station, float(entrance[0].station[0]))
            for table, draw in zip(entrance, draws, strict=True):
                if draw < probability:
                    vehicle, desired = self._draw(table, self._rng)
                    if not near and self._admits(table, vehicle):
                        route = "along.0" if way == 0 else "against.0"
                        self._add(vehicle, desired, route, table, "base")

    def entries(self, ego_station: float | None) -> list[str]:
        """Edges at whose beginnings vehicles may now be inserted."""
        if self._config.probability <= 0.0:
            return []
        open_to = [
            entrance[0].edge
            for entrance in self._entrances
            if entrance and not self._is_near(ego_station, float(entrance[0].station[0]))
        ]
        for lane in () if self._map is None else self._map.entrances:
            table = self._lanes.table(lane.id)
            if not self._is_near(ego_station, float(table.station[0]), float(table.offset[0])):
                open_to.append(lane.edge)
        return open_to

    def discard_pending(self) -> None:
        """Removes vehicles for which SUMO found no room at once."""
        for name in self._api.simulation.getPendingVehicles():
            if name in self._vehicles:
                self._api.vehicle.remove(name)
                self._vehicles.forget(name)

    def trim(self) -> None:
        """Removes surplus vehicles of a populated map, before anyone has seen them."""
        if self._map is not None and self._probability > 0.0:
            for name in self._map.surplus(self._api):
                self._take_off(name)

    def _is_near(self, ego_station: float | None, station: float, offset: float = 0.0) -> bool:
        """Whether a place is too close to the ego for the insertion of a vehicle."""
        clear = self._config.clear_distance + self._config.footprint.length
        return ego_station is not None and math.hypot(ego_station - station, offset) < clear

    def _spawn_elsewhere(
        self, trips: MapDemand, probability: float, ego_station: float | None
    ) -> None:
        route = set(self._lanes.edges)
        entrances = [lane for lane in trips.entrances if lane.edge not in route]
        arrivals = self._map_rng.random(len(entrances)) < probability
        for k in np.flatnonzero(arrivals).tolist():
            lane = entrances[k]
            vehicle, desired = self._draw(lane, self._map_rng)
            table = self._lanes.table(lane.id)
            near = self._is_near(ego_station, float(table.station[0]), float(table.offset[0]))
            if not near and self._admits(lane, vehicle):
                self._add_trip(trips, vehicle, desired, lane, "base")

    def _admits(self, lane: LaneTable | NetLane, vehicle: VehicleType) -> bool:
        """Whether a vehicle can enter the map at once; always in other scopes, where it waits."""
        if self._map is None:
            return True
        if self._full or not self._map.is_entrance(lane.edge):
            return False
        ahead = self._api.lane.getLastStepVehicleIDs(lane.id)
        if not ahead:
            return True
        last = ahead[0]
        rear = self._api.vehicle.getLanePosition(last) - self._api.vehicle.getLength(last)
        return bool(rear > vehicle.length + vehicle.minimum_gap)

    def _balance(self, trips: MapDemand, sight: Sight | None) -> None:
        """Keeps the number of vehicles on the map as asked, and prolongs their trips."""
        for name in self._api.simulation.getPendingVehicles():
            if trips.has(name):
                self._take_off(name)
        self._next_check -= 1
        if self._next_check > 0:
            return
        self._next_check = round(PERIOD / self._config.step_length)
        trips.prolong(self._api)
        occupied = trips.occupied(self._api)
        change = trips.correction(occupied)
        self._full = trips.is_full(occupied)
        for name in trips.leaving(self._api, sight, -change):
            self._take_off(name)
        self._top_up(trips, occupied, sight, change)

    def _top_up(
        self,
        trips: MapDemand,
        occupied: dict[str, Occupied],
        sight: Sight | None,
        number: int,
        ego: EgoRoom | None = None,
    ) -> None:
        """Adds vehicles inside the map, out of sight of the truck."""
        places = trips.free_places(
            occupied, sight, lambda lane: self._draw(lane, self._map_rng), number
        )
        for lane, position, vehicle, desired in places:
            if not _meets(ego, self._lanes.table(lane.id), position, vehicle):
                self._add_trip(trips, vehicle, desired, lane, f"{position:.3f}")

    def _take_off(self, name: str) -> None:
        self._api.vehicle.remove(name)
        self._vehicles.forget(name)

    def _fill_elsewhere(
        self, trips: MapDemand, low: float, high: float, ego: EgoRoom | None
    ) -> None:
        """Populates the lanes off the route, until the map has the asked number of vehicles."""
        config, rng = self._config, self._map_rng
        route = set(self._lanes.edges)
        for k in rng.permutation(len(trips.lanes)).tolist():
            lane = trips.lanes[k]
            if lane.edge in route:
                continue
            table = self._lanes.table(lane.id)
            speed = min(config.speed_limit, lane.speed)
            end = lane.length - max(JUNCTION_GAP, lane.stop_offset)
            for position, vehicle, desired in self._draw_along(lane, end, speed, rng):
                free = position > vehicle.length + 1.0 and low <= table.at(position)[0] <= high
                free = free and trips.missing(self._occupied) > 0
                if free and not _meets(ego, table, position, vehicle):
                    self._add_trip(trips, vehicle, desired, lane, f"{position:.3f}")
        self._top_up(trips, self._occupied, None, trips.missing(self._occupied), ego)

    def _add_trip(
        self,
        trips: MapDemand,
        vehicle: VehicleType,
        desired: float,
        lane: NetLane,
        position: str,
    ) -> None:
        # At the highest safe speed, because there may be a queue before the next junction.
        trip = trips.start(lane.id, vehicle.turning_radius)
        self._insert_trip(trips, trip, vehicle, desired, lane.id, position, "max")

    def _insert_trip(
        self,
        trips: MapDemand,
        trip: Trip,
        vehicle: VehicleType,
        desired: float,
        lane: str,
        position: str,
        speed: float | str,
    ) -> None:
        route = f"trip.{self._count:05d}"
        self._api.route.add(route, trip.edges)
        index = self._lanes.graph.lanes[lane].index
        trips.add(self._insert(vehicle, desired, route, index, position, speed), trip)
        if lane in self._occupied and position != "base":
            front = float(position)
            self._occupied[lane].places.append((front, front - vehicle.length, desired))

    def _draw_along(
        self, lane: LaneTable | NetLane, end: float, speed: float, rng: np.random.Generator
    ) -> Iterator[tuple[float, VehicleType, float]]:
        """Draws the vehicles of a lane up to a position: (position [m], type, desired speed [m/s]).

        Poisson arrivals of rate p at speed v have exponential distances of mean v / p.
        """
        if self._level is not None:
            yield from self._level.along(*self._place(lane), end, rng)
            return
        mean_gap = speed * 0.92 / self._config.probability
        position = float(rng.exponential(mean_gap))
        while position < end:
            vehicle, desired = self._draw(lane, rng)
            yield position, vehicle, desired
            # Far enough apart that SUMO can insert both at their speeds.
            least = vehicle.length + vehicle.minimum_gap + 1.5 * speed
            position += max(least, float(rng.exponential(mean_gap)))

    def _place(self, lane: LaneTable | NetLane) -> tuple[int, int]:
        """Index from the right among the edge's lanes for cars, and their number."""
        beside = [
            other.index for other in self._lanes.net.edge[lane.edge].lanes if other.is_driving
        ]
        return sum(index < lane.index for index in beside), len(beside)

    def _draw(
        self, lane: LaneTable | NetLane, rng: np.random.Generator
    ) -> tuple[VehicleType, float]:
        """Draws type and desired speed of a vehicle on a lane."""
        if self._level is not None:
            return self._level.draw(*self._place(lane), rng)
        # The draw of NumPy's `choice`, which takes much longer.
        kind = self._kinds[bisect_right(self._shares, rng.random())]
        # Heavy vehicles do not use the left lane of three, which is the law in many countries.
        index = lane.lane if isinstance(lane, LaneTable) else lane.index
        if index >= 2 and self._light and self._config.type_of(kind).heavy:
            kind = self._light
        vehicle = self._config.type_of(kind)
        return vehicle, vehicle.sample_desired_speed(self._config.speed_limit, rng)

    def _add(
        self,
        vehicle: VehicleType,
        desired: float,
        route: str,
        table: LaneTable,
        position: str,
        ahead: float = math.inf,
    ) -> None:
        front = 0.0 if position == "base" else float(position)
        if self._map is not None:
            trip = self._map.start(table.id, vehicle.turning_radius)
            ahead = self._lanes.graph.entry_speed(table.id, front, tuple(trip.edges))
        sign = self._limits.entering(table, front, vehicle.deceleration)
        fastest = self._api.vehicletype.getMaxSpeed(vehicle.name)
        limit = min(self._api.lane.getMaxSpeed(table.id), fastest, ahead, sign)
        if self._level is not None:
            limit = min(limit, self._level.fill_speed)
        # A speed above the lane's limit would raise the vehicle's speed factor permanently.
        speed: float | str = limit
        if self._level is not None and position == "base":
            # At the speed of the last vehicle, so that the entrance carries the whole flow.
            speed = "last"
        if self._map is not None:
            if table.length - front < JUNCTION_AHEAD:
                speed = "max"
            self._insert_trip(self._map, trip, vehicle, desired, table.id, position, speed)
        else:
            self._insert(vehicle, desired, route, table.index, position, speed)

    def _insert(
        self,
        vehicle: VehicleType,
        desired: float,
        route: str,
        lane: int,
        position: str,
        speed: float | str,
    ) -> str:
        """Adds a vehicle to SUMO and returns its name.

        `speed` is a limit [m/s] or a word of SUMO, such as "max".
        """
        kind = vehicle.name
        name = f"{kind}.{self._count:05d}"
        self._count += 1
        individual = vehicle.time_headway_spread > 0.0
        desired = self._vehicles.add(name, kind, desired, driver=vehicle if individual else None)
        self._api.vehicle.add(
            name,
            route,
            typeID=kind,
            departLane=str(lane),
            departPos=position,
            departSpeed=speed if isinstance(speed, str) else f"{min(desired, speed) * 0.98:.3f}",
        )
        self._api.vehicle.setMaxSpeed(name, desired)
        if individual:
            self._api.vehicle.setTau(name, vehicle.time_headway)
        if self._config.lane_change == "mobil":
            self._api.vehicle.setLaneChangeMode(name, MOBIL_MODE)
        return name

    def _define_routes(self, name: str, edges: tuple[str, ...]) -> None:
        """Adds a SUMO route from every edge, as a vehicle begins on the first edge of its route."""
        for index in range(len(edges)):
            self._api.route.add(f"{name}.{index}", list(edges[index:]))


def _meets(ego: EgoRoom | None, table: LaneTable, position: float, vehicle: VehicleType) -> bool:
    """Whether a vehicle inserted at a position of a lane is too close to the ego."""
    if ego is None:
        return False
    if table.direction > 0:
        return ego.takes(table.at(position)[0], vehicle.length, table.lane)
    return ego.blocks(table, position, vehicle.length, vehicle.width)
