"""Traffic controller: lights, limits, closed lanes and scripted vehicles of a running traffic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from iits_mj.core.errors import InputError
from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.overrides import Undo
from traffic_bridge.session import Session
from traffic_bridge.signals.event_runner import EventRunner
from traffic_bridge.signals.events import LONGEST
from traffic_bridge.signals.lights import LightAhead, LightPhase, TrafficLights
from traffic_bridge.signals.limits import SpeedLimits
from traffic_bridge.signals.merging import MergeGuide
from traffic_bridge.signals.obstructions import (
    CLOSURE_NOTICE,
    HAZARD_NOTICE,
    SCRIPTED,
    Obstructions,
)
from traffic_bridge.vehicles.demand import MOBIL_MODE
from traffic_bridge.vehicles.departures import Departure
from traffic_bridge.vehicles.registry import Vehicles
from traffic_bridge.vehicles.scripted import SUMO_MODE, Manner, ScriptedVehicle, ScriptedVehicles


class TrafficController:
    """Lights, limits, closures and scripts; PureSim and InterSim offer it as `traffic.signals`.

    Args:
      session: the running SUMO.
      lanes: of the route.
      vehicles: where scripted vehicles are noted.
      config: step length, lane-change model, events and departures.

    Attributes:
      traffic_lights, limits, obstructions: the parts that do the work; the methods here are the
        short way to them.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, config: TrafficConfig
    ) -> None:
        self._lanes = lanes
        self._vehicles = vehicles
        self._config = config
        mode = MOBIL_MODE if config.lane_change == "mobil" else SUMO_MODE
        self.traffic_lights = TrafficLights(session, lanes)
        self.limits = SpeedLimits(session, lanes, vehicles, config.step_length)
        self._guide = MergeGuide(session, lanes, vehicles, config.step_length)
        self._scripted = ScriptedVehicles(session, lanes, vehicles, mode)
        self.obstructions = Obstructions(lanes, self._scripted, self._guide, config)
        self._departures = sorted(config.departures, key=lambda departure: departure.time)
        self._departed = 0
        self._events = EventRunner(config.events, self)

    # The run -----------------------------------------------------------------------------------

    def begin(self, ego_station: float | None) -> None:
        """Checks all events and departures against net and route; begins what is due at once.

        Raises:
          InputError: an event or departure names a lane, light or type that is not there.
        """
        for number, departure in enumerate(self._departures):
            self._scripted.check(self._scripted_vehicle(number, departure))
        self._events.check()
        self._events.step(0.0, ego_station)

    def step(self, time: float, ego_station: float | None) -> None:
        """Everything that is due before a step of the traffic.

        Args:
          time: of the traffic [s].
          ego_station: of the truck's steer axle [m]; None without a truck.
        """
        self._events.step(time, ego_station)
        while (
            self._departed < len(self._departures)
            and self._departures[self._departed].time <= time + 1e-9
        ):
            departure = self._departures[self._departed]
            self._scripted.place([self._scripted_vehicle(self._departed, departure)])
            self._departed += 1
        self._scripted.step()
        self._vehicles.dress()
        self._guide.step()
        self.limits.step()

    # Traffic lights ----------------------------------------------------------------------------

    def lights(self) -> tuple[str, ...]:
        """Names of the traffic lights of the net, sorted."""
        return self.traffic_lights.names()

    def state(self, light: str) -> str:
        """State of a light, one letter a link, see `LightPhase`."""
        return self.traffic_lights.state(light)

    def set_state(self, light: str, state: str) -> None:
        """Sets a light by hand, see `TrafficLights.set_state`."""
        self.traffic_lights.set_state(light, state)

    def programs(self, light: str) -> tuple[str, ...]:
        """Names of a light's programs."""
        return self.traffic_lights.programs(light)

    def phases(self, light: str, program: str | None = None) -> tuple[LightPhase, ...]:
        """The phases of a program, of the running one by default."""
        return self.traffic_lights.phases(light, program)

    def define_program(self, light: str, program: str, phases: Sequence[LightPhase]) -> None:
        """Adds a program of one's own, see `TrafficLights.define_program`."""
        self.traffic_lights.define_program(light, program, phases)

    def run_program(self, light: str, program: str = "0") -> None:
        """Lets a light run by one of its programs."""
        self.traffic_lights.run_program(light, program)

    def phase(self, light: str) -> int:
        """Index of the running phase of a light's program, see `TrafficLights.phase`."""
        return self.traffic_lights.phase(light)

    def set_phase(self, light: str, phase: int, duration: float | None = None) -> None:
        """Goes to a phase of the running program at once, see `TrafficLights.set_phase`."""
        self.traffic_lights.set_phase(light, phase, duration)

    def light_ahead(self, station: float, lane: int | None = None) -> LightAhead | None:
        """The next light on the ego's route, see `TrafficLights.ahead`."""
        return self.traffic_lights.ahead(station, lane)

    # Speed limits ------------------------------------------------------------------------------

    def set_speed_limit(
        self, limit: float, start: float = 0.0, end: float = LONGEST, lane: int | None = None
    ) -> int:
        """Sets a limit on a stretch of the route; a number for `lift_speed_limit` comes back.

        See `SpeedLimits.set` for arguments and errors.
        """
        return self.limits.set(limit, start, end, lane)

    def lift_speed_limit(self, number: int) -> None:
        """Takes a limit away."""
        self.limits.lift(number)

    def reset_speed_limits(self) -> None:
        """Gives every lane back the limit it had on the map."""
        self.limits.reset()

    def speed_limit(self, station: float, lane: int = 0) -> float:
        """The limit that holds at a station of a lane [m/s]."""
        return self.limits.at(station, lane)

    # Obstructions ------------------------------------------------------------------------------

    def close_lane(
        self, lane: int, start: float, end: float, notice: float = CLOSURE_NOTICE
    ) -> int:
        """Closes a lane, see `Obstructions.close_lane`; a number for `open_lane` comes back."""
        return self.obstructions.close_lane(lane, start, end, notice)

    def open_lane(self, number: int) -> None:
        """Takes a closure away."""
        self.obstructions.open_lane(number)

    def stop_vehicle(
        self,
        station: float,
        lane: int = 0,
        type: str = "car",
        notice: float | None = HAZARD_NOTICE,
    ) -> int:
        """Lets a vehicle stand, see `Obstructions.stop_vehicle`; a number for `release`."""
        return self.obstructions.stop_vehicle(station, lane, type, notice)

    def convoy(
        self, station: float, speed: float, lane: int = 0, count: int = 3, type: str = "truck"
    ) -> int:
        """Puts a convoy on a lane, see `Obstructions.convoy`; a number for `release`."""
        return self.obstructions.convoy(station, speed, lane, count, type)

    def release(self, number: int) -> None:
        """Lets a stopped vehicle or a convoy drive on as others do."""
        self.obstructions.release(number)

    def has_vehicles(self, target: str) -> bool:
        """Whether there is a type, or a vehicle on the road, of this name."""
        if target in self._vehicles:
            self._vehicles.drop_lost()
        return target in self._vehicles or any(t.name == target for t in self._vehicles.types())

    def check_target(self, target: str) -> None:
        """Refuses the name of what can be changed when it is no type's and can be no vehicle's.

        Raises:
          InputError: no type is called so, and names of vehicles begin otherwise.
        """
        types = [kind.name for kind in self._vehicles.types()]
        family, dot, _ = target.partition(".")
        if target not in types and not (dot and family in (*types, *SCRIPTED)):
            raise InputError(
                f"target {target!r}: allowed are the types {', '.join(types)}, and names of "
                f"vehicles, which begin with their type's, {', '.join(SCRIPTED)}, and a dot"
            )

    def change_vehicles(self, target: str, values: dict[str, Any]) -> Undo:
        """Changes vehicles; what comes back undoes it, see `Vehicles.change`."""
        return self._vehicles.change(target, **values)

    # Inside ------------------------------------------------------------------------------------

    def _scripted_vehicle(self, number: int, departure: Departure) -> ScriptedVehicle:
        kind = self._config.type_of(departure.type)
        station = departure.station
        if station is None:
            first = self._lanes.within(0.0, math.inf, departure.lane)
            begin = min((float(table.station[0]) for table in first), default=0.0)
            station = max(begin, 0.0) + kind.length + 0.5
        speed = departure.speed
        if speed is None:
            speed = kind.desired_speed_mean * self._config.speed_limit
        return ScriptedVehicle(
            f"{kind.name}.d{number:05d}", kind.name, departure.lane, station, speed, Manner.FREE
        )
