"""A two-lane highway with traffic, in numpy: the fast world that the policy is trained in.

What it is: other vehicles follow by the IDM (Treiber et al. 2000, eq. 3) and change lanes by MOBIL
(Kesting et al. 2007, eq. 3-5) on a straight two-lane road, in a window that moves with the truck.
What it is not: there is no SUMO, no MuJoCo, no lateral dynamics; lane changes of the others are
instant for their followers and drawn as a smooth move. It is some hundred times faster than the
full chain, and figures from it are figures of this world only.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.decision.fast_world.config import (
    KINDS,
    SHARES,
    HighwayConfig,
    Obstacle,
    idm_acceleration,
)
from controllers.decision.fast_world.road import LANE_WIDTH, LANES
from iits_mj.messages import TrackedVehicle

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class HighwayTraffic:
    """The vehicles about the truck; arrays of shape (n,), changed in place by `step`."""

    CHANGE_DURATION = 3.5
    CHANGE_INTERVAL = 6.0

    def __init__(self, config: HighwayConfig, generator: np.random.Generator) -> None:
        self.config = config
        self._random = generator
        self._serial = 0
        self._clock = 0.0
        self._round_due = 0.0
        self.serial: IntArray = np.zeros(0, dtype=np.int64)
        self.front: FloatArray = np.zeros(0)
        self.speed: FloatArray = np.zeros(0)
        self.acceleration: FloatArray = np.zeros(0)
        self.lane: IntArray = np.zeros(0, dtype=np.int64)
        self.length: FloatArray = np.zeros(0)
        self.desired: FloatArray = np.zeros(0)
        self.time_gap: FloatArray = np.zeros(0)
        self.kind: IntArray = np.zeros(0, dtype=np.int64)
        self.change_time: FloatArray = np.zeros(0)
        self.change_from: FloatArray = np.zeros(0)
        # Beyond each edge of the window waits one vehicle a lane: its distance from the edge.
        self._wait_ahead = [0.5 * self._headway() for _ in range(LANES)]
        self._wait_behind = [0.5 * self._headway() for _ in range(LANES)]
        self._most_ahead = list(self._wait_ahead)
        self._most_behind = list(self._wait_behind)

    def fill(self, truck: Obstacle) -> None:
        """Places traffic over the whole window, leaving 40 m free about the truck in its lane."""
        for lane in range(LANES):
            front = truck.front - self.config.window_behind
            while True:
                front += self._headway()
                if front > truck.front + self.config.window_ahead:
                    break
                near = truck.front - truck.length - 40.0 < front < truck.front + 40.0
                if not (near and lane == truck.lane):
                    self._spawn(lane, front)

    def step(self, obstacles: list[Obstacle]) -> None:
        """Advances one timestep; obstacles are the lanes that the truck occupies."""
        dt = self.config.timestep
        self._clock += dt
        if self._clock >= self._round_due:
            self._round_due += 1.0
            self._change_lanes(obstacles)
        acceleration = self._accelerations(obstacles)
        new_speed = np.maximum(0.0, self.speed + acceleration * dt)
        self.front += 0.5 * (self.speed + new_speed) * dt
        self.acceleration = (new_speed - self.speed) / dt
        self.speed = new_speed
        self._exchange(obstacles[0])

    def tracked(self) -> tuple[TrackedVehicle, ...]:
        """The vehicles as messages, x along the straight road, y to the left of lane 0's centre."""
        phase = np.clip((self._clock - self.change_time) / self.CHANGE_DURATION, 0.0, 1.0)
        blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
        rate = 30.0 * phase**2 * (1.0 - phase) ** 2 / self.CHANGE_DURATION
        step = self.lane * LANE_WIDTH - self.change_from
        offset = (self.change_from + step * blend).tolist()
        lateral = (step * rate).tolist()
        center = (self.front - 0.5 * self.length).tolist()
        rows = zip(
            self.serial.tolist(),
            self.kind.tolist(),
            center,
            offset,
            lateral,
            self.speed.tolist(),
            self.acceleration.tolist(),
            self.lane.tolist(),
            strict=True,
        )
        vehicles = []
        for serial, index, x, y, lateral_speed, speed, acceleration, lane in rows:
            kind = KINDS[index]
            vehicles.append(
                TrackedVehicle(
                    id=f"v{serial}",
                    kind=kind.name,
                    x=x,
                    y=y,
                    speed=speed,
                    acceleration=acceleration,
                    lateral_speed=lateral_speed,
                    station=x,
                    offset=y,
                    lane=lane,
                    length=kind.length,
                    width=kind.width,
                    height=kind.height,
                )
            )
        return tuple(vehicles)

    def neighbors(self, front: float, lane: int) -> tuple[int, int]:
        """Indices of the vehicle ahead and behind a front position in a lane; -1 when none."""
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
        """Distance between fronts [m]: a least headway plus an exponential rest."""
        mean = self.config.mean_headway
        if not math.isfinite(mean):
            return math.inf
        least = min(12.0 + 1.5 * self.config.traffic_speed, 0.8 * mean)
        return float(least + self._random.exponential(mean - least))

    def _spawn(self, lane: int, front: float) -> None:
        random = self._random
        index = int(random.choice(len(KINDS), p=SHARES))
        kind = KINDS[index]
        factor = float(random.normal(kind.factor_mean, kind.factor_deviation))
        desired = self.config.traffic_speed * min(1.0, max(kind.factor_low, factor))
        speed = desired
        leader, _ = self.neighbors(front, lane)
        if leader >= 0 and self.front[leader] - self.length[leader] - front < 2.0 * speed:
            speed = min(speed, float(self.speed[leader]))
        self._serial += 1
        row: dict[str, float] = {
            "serial": self._serial,
            "front": front,
            "speed": speed,
            "acceleration": 0.0,
            "lane": lane,
            "length": kind.length,
            "desired": desired,
            "time_gap": kind.time_gap,
            "kind": index,
            "change_time": -math.inf,
            "change_from": lane * LANE_WIDTH,
        }
        for name, value in row.items():
            array = getattr(self, name)
            setattr(self, name, np.append(array, np.asarray(value, dtype=array.dtype)))

    def _exchange(self, truck: Obstacle) -> None:
        """Lets vehicles leave the window, and those in that its edges catch up with.

        What waits beyond an edge drives at 0.9 of the traffic's limit; when the window runs away
        from it, it is never farther than the headway that was drawn for it.
        """
        low = truck.front - self.config.window_behind
        high = truck.front + self.config.window_ahead
        keep = (self.front > low - 1.0) & (self.front < high + 1.0)
        if not keep.all():
            for name in _COLUMNS:
                setattr(self, name, getattr(self, name)[keep])
        closing = (truck.speed - 0.9 * self.config.traffic_speed) * self.config.timestep
        for lane in range(LANES):
            self._wait_ahead[lane] = min(self._wait_ahead[lane] - closing, self._most_ahead[lane])
            if self._wait_ahead[lane] <= 0.0 and self._free(lane, high):
                self._spawn(lane, high)
                self._wait_ahead[lane] = self._most_ahead[lane] = self._headway()
            wait = min(self._wait_behind[lane] + closing, self._most_behind[lane])
            self._wait_behind[lane] = wait
            if wait <= 0.0 and self._free(lane, low):
                self._spawn(lane, low)
                self._wait_behind[lane] = self._most_behind[lane] = self._headway()

    def _free(self, lane: int, front: float) -> bool:
        mine = self.front[self.lane == lane]
        return not bool((np.abs(mine - front) < 30.0).any())

    def _sorted(self, obstacles: list[Obstacle]) -> tuple[FloatArray, ...]:
        """Front, rear, speed, lane and order of vehicles and obstacles, by lane and position."""
        front = np.concatenate([self.front, [o.front for o in obstacles]])
        length = np.concatenate([self.length, [o.length for o in obstacles]])
        speed = np.concatenate([self.speed, [o.speed for o in obstacles]])
        lane = np.concatenate([self.lane, np.array([o.lane for o in obstacles], dtype=np.int64)])
        return front, front - length, speed, lane

    def _accelerations(self, obstacles: list[Obstacle]) -> FloatArray:
        front, rear, speed, lane = self._sorted(obstacles)
        order = np.lexsort((front, lane))
        gap = np.full(front.size, np.inf)
        leader_speed = speed.copy()
        follower, leader = order[:-1], order[1:]
        same = lane[follower] == lane[leader]
        follower, leader = follower[same], leader[same]
        gap[follower] = rear[leader] - front[follower]
        leader_speed[follower] = speed[leader]
        n = self.front.size
        return idm_acceleration(
            speed[:n], self.desired, gap[:n], leader_speed[:n], self.time_gap, self.config
        )

    def _change_lanes(self, obstacles: list[Obstacle]) -> None:
        """One MOBIL round, front to back; a change counts at once for those that follow it."""
        current = self._accelerations(obstacles)
        held = (current < 0.6) | (self.lane > 0)
        rested = self._clock - self.change_time > self.CHANGE_INTERVAL
        for i in np.flatnonzero(held & rested)[::-1]:
            if self._wants_change(int(i), float(current[i]), obstacles):
                self.change_from[i] = self.lane[i] * LANE_WIDTH
                self.change_time[i] = self._clock
                self.lane[i] = 1 - self.lane[i]

    def _wants_change(self, i: int, current: float, obstacles: list[Obstacle]) -> bool:
        config = self.config
        target = 1 - int(self.lane[i])
        gap, leader_speed, rear_gap, rear_speed, rear = self._gaps(i, target, obstacles)
        if gap < config.standstill_gap or rear_gap < config.standstill_gap:
            return False
        pair = np.array([self.speed[i], rear_speed])
        rear_desired = self.desired[rear] if rear >= 0 else max(rear_speed, 1.0)
        rear_time_gap = self.time_gap[rear] if rear >= 0 else 1.5
        after = idm_acceleration(
            pair,
            np.array([self.desired[i], rear_desired]),
            np.array([gap, rear_gap]),
            np.array([leader_speed, self.speed[i]]),
            np.array([self.time_gap[i], rear_time_gap]),
            config,
        )
        if after[1] < -config.safe_deceleration or after[0] < -config.safe_deceleration:
            return False
        before_rear = self.acceleration[rear] if rear >= 0 else 0.0
        loss = max(0.0, float(before_rear - after[1])) if math.isfinite(rear_gap) else 0.0
        bias = config.keep_right_bias if target == 0 else -config.keep_right_bias
        return bool(after[0] - current + bias - config.politeness * loss > config.change_threshold)

    def _gaps(
        self, i: int, target: int, obstacles: list[Obstacle]
    ) -> tuple[float, float, float, float, int]:
        """Gap and speed of the leader, gap, speed and index of the follower in another lane."""
        front, rear = float(self.front[i]), float(self.front[i] - self.length[i])
        lead, follow = self.neighbors(front, target)
        gap, leader_speed = math.inf, float(self.speed[i])
        rear_gap, rear_speed, index = math.inf, float(self.speed[i]), -1
        if lead >= 0:
            gap = float(self.front[lead] - self.length[lead]) - front
            leader_speed = float(self.speed[lead])
        if follow >= 0:
            rear_gap, rear_speed, index = rear - self.front[follow], self.speed[follow], follow
        for obstacle in obstacles:
            if obstacle.lane != target:
                continue
            if obstacle.front > front and obstacle.front - obstacle.length - front < gap:
                gap, leader_speed = obstacle.front - obstacle.length - front, obstacle.speed
            if obstacle.front <= front and rear - obstacle.front < rear_gap:
                rear_gap, rear_speed, index = rear - obstacle.front, obstacle.speed, -1
        return gap, leader_speed, float(rear_gap), float(rear_speed), index


_COLUMNS = (
    "serial",
    "front",
    "speed",
    "acceleration",
    "lane",
    "length",
    "desired",
    "time_gap",
    "kind",
    "change_time",
    "change_from",
)
