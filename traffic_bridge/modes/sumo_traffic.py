"""Runs a SUMO simulation on one route: demand, lane changes, observation."""

from __future__ import annotations

import numpy as np

from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.ego import EGO, EgoInTraffic, ego_type_xml
from traffic_bridge.modes.observation import Observation
from traffic_bridge.modes.replayed_vehicles import ReplayedVehicles
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.scenario.runner import Scenario
from traffic_bridge.session import Session
from traffic_bridge.signals.controller import TrafficController
from traffic_bridge.vehicles.demand import Demand
from traffic_bridge.vehicles.lane_changing import LaneChanger
from traffic_bridge.vehicles.map_demand import Sight
from traffic_bridge.vehicles.opposite_turns import OppositeTurns, merged
from traffic_bridge.vehicles.pedestrians import Pedestrians, pedestrian_type_xml
from traffic_bridge.vehicles.registry import Vehicles
from traffic_bridge.vehicles.service_level import BOTTLENECK, BOTTLENECK_RATIO

ACTOR = "actor."  # begins the names of a scenario's vehicles in SUMO
ENTRY_WAIT, LEVEL_ENTRY_WAIT = 5.0, 60.0  # [s] that a vehicle waits for room at an entrance
LOST_CHECK = 50  # steps between checks for vehicles that SUMO dropped at an entrance


class SumoTraffic:
    """One running SUMO simulation on one route.

    Args:
      route: the ego's road.
      config: settings.
      seed: of all random numbers.
      with_ego: the traffic reacts to the truck.
      lanes: of an earlier simulation on the same route, reused to save time.

    Attributes:
      replayed: recorded vehicles that are put into SUMO, or None.
      observation: reads the vehicles after each step.
      scenario: the events with conditions and those of vehicles on a plan.

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
        self.config = config
        self.replayed: ReplayedVehicles | None = None
        self._steps = 0
        walkways = config.pedestrians > 0.0
        net = build_network(route, whole=config.scope == "map", walkways=walkways)
        types = "".join(t.to_sumo_xml(config.speed_limit) for t in config.types)
        if walkways:
            types += pedestrian_type_xml()
        self.session = Session(
            net.path,
            types + ego_type_xml(config.footprint),
            config.step_length,
            seed,
            depart_delay=ENTRY_WAIT if config.steady is None else LEVEL_ENTRY_WAIT,
        )
        with self.session.guard("setting up the traffic"):
            if lanes is None:
                lanes = RouteLanes(self.session, net, route, config.oncoming)
            else:
                lanes.bind(self.session)
            self.lanes = lanes
            self.vehicles = Vehicles(self.session, config.types)
            self.signals = TrafficController(self.session, lanes, self.vehicles, config)
            rng = np.random.default_rng(seed)
            self._demand = Demand(
                self.session, lanes, self.vehicles, config, rng, self.signals.limits
            )
            self.scenario = Scenario(config, route, self.signals.events, self._take, seed)
            self.signals.events.records = self.scenario.records
            actors = self.scenario.actors
            self._actors = ReplayedVehicles(self.session, lanes, actors, config.step_length, ACTOR)
        self._ego = EgoInTraffic(self.session, lanes, config)
        self._with_ego = with_ego
        self._held: set[str] = set()
        self._turns: OppositeTurns | None = None
        if config.scope == "map":
            with self.session.guard("setting up the traffic"):
                self._turns = OppositeTurns(self.session, lanes.net, EGO)
        self._pedestrians: Pedestrians | None = None
        if walkways:
            with self.session.guard("setting up the pedestrians"):
                self._pedestrians = Pedestrians(self.session, lanes, config, seed)
        self._api = self.session.api
        self.observation = Observation(self.session, lanes, self.vehicles, config)
        self._lane_changer = (
            LaneChanger(self.session, lanes.graph, self.vehicles, config)
            if config.lane_change == "mobil"
            else None
        )
        self.vehicles.when_forgotten(self.observation.forget)
        if self._lane_changer is not None:
            self.vehicles.when_forgotten(self._lane_changer.forget)

    @property
    def time(self) -> float:
        """Traffic time [s]."""
        return self._steps * self.config.step_length

    def begin(self, ego: EgoState | None) -> VehicleFrame:
        """Populates the road around the ego; returns the vehicles at time zero."""
        with self.session.guard("populating the road"):
            self.signals.begin(None if ego is None else ego.station)
            steady = self.config.steady
            if steady is not None and self.config.level == "F":
                # Only a bottleneck ahead keeps traffic dense: without one a queue dissolves.
                end = self.lanes.route.length
                self.signals.set_speed_limit(
                    BOTTLENECK_RATIO * steady.speed, max(end - BOTTLENECK, 0.0), end
                )
            if self.replayed is not None:
                self.replayed.place(0.0)
            self._demand.fill(None if ego is None else self._ego.room(ego))
        if self._with_ego and ego is not None:
            self._ego.place(ego)
        self.session.step()
        with self.session.guard("populating the road"):
            self._demand.discard_pending()
            self._demand.trim()
            self._drop_arrived()
            return self.scenario.observe(0.0, ego, self._observe(ego))

    def advance(self, ego: EgoState | None) -> VehicleFrame:
        """Advances one step; `ego` is the state at its end. Returns the vehicles then."""
        with self.session.guard("adding vehicles"):
            station = None if ego is None else ego.station
            if self._steps % LOST_CHECK == 0:
                self.vehicles.drop_lost()
            self._demand.spawn(station, None if ego is None else self._sight(ego))
            if self._pedestrians is not None:
                self._pedestrians.spawn()
            self.signals.step(self.time, station)
            if self._lane_changer is not None:
                self._lane_changer.step(self.time, lambda: self._demand.entries(station))
            if self.replayed is not None:
                self.replayed.place(self.time + self.config.step_length)
            if len(self.scenario):
                end = self.time + self.config.step_length
                self.scenario.advance(end, ego)
                self._actors.place(end)
        if self._with_ego and ego is not None:
            self._ego.place(ego)
        self.session.step()
        self._steps += 1
        with self.session.guard("reading the vehicles"):
            self._drop_arrived()
            return self.scenario.observe(self.time, ego, self._observe(ego))

    def _take(self, row: TrackedVehicle) -> float:
        """Removes a vehicle that moves on a plan from now on; returns its desired speed [m/s]."""
        if row.id not in self.vehicles:
            return row.speed
        desired = self.vehicles.desired_speed(row.id)
        self._api.vehicle.remove(row.id)
        self.vehicles.forget(row.id)
        return desired

    def _sight(self, ego: EgoState) -> Sight:
        """The truck's place, near which no vehicle begins or ends inside the map."""
        x, y = self.lanes.to_sumo(ego.x, ego.y)
        return Sight(x, y, self.config.clear_distance + self.config.footprint.length)

    def _observe(self, ego: EgoState | None) -> VehicleFrame:
        boxes = self._ego.boxes(ego) if self._with_ego and ego is not None else ()
        frame = self.observation.read(ego, boxes)
        held = self.observation.held
        if self._turns is not None:
            held = merged(held.items(), self._turns.held().items())
        if held or self._held:
            # The limits of lane changes and turns apply in addition to SUMO's car-following.
            set_speed = self._api.vehicle.setSpeed
            for name in sorted(self._held - held.keys()):
                if name in self.vehicles:
                    set_speed(name, -1.0)
            self._held = {name for name in held if not self.vehicles.is_scripted(name)}
            for name in sorted(self._held):
                set_speed(name, held[name])
        if self._pedestrians is not None:
            frame = VehicleFrame.joined(frame, self._pedestrians.frame(ego, self._with_ego))
        return frame

    def close(self) -> None:
        """Ends SUMO."""
        self.session.close()

    def _drop_arrived(self) -> None:
        for name in self._api.simulation.getArrivedIDList():
            self.vehicles.forget(name)
