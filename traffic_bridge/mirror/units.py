"""The shown vehicles as rigid units: their poses between two steps of the traffic."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from traffic_bridge.mirror.articulation import Articulation, Pose, TrailerMemory, units
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
      position: of the units as last computed, shape (n, 3) [m].
      quaternion: of the units likewise, shape (n, 4), w first.
      radius: of a circle about the unit's position that holds its hull, shape (n,) [m].
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
        self._state = np.zeros((len(STATE), 0))
        self._trailer_yaw: list[float] = []
        self.set_slots([])

    def set_slots(self, taken: Sequence[Slot]) -> None:
        """Shows the vehicles of other slots; vehicles of two units must come last."""
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

    def take(self, frame: VehicleFrame, rows: IndexArray) -> None:
        """Reads the vehicles' states from a new frame.

        Args:
          frame: of the traffic.
          rows: of the vehicles in it, in the order of the slots.
        """
        self._before, self._state = self._state, np.asarray(frame.values.T[: len(STATE), rows])
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
        """Computes the poses of the units some time after the frame.

        Args:
          elapsed: that time [s].
          known: vehicles whose poses at that time are known; the others are extrapolated.
        """
        now = self._state[:6]
        if elapsed != 0.0:
            if self._trend is None:
                self._trend = trend(self._state, self._before, self._step_length)
            now = moved(self._state, self._trend, elapsed, self._step_length)
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

    def _corrected(self, now: FloatArray, known: VehicleFrame) -> FloatArray:
        """Poses, shape (6, n), in which those of the vehicles of a frame are replaced."""
        places = {name: place for place, name in enumerate(known.ids)}
        rows = np.array([places.get(name, -1) for name in self._names], dtype=np.intp)
        now, there = now.copy(), rows >= 0
        now[:, there] = known.values.T[: len(now), rows[there]]
        return now

    def _trailer(self, number: int, elapsed: float, pose: Pose) -> float:
        """Yaw of a semitrailer whose vehicle has moved since the frame [rad]."""
        trailer = self._trailer_yaw[number]
        if elapsed == 0.0:
            return trailer
        x0, y0, _, yaw0 = self._state[:4, self._single + number].tolist()
        way = math.copysign(math.hypot(pose[0] - x0, pose[1] - y0), elapsed)
        return self._joint[number].pulled(trailer, 0.5 * (yaw0 + pose[3]), way)

    def outline(self, unit: int) -> Outline:
        """A unit's rectangle from above and its motion, at the pose last computed."""
        slot, row = self.slots[unit], self._of[unit]
        front, rear, width, reach = self._extents[slot.type][self.units[unit]]
        x, y, _ = self.position[unit].tolist()
        w, i, j, k = self.quaternion[unit].tolist()
        yaw = math.atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k))
        ahead_x, ahead_y, middle = math.cos(yaw), math.sin(yaw), 0.5 * (front + rear)
        way, yaw_rate, speed = self._state[[3, 6, 7], row].tolist()
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


def trend(state: FloatArray, last: FloatArray, step_length: float) -> FloatArray:
    """Properties of the vehicles' motion in the last step that their present state lacks.

    The pace is the distance that they covered as a fraction of speed times time. Neighboring lanes
    in a bend share SUMO's positions but differ in length, by some per mille; a recording with
    instantaneous speeds, unlike SUMO's, differs by a dt/2. Beside the road's reference line a
    path climbs more than the road where the cross slope changes.

    Args:
      state: of n vehicles, see `STATE`, shape (10, n).
      last: the same one step before, shape (10, n); x is `NOWHERE` for a new vehicle.
      step_length: of the traffic [s].

    Returns:
      Pace, pitch rate and roll rate [rad/s], and by how much the path was steeper than the pitch,
      shape (4, n); 1, 0, 0, 0 if the pace is far from 1: the vehicle is new or was moved.
    """
    due = step_length * np.maximum(np.hypot(state[7], state[9]), CRAWL)
    change = state - last
    way = np.hypot(change[0], change[1])
    found = np.empty((4, due.size))
    found[0] = way / due
    strange = np.abs(found[0] - 1.0) > PACE_BAND
    way[strange] = 1.0
    found[1:3] = change[4:6] / step_length
    found[3] = change[2] / way + np.tan(state[4] - 0.5 * change[4])
    if strange.any():
        found[:, strange] = ((1.0,), (0.0,), (0.0,), (0.0,))
    return found


def moved(state: FloatArray, trend: FloatArray, elapsed: float, step_length: float) -> FloatArray:
    """Poses of vehicles some time after (or before) a frame.

    Acceleration and rates stay constant. SUMO's default scheme, semi-implicit Euler, moves a
    vehicle by v(k+1) dt in step k+1, so v(k) is the mean speed of the step that ended, and the
    speed at its end is half a step's gain higher: v(k) + a dt/2. With a constant acceleration the
    result meets SUMO's next position, v dt + a dt^2 on, and its last one, v dt back.

    Args:
      state: of n vehicles, see `STATE`, shape (10, n).
      trend: see `trend`, shape (4, n).
      elapsed: time since the frame [s], negative for before.
      step_length: of the traffic [s].

    Returns:
      x, y, z [m], yaw, pitch, roll [rad], shape (6, n).
    """
    yaw, pitch, yaw_rate, speed, acceleration, lateral = state[[3, 4, 6, 7, 8, 9]]
    way = elapsed * trend[0] * (speed + 0.5 * acceleration * (step_length + elapsed))
    if elapsed > 0.0:
        # Braking ends at standstill: a vehicle does not roll backwards.
        way = np.maximum(way, 0.0)
    turn = elapsed * yaw_rate
    # The arc is taken as its chord: shorter by less than 1e-3 at 1.5 rad/s.
    chord = yaw + 0.5 * turn
    if lateral.any():
        # Speed is along the lane, and a slow vehicle's box turns less than its path.
        slide = np.arctan2(lateral, np.maximum(speed, CRAWL))
        chord = chord + slide - np.arctan2(lateral, np.maximum(speed, TIGHT_TURN))
        way = np.where(speed > CRAWL, way / np.cos(slide), way)
    found = state[:6].copy()
    found[0] += way * np.cos(chord)
    found[1] += way * np.sin(chord)
    tilt = elapsed * trend[1:3]
    # Pitch is positive nose down (ISO 8855); roads are measured in the plane.
    found[2] += way * (trend[3] - np.tan(pitch + 0.5 * tilt[0]))
    found[3] += turn
    found[4:] += tilt
    return found


def quaternions(angles: FloatArray) -> FloatArray:
    """Quaternions (4, n), w first, of intrinsic rotations by yaw, pitch, roll (3, n) [rad]."""
    half = 0.5 * angles
    trig = np.empty((2, *half.shape))
    np.cos(half, out=trig[0])
    np.sin(half, out=trig[1])
    # cos and sin of pitch times those of roll: cc, cs, sc, ss.
    products = (trig[:, None, 1] * trig[None, :, 2]).reshape(4, -1)
    c, s = products * trig[0, 0], products * trig[1, 0]
    found = np.empty((4, half.shape[1]))
    np.add(c[0], s[3], out=found[0])
    np.subtract(c[1], s[2], out=found[1])
    np.add(c[2], s[1], out=found[2])
    np.subtract(s[0], c[3], out=found[3])
    return found
