"""Rounds of MOBIL decisions over a running simulation; the model itself is in `mobil`."""

from __future__ import annotations

import dataclasses
import math

from traffic_bridge import mobil
from traffic_bridge.config import TrafficConfig
from traffic_bridge.ego import EGO, SHADOW
from traffic_bridge.lanes import RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.signals import BLOCKER
from traffic_bridge.vehicles import Vehicles

PERIOD = 1.0  # [s] between rounds of decisions
LOOK_AHEAD = 400.0  # [m]: nobody goes to a lane that ends within this distance
REST = 6.0  # [s] after a lane change before the next


class LaneChanger:
    """Decides on the lane changes of all vehicles of the route once a second, by MOBIL.

    Args:
      session: the running SUMO.
      lanes: of the route.
      vehicles: what each vehicle is.
      config: with the truck's footprint and the step length.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, config: TrafficConfig
    ) -> None:
        self._api = session.api
        self._lanes = lanes
        self._vehicles = vehicles
        self._config = config
        self._changed: dict[str, float] = {}
        self._until = PERIOD

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left."""
        self._changed.pop(name, None)

    def step(self, time: float, with_ego: bool) -> None:
        """One traffic step; a round of decisions when it is due.

        Args:
          time: of the traffic [s].
          with_ego: the truck is in the traffic.
        """
        self._until -= self._config.step_length
        if self._until > 1e-9:
            return
        self._until = PERIOD
        places: dict[str, tuple[str, int, float]] = {}
        drivers = []
        vehicle = self._api.vehicle
        for name in sorted(vehicle.getIDList()):
            if name not in self._vehicles:
                continue
            lane_id = vehicle.getLaneID(name)
            table = self._lanes.tables.get(lane_id)
            if table is None or table.lane < 0:
                continue
            position, speed = vehicle.getLanePosition(name), vehicle.getSpeed(name)
            places[name] = (table.edge, table.index, position)
            drivers.append(
                mobil.Driver(
                    name,
                    table.at(position)[0],
                    table.lane,
                    speed,
                    self._vehicles.desired_speed(name),
                    self._vehicles.type_of(name),
                    movable=not name.startswith(BLOCKER),
                )
            )
        if with_ego:
            drivers += self._ego_drivers()

        def may_change(driver: mobil.Driver, target: int) -> bool:
            edge, index, position = places[driver.name]
            table = self._lanes.tables.get(f"{edge}_{index + target - driver.lane}")
            if table is None or table.lane != target or edge.startswith(":"):
                return False
            if table.length - position < LOOK_AHEAD and not self._lanes.goes_on(table):
                return False
            return time - self._changed.get(driver.name, -math.inf) >= REST

        for name, target in mobil.decide(drivers, may_change).items():
            lane = next(driver.lane for driver in drivers if driver.name == name)
            vehicle.changeLane(name, places[name][1] + target - lane, PERIOD)
            self._changed[name] = time

    def _ego_drivers(self) -> list[mobil.Driver]:
        """The truck and its shadow, as obstacles to MOBIL."""
        length = self._config.footprint.length
        kind = dataclasses.replace(self._config.types[-1], length=length)
        drivers = []
        for name in self._api.vehicle.getIDList():
            if name != EGO and not name.startswith(SHADOW):
                continue
            table = self._lanes.tables.get(self._api.vehicle.getLaneID(name))
            if table is not None and table.lane >= 0:
                station = table.at(self._api.vehicle.getLanePosition(name))[0]
                speed = self._api.vehicle.getSpeed(name)
                drivers.append(
                    mobil.Driver(name, station, table.lane, speed, max(speed, 15.0), kind, False)
                )
        return drivers
