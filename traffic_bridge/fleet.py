"""The shown vehicles as rigid units: who consists of what, and where each unit is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from traffic_bridge.articulation import Articulation, TrailerMemory
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.look_parts import Unit
from traffic_bridge.motion import (
    CRAWL,
    NOWHERE,
    STATE,
    moved,
    on_plane,
    pace,
    quaternions,
    state_of,
)
from traffic_bridge.slots import Slot
from traffic_bridge.vehicles import VehicleType

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


class Fleet:
    """Motion of the vehicles in some slots.

    Its arrays have one row a unit: first the vehicles of one unit, then all tractors, then all
    semitrailers.

    Args:
      types: of the vehicles.
      looks: units of each type.
      step_length: of the traffic [s].

    Attributes:
      slots: whose vehicles they are, one a unit; units: number of the unit in its vehicle.
    """

    def __init__(
        self,
        types: Sequence[VehicleType],
        looks: Sequence[tuple[Unit, ...]],
        step_length: float,
    ) -> None:
        self._types = types
        self._looks = looks
        self._step_length = step_length
        self._memory = TrailerMemory()
        self.clear()

    def clear(self) -> None:
        """Forgets everybody."""
        self._memory.clear()
        self._last: dict[str, list[float]] = {}
        self._pace = np.zeros(0)
        self._state = np.zeros((len(STATE), 0))
        self.set_slots([])

    def set_slots(self, taken: Sequence[Slot]) -> None:
        """Takes other slots than before."""
        single = [slot for slot in taken if len(self._looks[slot.type]) == 1]
        joint = [slot for slot in taken if len(self._looks[slot.type]) == 2]
        self._vehicles = single + joint
        self._single = len(single)
        self._joint_names = [slot.vehicle or "" for slot in joint]
        self._articulation = Articulation.of_lengths(
            [self._types[slot.type].length for slot in joint]
        )
        self.slots = single + joint + joint
        self.units = [0] * len(self._vehicles) + [1] * len(joint)
        self._extent = np.array(
            [
                _extent(self._looks[slot.type][unit])
                for slot, unit in zip(self.slots, self.units, strict=True)
            ]
        ).reshape(-1, 3)

    def take(self, frame: VehicleFrame) -> None:
        """Reads where the vehicles of the slots are in a new frame."""
        rows = np.fromiter((slot.row for slot in self._vehicles), np.intp, len(self._vehicles))
        self._state = state_of(frame, rows)
        names = [slot.vehicle or "" for slot in self._vehicles]
        last = np.array([self._last.get(name, NOWHERE) for name in names]).reshape(-1, 2)
        self._pace = pace(self._state, last, self._step_length)
        self._last = dict(zip(names, self._state[:2].T.tolist(), strict=True))
        x, y, _, yaw, _, _, yaw_rate, speed, *_ = self._state[:, self._single :]
        curvature = np.where(speed > CRAWL, yaw_rate / np.maximum(speed, CRAWL), 0.0)
        self._trailer_yaw = self._memory.follow(
            self._joint_names, self._articulation, x, y, yaw, curvature
        )

    def poses(self, elapsed: float) -> tuple[FloatArray, FloatArray]:
        """Where the units are some time after the frame [s].

        Returns:
          Positions (n, 3) [m] and quaternions (n, 4), w first.
        """
        x, y, z, yaw = moved(self._state, self._pace, elapsed, self._step_length)
        pitch, roll = self._state[4], self._state[5]
        position = np.column_stack((x, y, z))
        if not self._joint_names:
            return position, quaternions(yaw, pitch, roll)
        k = self._single
        trailer = self._trailer_yaw
        if elapsed != 0.0:
            dx, dy = x[k:] - self._state[0, k:], y[k:] - self._state[1, k:]
            way = np.hypot(dx, dy) * np.sign(elapsed)
            chord = 0.5 * (yaw[k:] + self._state[3, k:])
            trailer = self._articulation.pulled(trailer, chord, way)
        tractor = self._articulation.tractor_yaw(yaw[k:], trailer)
        return self._place(position, yaw, pitch, roll, tractor, trailer)

    def _place(
        self,
        position: FloatArray,
        yaw: FloatArray,
        pitch: FloatArray,
        roll: FloatArray,
        tractor: FloatArray,
        trailer: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Puts tractors and semitrailers at their kingpins, in the plane of the road there."""
        k, ahead = self._single, self._articulation.kingpin
        place, turns = on_plane(
            position[k:],
            quaternions(yaw[k:], pitch[k:], roll[k:]),
            ahead,
            np.stack((trailer - yaw[k:], tractor - yaw[k:])),
        )
        return (
            np.concatenate((position[:k], place, place)),
            np.concatenate((quaternions(yaw[:k], pitch[:k], roll[:k]), turns[1], turns[0])),
        )

    def outlines(
        self, position: FloatArray, quaternion: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Units from above, and how they move, for `contact.may_touch`.

        Args:
          position: of the units, see `poses`.
          quaternion: likewise.

        Returns:
          Rectangles (n, 3, 2) [m]; velocity and greatest speed by rotation (n, 3) [m/s].
        """
        w, x, y, z = quaternion.T
        along = np.column_stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)))
        along /= np.linalg.norm(along, axis=1)[:, None]
        left = np.column_stack((-along[:, 1], along[:, 0]))
        front, rear, width = self._extent.T
        center = position[:, :2] + 0.5 * (front + rear)[:, None] * along
        boxes = np.stack(
            (center, 0.5 * (front - rear)[:, None] * along, 0.5 * width[:, None] * left), axis=1
        )
        k = self._single
        order = np.r_[0 : len(self._vehicles), k : len(self._vehicles)]
        _, _, _, yaw, _, _, yaw_rate, speed, *_ = self._state[:, order]
        spin = np.abs(yaw_rate)
        # A unit turns about the box's centre with what the kingpin's angle makes of the speed.
        bend = np.abs(np.sin(self._state[3, k:] - self._trailer_yaw))
        turn = self._state[7, k:] * bend / self._articulation.axles
        spin[k:] += np.concatenate((turn, turn))
        reach = front - rear
        return boxes, np.column_stack((speed * np.cos(yaw), speed * np.sin(yaw), spin * reach))


def _extent(unit: Unit) -> tuple[float, float, float]:
    """Front, rear and width of a unit's hull from above [m]."""
    front = max(center[0] + 0.5 * size[0] for center, size in unit.hull)
    rear = min(center[0] - 0.5 * size[0] for center, size in unit.hull)
    return front, rear, max(size[1] for _, size in unit.hull)
