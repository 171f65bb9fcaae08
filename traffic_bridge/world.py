"""The traffic of one route in SUMO: demand, lane changes, and what is seen around the ego."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from iits_mj.messages import EgoState, TrackedVehicle
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.demand import Demand
from traffic_bridge.ego import EgoInTraffic, ego_type_xml
from traffic_bridge.lane_changing import LaneChanger
from traffic_bridge.lanes import RouteLanes
from traffic_bridge.network import build_network
from traffic_bridge.session import Session
from traffic_bridge.signals import TrafficController
from traffic_bridge.smoothing import LateralSmoother
from traffic_bridge.vehicles import Vehicles

VIEW = "view"  # the SUMO point of interest that follows the ego, to ask who is near it
VIEW_MARGIN = 30.0  # [m]: SUMO measures to front bumpers, we to centres
TIGHT_TURN = 2.0  # [m/s] below which a sideways motion turns the box no further


class _Seen(NamedTuple):
    name: str
    lane: str
    position: float
    speed: float
    acceleration: float


class World:
    """One running SUMO simulation on one route.

    Args:
      route: the ego's road.
      config: settings.
      seed: of everything random.
      with_ego: the traffic reacts to the truck.
      lanes: of an earlier world on the same route, to save reading the net again.

    Raises:
      MapError, TrafficError: see `build_network` and `Session`.
    """

    def __init__(
        self,
        route: Route,
        config: TrafficConfig,
        seed: int,
        with_ego: bool,
        lanes: RouteLanes | None = None,
    ) -> None:
        self.route = route
        self.config = config
        self.time = 0.0
        network = build_network(route)
        types = "".join(t.to_sumo_xml(config.speed_limit) for t in config.types)
        self.session = Session(
            network.path, types + ego_type_xml(config.footprint), config.step_length, seed
        )
        with self.session.guard("setting up the traffic"):
            if lanes is None:
                lanes = RouteLanes(self.session, network, route, config.oncoming)
            else:
                lanes.bind(self.session)
            self.lanes = lanes
            self.vehicles = Vehicles(self.session, config.types)
            self.signals = TrafficController(self.session, lanes, self.vehicles)
            rng = np.random.default_rng(seed)
            self._demand = Demand(self.session, lanes, self.vehicles, config, rng)
        self._ego = EgoInTraffic(self.session, lanes, route, config.footprint)
        self._with_ego = with_ego
        self._api = self.session.api
        self._smoother = LateralSmoother(config.lane_change_duration)
        self._lane_changer = (
            LaneChanger(self.session, lanes, self.vehicles, config)
            if config.lane_change == "mobil"
            else None
        )
        self._viewing = False

    def begin(self, ego: EgoState | None) -> list[TrackedVehicle]:
        """Populates the road around the ego and lets everybody depart; time is zero then."""
        with self.session.guard("populating the road"):
            if ego is None:
                self._demand.fill(None, -1, 0.0)
            else:
                _, _, station, offset = self._ego.front(ego)
                lane = self.route.lane_at(station, offset)
                self._demand.fill(station, lane, ego.speed)
            if ego is not None:
                self._look(ego)
        if self._with_ego and ego is not None:
            self._ego.place(ego)
        self.session.step()
        with self.session.guard("populating the road"):
            self._demand.discard_pending()
            self._drop_arrived()
            return self._observe(ego)

    def advance(self, ego: EgoState | None) -> list[TrackedVehicle]:
        """One step; the ego is where it is at the step's end. Returns the vehicles, by name."""
        with self.session.guard("adding vehicles"):
            self._demand.spawn(None if ego is None else ego.station)
            if self._lane_changer is not None:
                self._lane_changer.step(self.time, self._with_ego and ego is not None)
            if ego is not None:
                self._look(ego)
        if self._with_ego and ego is not None:
            self._ego.place(ego)
        self.session.step()
        self.time += self.config.step_length
        with self.session.guard("reading the vehicles"):
            self._drop_arrived()
            return self._observe(ego)

    def close(self) -> None:
        """Ends SUMO."""
        self.session.close()

    # Reading -----------------------------------------------------------------------------------

    def _look(self, ego: EgoState) -> None:
        x, y = self.lanes.to_sumo(ego.x, ego.y)
        poi = self._api.poi
        if not self._viewing:
            poi.add(VIEW, x, y, (0, 0, 0, 0))
            constants = self._api.constants
            poi.subscribeContext(
                VIEW,
                constants.CMD_GET_VEHICLE_VARIABLE,
                self.config.view_range + VIEW_MARGIN,
                [
                    constants.VAR_LANE_ID,
                    constants.VAR_LANEPOSITION,
                    constants.VAR_SPEED,
                    constants.VAR_ACCELERATION,
                ],
            )
            self._viewing = True
        poi.setPosition(VIEW, x, y)

    def _seen(self, ego: EgoState | None) -> list[_Seen]:
        """The traffic near the ego (everybody without one), sorted by name."""
        if ego is None:
            vehicle = self._api.vehicle
            rows = [
                _Seen(
                    name,
                    vehicle.getLaneID(name),
                    vehicle.getLanePosition(name),
                    vehicle.getSpeed(name),
                    vehicle.getAcceleration(name),
                )
                for name in vehicle.getIDList()
            ]
        else:
            constants = self._api.constants
            found = self._api.poi.getContextSubscriptionResults(VIEW)
            rows = [
                _Seen(
                    name,
                    values[constants.VAR_LANE_ID],
                    values[constants.VAR_LANEPOSITION],
                    values[constants.VAR_SPEED],
                    values[constants.VAR_ACCELERATION],
                )
                for name, values in found.items()
            ]
        return sorted(row for row in rows if row.lane and row.name in self.vehicles)

    def _observe(self, ego: EgoState | None) -> list[TrackedVehicle]:
        rows = self._seen(ego)
        if not rows:
            return []
        types = [self.vehicles.type_of(row.name) for row in rows]
        size = np.array([(t.length, t.width, t.height) for t in types])
        station, offset = np.empty(len(rows)), np.empty(len(rows))
        lanes = [-1] * len(rows)
        direction, on_route = np.ones(len(rows)), np.ones(len(rows), dtype=bool)
        for i, row in enumerate(rows):
            table = self.lanes.tables.get(row.lane)
            if table is None:
                station[i], offset[i], direction[i] = self._off_route(row.name, ego, size[i, 0])
                on_route[i] = False
            else:
                middle = row.position - 0.5 * size[i, 0]
                station[i], offset[i] = table.at(middle)
                # On its lane's centre a vehicle is in that lane; else the road is asked below.
                lanes[i] = table.lane if middle > 0.0 else -1
                direction[i] = table.direction
                on_route[i] = table.direction > 0
        speed = direction * np.array([row.speed for row in rows])
        shown, lateral = self._smoother.update(
            [row.name for row in rows], station, offset, speed, size, self.config.step_length
        )
        point = self.route.evaluate(station, shown)
        forward = direction * np.maximum(np.abs(speed), TIGHT_TURN)
        yaw = point.heading + np.arctan2(lateral, forward)
        seen = []
        for i, row in enumerate(rows):
            x, y = float(point.x[i]), float(point.y[i])
            near = ego is None or math.hypot(x - ego.x, y - ego.y) <= self.config.view_range
            if not near:
                continue
            s, d = float(station[i]), float(shown[i])
            centered = lanes[i] >= 0 and shown[i] == offset[i]
            lane = lanes[i] if centered else self.route.lane_at(s, d) if on_route[i] else -1
            seen.append(
                TrackedVehicle(
                    id=row.name,
                    kind=types[i].kind,
                    x=x,
                    y=y,
                    z=float(point.z[i]),
                    yaw=math.remainder(float(yaw[i]), 2.0 * math.pi),
                    speed=row.speed,
                    acceleration=row.acceleration,
                    lateral_speed=float(direction[i] * lateral[i]),
                    station=s,
                    offset=d,
                    lane=lane,
                    length=types[i].length,
                    width=types[i].width,
                    height=types[i].height,
                )
            )
        return seen

    def _off_route(
        self, name: str, ego: EgoState | None, length: float
    ) -> tuple[float, float, float]:
        """Station, offset and direction of a vehicle on another road, as seen from the route."""
        yaw = math.radians(90.0 - self._api.vehicle.getAngle(name))
        x, y = self.lanes.to_map(*self._api.vehicle.getPosition(name))
        x, y = x - 0.5 * length * math.cos(yaw), y - 0.5 * length * math.sin(yaw)
        station, offset = self.route.locate(x, y, None if ego is None else ego.station)
        heading = float(self.route.evaluate(station).heading)
        return station, offset, 1.0 if math.cos(yaw - heading) >= 0.0 else -1.0

    def _drop_arrived(self) -> None:
        for name in self._api.simulation.getArrivedIDList():
            self.vehicles.forget(name)
            if self._lane_changer is not None:
                self._lane_changer.forget(name)
