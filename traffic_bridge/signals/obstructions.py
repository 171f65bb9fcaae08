"""Closed lanes, stopped vehicles and slow convoys in a running traffic."""

from __future__ import annotations

import itertools

from iits_mj.core.errors import InputError
from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.signals.events import LaneClosure, SlowConvoy, StoppedVehicle
from traffic_bridge.signals.merging import MergeGuide, Obstacle
from traffic_bridge.vehicles.scripted import Manner, ScriptedVehicle, ScriptedVehicles
from traffic_bridge.vehicles.types import VehicleType

BLOCKER_SPACING = 80.0  # [m] between the safety trucks of a long closure
CLOSURE_NOTICE = 400.0  # [m] before a closure in which drivers leave the lane
HAZARD_NOTICE = 200.0  # [m] at which hazard lights are seen
CONVOY_HEADWAY = 2.0  # [s] between the vehicles of a convoy
# Names of vehicles of events begin with one of these and a dot.
SCRIPTED = BLOCKER, STOPPED, CONVOY = "blocker", "stopped", "convoy"


class Obstructions:
    """Closes lanes, and adds stopped vehicles and convoys."""

    def __init__(
        self,
        lanes: RouteLanes,
        scripted: ScriptedVehicles,
        guide: MergeGuide,
        config: TrafficConfig,
    ) -> None:
        self._lanes = lanes
        self._scripted = scripted
        self._guide = guide
        self._config = config
        self._numbers = itertools.count()
        self._closures: dict[int, tuple[int, list[str]]] = {}
        self._groups: dict[int, tuple[list[str], str, int | None]] = {}

    def closed(self) -> tuple[Obstacle, ...]:
        """The obstacles with a warning: closures and vehicles with hazard lights."""
        return self._guide.obstacles()

    def close_lane(
        self, lane: int, start: float, end: float, notice: float = CLOSURE_NOTICE
    ) -> int:
        """Closes a lane with standing safety trucks, which the ego also sees as vehicles.

        Each truck appears as soon as its place is free and approaching vehicles can still stop.

        Args:
          lane: index from the outside.
          start: station of the first truck's rear [m].
          end: station [m].
          notice: distance before the start at which drivers begin to leave the lane [m].

        Returns:
          The number for `open_lane`.

        Raises:
          InputError: the interval is not on the route, or the lane does not exist there.
        """
        closure = LaneClosure(lane=lane, start=start, end=end, notice=notice)
        obstacle = self.check_closure(closure)
        number = next(self._numbers)
        types = self._config.types
        kind = next((kind for kind in types if kind.name == "truck"), types[0])
        stations = closure_places(closure, kind.length)
        group = [
            ScriptedVehicle(
                f"{BLOCKER}.{number}.{k}",
                kind.name,
                lane,
                station,
                0.0,
                Manner.STANDING,
            )
            for k, station in enumerate(stations)
        ]
        # All places are checked before the first truck is placed.
        for vehicle in group:
            self._scripted.check(vehicle)
        for vehicle in group:
            self._scripted.place([vehicle])
        names = [vehicle.name for vehicle in group]
        self._closures[number] = self._guide.add(obstacle), names
        return number

    def check_closure(self, closure: LaneClosure) -> Obstacle:
        """The obstacle of a closure; InputError if its lane does not exist at start or end."""
        for station in (closure.start, closure.end):
            if self._lanes.find(closure.lane, station) is None:
                raise InputError(f"lane {closure.lane} does not exist at station {station:g}")
        return Obstacle(closure.lane, closure.start, closure.end, closure.notice)

    def check(self, vehicle: ScriptedVehicle) -> None:
        """Checks that a vehicle's lane exists, see `ScriptedVehicles.check`."""
        self._scripted.check(vehicle)

    def open_lane(self, number: int) -> None:
        """Ends a closure; InputError if there is no such closure."""
        if number not in list(self._closures):
            raise InputError(f"closure {number!r}: there are {sorted(self._closures)}")
        obstacle, names = self._closures.pop(number)
        self._guide.remove(obstacle)
        self._scripted.remove(names)

    def stop_vehicle(
        self,
        station: float,
        lane: int = 0,
        type: str = "car",
        notice: float | None = HAZARD_NOTICE,
    ) -> int:
        """Puts a standing vehicle on a lane, as soon as its place is free.

        Args:
          station: of its front bumper [m].
          lane: from the outside.
          type: name of its type.
          notice: distance at which others see its hazard lights [m]; None: they are off.

        Returns:
          The number for `release`.

        Raises:
          InputError: the lane does not exist there, or the type is unknown.
        """
        # The event's class checks the values.
        StoppedVehicle(
            station=station, lane=lane, type=type, notice=0.0 if notice is None else notice
        )
        number = next(self._numbers)
        kind = self._config.type_of(type)
        name = f"{STOPPED}.{number}"
        self._scripted.place([ScriptedVehicle(name, type, lane, station, 0.0, Manner.STANDING)])
        warned = None
        if notice is not None:
            warned = self._guide.add(Obstacle(lane, station - kind.length, station, notice))
        self._groups[number] = [name], type, warned
        return number

    def convoy(
        self, station: float, speed: float, lane: int = 0, count: int = 3, type: str = "truck"
    ) -> int:
        """Puts vehicles that keep their lane on it, as soon as there is room for all of them.

        Args:
          station: of the first one's front bumper [m].
          speed: [m/s].
          lane: from the outside.
          count: number of vehicles.
          type: name of their type.

        Returns:
          The number for `release`.

        Raises:
          InputError: the lane does not exist there, or the type is unknown.
        """
        convoy = SlowConvoy(station=station, speed=speed, lane=lane, count=count, type=type)
        number = next(self._numbers)
        group = self.convoy_group(number, convoy)
        self._scripted.place(group)
        self._groups[number] = [vehicle.name for vehicle in group], type, None
        return number

    def convoy_group(self, number: int, convoy: SlowConvoy) -> list[ScriptedVehicle]:
        """The vehicles of a convoy, beginning with the first one."""
        kind = self._config.type_of(convoy.type)
        return [
            ScriptedVehicle(
                f"{CONVOY}.{number}.{k:02d}",
                convoy.type,
                convoy.lane,
                station,
                convoy.speed,
                Manner.KEEPING_LANE,
            )
            for k, station in enumerate(convoy_places(convoy, kind))
        ]

    def release(self, number: int) -> None:
        """Makes a stopped vehicle or a convoy drive like the others.

        Raises:
          InputError: there is no such vehicle or convoy.
        """
        if number not in list(self._groups):
            raise InputError(f"scripted vehicles {number!r}: there are {sorted(self._groups)}")
        names, type_name, warned = self._groups.pop(number)
        if warned is not None:
            self._guide.remove(warned)
        kind = self._config.type_of(type_name)
        self._scripted.release(names, kind.desired_speed_mean * self._config.speed_limit)


def closure_places(closure: LaneClosure, length: float) -> list[float]:
    """Stations of the front bumpers of a closure's safety trucks of a length [m]."""
    first = closure.start + length
    count = max(int((closure.end - first) / BLOCKER_SPACING) + 1, 1)
    return [first + k * BLOCKER_SPACING for k in range(count)]


def convoy_places(convoy: SlowConvoy, kind: VehicleType) -> list[float]:
    """Stations of the front bumpers of a convoy's vehicles of a type, from the first one [m]."""
    spacing = kind.length + kind.minimum_gap + convoy.speed * CONVOY_HEADWAY
    return [convoy.station - k * spacing for k in range(convoy.count)]
