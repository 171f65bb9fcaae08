"""Rounds of MOBIL decisions over a running simulation; the model itself is in `mobil`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection
from functools import lru_cache

from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.lane_graph import Lane, LaneGraph, Onward
from traffic_bridge.session import Session
from traffic_bridge.vehicles.demand import MOBIL_MODE
from traffic_bridge.vehicles.mobil import Driver
from traffic_bridge.vehicles.occupancy import Occupancy, Place, decide
from traffic_bridge.vehicles.registry import Vehicles, VehicleType

PERIOD = 1.0  # [s] between rounds of decisions
LOOK_AHEAD = 400.0  # [m]: nobody goes to a lane that ends within this distance
ENTRY = 1.0  # [m] from the beginning of a lane to the rear of who appears there, at most
REST = 6.0  # [s] after a lane change before the next


class LaneChanger:
    """Decides on the lane changes of all vehicles once a second, by MOBIL.

    Who changes lanes by MOBIL is told by SUMO's lane-change mode, which the demand sets; all other
    vehicles (the truck and its shadow, standing and replayed vehicles) are there to be minded. SUMO
    itself only moves vehicles to the lanes from which their way goes on.

    Where traffic enters nobody changes lanes until the entrance is far enough behind: SUMO, which
    takes a lane as free as soon as it is left, would put the next vehicle where the last one is
    still seen.

    Args:
      session: the running SUMO.
      graph: the lanes of its net.
      vehicles: what each vehicle is.
      config: with the step length and the kinds of vehicles.
    """

    def __init__(
        self, session: Session, graph: LaneGraph, vehicles: Vehicles, config: TrafficConfig
    ) -> None:
        self._api = session.api
        self._graph = graph
        self._vehicles = vehicles
        self._config = config
        # When a vehicle was told to change lanes, and to which side (+1 left).
        self._changed: dict[str, tuple[float, int]] = {}
        self._until = PERIOD
        self._entries: frozenset[str] = frozenset()
        self._near_entry: dict[str, float] = {}
        longest = max(kind.length for kind in config.types)
        self._entry_zone = ENTRY + longest + config.speed_limit * config.lane_change_duration
        # The rear of who is in it may still be on the lane before.
        self._entry_reach = self._entry_zone + longest
        self._ways: dict[str, Onward] = {}
        self._obstacle = lru_cache(maxsize=64)(self._obstacle_of_length)

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left."""
        self._changed.pop(name, None)

    def step(self, time: float, entries: Callable[[], Collection[str]] = tuple) -> None:
        """One traffic step; a round of decisions when it is due.

        Args:
          time: of the traffic [s].
          entries: gives the edges at whose beginnings vehicles may appear now.
        """
        self._until -= self._config.step_length
        if self._until > 1e-9:
            return
        self._until = PERIOD
        vehicle = self._api.vehicle
        self._note_entries(frozenset(entries()))
        permitted: dict[str, bool] = {}

        def may_change(place: Place, target: Lane) -> bool:
            if time - self._changed.get(place.driver.name, (-math.inf, 0))[0] < REST:
                return False
            if self._is_near_entry(place):
                return False
            if target.id not in permitted:
                permitted[target.id] = self._is_open(target)
            return permitted[target.id] and self._goes_on(place, target)

        duration = self._config.lane_change_duration
        occupancy = Occupancy(self._graph, self._places(), duration)
        before = {name: place.lane.index for name, place in occupancy.places.items()}
        for name, (begun, side) in self._changed.items():
            left = begun + duration - time
            if left > 0.0 and name in occupancy.places:
                occupancy.note_leaving(name, occupancy.places[name].lane.beside(-side), left)
        for name, lane in decide(self._graph, occupancy, may_change).items():
            vehicle.changeLane(name, lane.index, PERIOD)
            self._changed[name] = time, lane.index - before[name]

    def _places(self) -> list[Place]:
        vehicle, lanes = self._api.vehicle, self._graph.lanes
        places = []
        for name in vehicle.getIDList():
            lane = lanes.get(vehicle.getLaneID(name))
            if lane is None:
                continue
            speed = vehicle.getSpeed(name)
            # What SUMO's IDM aims at: the vehicle's own desire within the lane's limit.
            desired = vehicle.getAllowedSpeed(name)
            if name in self._vehicles:
                kind = self._vehicles.type_of(name)
                movable = vehicle.getLaneChangeMode(name) == MOBIL_MODE
            else:
                kind, movable = self._obstacle(vehicle.getLength(name)), False
                desired = max(speed, desired)
            driver = Driver(name, speed, desired, kind, movable)
            onward = self._way(vehicle.getRouteID(name))
            places.append(Place(driver, lane, vehicle.getLanePosition(name), onward))
        return places

    def _obstacle_of_length(self, length: float) -> VehicleType:
        """The truck, its shadow or a replayed vehicle: drives like the last of the kinds."""
        return dataclasses.replace(self._config.types[-1], length=length)

    def _way(self, route: str) -> Onward:
        if route not in self._ways:
            edges = self._api.route.getEdges(route)
            # On a way that visits an edge twice, the first visit tells where it leads.
            following = dict(zip(reversed(edges[:-1]), reversed(edges[1:]), strict=True))
            self._ways[route] = following.get
        return self._ways[route]

    def _note_entries(self, entries: frozenset[str]) -> None:
        if entries != self._entries:
            self._entries = entries
            self._near_entry = self._graph.from_entries(entries, self._entry_reach)

    def _is_near_entry(self, place: Place) -> bool:
        begin = self._near_entry.get(place.lane.id, math.inf)
        return begin + place.position - place.driver.type.length < self._entry_zone

    def _is_open(self, lane: Lane) -> bool:
        closed = self._api.lane.getDisallowed(lane.id)
        return "passenger" not in closed and "all" not in closed

    def _goes_on(self, place: Place, lane: Lane) -> bool:
        """Whether the vehicle's way can be driven on a lane for a while."""
        way = lane.length - place.position
        while way < LOOK_AHEAD:
            after = self._graph.after(lane, place.onward)
            if after is None:
                return not lane.internal and place.onward(lane.edge) is None
            lane = after
            way += lane.length
        return True
