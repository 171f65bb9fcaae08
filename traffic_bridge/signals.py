"""Traffic controller: traffic lights, speed limits and closed lanes of a running simulation."""

from __future__ import annotations

import math

from iits_mj.errors import InputError
from traffic_bridge.lanes import RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.vehicles import Vehicles

BLOCKER = "blocker"
BLOCKER_SPACING = 80.0  # [m] between the safety trucks of a long closure
_LIGHTS = "rRyYgGuoOs"


class TrafficController:
    """Lights, limits and closures; PureSim and InterSim offer it as `traffic.signals`.

    Args:
      session: the running SUMO.
      lanes: of the route.
      vehicles: where the standing trucks of closures are noted.
    """

    def __init__(self, session: Session, lanes: RouteLanes, vehicles: Vehicles) -> None:
        self._session = session
        self._vehicles = vehicles
        self._api = session.api
        self._lanes = lanes
        self._limits: dict[str, float] = {}
        self._closures: dict[int, list[str]] = {}
        self._count = 0
        self._defined = False

    # Traffic lights ----------------------------------------------------------------------------

    def lights(self) -> tuple[str, ...]:
        """Names of the traffic lights of the net, sorted."""
        return tuple(sorted(self._api.trafficlight.getIDList()))

    def state(self, light: str) -> str:
        """State of a light, one letter a link: r red, y yellow, g and G green, u red-yellow."""
        self._check_light(light)
        return str(self._api.trafficlight.getRedYellowGreenState(light))

    def set_state(self, light: str, state: str) -> None:
        """Sets a light by hand; it stays until `run_program`.

        Args:
          light: its name.
          state: one letter a link as `state` gives them, or a single letter for all links.

        Raises:
          InputError: no such light, a wrong letter or a wrong number of letters.
        """
        links = len(self.state(light))
        state = state * links if len(state) == 1 else state
        if len(state) != links or any(letter not in _LIGHTS for letter in state):
            raise InputError(
                f"state {state!r} of traffic light {light!r}: {links} letters of {_LIGHTS!r}"
            )
        with self._session.guard(f"setting traffic light {light}"):
            self._api.trafficlight.setRedYellowGreenState(light, state)

    def programs(self, light: str) -> tuple[str, ...]:
        """Names of a light's programs."""
        self._check_light(light)
        return tuple(logic.programID for logic in self._api.trafficlight.getAllProgramLogics(light))

    def run_program(self, light: str, program: str = "0") -> None:
        """Lets a light run by one of its programs again."""
        if program not in self.programs(light):
            raise InputError(
                f"program {program!r} of traffic light {light!r}: there are "
                f"{', '.join(self.programs(light))}"
            )
        with self._session.guard(f"setting traffic light {light}"):
            self._api.trafficlight.setProgram(light, program)

    def phase(self, light: str) -> int:
        """Index of the running phase of a light's program."""
        self._check_light(light)
        return int(self._api.trafficlight.getPhase(light))

    # Speed limits ------------------------------------------------------------------------------

    def set_speed_limit(
        self, limit: float, start: float = 0.0, end: float = math.inf, lane: int | None = None
    ) -> int:
        """Sets a speed limit on every SUMO lane that overlaps an interval of the route.

        A limit holds on whole SUMO lanes, which end where the map's roads or lane sections do.

        Args:
          limit: [m/s].
          start: station [m].
          end: station [m].
          lane: index from the right; None for all lanes.

        Returns:
          The number of SUMO lanes changed.

        Raises:
          InputError: the limit is not between 1 and 70 m/s, or no lane lies in the interval.
        """
        if not (math.isfinite(limit) and 1.0 <= limit <= 70.0):
            raise InputError(f"speed limit {limit!r} m/s: allowed is 1 to 70")
        tables = self._lanes.within(start, end, lane)
        if not tables:
            raise InputError(f"no lane {lane} of the route between stations {start:g} and {end:g}")
        for table in tables:
            self._limits.setdefault(table.id, self._api.lane.getMaxSpeed(table.id))
            self._api.lane.setMaxSpeed(table.id, limit)
        return len(tables)

    def reset_speed_limits(self) -> None:
        """Gives every lane back the limit it had on the map."""
        for lane, limit in self._limits.items():
            self._api.lane.setMaxSpeed(lane, limit)
        self._limits.clear()

    # Closed lanes ------------------------------------------------------------------------------

    def close_lane(self, lane: int, start: float, end: float) -> int:
        """Closes a lane by standing safety trucks, which the ego sees as vehicles too.

        Args:
          lane: index from the right.
          start: station [m].
          end: station [m].

        Returns:
          A number to give to `open_lane`.

        Raises:
          InputError: the interval is not on the route, or the lane does not exist there.
        """
        if not (math.isfinite(start) and math.isfinite(end) and end > start):
            raise InputError(f"closure from {start!r} to {end!r}: needs start < end, finite")
        if not self._defined:
            # A standing truck is a rigid truck to everybody who looks at it.
            self._api.vehicletype.copy("truck", BLOCKER)
            self._defined = True
        number = self._count
        self._count += 1
        # All places are found before the first truck is put down: a closure is whole or not at all.
        first = start + self._api.vehicletype.getLength(BLOCKER)
        places = []
        for k in range(max(int((end - first) / BLOCKER_SPACING) + 1, 1)):
            station = first + k * BLOCKER_SPACING
            table = self._lanes.find(lane, station)
            if table is None:
                raise InputError(f"lane {lane} does not exist at station {station:g}")
            places.append((table, table.position_of(station)))
        names: list[str] = []
        for table, position in places:
            name = f"{BLOCKER}.{number}.{len(names)}"
            route = f"along.{self._lanes.edges.index(table.edge)}"
            with self._session.guard(f"closing lane {lane}"):
                self._api.vehicle.add(name, route, typeID=BLOCKER, departSpeed="0")
                self._api.vehicle.moveTo(name, table.id, position)
                self._api.vehicle.setSpeedMode(name, 0)
                self._api.vehicle.setSpeed(name, 0.0)
                self._api.vehicle.setLaneChangeMode(name, 0)
            self._vehicles.add(name, "truck", 0.0)
            names.append(name)
        self._closures[number] = names
        return number

    def open_lane(self, number: int) -> None:
        """Takes a closure away.

        Raises:
          InputError: there is no such closure.
        """
        if number not in self._closures:
            raise InputError(f"closure {number!r}: there are {sorted(self._closures)}")
        for name in self._closures.pop(number):
            with self._session.guard("opening a lane"):
                self._api.vehicle.remove(name)
            self._vehicles.forget(name)

    def _check_light(self, light: str) -> None:
        if light not in self._api.trafficlight.getIDList():
            raise InputError(
                f"no traffic light {light!r} in the net; there are: {', '.join(self.lights())}"
            )
