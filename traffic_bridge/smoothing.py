"""Turns SUMO's instant lane changes into sideways motion, by quintic polynomials.

SUMO puts a vehicle into the next lane within one step. The difference between where SUMO has it
and where it is shown (the residual) starts as minus the jump and goes to zero with zero speed and
acceleration at both ends, as drivers do in 3-4 s (Toledo and Zohar, "Modeling duration of lane
changes", Transportation Research Record 1999, 2007, find a mean of 4.6 s, 1 to 13 s).
The motion is hastened where the vehicle would otherwise touch another one that SUMO, which has it
in the new lane already, lets it pass; where haste is not enough, as for who swings out from behind
a standing truck, the vehicle is held back until it is clear of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Rows = Sequence[FloatArray]

JUMP = 0.3  # [m] in one step: more than any lane's taper or a map's seam moves a vehicle
SLOW = 5.0  # [m/s] below which a lane change takes longer, in proportion: nobody slides sideways
URGENT_PACE = 0.5
SHORTEST = 1.0  # [s]
SIDE_MARGIN = 0.3  # [m]
HELD_GAP = 0.7  # [m] kept to who stands before a vehicle that swings out
HELD_SPEED = 1.5  # [m/s]: who is slower than it may be by more than this is not held
CREEP = 0.3  # [m/s]: nobody who swings out is held for ever
CLEARED_BY = 0.62  # fraction of the change after which the old lane is free (quintic: 3/4 done)


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
class _Change:
    """A residual on its way to zero: polynomial, its age and its duration [s]."""

    coefficients: tuple[float, float, float, float, float, float]
    duration: float
    age: float = 0.0

    def state(self) -> tuple[float, float, float]:
        c0, c1, c2, c3, c4, c5 = self.coefficients
        t = self.age
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        )


class LateralSmoother:
    """Keeps the vehicles' sideways motion continuous, whatever road they are on.

    A lane change is where a lane's centre under the vehicle leaps sideways, against the way the
    vehicle went along the mean of its two headings.

    Args:
      duration: of a lane change at speed [s]; 0 turns the smoothing off.

    Attributes:
      held: speed that a vehicle must not exceed until the one before it in its old lane is passed
        without touching [m/s], by name.
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self.held: dict[str, float] = {}
        self._names: list[str] = []
        self._place: dict[str, int] = {}
        self._last: Rows = ()
        self._lane: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        self._changes: dict[str, _Change] = {}
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
        obstacles: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """How far beside their lane's centre the vehicles are shown after a step.

        Args:
          names: of the n vehicles; vehicles that are not named are forgotten.
          lane: a number of the lane that each is on, shape (n,); within one lane nobody leaps.
          pose: x, y and heading of the lanes' centres under the boxes' centres [m], [rad], each of
            shape (n,).
          speed: [m/s], shape (n,).
          size: length and width, shape (2, n) or more rows [m].
          road: station, offset of the lanes' centres on the route [m] and the direction on it (+1
            along, -1 against, 0 on another road), each of shape (n,).
          dt: since the last update [s].
          obstacles: boxes that are none of the vehicles (the truck): station and offset of the
            centre, speed, length and width, shape (5, m) [m], [m/s].

        Returns:
          Offset from the lane's centre, lateral speed and lateral acceleration, each of shape (n,),
          positive to the vehicle's left; None where all of them are zero.
        """
        if self.duration <= 0.0:
            return None
        for i, jump in self._jumps(names, lane, pose):
            self._begin(names[i], jump)
        self._last, self._lane = pose, lane
        if self._names != names:
            self._names, self._place = names, {name: i for i, name in enumerate(names)}
        self.held.clear()
        if not self._changes:
            return None
        place = self._place
        shown = np.zeros((3, len(names)))
        self._changes = {name: c for name, c in self._changes.items() if name in place}
        for name, change in list(self._changes.items()):
            i = place[name]
            pace = min(1.0, float(speed[i]) / SLOW)
            # Who stands in somebody's way completes the change, however slowly.
            pace = max(pace, URGENT_PACE if name in self._urgent else 0.0)
            change.age += dt * pace
            if change.age >= change.duration:
                del self._changes[name]
                continue
            residual, rate, bend = change.state()
            shown[:, i] = residual, rate * pace, bend * pace * pace
        boxes = _boxes(road, shown[0], speed, size, obstacles)
        self._urgent = {
            name
            for name, change in self._changes.items()
            if road[2][place[name]] != 0.0
            and self._hasten(place[name], change, float(road[1][place[name]]), boxes)
        }
        return shown[0], shown[1], shown[2]

    def _jumps(
        self, names: list[str], lane: NDArray[np.intp], pose: Rows
    ) -> list[tuple[int, float]]:
        """Vehicles whose lane's centre has leapt sideways, and how far to the left [m]."""
        if not self._names:
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
        turn = heading - old_heading
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        course = old_heading + 0.5 * turn
        across = (y - old_y) * np.cos(course) - (x - old_x) * np.sin(course)
        leapt = np.abs(across) > JUMP
        return list(zip(now[leapt].tolist(), across[leapt].tolist(), strict=True))

    def _begin(self, name: str, jump: float) -> None:
        residual, rate, bend = 0.0, 0.0, 0.0
        if name in self._changes:
            residual, rate, bend = self._changes[name].state()
        self._changes[name] = _Change(
            quintic(residual - jump, rate, bend, self.duration), self.duration
        )

    def _hasten(self, i: int, change: _Change, aim: float, boxes: FloatArray) -> bool:
        """Shortens a change so that the old lane is left before the gap there is used up.

        Args:
          i: number of the vehicle.
          change: its change.
          aim: offset to which it goes [m].
          boxes: see `_boxes`.

        Returns:
          Whether that gap is nearly used up.
        """
        station, offset, along, length, width = boxes
        side = 0.5 * (width + width[i]) + SIDE_MARGIN
        conflict = (np.abs(offset - offset[i]) < side) & (np.abs(offset - aim) >= side)
        conflict &= np.isfinite(station)
        conflict[i] = False
        if not conflict.any():
            return False
        apart = station[conflict] - station[i]
        gap = np.abs(apart) - 0.5 * (length[conflict] + length[i])
        closing = -np.sign(apart) * (along[conflict] - along[i])
        # One metre and half a metre a second are held back for accelerations in the meantime.
        time = np.maximum(gap - 1.0, 0.0) / np.maximum(closing + 0.5, 0.5)
        remaining = change.duration - change.age
        wanted = max(float(time.min()) / CLEARED_BY, SHORTEST)
        if wanted < remaining - 0.1:
            change.coefficients = quintic(*change.state(), wanted)
            change.duration, change.age = wanted, 0.0
        self._hold(i, change, apart, gap, along[conflict], along[i])
        return wanted <= SHORTEST or self._names[i] in self.held

    def _hold(
        self,
        i: int,
        change: _Change,
        apart: FloatArray,
        gap: FloatArray,
        others: FloatArray,
        speed: float,
    ) -> None:
        """Notes the speed at which a vehicle is clear of those before it when it reaches them."""
        way = 1.0 if speed >= 0.0 else -1.0
        ahead = apart * way > 0.0
        if not ahead.any():
            return
        time = CLEARED_BY * max(change.duration - change.age, 0.1) / URGENT_PACE
        room = np.maximum(gap[ahead] - HELD_GAP, 0.0) / time
        limit = max(float(np.min(np.maximum(others[ahead] * way, 0.0) + room)), CREEP)
        if limit < abs(speed) + HELD_SPEED:
            self.held[self._names[i]] = limit


def _boxes(
    road: Rows,
    residual: FloatArray,
    speed: FloatArray,
    size: FloatArray,
    obstacles: FloatArray | None,
) -> FloatArray:
    """Who may be touched: station, offset, speed along the route, length and width, shape (5, k).

    Vehicles on other roads have an infinite station.
    """
    station, offset, direction = road
    on = np.where(direction != 0.0, station, np.inf)
    own = np.stack((on, offset + direction * residual, direction * speed, size[0], size[1]))
    return own if obstacles is None else np.concatenate((own, obstacles), axis=1)
