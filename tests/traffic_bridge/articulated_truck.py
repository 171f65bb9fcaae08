"""A scripted articulated truck for the tests of behavior: exact kinematics, two boxes."""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.messages import EgoState
from iits_mj.road import Route
from tests.traffic_bridge.scripted_truck import corners, overlap, vehicle_box

# The combination of `EgoFootprint`: 16.5 m long, 2.55 m wide, front bumper 1.40 m before the axle.
WIDTH, LENGTH, FRONT = 2.55, 16.5, 1.40
WHEELBASE = 3.8  # [m] steer axle to the fifth wheel, which is above the drive axle
TRAILER = 7.7  # [m] fifth wheel to the trailer's axle group
TRACTOR_LENGTH = 6.0
TRAILER_FRONT = 1.4  # [m] of the trailer before the fifth wheel
STEP = 0.1


class ArticulatedTruck:
    """Follows the road at a smoothly changing offset; both units roll without slip.

    The steer axle moves along the path; tractor and trailer follow by the tractrix
    dpsi/dt = v / L sin(direction of the pulling point's motion - psi).
    """

    def __init__(self, route: Route, station: float, offset: float, speed: float) -> None:
        self.route, self.station, self.offset, self.speed = route, station, offset, speed
        self.time = 0.0
        heading = float(route.evaluate(station, offset).heading)
        self.yaw = self.trailer_yaw = heading
        self._change: tuple[float, float, float, float] | None = None

    def change_lane(self, offset: float, duration: float) -> None:
        """Begins a quintic motion to another offset, from rest to rest."""
        self._change = (self.time, self.offset, offset, duration)

    @property
    def changing(self) -> bool:
        return self._change is not None

    def advance(self, acceleration: float = 0.0) -> EgoState:
        """Advances one traffic step in ten steps of the kinematics."""
        dt = STEP / 10.0
        for _ in range(10):
            self.time += dt
            self.speed = max(self.speed + acceleration * dt, 0.0)
            x, y = self._steer_axle()
            self.station += self.speed * dt
            if self._change is not None:
                begin, old, new, duration = self._change
                t = min((self.time - begin) / duration, 1.0)
                self.offset = old + (new - old) * t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
                if t >= 1.0:
                    self._change = None
            ahead_x, ahead_y = self._steer_axle()
            way = math.hypot(ahead_x - x, ahead_y - y)
            if way > 1e-9:
                angle = math.atan2(ahead_y - y, ahead_x - x) - self.yaw
                # The fifth wheel rolls along the tractor's axis.
                pulled = way * math.cos(angle)
                self.trailer_yaw += pulled / TRAILER * math.sin(self.yaw - self.trailer_yaw)
                self.yaw += way / WHEELBASE * math.sin(angle)
        return self.state()

    def _steer_axle(self) -> tuple[float, float]:
        point = self.route.evaluate(self.station, self.offset)
        return float(point.x), float(point.y)

    def _fifth_wheel(self) -> tuple[float, float]:
        x, y = self._steer_axle()
        return x - WHEELBASE * math.cos(self.yaw), y - WHEELBASE * math.sin(self.yaw)

    def state(self) -> EgoState:
        """The truck's state."""
        x, y = self._steer_axle()
        fifth_x, fifth_y = self._fifth_wheel()
        rear = (
            fifth_x - TRAILER * math.cos(self.trailer_yaw),
            fifth_y - TRAILER * math.sin(self.trailer_yaw),
        )
        return EgoState(
            time=self.time,
            x=x,
            y=y,
            z=float(self.route.evaluate(self.station, self.offset).z),
            yaw=self.yaw,
            speed=self.speed,
            articulation=self.yaw - self.trailer_yaw,
            station=self.station,
            offset=self.offset,
            trailer_offset=float(self.route.locate(*rear, self.station)[1]),
        )

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (4, 2) of tractor and trailer, together 16.5 m long when straight."""
        x, y = self._steer_axle()
        back = 0.5 * TRACTOR_LENGTH - FRONT
        tractor = corners(
            x - back * math.cos(self.yaw),
            y - back * math.sin(self.yaw),
            self.yaw,
            TRACTOR_LENGTH,
            WIDTH,
        )
        fifth_x, fifth_y = self._fifth_wheel()
        length = LENGTH - FRONT - WHEELBASE + TRAILER_FRONT
        back = 0.5 * length - TRAILER_FRONT
        trailer = corners(
            fifth_x - back * math.cos(self.trailer_yaw),
            fifth_y - back * math.sin(self.trailer_yaw),
            self.trailer_yaw,
            length,
            WIDTH,
        )
        return tractor, trailer

    def touches(self, vehicle) -> bool:
        """Whether a vehicle's box overlaps either unit."""
        if math.hypot(vehicle.x - self._steer_axle()[0], vehicle.y - self._steer_axle()[1]) > 40.0:
            return False
        box = vehicle_box(vehicle)
        return any(overlap(box, unit) for unit in self.boxes())
