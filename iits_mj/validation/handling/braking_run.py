"""Records braking in a bend or on split friction: a driver steers, pedal up, XBR demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import sampled, wheel_slips


@dataclass(frozen=True)
class BrakingRun:
    """Time histories, each of shape (n,), every 10 ms from the demand on; SI, ISO 8855.

    Attributes:
      time; speed: along the tractor; x, y: steer axle centre; yaw, yaw_rate: of the tractor.
      trailer_yaw_rate, articulation; steering_wheel: actual angle.
      slip: longitudinal slip of each wheel, shape (n, 12), axle by axle, left before right.
    """

    time: FloatArray
    speed: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    trailer_yaw_rate: FloatArray
    articulation: FloatArray
    steering_wheel: FloatArray
    slip: FloatArray

    def distance(self) -> float:
        """Path length [m]."""
        return float(np.sum(np.hypot(np.diff(self.x), np.diff(self.y))))

    def locked(self, axles: slice, above: float) -> float:
        """Share of time that a wheel of these axles slips by 80 % or more above a speed [m/s]."""
        wheels = self.slip[:, 2 * axles.start : 2 * axles.stop]
        moving = self.speed > above
        return float(np.mean(np.max(np.abs(wheels[moving]), axis=1) > 0.8)) if moving.any() else 0.0


def brake(
    truck: Truck,
    demand: float,
    steering: Callable[[float, EgoState], float],
    *,
    duration: float,
    stop: Callable[[EgoState], bool],
) -> BrakingRun:
    """Brakes the truck as it moves.

    Args:
      truck: rolling.
      demand: wanted deceleration [m/s2], positive.
      steering: steering-wheel angle [rad] by time [s] and state.
      duration: at most [s].
      stop: ends the run early.
    """
    table = sampled(
        truck,
        lambda time, state: VehicleCommand(
            xbr_mode=XbrMode.MAXIMUM,
            xbr_demand=-demand,
            steering_wheel_angle=steering(time, state),
        ),
        lambda state: [*_row(state), *wheel_slips(truck)],
        duration,
        stop,
    )
    table[:, 4] = np.unwrap(table[:, 4])
    names = list(BrakingRun.__dataclass_fields__)[:-1]
    columns = dict(zip(names, table[:, : len(names)].T, strict=True))
    return BrakingRun(**columns, slip=table[:, len(names) :])


def _row(state: EgoState) -> list[float]:
    return [
        state.speed,
        state.x,
        state.y,
        state.yaw,
        state.yaw_rate,
        state.trailer_yaw_rate,
        state.articulation,
        state.steering_wheel_angle,
    ]
