"""Drivers leave a lane before it is closed, and let waiting vehicles merge.

In the stretch before an obstacle with a warning (signs, arrows, hazard lights) vehicles do not
overtake, and those on the obstacle's lane change to the nearest open lane as soon as there is a
gap. A vehicle that waits at the end of its lane is let in by `ZipperMerge`. This applies to both
lane-change models: the vehicles are guided until they are past the obstacle, then they return to
their model.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from traffic_bridge.network.route_lanes import LaneTable, RouteLanes, upstream
from traffic_bridge.session import Session
from traffic_bridge.vehicles.registry import Vehicles

WAITING_SPEED = 3.0  # [m/s] below which a vehicle before an obstacle waits for a gap
EASY_BRAKING = 1.5  # [m/s2]
SPACE = 4.0  # [m] left behind the waiting vehicle
DELAY = 10.0  # [s] that a vehicle waits for a natural gap: stopping others costs flow
PATIENCE = 20.0  # [s] after which a driver drives on, and does not let in another one here
REASON = "zipper merge"
PERIOD = 0.5  # [s] between rounds of requests
# SUMO's lane-change mode in the stretch: leave lanes that end, cooperate, follow our requests if
# the gap is safe, adapt the speed to a gap; no overtaking, no keeping right.
MERGING = 0b10_0000_0101


@dataclass(frozen=True)
class Waiting:
    """A vehicle that waits before an obstacle.

    Attributes:
      name: of the vehicle; station: of its front bumper [m]; target: the lane to which it changes.
    """

    name: str
    station: float
    target: LaneTable


@dataclass
class _Yield:
    """A waiting vehicle, the vehicle that makes a gap for it, and for how long it does so [s]."""

    waiting: Waiting
    giver: str
    age: float = 0.0


class ZipperMerge:
    """Makes gaps for vehicles that wait at the end of their lane: zipper merge.

    Without it a dense flow on the open lane leaves no safe gap, and the closed lane waits for
    minutes. The first vehicle on the target lane that can stop behind the waiting vehicle with an
    easy deceleration makes the gap: it keeps v^2 <= 2 b distance until the other one is in.
    """

    def __init__(self, session: Session, vehicles: Vehicles) -> None:
        self._api = session.api
        self._vehicles = vehicles
        self._gaps: dict[int, _Yield] = {}
        self._impatient: set[str] = set()
        self._waited: dict[str, float] = {}

    def choose(self, waiting: dict[int, Waiting], period: float) -> None:
        """Chooses vehicles that make gaps, and ends gaps that are no longer needed.

        Args:
          waiting: the foremost waiting vehicle before each obstacle that has one.
          period: time since the last call [s].
        """
        self._impatient = {name for name in self._impatient if name in self._vehicles}
        for number, gap in list(self._gaps.items()):
            gap.age += period
            still = waiting.get(number)
            if gap.age > PATIENCE:
                self._impatient.add(gap.giver)
            elif still is not None and still.name == gap.waiting.name:
                gap.waiting = still
                continue
            self._vehicles.hold_below(gap.giver, None, REASON)
            del self._gaps[number]
        before = self._waited
        self._waited = {w.name: before.get(w.name, 0.0) + period for w in waiting.values()}
        for number, one in sorted(waiting.items()):
            if number not in self._gaps and self._waited[one.name] > DELAY:
                giver = self._choose(one, {gap.giver for gap in self._gaps.values()})
                if giver is not None:
                    self._gaps[number] = _Yield(one, giver)

    def step(self, step_length: float) -> None:
        """Limits the speed of vehicles that make gaps; `step_length` is that of the traffic [s]."""
        for number, gap in list(self._gaps.items()):
            if gap.giver not in self._vehicles:
                del self._gaps[number]
                continue
            speed = float(self._api.vehicle.getSpeed(gap.giver))
            left = max(self._distance(gap.giver, gap.waiting) - speed * step_length, 0.0)
            allowed = max(math.sqrt(2.0 * EASY_BRAKING * left), speed - EASY_BRAKING * step_length)
            self._vehicles.hold_below(gap.giver, allowed, REASON)

    def _choose(self, one: Waiting, taken: set[str]) -> str | None:
        """The nearest vehicle that can stop behind the waiting one with an easy deceleration."""
        best, nearest = None, math.inf
        vehicle = self._api.vehicle
        for name in self._api.lane.getLastStepVehicleIDs(one.target.id):
            unfit = name not in self._vehicles or self._vehicles.is_scripted(name)
            if unfit or name in taken or name in self._impatient:
                continue
            distance = self._distance(name, one)
            need = vehicle.getSpeed(name) ** 2 / (2.0 * EASY_BRAKING)
            if need <= distance < nearest:
                best, nearest = name, distance
        return best

    def _distance(self, name: str, one: Waiting) -> float:
        """Distance of a vehicle on the target lane to its place behind the waiting one [m]."""
        front, _ = one.target.at(self._api.vehicle.getLanePosition(name))
        return one.station - float(self._api.vehicle.getLength(one.name)) - SPACE - front


@dataclass(frozen=True)
class Obstacle:
    """A stretch of a lane that cannot be driven.

    Attributes:
      lane: from the outside; start, end: stations [m]; notice: distance before the start at which
        the warning begins [m].
    """

    lane: int
    start: float
    end: float
    notice: float


class MergeGuide:
    """Guides vehicles past the obstacles on the route."""

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
        self._steps = 0
        self._obstacles: dict[int, Obstacle] = {}
        self._leading: dict[int, frozenset[str]] = {}
        self._numbers = itertools.count()
        self._former_modes: dict[str, int] = {}
        self._zipper = ZipperMerge(session, vehicles)

    def add(self, obstacle: Obstacle) -> int:
        """Adds a warning of an obstacle; returns the number for `remove`."""
        number = next(self._numbers)
        self._obstacles[number] = obstacle
        # Lanes are counted from the outside, so a lane's number changes where another one begins or
        # ends; the net determines which lanes lead to the obstacle.
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
        """The obstacles with a warning, in the order in which they were added."""
        return tuple(self._obstacles.values())

    def step(self) -> None:
        """One traffic step; sends lane-change requests if a round is due."""
        if not self._obstacles and not self._former_modes:
            return
        due = self._steps % self._every == 0
        self._steps += 1
        with self._session.guard("guiding vehicles past an obstacle"):
            if due:
                self._round()
            self._zipper.step(self._step_length)

    def _round(self) -> None:
        inside: set[str] = set()
        waiting: dict[int, Waiting] = {}
        for number, obstacle in self._obstacles.items():
            first = obstacle.start - obstacle.notice
            for table in self._lanes.within(first, obstacle.end):
                leads = table.id in self._leading[number] and not table.id.startswith(":")
                inside |= self._guide(table, number, leads, waiting)
        self._zipper.choose(waiting, self._period)
        for name in sorted(set(self._former_modes) - inside):
            mode = self._former_modes.pop(name)
            if name in self._vehicles:
                self._api.vehicle.setLaneChangeMode(name, mode)

    def _guide(
        self, table: LaneTable, number: int, leads: bool, waiting: dict[int, Waiting]
    ) -> set[str]:
        """Guides the vehicles on a SUMO lane, and out of it if it leads to the obstacle.

        Returns the vehicles in the stretch; adds the foremost vehicle that waits to `waiting`.
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
            vehicle.changeLane(name, index, self._period + self._step_length)
            foremost = number not in waiting or waiting[number].station < station
            if foremost and station < obstacle.start and vehicle.getSpeed(name) < WAITING_SPEED:
                target = self._lanes.tables[f"{table.edge}_{index}"]
                waiting[number] = Waiting(name, station, target)
        return inside

    def _way_out(self, table: LaneTable, station: float, end: float) -> int | None:
        """SUMO's index of the nearest open lane of the edge, the left one of two; or None."""
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
