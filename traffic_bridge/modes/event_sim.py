"""EventSim: the road users of scripted events alone, without SUMO."""

from __future__ import annotations

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.repsim import RepSim
from traffic_bridge.modes.sumo_modes import MODES, Mode, PureSim
from traffic_bridge.scenario.actions import SceneEvent, TruckEvent
from traffic_bridge.scenario.runner import Scenario


class EventSim(Mode):
    """An empty road, or recorded traffic, with the events that need no SUMO.

    Args:
      route: the truck's road.
      config: its events, types, view range, step and footprint are used.
      seed: of the places of swarms; nothing else is random.
      recorded: traffic among which the events take place, None for an empty road.

    Raises:
      InputError: an event needs SUMO.
    """

    mode = "EventSim"

    def __init__(
        self, route: Route, config: TrafficConfig, seed: int = 0, recorded: RepSim | None = None
    ) -> None:
        self.route, self.config, self.seed = route, config, seed
        for event in config.events:
            if not isinstance(event, (SceneEvent, TruckEvent)):
                raise InputError(
                    f"event {event.title}: {event.kind} needs SUMO traffic: use traffic-mode inter "
                    "or pure"
                )
        self._recorded = recorded
        self._scenario: Scenario | None = None
        self._steps = 0

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._steps * self.config.step_length

    def running_scenario(self) -> Scenario | None:
        """Returns the running events."""
        return self._scenario

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Begins again; see `Traffic`."""
        self._steps, self._scenario = 0, Scenario(self.config, self.route, seed=self.seed)
        others = VehicleFrame.empty() if self._recorded is None else self._recorded.reset(ego)
        return self._scenario.observe(0.0, ego, others)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; see `Traffic`."""
        if self._scenario is None:
            raise TrafficError("the traffic has not been started: call reset() first")
        self._steps += 1
        self._scenario.advance(self.time, ego)
        others = VehicleFrame.empty() if self._recorded is None else self._recorded.step(ego)
        return self._scenario.observe(self.time, ego, others)

    def exact_vehicles(self, time: float) -> VehicleFrame | None:
        """Returns the recorded vehicles at a time between two steps [s]."""
        if self._recorded is None or self._scenario is None:
            return None
        exact = self._recorded.exact_vehicles(time)
        if exact is None:
            return None
        return exact.without(self._scenario.actors.members)

    def close(self) -> None:
        """Ends the traffic; may be called again."""
        if self._recorded is not None:
            self._recorded.close()


# The modes that settings and a seed repeat.
Repeatable = PureSim | EventSim
REPEATABLE: dict[str, type[Repeatable]] = {**MODES, EventSim.mode: EventSim}
