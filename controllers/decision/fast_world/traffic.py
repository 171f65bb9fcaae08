"""A two-lane highway with traffic, in numpy: the fast world that the policy is trained in.

The drivers of the SUMO traffic follow by the IDM (Treiber et al. 2000, eq. 3) and change lanes by
MOBIL (Kesting et al. 2007, eq. 3-5), on a straight two-lane road, in a window that moves with the
truck. There is no SUMO, no MuJoCo and no lateral dynamics; lane changes of the others are instant
for their followers, and the truck sees them as a smooth move. This world is some hundred times
faster than the full chain; its results hold for this world only.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from controllers.decision.fast_world.changes import Queue, Vehicles, gains
from controllers.decision.fast_world.config import (
    KINDS,
    LANE_WIDTH,
    LANES,
    SHARES,
    TRUCK_KIND,
    Drivers,
    HighwayConfig,
    Obstacle,
    idm_acceleration,
)
from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.messages import TrackedVehicle

Number = TypeVar("Number", float, FloatArray)

HARDEST_BRAKING = 8.0  # [m/s2], dry road
# Arrays of `HighwayTraffic` with one entry per vehicle, and their types.
COLUMNS = {
    **dict.fromkeys(("serial", "lane", "kind"), np.int64),
    **dict.fromkeys(("front", "speed", "acceleration", "length", "desired"), np.float64),
    **dict.fromkeys(("change_time", "change_from"), np.float64),
}


def blended(phase: Number, duration: float) -> tuple[Number, Number]:
    """Returns the share of a lane change at a phase of 0 to 1, by a quintic, and its rate [1/s]."""
    blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return blend, 30.0 * phase**2 * (1.0 - phase) ** 2 / duration


class HighwayTraffic:
    """The vehicles around the truck; arrays of shape (n,), changed in place by `step`.

    Attributes:
      clock: time since the start [s].
      front: stations of the front bumpers [m]; the other arrays also have one entry per vehicle.
    """

    CHANGE_DURATION = 3.5
    CHANGE_INTERVAL = 6.0

    serial: IntArray
    front: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    lane: IntArray
    length: FloatArray
    desired: FloatArray
    kind: IntArray
    change_time: FloatArray
    change_from: FloatArray

    def __init__(self, config: HighwayConfig, generator: np.random.Generator) -> None:
        self.config = config
        self._random = generator
        self._serial = 0
        self.clock = 0.0
        self._round_due = 0.0
        for name, kind in COLUMNS.items():
            setattr(self, name, np.zeros(0, dtype=kind))
        # Beyond each edge of the window one vehicle per lane waits: its distance from the edge.
        self._wait_ahead = [0.5 * self._headway() for _ in range(LANES)]
        self._wait_behind = [0.5 * self._headway() for _ in range(LANES)]
        self._most_ahead = list(self._wait_ahead)
        self._most_behind = list(self._wait_behind)

    def fill(self, truck: Obstacle) -> None:
        """Places traffic in the whole window, with 40 m free around the truck in its lane."""
        for lane in range(LANES):
            front = truck.front - self.config.window_behind
            while True:
                front += self._headway()
                if front > truck.front + self.config.window_ahead:
                    break
                near = truck.front - truck.length - 40.0 < front < truck.front + 40.0
                if not (near and lane == truck.lane):
                    self.spawn(lane, front)

    def step(self, obstacles: list[Obstacle]) -> None:
        """Advances one timestep; obstacles are the lanes that the truck occupies."""
        dt = self.config.timestep
        self.clock += dt
        if self.clock >= self._round_due:
            self._round_due += 1.0
            self._change_lanes(obstacles)
        vehicles = self._vehicles(obstacles)
        gap, leader_speed = Queue(vehicles).ahead()
        wanted = idm_acceleration(
            vehicles.speed, vehicles.desired, gap, leader_speed, vehicles.drivers
        )
        wanted = np.maximum(wanted[: self.front.size], -HARDEST_BRAKING)
        new_speed = np.maximum(0.0, self.speed + wanted * dt)
        self.front += 0.5 * (self.speed + new_speed) * dt
        self.acceleration = (new_speed - self.speed) / dt
        self.speed = new_speed
        self._exchange(obstacles[0])

    def tracked(self, front: float | None = None) -> tuple[TrackedVehicle, ...]:
        """Returns the vehicles as messages, x along the road, y to the left of lane 0's center.

        Args:
          front: of the truck [m], to return only vehicles in sight of it; default: all.
        """
        seen = np.arange(self.front.size)
        if front is not None:
            distance = self.front - front
            low, high = -self.config.sight_behind, self.config.sight_ahead
            seen = np.flatnonzero((distance > low) & (distance < high))
        change_from = self.change_from[seen]
        phase = (self.clock - self.change_time[seen]) / self.CHANGE_DURATION
        blend, rate = blended(np.minimum(np.maximum(phase, 0.0), 1.0), self.CHANGE_DURATION)
        step = self.lane[seen] * LANE_WIDTH - change_from
        rows = zip(
            self.serial[seen].tolist(),
            self.kind[seen].tolist(),
            (self.front - 0.5 * self.length)[seen].tolist(),
            (change_from + step * blend).tolist(),
            (step * rate).tolist(),
            self.speed[seen].tolist(),
            self.acceleration[seen].tolist(),
            strict=True,
        )
        return tuple(
            TrackedVehicle(
                id=f"v{serial}",
                kind=(kind := KINDS[index]).kind,
                x=x,
                y=y,
                speed=speed,
                acceleration=acceleration,
                lateral_speed=lateral_speed,
                station=x,
                offset=y,
                lane=int(y / LANE_WIDTH + 0.5),
                length=kind.length,
                width=kind.width,
                height=kind.height,
            )
            for serial, index, x, y, lateral_speed, speed, acceleration in rows
        )

    def neighbors(self, front: float, lane: int) -> tuple[int, int]:
        """Returns indices of the vehicles ahead of and behind a front in a lane; -1 for none."""
        mine = np.flatnonzero(self.lane == lane)
        if mine.size == 0:
            return -1, -1
        ahead = mine[self.front[mine] > front]
        behind = mine[self.front[mine] <= front]
        return (
            int(ahead[np.argmin(self.front[ahead])]) if ahead.size else -1,
            int(behind[np.argmax(self.front[behind])]) if behind.size else -1,
        )

    def _headway(self) -> float:
        """Draws a distance between fronts [m]: Poisson arrivals, enough to drive at the limit."""
        mean = self.config.mean_headway
        if not math.isfinite(mean):
            return math.inf
        least = KINDS[0].length + KINDS[0].minimum_gap + 1.5 * self.config.traffic_speed
        return max(least, float(self._random.exponential(mean)))

    def spawn(self, lane: int, front: float) -> None:
        """Adds a random vehicle with its front bumper at a station [m], if there is room."""
        random = self._random
        index = int(random.choice(len(KINDS), p=SHARES))
        kind = KINDS[index]
        factor = float(random.normal(kind.desired_speed_mean, kind.desired_speed_deviation))
        desired = self.config.traffic_speed * min(1.0, max(kind.desired_speed_low, factor))
        speed = desired
        leader, follower = self.neighbors(front, lane)
        if leader >= 0 and self.front[leader] - self.length[leader] - front < 2.0 * speed:
            speed = min(speed, float(self.speed[leader]))
        if follower >= 0 and front - kind.length - self.front[follower] < kind.minimum_gap:
            return  # The vehicle is too long for the gap.
        self._serial += 1
        row: dict[str, float] = {
            "serial": self._serial,
            "front": front,
            "speed": speed,
            "acceleration": 0.0,
            "lane": lane,
            "length": kind.length,
            "desired": desired,
            "kind": index,
            "change_time": -math.inf,
            "change_from": lane * LANE_WIDTH,
        }
        for name, value in row.items():
            array = getattr(self, name)
            setattr(self, name, np.append(array, np.asarray(value, dtype=array.dtype)))

    def _exchange(self, truck: Obstacle) -> None:
        """Removes vehicles that leave the window and adds those that its edges reach.

        A vehicle that waits beyond an edge drives at 0.9 of the traffic's limit; if the window
        moves away from it, its distance is at most the headway that was drawn for it.
        """
        low = truck.front - self.config.window_behind
        high = truck.front + self.config.window_ahead
        keep = (self.front > low - 1.0) & (self.front < high + 1.0)
        if not keep.all():
            for name in COLUMNS:
                setattr(self, name, getattr(self, name)[keep])
        closing = (truck.speed - 0.9 * self.config.traffic_speed) * self.config.timestep
        for lane in range(LANES):
            self._wait_ahead[lane] = min(self._wait_ahead[lane] - closing, self._most_ahead[lane])
            if self._wait_ahead[lane] <= 0.0 and self._free(lane, high):
                self.spawn(lane, high)
                self._wait_ahead[lane] = self._most_ahead[lane] = self._headway()
            wait = min(self._wait_behind[lane] + closing, self._most_behind[lane])
            self._wait_behind[lane] = wait
            if wait <= 0.0 and self._free(lane, low):
                self.spawn(lane, low)
                self._wait_behind[lane] = self._most_behind[lane] = self._headway()

    def _free(self, lane: int, front: float) -> bool:
        mine = self.front[self.lane == lane]
        return not bool((np.abs(mine - front) < 30.0).any())

    def _vehicles(self, obstacles: list[Obstacle]) -> Vehicles:
        """Returns the vehicles, then the truck, once for each lane that it occupies."""
        return Vehicles(
            front=np.append(self.front, [o.front for o in obstacles]),
            length=np.append(self.length, [o.length for o in obstacles]),
            speed=np.append(self.speed, [o.speed for o in obstacles]),
            # The truck keeps its speed.
            desired=np.append(self.desired, [max(o.speed, 1.0) for o in obstacles]),
            lane=np.append(self.lane, [o.lane for o in obstacles]),
            drivers=Drivers(np.append(self.kind, [TRUCK_KIND] * len(obstacles))),
        )

    def _change_lanes(self, obstacles: list[Obstacle]) -> None:
        """Runs a MOBIL round, vehicle by vehicle; each sees the changes of those before it."""
        rested = np.flatnonzero(self.clock - self.change_time > self.CHANGE_INTERVAL)
        while rested.size:
            vehicles = self._vehicles(obstacles)
            wanting = np.flatnonzero(gains(vehicles, rested, self.config.keeps_right) > 0.0)
            if wanting.size == 0:
                return
            first = int(rested[wanting[0]])
            self.change_from[first] = self.lane[first] * LANE_WIDTH
            self.change_time[first] = self.clock
            self.lane[first] = 1 - self.lane[first]
            rested = rested[wanting[0] + 1 :]
