"""The shown vehicles as rigid units: their poses between two steps of the traffic."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from traffic_bridge.mirror.articulation import Articulation, TrailerMemory
from traffic_bridge.mirror.bodies import Outline
from traffic_bridge.mirror.looks import Unit
from traffic_bridge.mirror.slots import Slot
from traffic_bridge.modes.observation import TIGHT_TURN
from traffic_bridge.vehicles.types import VehicleType

# x, y, z, yaw, pitch, roll, yaw_rate, speed, acceleration, lateral_speed.
STATE = COLUMNS[:10]

CRAWL = 0.1  # [m/s] below which speed, lateral speed and yaw rate do not define a direction

PACE_BAND = 0.1  # a pace farther from 1 than this is ignored
NOWHERE = 1e12  # [m], x of a vehicle without a last state

_extrapolate = kernels.function(
    "iits_mirror_extrapolate",
    None,
    *(kernels.Integer, *2 * [kernels.Address], *5 * [kernels.Real], kernels.Address),
)
_place = kernels.function("iits_mirror_place", None, *2 * [kernels.Integer], *3 * [kernels.Address])
_articulate = kernels.function(
    "iits_mirror_articulate", None, *2 * [kernels.Integer], *5 * [kernels.Address]
)
_near = kernels.function(
    "iits_mirror_near",
    kernels.Integer,
    *(kernels.Integer, *2 * [kernels.Address], kernels.Integer, *3 * [kernels.Address]),
    *(kernels.Real, kernels.Address),
)
_show = kernels.function("iits_mirror_show", None, kernels.Integer, *5 * [kernels.Address])


class VehicleUnits:
    """Poses of the units of the shown vehicles.

    The arrays have one row per unit: first the vehicles of one unit, then all tractors, then all
    semitrailers.

    Args:
      types: of the vehicles.
      looks: units of each type.
      step_length: of the traffic [s].

    Attributes:
      slots: slot of each unit's vehicle; units: number of each unit in its vehicle.
    """

    def __init__(
        self,
        types: Sequence[VehicleType],
        looks: Sequence[tuple[Unit, ...]],
        step_length: float,
    ) -> None:
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
        """Forgets all vehicles."""
        self._memory.clear()
        self._names: list[str] = []
        self._state = kernels.Table(np.zeros((len(STATE), 0)))
        self.set_slots([])

    def set_slots(self, taken: Sequence[Slot]) -> None:
        """Shows the vehicles of other slots; vehicles of two units must come last."""
        known = dict(zip(self._names, self._state.numbers.T.tolist(), strict=True))
        self._names = [slot.vehicle or "" for slot in taken]
        nowhere = [NOWHERE] + [0.0] * (len(STATE) - 1)
        state = np.array([known.get(name, nowhere) for name in self._names])
        count = len(taken)
        # The states in the newest frame and in the one before, and the poses last computed.
        self._state = kernels.Table(state.reshape(count, len(STATE)).T)
        self._before = kernels.Table(np.empty((len(STATE), count)))
        self._now = kernels.Table(np.empty((6, count)))
        self._joint = [self._trucks[slot.type] for slot in taken if slot.type in self._trucks]
        self._single = count - len(self._joint)
        self._trucks_table = kernels.Table(
            np.array([(truck.kingpin, truck.axles) for truck in self._joint]).reshape(-1, 2).T
        )
        # Yaw of the semitrailers in the newest frame, and after the motion since it.
        self._trailer_yaw: list[float] = []
        self._trailers = kernels.Table(np.zeros(len(self._joint)))
        self.slots = [*taken, *taken[self._single :]]
        self.units = [0] * count + [1] * len(self._joint)
        self._of = [*range(count), *range(self._single, count)]
        # Radius of a circle about the unit's position that holds its hull [m].
        self._radius = kernels.Table(
            [
                self._extents[slot.type][unit][3]
                for slot, unit in zip(self.slots, self.units, strict=True)
            ]
        )
        self._position = kernels.Table(np.zeros((len(self.slots), 3)))
        self._quaternion = kernels.Table(np.zeros((len(self.slots), 4)))
        self._found = kernels.Table(np.empty(len(self.slots)))

    @property
    def position(self) -> FloatArray:
        """Positions of the units as last computed, shape (n, 3) [m]."""
        return self._position.numbers

    @property
    def quaternion(self) -> FloatArray:
        """Quaternions of the units as last computed, w first, shape (n, 4)."""
        return self._quaternion.numbers

    def take(self, frame: VehicleFrame, rows: IndexArray) -> None:
        """Reads the vehicles' states from a new frame.

        Args:
          frame: of the traffic.
          rows: of the vehicles in it, in the order of the slots.
        """
        self._before, self._state = self._state, self._before
        state = self._state.numbers
        frame.values.T[: len(STATE)].take(rows, axis=1, out=state, mode="clip")
        if self._joint:
            places = [
                (x, y, yaw, rate / speed if speed > CRAWL else 0.0)
                for x, y, _, yaw, _, _, rate, speed, *_ in state[:, self._single :].T.tolist()
            ]
            self._trailer_yaw = self._memory.follow(
                self._names[self._single :], self._joint, places
            )

    def move(self, elapsed: float, known: VehicleFrame | None = None) -> None:
        """Computes the poses of the units some time after the frame.

        Args:
          elapsed: that time [s].
          known: vehicles whose poses at that time are known; the others are extrapolated.
        """
        now, k, count = self._state, self._single, len(self._names)
        if elapsed != 0.0 or known is not None:
            now = self._now
            tables = self._state.address, self._before.address
            limits = CRAWL, TIGHT_TURN, PACE_BAND
            _extrapolate(count, *tables, elapsed, self._step_length, *limits, now.address)
        if known is not None:
            self._correct(known)
        _place(k, count, now.address, self._position.address, self._quaternion.address)
        if not self._joint:
            return
        yaws = self._trailer_yaw
        if now is self._now:
            places = zip(*now.numbers[[0, 1, 3], k:].tolist(), strict=True)
            yaws = [self._trailer(number, elapsed, *place) for number, place in enumerate(places)]
        self._trailers.numbers[:] = yaws
        articulation = self._trucks_table.address, self._trailers.address
        poses = self._position.address, self._quaternion.address
        _articulate(k, count, now.address, *articulation, *poses)

    def _correct(self, known: VehicleFrame) -> None:
        """Replaces the computed poses of the vehicles of a frame by theirs."""
        places = {name: place for place, name in enumerate(known.ids)}
        rows = np.array([places.get(name, -1) for name in self._names], dtype=np.intp)
        now, there = self._now.numbers, rows >= 0
        now[:, there] = known.values.T[: len(now), rows[there]]

    def _trailer(self, number: int, elapsed: float, x: float, y: float, yaw: float) -> float:
        """Yaw of a semitrailer whose vehicle has moved since the frame [rad]."""
        trailer = self._trailer_yaw[number]
        if elapsed == 0.0:
            return trailer
        x0, y0, _, yaw0 = self._state.numbers[:4, self._single + number].tolist()
        way = math.copysign(math.hypot(x - x0, y - y0), elapsed)
        return self._joint[number].pulled(trailer, 0.5 * (yaw0 + yaw), way)

    def show(self, bodies: kernels.Table, position: int, quaternion: int) -> None:
        """Writes the poses last computed into mocap bodies.

        Args:
          bodies: number of each unit's mocap body, shape (n,).
          position: address of MuJoCo's `mocap_pos`.
          quaternion: address of MuJoCo's `mocap_quat`.
        """
        poses = self._position.address, self._quaternion.address
        _show(len(self.slots), bodies.address, *poses, position, quaternion)

    def near(
        self, geoms: kernels.Table, radius: kernels.Table, centers: int, distance: float
    ) -> list[int]:
        """Numbers of the units whose hull may be near one of several circles about geoms.

        Args:
          geoms: their numbers, shape (m,); their heights do not count.
          radius: of the circles [m], shape (m,).
          centers: address of MuJoCo's `geom_xpos`.
          distance: up to which a hull is near [m].
        """
        count = _near(
            *(len(self.slots), self._position.address, self._radius.address),
            *(len(geoms.numbers), geoms.address, radius.address, centers, distance),
            self._found.address,
        )
        return [int(unit) for unit in self._found.numbers[:count].tolist()]

    def outline(self, unit: int) -> Outline:
        """A unit's rectangle from above and its motion, at the pose last computed."""
        slot, row = self.slots[unit], self._of[unit]
        front, rear, width, reach = self._extents[slot.type][self.units[unit]]
        x, y, _ = self.position[unit].tolist()
        w, i, j, k = self.quaternion[unit].tolist()
        yaw = math.atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k))
        ahead_x, ahead_y, middle = math.cos(yaw), math.sin(yaw), 0.5 * (front + rear)
        way, yaw_rate, speed = self._state.numbers[[3, 6, 7], row].tolist()
        spin = abs(yaw_rate)
        if row >= self._single:
            # A unit also turns about the box's center as the semitrailer is pulled straight.
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
    """Front, rear and width of a unit's hull, and its reach about the vehicle's center [m]."""
    front = max(center[0] + 0.5 * size[0] for center, size in unit.hull)
    rear = min(center[0] - 0.5 * size[0] for center, size in unit.hull)
    width = max(size[1] for _, size in unit.hull)
    # Even at an angle of 90 degrees, the tractor's farthest corner is within the whole length.
    return front, rear, width, kind.length if unit.name else math.hypot(front, 0.5 * width)
