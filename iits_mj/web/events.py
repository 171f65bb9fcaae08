"""Events that a viewer triggers: other vehicles, closed lanes, failures of the truck, wind."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.units import KMH
from iits_mj.simulation import Simulation
from traffic_bridge.signals.controller import TrafficController
from traffic_bridge.vehicles.registry import Vehicles

# An event of the traffic ends after this time [s].
_TRAFFIC_TIME = 30.0
_BRAKING_TIME = 4.0
_GUST_TIME = 3.0
GUST = 18.0  # [m/s]
WIND_MAX = 25.0  # [m/s]


class Events:
    """Triggers events of a running drive, and ends them in simulated time.

    Args:
      simulation: the drive.

    Attributes:
      wind: steady wind from the left [m/s].
      names: of the events that this drive offers.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._ending: list[tuple[float, Callable[[], None]]] = []
        self.wind, self._gust_end = 0.0, -math.inf
        self._of_traffic: dict[str, Callable[[], str]] = {
            "Leader brakes hard": self._leader_brakes,
            "Slow truck ahead": self._slow_truck,
            "Stopped car ahead": self._stopped_car,
            "Lane closed ahead": self._closed_lane,
            "Limit 40 km/h ahead": self._limit,
        }
        self._of_truck: dict[str, Callable[[], str]] = {
            "Gust from the left": self._gust,
            "Front brakes lose air": lambda: self._leak("front"),
            "Drive brakes lose air": lambda: self._leak("drive"),
            "Trailer brakes lose air": lambda: self._leak("trailer"),
            "Front left tire bursts": self._puncture,
            "Repair the truck": self._repair,
        }
        if not simulation.truck.parameters.couplings:
            del self._of_truck["Trailer brakes lose air"]
        known = simulation.traffic is not None
        if not known or simulation.traffic.signal_controller() is None:  # type: ignore[union-attr]
            self._of_traffic = {}
        self.names = (*self._of_traffic, *self._of_truck)

    def trigger(self, name: str) -> str:
        """Begins an event; returns what happens, in words.

        Raises:
          InputError: there is no such event, or it is not possible here.
        """
        event = (self._of_traffic | self._of_truck).get(name)
        if event is None:
            raise InputError(f"event {name!r}: use one of {', '.join(self.names)}")
        return event()

    def advance(self) -> None:
        """Ends the events that are over and sets the wind; call it before every cycle."""
        time = self._simulation.time
        over = [end for until, end in self._ending if until <= time]
        self._ending = [entry for entry in self._ending if entry[0] > time]
        for end in over:
            end()
        gust = GUST if time < self._gust_end else 0.0
        yaw = self._simulation.frame.ego.yaw
        # From the left: toward the truck's right side.
        across = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        self._simulation.truck.model.opt.wind[:] = (self.wind + gust) * across

    @property
    def _vehicles(self) -> Vehicles:
        vehicles = getattr(self._simulation.traffic, "vehicles", None)
        if not isinstance(vehicles, Vehicles):
            raise InputError("this traffic does not react: use SUMO traffic")
        return vehicles

    @property
    def _signals(self) -> TrafficController:
        traffic = self._simulation.traffic
        signals = None if traffic is None else traffic.signal_controller()
        if signals is None:
            raise InputError("this traffic has no events: use SUMO traffic")
        return signals

    def _until(self, duration: float, end: Callable[[], None]) -> None:
        self._ending.append((self._simulation.time + duration, end))

    def _leader_brakes(self) -> str:
        simulation = self._simulation
        scene, lane = simulation.scene, simulation.frame.lane
        leader = None if lane < 0 else scene.neighbors.leader_in_lane(simulation.route, lane)
        if leader is None or leader.gap > 200.0:
            raise InputError("no vehicle is ahead of the truck in its lane within 200 m")
        vehicles = self._vehicles
        undo = vehicles.change(leader.id, deceleration=6.0)
        vehicles.hold_below(leader.id, 1.0, "viewer")

        def end() -> None:
            vehicles.hold_below(leader.id, None, "viewer")
            undo()

        self._until(_BRAKING_TIME, end)
        return f"the vehicle {leader.gap:.0f} m ahead brakes for {_BRAKING_TIME:g} s"

    def _slow_truck(self) -> str:
        frame = self._simulation.frame
        lane, station = self._place(40.0 + 2.0 * frame.ego.speed)
        number = self._signals.convoy(
            station + 12.0, max(0.5 * frame.ego.speed, 4.0), lane, count=1, type="truck"
        )
        self._until(_TRAFFIC_TIME, lambda: self._signals.release(number))
        return "a truck at half the speed appears ahead, as soon as its place is free"

    def _stopped_car(self) -> str:
        lane, station = self._place(200.0)
        number = self._signals.stop_vehicle(station, lane)
        self._until(_TRAFFIC_TIME, lambda: self._signals.release(number))
        return f"a car with hazard lights stands 200 m ahead for {_TRAFFIC_TIME:g} s"

    def _closed_lane(self) -> str:
        lane, station = self._place(400.0)
        number = self._signals.close_lane(lane, station, station + 100.0)
        self._until(2.0 * _TRAFFIC_TIME, lambda: self._signals.open_lane(number))
        return f"the truck's lane is closed 400 m ahead for {2.0 * _TRAFFIC_TIME:g} s"

    def _limit(self) -> str:
        _, station = self._place(150.0)
        limit = self._signals.set_speed_limit(40.0 * KMH, station, station + 500.0)
        self._until(2.0 * _TRAFFIC_TIME, lambda: self._signals.lift_speed_limit(limit))
        return "a limit of 40 km/h begins 150 m ahead, for 500 m"

    def _place(self, ahead: float) -> tuple[int, float]:
        """Returns the truck's lane and a station this far ahead of its front bumper.

        Raises:
          InputError: the road or the lane ends before.
        """
        simulation = self._simulation
        front = simulation.frame.ego.station + simulation.truck.footprint.front_overhang
        station = front + ahead
        lane = max(simulation.frame.lane, 0)
        if station > simulation.route.length - 150.0:
            raise InputError("the road ends too soon for this event")
        if lane >= int(simulation.route.lane_count(station)):
            raise InputError("the truck's lane ends before the place of this event")
        return lane, station

    def _gust(self) -> str:
        self._gust_end = self._simulation.time + _GUST_TIME
        return f"wind of {GUST:g} m/s from the left for {_GUST_TIME:g} s"

    def _leak(self, circuit: str) -> str:
        self._simulation.truck.faults.leak(circuit)
        return f"the {circuit} brake circuit loses its air"

    def _puncture(self) -> str:
        faults = self._simulation.truck.faults
        wheel = faults.wheels[0]
        faults.puncture(wheel)
        return f"the tire {wheel.replace('_', ' ')} has lost its pressure"

    def _repair(self) -> str:
        self._simulation.truck.faults.clear()
        return "the truck is repaired; emptied circuits fill again"
