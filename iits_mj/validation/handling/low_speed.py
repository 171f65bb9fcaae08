"""The 90 degree turn of 12.5 m radius at 5 km/h against the kinematic trailer.

The steer axle's centre runs near the arc; `swept_path` has the turn by the Australian PBS, whose
arc is that of the outer steer tire's wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import Kinematic
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import KMH
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import Recording, drive

RADIUS = 12.5
_SPEED = 5.0 * KMH
_STRAIGHT = 2.0


@dataclass(frozen=True)
class Turn:
    """One turn.

    Attributes:
      recording: of the truck.
      kinematic_front, kinematic_rear: tracks of the kinematic model, whose tractor turns as the
        truck's does: steer axle and trailer group, (n, 2) [m].
    """

    recording: Recording
    kinematic_front: FloatArray
    kinematic_rear: FloatArray

    def path_error(self) -> float:
        """Greatest distance of the trailer group's track from the kinematic track [m]."""
        truck = np.column_stack([self.recording.rear_x, self.recording.rear_y])
        return max(_distance(point, self.kinematic_rear) for point in truck[::20])

    def off_tracking(self) -> float:
        """Greatest distance of the trailer group's track from the steer axle's track [m]."""
        front = np.column_stack([self.recording.x, self.recording.y])
        rear = np.column_stack([self.recording.rear_x, self.recording.rear_y])
        inside = rear[(rear[:, 0] > front[0, 0]) & (rear[:, 0] < front[-1, 0])]
        return max(_distance(point, front) for point in inside[::20])

    def kinematic_off_tracking(self) -> float:
        """The same for the kinematic model [m]."""
        front, rear = self.kinematic_front, self.kinematic_rear
        inside = rear[(rear[:, 0] > front[0, 0]) & (rear[:, 0] < front[-1, 0])]
        return max(_distance(point, front) for point in inside[::20])


def turn(payload: float, timestep: float) -> Turn:
    """Drives the turn; the steer axle's centre follows the arc of 12.5 m."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    parameters = truck.parameters
    kinematic = Kinematic.from_parameters(parameters)
    angle = parameters.steering.ratio * np.arcsin(kinematic.L / RADIUS)
    truck.reset(speed=_SPEED)
    # The wheels are turned within 1.5 s, as somebody who knows the corner does.
    rate = angle / 1.5

    def steering(time: float, yaw: float) -> float:
        into = np.clip((time * _SPEED - _STRAIGHT) / _SPEED * rate, 0.0, angle)
        # Straighten so that the heading ends near 90 degrees.
        left = np.deg2rad(90.0) - yaw
        lead = 0.75 * _SPEED / RADIUS
        return float(min(into, max(left / lead, 0.0) * angle if left < lead else angle))

    recording = drive(truck, steering, speed=_SPEED, duration=30.0)
    # The reference trailer follows the tractor's own motion: its turn per metre as a steer angle.
    turning = recording.yaw_rate / np.maximum(recording.speed, 0.1)
    states = kinematic.simulate(recording.time, recording.speed, np.arctan(kinematic.L * turning))
    front, rear = kinematic.steer_axle(states), kinematic.trailer_axle(states)
    shift = np.array([recording.x[0], recording.y[0]]) - front[0]
    return Turn(recording, front + shift, rear + shift)


def _distance(point: FloatArray, track: FloatArray) -> float:
    """Distance [m] of a point (2,) from a polyline (n, 2)."""
    start, step = track[:-1], np.diff(track, axis=0)
    length = np.maximum((step**2).sum(1), 1e-18)
    share = np.clip(((point - start) * step).sum(1) / length, 0.0, 1.0)
    return float(np.min(np.linalg.norm(start + share[:, None] * step - point, axis=1)))
