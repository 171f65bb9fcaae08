"""Turns SUMO's instantaneous lane changes into lateral motion by quintic polynomials.

SUMO moves a vehicle to the next lane within one step. The difference between SUMO's position and
the shown one (the residual) starts as minus the jump and decays to zero with zero speed and
acceleration at both ends, as drivers do in 3-4 s (Toledo and Zohar, "Modeling duration of lane
changes", Transportation Research Record 1999, 2007, find a mean of 4.6 s, 1 to 13 s).
In SUMO the vehicle is already in the new lane and may pass vehicles of the old lane. If it would
touch one of them, its lateral motion is faster. If that is not enough, as behind a stopped truck,
it slows down until it is clear of the other vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray

Rows = Sequence[FloatArray]

SLOW = 5.0  # [m/s] below which a lane change takes longer, in proportion
URGENT_PACE = 0.5
PACE_RATE = 1.0  # [1/s]
# The lateral speed is at most SIDE_SPEED [m/s] plus STEEPEST times the forward speed.
SIDE_SPEED, STEEPEST = 0.5, 0.7
JUMP = 0.3  # [m] in one step: more than a lane's taper or a map's seam moves a vehicle
SHORTEST = 1.0  # [s]
SIDE_MARGIN = 0.3  # [m]
HELD_GAP = 0.7  # [m] kept to a stopped vehicle ahead during the change
TAIL_GAP = 2.0  # [m] kept behind a vehicle that changes lanes
HELD_SPEED = 1.5  # [m/s]: a vehicle slower than its limit by more than this is not limited
CREEP = 0.3  # [m/s], the lowest limit, so that no vehicle waits for ever
# Vehicles matter to a change within these distances between centers, along and across [m].
REACH, SIDEWAYS = 100.0, 3.2
CLEARED_BY = 0.62  # fraction of the change after which the old lane is free (quintic: 3/4 done)

_vehicles_beside = kernels.function(
    "iits_vehicles_beside",
    kernels.Integer,
    *(kernels.Integer, kernels.Address, kernels.Integer, *4 * [kernels.Real], kernels.Address),
)


def nearest_turn(angles: FloatArray) -> FloatArray:
    """The same angles from -pi to pi [rad]; rounds otherwise than `iits_mj.core.angles`."""
    return np.asarray(angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi)))


def quintic(
    position: float, speed: float, acceleration: float, duration: float
) -> tuple[float, float, float, float, float, float]:
    """Coefficients c0..c5 of the polynomial from a given state to rest at zero.

    Takahashi, Hongo, Ninomiya and Sugimoto, "Local path planning and motion control for AGV in
    positioning", IROS 1989: the quintic minimises the integral of jerk squared.

    Args:
      position: at the beginning [m].
      speed: at the beginning [m/s].
      acceleration: at the beginning [m/s2].
      duration: until rest at zero [s].
    """
    t = duration
    c2 = 0.5 * acceleration
    end = -(position + speed * t + c2 * t**2)
    rate = -(speed + 2.0 * c2 * t)
    bend = -2.0 * c2
    c3 = (10.0 * end - 4.0 * rate * t + 0.5 * bend * t**2) / t**3
    c4 = (-15.0 * end + 7.0 * rate * t - bend * t**2) / t**4
    c5 = (6.0 * end - 3.0 * rate * t + 0.5 * bend * t**2) / t**5
    return position, speed, c2, c3, c4, c5


@dataclass
class SidewaysMotion:
    """A decaying residual: polynomial, and age and duration in its own time [s].

    `pace` is the rate of its own time, 0 to 1; None before the first step.
    """

    coefficients: tuple[float, float, float, float, float, float]
    duration: float
    age: float = 0.0
    pace: float | None = None

    def advance(self, dt: float, speed: float, urgent: bool) -> float:
        """Advances the change by a step and returns its pace, 0 to 1.

        Slow vehicles change lanes slowly, but an urgent change continues at any speed. The pace is
        continuous, and the lateral speed is limited by the forward speed.
        """
        wanted = max(min(1.0, speed / SLOW), URGENT_PACE if urgent else 0.0)
        if self.pace is None:
            self.pace = wanted
        step = PACE_RATE * dt
        self.pace = min(max(wanted, self.pace - step), self.pace + step)
        rate = abs(self.state()[1])
        if rate > 0.0:
            self.pace = min(self.pace, (SIDE_SPEED + STEEPEST * speed) / rate)
        self.age += dt * self.pace
        return self.pace

    def state(self) -> tuple[float, float, float]:
        """Residual and its first two derivatives in its own time [m], [m/s], [m/s2]."""
        c0, c1, c2, c3, c4, c5 = self.coefficients
        t = self.age
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        )


class Shift(NamedTuple):
    """Lateral distance of a vehicle from its lane's center, with derivatives, left positive.

    Attributes:
      number: index of the vehicle in the arrays.
      offset: [m]; speed: [m/s]; acceleration: [m/s2].
    """

    number: int
    offset: float
    speed: float
    acceleration: float


class Box(NamedTuple):
    """A box on the route: station and offset of its center [m], speed [m/s], size [m].

    `number` is the vehicle's index, -1 for an obstacle.
    """

    station: float
    offset: float
    speed: float
    length: float
    width: float
    number: int = -1


class LateralSmoother:
    """Keeps the vehicles' lateral motion continuous, on and off the route.

    A lane change is a lateral jump of the lane's center under the vehicle, measured across the mean
    of its headings before and after.

    Args:
      duration: of a lane change at speed [s]; 0 turns the smoothing off.

    Attributes:
      held: speed limits that prevent contact during lane changes [m/s], by vehicle.
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self.held: dict[str, float] = {}
        self._names: list[str] = []
        self._place: dict[str, int] = {}
        self._last: Rows = ()
        self._lane: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        self._changes: dict[str, SidewaysMotion] = {}
        self._urgent: set[str] = set()

    def clear(self) -> None:
        """Forgets all vehicles."""
        self._names, self._place, self._last = [], {}, ()
        self._changes.clear()
        self._urgent.clear()
        self.held.clear()

    def update(
        self,
        names: list[str],
        lane: NDArray[np.intp],
        pose: Rows,
        speed: FloatArray,
        size: FloatArray,
        road: Rows,
        dt: float,
        obstacles: Sequence[Box] = (),
    ) -> list[Shift]:
        """Lateral distances of the shown vehicles from their lanes' centers after a step.

        Args:
          names: of the n vehicles; data of all others are dropped.
          lane: number of each vehicle's lane, shape (n,); jumps occur only between lanes.
          pose: x, y and heading of the lanes' centers at the vehicles' centers [m], [rad], each of
            shape (n,).
          speed: [m/s], shape (n,).
          size: length and width, shape (2, n) or more rows [m].
          road: station, offset of the lanes' centers on the route [m] and the direction on it (+1
            along, -1 against, 0 on another road), each of shape (n,).
          dt: since the last update [s].
          obstacles: other boxes (the truck).

        Returns:
          The vehicles off their lanes' centers, in the order of their numbers.
        """
        if self.duration <= 0.0:
            return []
        for i, jump in self._jumps(names, lane, pose):
            self._begin(names[i], jump)
        self._last, self._lane = pose, lane
        if self._names is not names:
            self._names, self._place = names, {name: i for i, name in enumerate(names)}
        self.held.clear()
        if not self._changes:
            return []
        place = self._place
        self._changes = {name: c for name, c in self._changes.items() if name in place}
        shifts = []
        for name, change in list(self._changes.items()):
            pace = change.advance(dt, float(speed[place[name]]), name in self._urgent)
            if change.age >= change.duration:
                del self._changes[name]
                continue
            residual, rate, bend = change.state()
            shifts.append(Shift(place[name], residual, rate * pace, bend * pace * pace))
        boxes = _Boxes(road, speed, size, shifts, obstacles)
        self._urgent = {
            names[shift.number]
            for shift in shifts
            if road[2][shift.number] != 0.0 and self._hasten(names[shift.number], shift, boxes)
        }
        return sorted(shifts)

    def _jumps(
        self, names: list[str], lane: NDArray[np.intp], pose: Rows
    ) -> list[tuple[int, float]]:
        """Vehicles whose lane's center has jumped, and the jumps to the left [m]."""
        if not self._names or lane is self._lane:
            return []
        if names == self._names:
            now = before = np.flatnonzero(lane != self._lane)
        else:
            index = np.array([self._place.get(name, -1) for name in names], dtype=np.intp)
            now = np.flatnonzero((index >= 0) & (lane != self._lane[index]))
            before = index[now]
        if not now.size:
            return []
        x, y, heading = (row[now] for row in pose)
        old_x, old_y, old_heading = (row[before] for row in self._last)
        course = old_heading + 0.5 * nearest_turn(heading - old_heading)
        across = (y - old_y) * np.cos(course) - (x - old_x) * np.sin(course)
        jumped = np.abs(across) > JUMP
        return list(zip(now[jumped].tolist(), across[jumped].tolist(), strict=True))

    def _begin(self, name: str, jump: float) -> None:
        residual, rate, bend, pace = 0.0, 0.0, 0.0, None
        if name in self._changes:
            residual, rate, bend = self._changes[name].state()
            pace = self._changes[name].pace
        self._changes[name] = SidewaysMotion(
            quintic(residual - jump, rate, bend, self.duration), self.duration, pace=pace
        )

    def _hasten(self, name: str, shift: Shift, boxes: _Boxes) -> bool:
        """Shortens a change so that the vehicle leaves the old lane before its gap there closes.

        Returns:
          Whether that gap is nearly closed.
        """
        own, aim = boxes.box(shift.number), boxes.aim(shift.number)
        conflicts = boxes.beside(own, aim)
        if not conflicts:
            return False
        change = self._changes[name]
        least = math.inf
        for other in conflicts:
            gap, sign = _gap(own, other)
            closing = -sign * (other.speed - own.speed)
            # A reserve of 1 m and 0.5 m/s allows for accelerations in the meantime.
            least = min(least, max(gap - 1.0, 0.0) / max(closing + 0.5, 0.5))
        wanted = max(least / CLEARED_BY, SHORTEST)
        if wanted < change.duration - change.age - 0.1:
            change.coefficients = quintic(*change.state(), wanted)
            change.duration, change.age = wanted, 0.0
        self._hold(name, change, own, conflicts)
        return wanted <= SHORTEST or name in self.held

    def _hold(self, name: str, change: SidewaysMotion, own: Box, conflicts: list[Box]) -> None:
        """Limits the speeds of the vehicle behind others, and of others behind the vehicle.

        A follower in the old lane keeps clear of the rear, which swings out as the box turns.
        """
        way = 1.0 if own.speed >= 0.0 else -1.0
        due = CLEARED_BY * max(change.duration - change.age, 0.1) / URGENT_PACE
        for other in conflicts:
            gap, sign = _gap(own, other)
            side = 0.5 * (other.width + own.width) - abs(other.offset - own.offset)
            time = max(due, side / (SIDE_SPEED + STEEPEST * abs(own.speed)))
            if sign * way > 0.0:
                room = max(gap - HELD_GAP, 0.0) / time
                self._limit(name, own.speed * way, other.speed * way, room)
            elif other.number >= 0:
                room = max(gap - TAIL_GAP, 0.0) / time
                self._limit(self._names[other.number], other.speed * way, own.speed * way, room)

    def _limit(self, name: str, speed: float, ahead: float, room: float) -> None:
        """Limits a vehicle's speed to that of the one ahead plus the closing speed `room` [m/s]."""
        limit = max(max(ahead, 0.0) + room, CREEP)
        if limit < speed + HELD_SPEED:
            self.held[name] = min(limit, self.held.get(name, limit))


class _Boxes:
    """The vehicles and obstacles as boxes on the route, made on demand."""

    def __init__(
        self,
        road: Rows,
        speed: FloatArray,
        size: FloatArray,
        shifts: list[Shift],
        obstacles: Sequence[Box],
    ) -> None:
        station, self._aim, direction = road
        self._speed = speed
        # The rows of `Box`, with the direction instead of the speed.
        self._table = kernels.Table((station, self._aim, direction, size[0], size[1]))
        self._found = kernels.Table(np.empty(len(speed)))
        rows = self._table.numbers
        for shift in shifts:
            rows[1, shift.number] += rows[2, shift.number] * shift.offset
        self._obstacles = obstacles

    def aim(self, number: int) -> float:
        """Offset on the route at the end of a vehicle's change [m]."""
        return float(self._aim[number])

    def box(self, number: int) -> Box:
        """The shown box of a vehicle."""
        station, offset, direction, length, width = self._table.numbers[:, number].tolist()
        return Box(station, offset, direction * float(self._speed[number]), length, width, number)

    def beside(self, own: Box, aim: float) -> list[Box]:
        """The boxes that a vehicle's side overlaps now, but not at the offset `aim` [m]."""
        sides = REACH, SIDEWAYS, SIDE_MARGIN
        count = _vehicles_beside(
            len(self._speed), self._table.address, own.number, aim, *sides, self._found.address
        )
        found = [self.box(int(number)) for number in self._found.numbers[:count].tolist()]
        for other in self._obstacles:
            side = 0.5 * (other.width + own.width) + SIDE_MARGIN
            if abs(other.offset - own.offset) < side <= abs(other.offset - aim):
                found.append(other)
        return found


def _gap(own: Box, other: Box) -> tuple[float, float]:
    """Free distance along the route between two boxes [m], and +1 if the other is ahead."""
    apart = other.station - own.station
    sign = 1.0 if apart > 0.0 else -1.0 if apart < 0.0 else 0.0
    return abs(apart) - 0.5 * (other.length + own.length), sign
