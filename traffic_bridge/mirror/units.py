"""The shown vehicles as rigid units: who consists of what, and where each unit is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.mirror.articulation import Articulation, Pose, TrailerMemory, units
from traffic_bridge.mirror.bodies import Outline
from traffic_bridge.mirror.look_parts import Unit
from traffic_bridge.mirror.motion import CRAWL, NOWHERE, STATE, moved, quaternions, state_of, trend
from traffic_bridge.mirror.slots import Slot
from traffic_bridge.vehicles.registry import VehicleType

IntArray = NDArray[np.intp]


class VehicleUnits:
    """Motion of the vehicles in some slots.

    Its arrays have one row a unit: first the vehicles of one unit, then all tractors, then all
    semitrailers.

    Args:
      types: of the vehicles.
      looks: units of each type.
      step_length: of the traffic [s].

    Attributes:
      slots: whose vehicles they are, one a unit; units: number of the unit in its vehicle.
      position: of the units as last asked for, shape (n, 3) [m].
      quaternion: of the units likewise, shape (n, 4), w first.
      radius: about the unit's position that holds its hull, shape (n,) [m].
    """

    def __init__(
        self,
        types: Sequence[VehicleType],
        looks: Sequence[tuple[Unit, ...]],
        step_length: float,
    ) -> None:
        self._looks = looks
        self._step_length = step_length
        self._trucks = {
            number: Articulation.of_length(kind.length)
            for number, kind in enumerate(types)
            if len(looks[number]) == 2
        }
        self._extents = [
            [_extent(unit, kind) for unit in units]
            for kind, units in zip(types, looks, strict=True)
        ]
        self._memory = TrailerMemory()
        self.clear()

    def clear(self) -> None:
        """Forgets everybody."""
        self._memory.clear()
        self._names: list[str] = []
        self._state = np.zeros((len(STATE), 0))
        self._trailer_yaw: list[float] = []
        self.set_slots([])

    def set_slots(self, taken: Sequence[Slot]) -> None:
        """Takes other slots than before; those of two units are the last."""
        known = dict(zip(self._names, self._state.T.tolist(), strict=True))
        self._names = [slot.vehicle or "" for slot in taken]
        nowhere = [NOWHERE] + [0.0] * (len(STATE) - 1)
        self._state = (
            np.array([known.get(name, nowhere) for name in self._names]).reshape(-1, len(STATE)).T
        )
        self._joint = [self._trucks[slot.type] for slot in taken if slot.type in self._trucks]
        self._single, count = len(taken) - len(self._joint), len(taken)
        self.slots = [*taken, *taken[self._single :]]
        self.units = [0] * count + [1] * len(self._joint)
        self._of = [*range(count), *range(self._single, count)]
        self.radius = np.array(
            [
                self._extents[slot.type][unit][3]
                for slot, unit in zip(self.slots, self.units, strict=True)
            ]
        )
        self.position = np.zeros((len(self.slots), 3))
        self.quaternion = np.zeros((len(self.slots), 4))

    def take(self, frame: VehicleFrame, rows: IntArray) -> None:
        """Reads where the vehicles are: their rows in a new frame, in the order of the slots."""
        self._before, self._state = self._state, state_of(frame, rows)
        self._trend: FloatArray | None = None
        if self._joint:
            places = [
                (x, y, yaw, rate / speed if speed > CRAWL else 0.0)
                for x, y, _, yaw, _, _, rate, speed, *_ in self._state[:, self._single :].T.tolist()
            ]
            self._trailer_yaw = self._memory.follow(
                self._names[self._single :], self._joint, places
            )

    def move(self, elapsed: float, known: VehicleFrame | None = None) -> None:
        """Computes where the units are some time after the frame [s].

        Args:
          elapsed: that time [s].
          known: vehicles whose places then are known; all others are moved on.
        """
        now = self._moved(elapsed) if elapsed != 0.0 else self._state[:6]
        if known is not None:
            now = self._corrected(now, known)
        k, count = self._single, now.shape[1]
        self.position[:k] = now[:3, :k].T
        self.quaternion[:k] = quaternions(now[3:, :k]).T
        if not self._joint:
            return
        places = [
            units(truck, self._trailer(number, elapsed, pose), pose)
            for number, (truck, pose) in enumerate(
                zip(self._joint, now[:, k:].T.tolist(), strict=True)
            )
        ]
        self.position[k:count] = self.position[count:] = [kingpin for kingpin, _, _ in places]
        self.quaternion[k:count] = [tractor for _, tractor, _ in places]
        self.quaternion[count:] = [trailer for _, _, trailer in places]

    def _moved(self, elapsed: float) -> FloatArray:
        if self._trend is None:
            self._trend = trend(self._state, self._before, self._step_length)
        return moved(self._state, self._trend, elapsed, self._step_length)

    def _corrected(self, now: FloatArray, known: VehicleFrame) -> FloatArray:
        """Poses, shape (6, n), with those of the vehicles of a frame put in."""
        places = {name: place for place, name in enumerate(known.ids)}
        rows = np.array([places.get(name, -1) for name in self._names], dtype=np.intp)
        now, there = now.copy(), rows >= 0
        now[:, there] = known.values.T[: len(now), rows[there]]
        return now

    def _trailer(self, number: int, elapsed: float, pose: Pose) -> float:
        """Yaw of a semitrailer whose box has moved since the frame [rad]."""
        trailer = self._trailer_yaw[number]
        if elapsed == 0.0:
            return trailer
        x0, y0, _, yaw0 = self._state[:4, self._single + number].tolist()
        way = math.copysign(math.hypot(pose[0] - x0, pose[1] - y0), elapsed)
        return self._joint[number].pulled(trailer, 0.5 * (yaw0 + pose[3]), way)

    def outline(self, unit: int) -> Outline:
        """A unit from above and how it moves, at the positions last computed."""
        slot, row = self.slots[unit], self._of[unit]
        front, rear, width, reach = self._extents[slot.type][self.units[unit]]
        x, y, _ = self.position[unit].tolist()
        w, i, j, k = self.quaternion[unit].tolist()
        yaw = math.atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k))
        ahead_x, ahead_y, middle = math.cos(yaw), math.sin(yaw), 0.5 * (front + rear)
        way, yaw_rate, speed = self._state[[3, 6, 7], row].tolist()
        spin = abs(yaw_rate)
        if row >= self._single:
            # A unit turns about the box's centre with what the semitrailer's angle makes of speed.
            number = row - self._single
            bend = math.sin(way - self._trailer_yaw[number])
            spin += speed * abs(bend) / self._joint[number].axles
        return Outline(
            x + middle * ahead_x,
            y + middle * ahead_y,
            ahead_x,
            ahead_y,
            0.5 * (front - rear),
            0.5 * width,
            speed * math.cos(way),
            speed * math.sin(way),
            spin * reach,
        )


def _extent(unit: Unit, kind: VehicleType) -> tuple[float, float, float, float]:
    """Front, rear and width of a unit's hull from above, and its reach about the box's centre."""
    front = max(center[0] + 0.5 * size[0] for center, size in unit.hull)
    rear = min(center[0] - 0.5 * size[0] for center, size in unit.hull)
    width = max(size[1] for _, size in unit.hull)
    # The farthest corner of a tractor that has turned square is nearer than the whole length.
    return front, rear, width, kind.length if unit.name else math.hypot(front, 0.5 * width)
