"""Drives the truck open loop in steering, holds its speed, and records what the references need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.truck import Truck

FloatArray = NDArray[np.float64]

# Rate of recording and of the speed hold [s].
PERIOD = 0.01
# Pedal per speed error [s/m], and its integral [1/m].
_GAIN = 0.5
_INTEGRAL = 0.1


@dataclass(frozen=True)
class Recording:
    """Time histories of a manoeuvre, each of shape (n,), sampled every 10 ms; SI, ISO 8855.

    Attributes:
      time, speed; steering_wheel: actual angle; road_wheel: mean of left and right.
      yaw, yaw_rate, trailer_yaw_rate, articulation; x, y: steer axle centre.
      rear_x, rear_y: centre of the trailer's axle group.
      lateral_acceleration, trailer_lateral_acceleration: of the CGs, gravity removed.
      lateral_velocity: of the steer axle centre; roll: of the tractor; trailer_roll.
      side_loads: least vertical tire force of an axle's two sides, shape (n, 6).
    """

    time: FloatArray
    speed: FloatArray
    steering_wheel: FloatArray
    road_wheel: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    trailer_yaw_rate: FloatArray
    articulation: FloatArray
    x: FloatArray
    y: FloatArray
    rear_x: FloatArray
    rear_y: FloatArray
    lateral_acceleration: FloatArray
    trailer_lateral_acceleration: FloatArray
    lateral_velocity: FloatArray
    roll: FloatArray
    trailer_roll: FloatArray
    side_loads: FloatArray

    def after(self, start: float) -> Recording:
        """The recording from a time [s] on, its time starting at zero there."""
        keep = self.time >= start - 1e-9
        columns = {name: getattr(self, name)[keep] for name in self.__dataclass_fields__}
        columns["time"] = columns["time"] - columns["time"][0]
        return Recording(**columns)


def drive(
    truck: Truck,
    steering: Callable[[float, float], float],
    *,
    speed: float | Callable[[float], float],
    duration: float,
    stop: Callable[[float], bool] | None = None,
) -> Recording:
    """Runs a manoeuvre on the truck as it stands (call `truck.reset` before).

    Args:
      truck: on a road long enough.
      steering: steering-wheel angle [rad] by (time [s], yaw [rad]).
      speed: held by the pedal and, above it, by light braking [m/s]; or a function of time.
      duration: at most [s].
      stop: ends the run early when it returns True for the trailer's lateral acceleration [m/s2].
    """
    steps = round(PERIOD / truck.model.opt.timestep)
    wanted = speed if callable(speed) else lambda _: speed
    rows: list[list[float]] = []
    integral = 0.0
    start = truck.time
    for tick in range(round(duration / PERIOD) + 1):
        time = tick * PERIOD
        state = truck.observe()
        row = _row(truck)
        rows.append([time, *row])
        if stop is not None and stop(row[13]):
            break
        error = wanted(time) - state.speed
        integral = float(np.clip(integral + _INTEGRAL * error * PERIOD, 0.0, 1.0))
        pedal = float(np.clip(_GAIN * error + integral, 0.0, 1.0))
        braking = error < -0.3
        truck.command(
            accelerator_pedal=pedal,
            steering_wheel_angle=steering(time, state.yaw),
            xbr_mode=2.0 if braking else 0.0,
            xbr_demand=max(2.0 * error, -3.0) if braking else 0.0,
        )
        target = start + (tick + 1) * PERIOD
        while truck.time < target - 0.5 * truck.model.opt.timestep:
            truck.step(steps)
    table = np.array(rows)
    columns = table.T[: len(Recording.__dataclass_fields__) - 1]
    named = dict(zip(list(Recording.__dataclass_fields__)[:-1], columns, strict=True))
    return Recording(**named, side_loads=table[:, len(columns) :])


def _row(truck: Truck) -> list[float]:
    """One sample, in the order of `Recording`'s fields after time; call `truck.observe` before."""
    data = truck.data
    state = truck.observe()
    rear = data.site("trailer_axle_center").xpos
    trailer = data.body("trailer").xmat.reshape(3, 3)
    gravity = trailer.T @ truck.model.opt.gravity
    trailer_acceleration = data.sensor("trailer_acceleration").data + gravity
    trailer_roll = np.arctan2(trailer[2, 1], trailer[2, 2])
    loads = [
        min(data.sensor(f"{axle.name}_{side}_tire_force").data[2] for side in ("left", "right"))
        for axle in truck.parameters.axles
    ]
    return [
        state.speed,
        state.steering_wheel_angle,
        state.road_wheel_angle,
        state.yaw,
        state.yaw_rate,
        state.trailer_yaw_rate,
        state.articulation,
        state.x,
        state.y,
        float(rear[0]),
        float(rear[1]),
        state.lateral_acceleration,
        float(trailer_acceleration[1]),
        state.lateral_speed,
        state.roll,
        float(trailer_roll),
        *map(float, loads),
    ]
