"""Scripted vehicles: stopped vehicles, convoys and listed departures.

A vehicle waits until its place is free and all followers can still stop, so that a script never
causes a collision.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

from iits_mj.core.errors import InputError
from traffic_bridge.network.route_lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.vehicles.registry import Vehicles

REACTION = 1.0  # [s] before a driver brakes (judgement)
HARD_BRAKING = 3.0  # [m/s2] that followers may need when a vehicle appears (judgement)
SIDE_CLEARANCE = 5.0  # [m] that must be free ahead and behind on the adjacent lanes
LOOK = 250.0  # [m] behind and ahead of a place in which other vehicles matter

# SUMO's lane-change modes (its manual, "lane change mode").
FIXED = 0  # never changes lanes
LEAVE_ENDING_LANE = 0b10_0000_0001  # leaves lanes that end, if there is a gap
SUMO_MODE = 0b0110_0101_0101  # SUMO's default: all motives, other vehicles keep their gaps

# SUMO's speed mode with all safety checks, and the speed value that returns control to its model.
SAFE_SPEED, MODEL_SPEED = 31, -1.0


class Manner(enum.Enum):
    """Behavior of a scripted vehicle: it stands, keeps its lane, or drives as ordinary traffic."""

    STANDING = "standing"
    KEEPING_LANE = "keeping lane"
    FREE = "free"


@dataclass(frozen=True)
class ScriptedVehicle:
    """A vehicle to be put on the road.

    Attributes:
      name: of the vehicle; type: name of its type.
      lane: of the route, from the right; station: of its front bumper [m].
      speed: initial and desired speed [m/s].
      manner: see `Manner`.
    """

    name: str
    type: str
    lane: int
    station: float
    speed: float
    manner: Manner


class ScriptedVehicles:
    """Puts scripted vehicles on the road and removes them.

    `free_mode` is SUMO's lane-change mode of ordinary traffic.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, free_mode: int
    ) -> None:
        self._session = session
        self._api = session.api
        self._lanes = lanes
        self._vehicles = vehicles
        self._free_mode = free_mode
        self._waiting: list[tuple[ScriptedVehicle, ...]] = []
        self._fresh: list[tuple[int, float, float]] = []
        self._routes: set[int] = set()

    def place(self, group: Sequence[ScriptedVehicle]) -> None:
        """Puts a group of vehicles on the road together, as soon as all have room.

        Raises:
          InputError: a place is not on the route, or a type is unknown; then none is placed.
        """
        for vehicle in group:
            self.check(vehicle)
        with self._session.guard("placing vehicles"):
            self._waiting.append(tuple(group))

    def check(self, vehicle: ScriptedVehicle) -> None:
        """Checks that a vehicle's type and lane exist.

        Raises:
          InputError: the type is unknown, or the lane does not exist there.
        """
        length = self._length(vehicle.type)
        for station in (vehicle.station, vehicle.station - length):
            if station < 0.0 or self._lanes.find(vehicle.lane, station) is None:
                raise InputError(
                    f"{vehicle.type} at station {vehicle.station:g} m: lane {vehicle.lane} "
                    f"does not exist at station {station:g} m"
                )

    def step(self) -> None:
        """Places the waiting groups that have room."""
        self._fresh.clear()
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        for group in waiting:
            if all(self._has_room(vehicle) for vehicle in group):
                for vehicle in group:
                    self._put(vehicle)
            else:
                self._waiting.append(group)

    def remove(self, names: Sequence[str]) -> None:
        """Removes vehicles from the road or the waiting list."""
        self._stop_waiting(names)
        for name in names:
            if name in self._vehicles:
                with self._session.guard(f"removing {name}"):
                    self._api.vehicle.remove(name)
                self._vehicles.forget(name)

    def release(self, names: Sequence[str], desired_speed: float) -> None:
        """Turns vehicles into ordinary traffic with a desired speed [m/s]."""
        self._stop_waiting(names)
        for name in names:
            if name in self._vehicles:
                self._vehicles.unscript(name)
                with self._session.guard(f"releasing {name}"):
                    self._api.vehicle.setSpeedMode(name, SAFE_SPEED)
                    self._api.vehicle.setSpeed(name, MODEL_SPEED)
                    self._api.vehicle.setLaneChangeMode(name, self._free_mode)
                self._vehicles.change(name, desired_speed=desired_speed)

    def _stop_waiting(self, names: Sequence[str]) -> None:
        wanted = set(names)
        self._waiting = [g for g in self._waiting if not wanted & {p.name for p in g}]

    def _length(self, type_name: str) -> float:
        for kind in self._vehicles.types():
            if kind.name == type_name:
                return kind.length
        known = ", ".join(kind.name for kind in self._vehicles.types())
        raise InputError(f"vehicle type {type_name!r}: the types are {known}")

    def _has_room(self, vehicle: ScriptedVehicle) -> bool:
        front = vehicle.station
        rear = front - self._length(vehicle.type)
        for lane, other_front, other_rear in self._fresh:
            if lane == vehicle.lane and other_rear < front + 1.0 and other_front > rear - 1.0:
                return False
        api = self._api.vehicle
        for table in self._lanes.within(rear - LOOK, front + LOOK):
            aside = abs(table.lane - vehicle.lane)
            if aside > 1:
                continue
            for name in self._api.lane.getLastStepVehicleIDs(table.id):
                other_front, _ = table.at(api.getLanePosition(name))
                other_rear = other_front - api.getLength(name)
                speed = api.getSpeed(name)
                if aside:
                    # It may have left this lane in SUMO and still be shown on it.
                    if other_rear < front + SIDE_CLEARANCE and other_front > rear - SIDE_CLEARANCE:
                        return False
                elif other_front > front:
                    if other_rear - front < _room(vehicle.speed, speed):
                        return False
                elif rear - other_front < _room(speed, vehicle.speed):
                    return False
        return True

    def _put(self, vehicle: ScriptedVehicle) -> None:
        table = self._lanes.find(vehicle.lane, vehicle.station)
        if table is None:
            raise InputError(f"lane {vehicle.lane} ends before station {vehicle.station:g} m")
        name, api = vehicle.name, self._api.vehicle
        scripted = vehicle.manner is not Manner.FREE
        desired = self._vehicles.add(name, vehicle.type, vehicle.speed, scripted)
        with self._session.guard(f"placing {name}"):
            route = self._route(table)
            # SUMO refuses a departure that is faster than its type or than the limit of the edge's
            # first lane.
            limits = [self._api.lane.getMaxSpeed(lane) for lane in (table.id, f"{table.edge}_0")]
            fastest = self._api.vehicletype.getMaxSpeed(vehicle.type)
            # Slightly less, because SUMO compares the rounded text.
            speed = min(desired, vehicle.speed, fastest - 1e-3, *(v - 1e-3 for v in limits))
            api.add(name, route, typeID=vehicle.type, departSpeed=f"{speed:.3f}")
            api.moveTo(name, table.id, table.position_of(vehicle.station))
            if vehicle.manner is Manner.STANDING:
                api.setSpeedMode(name, 0)
                api.setSpeed(name, 0.0)
                api.setLaneChangeMode(name, FIXED)
            else:
                api.setMaxSpeed(name, desired)
                if scripted:
                    api.setLaneChangeMode(name, LEAVE_ENDING_LANE)
                else:
                    api.setLaneChangeMode(name, self._free_mode)
        length = self._length(vehicle.type)
        self._fresh.append((vehicle.lane, vehicle.station, vehicle.station - length))

    def _route(self, table: LaneTable) -> str:
        """The SUMO route from a lane's edge to the end of the ego's route."""
        index = self._lanes.edges.index(table.edge)
        name = f"scripted.{index}"
        if index not in self._routes:
            self._api.route.add(name, list(self._lanes.edges[index:]))
            self._routes.add(index)
        return name


def _room(behind: float, ahead: float) -> float:
    """Least gap [m] between a vehicle at speed `behind` and its leader at speed `ahead`."""
    braking = max(behind**2 - ahead**2, 0.0) / (2.0 * HARD_BRAKING)
    return 2.0 + behind * REACTION + braking
