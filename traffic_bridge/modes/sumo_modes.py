"""PureSim and InterSim, and the interface of all modes.

Every mode has the same use: `reset(ego)`, then `step(ego)` each 0.1 s with the truck's state at the
end of the step, then `close()`; each is a context manager.
"""

from __future__ import annotations

from types import NoneType
from typing import Protocol, runtime_checkable

from iits_mj.core.checks import is_whole, shown, whole
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import RoadMap, Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.ego import check_ego
from traffic_bridge.modes.sumo_traffic import SumoTraffic
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.scenario.runner import Scenario
from traffic_bridge.session import Session
from traffic_bridge.signals.controller import TrafficController
from traffic_bridge.vehicles.registry import Vehicles


@runtime_checkable
class Traffic(Protocol):
    """The interface of every mode."""

    route: Route

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts the traffic again; returns the vehicles at time zero, sorted by name."""

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; `ego` is the state at its end. Returns the vehicles then, sorted."""

    def close(self) -> None:
        """Ends the traffic; may be called again."""
        return

    def signal_controller(self) -> TrafficController | None:
        """Returns the lights and changing limits; None if the traffic has none."""
        return None

    def exact_vehicles(self, time: float) -> VehicleFrame | None:  # noqa: ARG002
        """Returns the vehicles with known places between two steps; None if there are none."""
        return None

    def running_scenario(self) -> Scenario | None:
        """Returns the running events and their records; None if the traffic has none."""
        return None


class Mode(Traffic, Closing):
    """Base of every mode: a context manager with the defaults of `Traffic`."""


class PureSim(Mode):
    """Traffic with IDM and a lane-change model that does not react to the truck.

    Args:
      route: the ego's road.
      config: settings.
      seed: the same seed gives bit-identical vehicles in every run and process.

    Raises:
      InputError: no route or configuration, or the seed is no whole number from 0 to 2^31 - 1.
    """

    mode = "PureSim"
    with_ego = False

    def __init__(self, route: Route, config: TrafficConfig | None = None, seed: int = 0) -> None:
        self.route = _checked_route(self.mode, route)
        if not isinstance(config, (TrafficConfig, NoneType)):
            raise InputError(
                f"{self.mode} needs a TrafficConfig, not {shown(config)}, for example "
                'TrafficConfig(density="medium")'
            )
        self.config = TrafficConfig() if config is None else config
        if not is_whole(seed) or not 0 <= seed < 2**31:
            raise InputError(f"seed {shown(seed)}: a whole number from 0 to {2**31 - 1}")
        self.seed = whole("seed", seed)
        self._world: SumoTraffic | None = None
        self._lanes: RouteLanes | None = None

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""
        return self._running.time

    @property
    def vehicles(self) -> Vehicles:
        """The vehicles' types and parameters, which can be changed."""
        return self._running.vehicles

    @property
    def signals(self) -> TrafficController:
        """Traffic lights, speed limits, lane closures and events."""
        return self._running.signals

    def signal_controller(self) -> TrafficController | None:
        """Returns the lights and changing limits."""
        return self.signals

    def running_scenario(self) -> Scenario | None:
        """Returns the running events."""
        return self._running.scenario

    @property
    def session(self) -> Session:
        """The running SUMO, for functions outside this interface."""
        return self._running.session

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts SUMO again and populates the road.

        Args:
          ego: the truck, around which space is kept free; None: no truck, and all vehicles are
            reported.

        Returns:
          The vehicles at time zero, sorted by name.

        Raises:
          TrafficError: SUMO fails, or already runs in this process.
          MapError: SUMO cannot use the map.
        """
        self.close()
        if ego is not None:
            check_ego(ego, self.route if self.with_ego else None)
        self._world = SumoTraffic(self.route, self.config, self.seed, self.with_ego, self._lanes)
        self._lanes = self._world.lanes
        self._prepare(self._world)
        with self._world.session.guard("beginning the traffic"):
            return self._world.begin(ego)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step.

        Args:
          ego: the truck's state at the end of the step.

        Returns:
          The vehicles within the view range of the truck at the end of the step, sorted by name.
        """
        world = self._running
        if ego is not None:
            check_ego(ego, self.route if self.with_ego else None)
        # Any exception in a step, also an interrupt, ends SUMO.
        with world.session.guard("advancing the traffic"):
            return world.advance(ego)

    def close(self) -> None:
        """Ends SUMO; may be called again."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def _prepare(self, world: SumoTraffic) -> None:
        """Adds the parts of a mode to a new simulation."""

    @property
    def _running(self) -> SumoTraffic:
        if self._world is None:
            raise TrafficError("the traffic has not been started: call reset() first")
        return self._world


class InterSim(PureSim):
    """Traffic that reacts to the truck: brakes for it and overtakes it without cutting in.

    In SUMO the truck has its true pose and the length of the whole combination. Arguments and
    errors are those of `PureSim`; `reset` without an ego puts the truck at the route's beginning.
    """

    mode = "InterSim"
    with_ego = True

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts SUMO again, with the truck on the road; see `PureSim.reset`."""
        return super().reset(self._at_start() if ego is None else ego)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; the ego's state is that at its end; see `PureSim.step`."""
        if ego is None:
            raise InputError("InterSim.step needs the ego's state; PureSim runs without it")
        return super().step(ego)

    def _at_start(self) -> EgoState:
        footprint = self.config.footprint
        station = min(footprint.length + 2.0, self.route.length)
        offset = self.route.lane_offset(0, station)
        p = self.route.evaluate(station, offset)
        return EgoState(
            x=float(p.x),
            y=float(p.y),
            z=float(p.z),
            yaw=float(p.heading),
            station=station,
            offset=offset,
            trailer_offset=offset,
        )


MODES: dict[str, type[PureSim]] = {mode.mode: mode for mode in (InterSim, PureSim)}


def _checked_route(mode: str, route: object) -> Route:
    if isinstance(route, Route):
        return route
    if isinstance(route, RoadMap):
        raise InputError(f"{mode} needs a Route, not a RoadMap: give road_map.route()")
    raise InputError(f"{mode} needs a Route, not {shown(route)}: RoadMap.builtin().route() is one")
