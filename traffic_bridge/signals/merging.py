"""Drivers leave a lane before it is closed: what signs, arrows and hazard lights tell them.

In the stretch before an obstacle of which drivers are warned, nobody overtakes, and who is on the
lane of the obstacle is asked to leave it for the nearest open lane, as soon as others leave the
room. Who waits at the end of the lane is let in by one driver after the other, as at a zip (see
`courtesy`). This holds with both lane-change models: the vehicles are under these orders until they
are past the obstacle, then they go back to their model.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from iits_mj.errors import InputError
from traffic_bridge.network.lanes import LaneTable, RouteLanes
from traffic_bridge.network.upstream import upstream
from traffic_bridge.session import Session
from traffic_bridge.signals.courtesy import WAITING_SPEED, Courtesy, Waiting
from traffic_bridge.vehicles.registry import Vehicles

PERIOD = 0.5  # [s] between rounds of requests
# SUMO's lane-change mode in the stretch: away from lanes that end, room for others, our requests
# where others' gaps are respected, at a speed that fits a gap; no overtaking, no keeping right.
MERGING = 0b10_0000_0101


@dataclass(frozen=True)
class Obstacle:
    """A stretch of a lane that cannot be driven.

    Attributes:
      lane: from the right; start, end: stations [m]; notice: distance before the start from which
        on drivers know [m].
    """

    lane: int
    start: float
    end: float
    notice: float


class MergeGuide:
    """Asks drivers out of the way of obstacles; the traffic controller has one.

    Args:
      session: the running SUMO.
      lanes: of the route.
      vehicles: who may be asked.
      step_length: [s].
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, step_length: float
    ) -> None:
        self._session = session
        self._api = session.api
        self._lanes = lanes
        self._vehicles = vehicles
        self._every = max(1, round(PERIOD / step_length))
        self._step_length = step_length
        self._period = self._every * step_length
        self._duration = self._every * step_length + step_length
        self._steps = 0
        self._obstacles: dict[int, Obstacle] = {}
        self._leading: dict[int, frozenset[str]] = {}
        self._numbers = itertools.count()
        self._former_modes: dict[str, int] = {}
        self._courtesy = Courtesy(session, vehicles)

    def add(self, obstacle: Obstacle) -> int:
        """Warns of an obstacle; returns a number to give to `remove`."""
        number = next(self._numbers)
        self._obstacles[number] = obstacle
        # Lanes are counted from the right, so that the count changes where one begins or ends:
        # which lanes lead to the obstacle is told by the net.
        with self._session.guard("warning of an obstacle"):
            on = self._lanes.within(obstacle.start, obstacle.end, obstacle.lane)
            lanes = on + upstream(self._lanes, on, obstacle.notice)
        self._leading[number] = frozenset(table.id for table in lanes)
        self._steps = 0
        return number

    def remove(self, number: int) -> None:
        """Ends a warning."""
        with self._session.guard("ending a warning"):
            del self._obstacles[number], self._leading[number]
        self._steps = 0

    def obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles of which drivers are warned, in the order in which they came."""
        return tuple(self._obstacles.values())

    def step(self) -> None:
        """A round of requests when it is due."""
        if not self._obstacles and not self._former_modes:
            return
        due = self._steps % self._every == 0
        self._steps += 1
        with self._session.guard("guiding vehicles past an obstacle"):
            if due:
                self._round()
            self._courtesy.step(self._step_length)

    # Inside ------------------------------------------------------------------------------------

    def _round(self) -> None:
        inside: set[str] = set()
        waiting: dict[int, Waiting] = {}
        for number, obstacle in self._obstacles.items():
            first = obstacle.start - obstacle.notice
            for table in self._lanes.within(first, obstacle.end):
                leads = table.id in self._leading[number] and not table.id.startswith(":")
                inside |= self._guide(table, number, leads, waiting)
        self._courtesy.choose(waiting, self._period)
        for name in sorted(set(self._former_modes) - inside):
            mode = self._former_modes.pop(name)
            if name in self._vehicles:
                self._api.vehicle.setLaneChangeMode(name, mode)

    def _guide(
        self, table: LaneTable, number: int, leads: bool, waiting: dict[int, Waiting]
    ) -> set[str]:
        """Orders to the vehicles on a SUMO lane, out of it where it leads to the obstacle.

        Args:
          table: of the lane.
          number: of the obstacle.
          leads: whether the lane leads to it.
          waiting: the foremost vehicle that waits before each obstacle, to be completed.

        Returns:
          Who is in the stretch.
        """
        vehicle, obstacle = self._api.vehicle, self._obstacles[number]
        first = obstacle.start - obstacle.notice
        inside = set()
        for name in self._api.lane.getLastStepVehicleIDs(table.id):
            if name not in self._vehicles or self._vehicles.is_scripted(name):
                continue
            station, _ = table.at(vehicle.getLanePosition(name))
            if not first <= station <= obstacle.end:
                continue
            inside.add(name)
            if name not in self._former_modes:
                self._former_modes[name] = int(vehicle.getLaneChangeMode(name))
                vehicle.setLaneChangeMode(name, MERGING)
            index = self._way_out(table, station, obstacle.end) if leads else None
            if index is None:
                continue
            vehicle.changeLane(name, index, self._duration)
            foremost = number not in waiting or waiting[number].station < station
            if foremost and station < obstacle.start and vehicle.getSpeed(name) < WAITING_SPEED:
                beside = self._lanes.tables[f"{table.edge}_{index}"]
                waiting[number] = Waiting(name, station, beside)
        return inside

    def _way_out(self, table: LaneTable, station: float, end: float) -> int | None:
        """SUMO's index of the nearest open lane of the edge, the left one of two; None: none."""
        for distance in range(1, 8):
            for index in (table.index + distance, table.index - distance):
                other = self._lanes.tables.get(f"{table.edge}_{index}")
                if other is None or other.lane < 0 or other.direction != table.direction:
                    continue
                if not self._is_closed(other, station, end):
                    return index
        return None

    def _is_closed(self, table: LaneTable, start: float, end: float) -> bool:
        """Whether a lane leads to an obstacle that lies between two stations [m]."""
        return any(
            table.id in self._leading[number] and o.start < end and o.end > start
            for number, o in self._obstacles.items()
        )


def check_obstacle(obstacle: Obstacle, lanes: RouteLanes) -> None:
    """Refuses an obstacle on a lane that does not exist where it begins and ends.

    Raises:
      InputError: the lane does not exist there.
    """
    for station in (obstacle.start, obstacle.end):
        if lanes.find(obstacle.lane, station) is None:
            raise InputError(f"lane {obstacle.lane} does not exist at station {station:g}")
