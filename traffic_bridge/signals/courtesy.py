"""Drivers let in who waits at the end of a lane: one each, like the teeth of a zip.

Without it a dense flow on the open lane leaves no gap that others' braking allows, and the closed
lane waits for minutes. The driver chosen is the first on the lane beside who can stop behind the
waiting vehicle with an easy deceleration; it is held to v^2 = 2 b distance until the other one
is in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from traffic_bridge.network.lanes import LaneTable
from traffic_bridge.session import Session
from traffic_bridge.vehicles.registry import Vehicles

WAITING_SPEED = 3.0  # [m/s] below which a vehicle before an obstacle waits for a gap
EASY_BRAKING = 1.5  # [m/s2]
SPACE = 4.0  # [m] left behind the waiting vehicle
DELAY = 10.0  # [s] that one waits for a gap that comes by itself: stopping others costs flow
PATIENCE = 20.0  # [s] after which a driver drives on, and lets nobody in again here
REASON = "courtesy"


@dataclass(frozen=True)
class Waiting:
    """A vehicle that waits before an obstacle.

    Attributes:
      name: of the vehicle; station: of its front bumper [m]; beside: the lane that it wants.
    """

    name: str
    station: float
    beside: LaneTable


@dataclass
class _Favor:
    """Who is let in by whom, and for how long already [s]."""

    waiting: Waiting
    giver: str
    age: float = 0.0


class Courtesy:
    """Makes gaps for waiting vehicles.

    Args:
      session: the running SUMO.
      vehicles: who may be slowed down.
    """

    def __init__(self, session: Session, vehicles: Vehicles) -> None:
        self._api = session.api
        self._vehicles = vehicles
        self._favors: dict[int, _Favor] = {}
        self._impatient: set[str] = set()
        self._waited: dict[str, float] = {}

    def choose(self, waiting: dict[int, Waiting], period: float) -> None:
        """Begins and ends favors.

        Args:
          waiting: the foremost waiting vehicle before each obstacle that has one.
          period: time since the last call [s].
        """
        self._impatient = {name for name in self._impatient if name in self._vehicles}
        for number, favor in list(self._favors.items()):
            favor.age += period
            still = waiting.get(number)
            if favor.age > PATIENCE:
                self._impatient.add(favor.giver)
            elif still is not None and still.name == favor.waiting.name:
                favor.waiting = still
                continue
            self._vehicles.hold_below(favor.giver, None, REASON)
            del self._favors[number]
        before = self._waited
        self._waited = {w.name: before.get(w.name, 0.0) + period for w in waiting.values()}
        for number, one in sorted(waiting.items()):
            if number not in self._favors and self._waited[one.name] > DELAY:
                giver = self._choose(one, {favor.giver for favor in self._favors.values()})
                if giver is not None:
                    self._favors[number] = _Favor(one, giver)

    def step(self, step_length: float) -> None:
        """Holds the givers to the speed from which they can still stop behind the other, easily.

        Args:
          step_length: of the coming step of the traffic [s].
        """
        for number, favor in list(self._favors.items()):
            if favor.giver not in self._vehicles:
                del self._favors[number]
                continue
            speed = float(self._api.vehicle.getSpeed(favor.giver))
            left = max(self._distance(favor.giver, favor.waiting) - speed * step_length, 0.0)
            allowed = max(math.sqrt(2.0 * EASY_BRAKING * left), speed - EASY_BRAKING * step_length)
            self._vehicles.hold_below(favor.giver, allowed, REASON)

    def _choose(self, one: Waiting, taken: set[str]) -> str | None:
        """The nearest driver behind who can stop easily behind the waiting vehicle."""
        best, nearest = None, math.inf
        vehicle = self._api.vehicle
        for name in self._api.lane.getLastStepVehicleIDs(one.beside.id):
            unfit = name not in self._vehicles or self._vehicles.is_scripted(name)
            if unfit or name in taken or name in self._impatient:
                continue
            distance = self._distance(name, one)
            need = vehicle.getSpeed(name) ** 2 / (2.0 * EASY_BRAKING)
            if need <= distance < nearest:
                best, nearest = name, distance
        return best

    def _distance(self, name: str, one: Waiting) -> float:
        """Way of a vehicle on the lane beside to its place behind the waiting one [m]."""
        front, _ = one.beside.at(self._api.vehicle.getLanePosition(name))
        return one.station - float(self._api.vehicle.getLength(one.name)) - SPACE - front
