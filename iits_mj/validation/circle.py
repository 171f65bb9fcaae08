"""Steady circle of 100 m radius (ISO 14792, constant radius): understeer gradient."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic import Kinematic, YawSideslip, understeer_gradient
from iits_mj.truck import Truck
from iits_mj.validation.recorder import Recording, drive
from iits_mj.validation.step_steer import FREE_HITCH

FloatArray = NDArray[np.float64]

RADIUS = 100.0
_START = 20.0
_SETTLE = 14.0
_AVERAGE = 6.0


@dataclass(frozen=True)
class Circle:
    """Steady states on the circle, each of shape (k,).

    Attributes:
      lateral: lateral acceleration [m/s2]; steer: road-wheel angle less the wheelbase's share of
        the curvature driven [rad].
      gradient: slope of steer over lateral [rad s2/m]; reference: the linear model's.
    """

    lateral: FloatArray
    steer: FloatArray
    gradient: float
    reference: float


def circle(payload: float, timestep: float, speeds: tuple[float, ...]) -> Circle:
    """Drives the circle at each speed [m/s] until it is steady."""
    truck = Truck.load(payload, parameters=FREE_HITCH, timestep=timestep, visuals=False)
    wheelbase = Kinematic.from_parameters(truck.parameters).L
    lateral, steer = [], []
    for speed in speeds:
        record = _steady(truck, speed, wheelbase)
        rate, forward = float(record.yaw_rate.mean()), float(record.speed.mean())
        lateral.append(rate * forward)
        steer.append(float(record.road_wheel.mean()) - wheelbase * rate / forward)
    gradient = float(np.polyfit(lateral, steer, 1)[0])
    middle = float(np.mean(speeds))
    model = YawSideslip.from_parameters(truck.parameters, payload, cruise_speed=middle)
    reference = understeer_gradient(model, middle)
    return Circle(np.array(lateral), np.array(steer), gradient, reference)


def _steady(truck: Truck, speed: float, wheelbase: float) -> Recording:
    """The last seconds on the circle at one speed [m/s]."""
    truck.reset(station=_START, speed=speed)
    ratio = truck.parameters.steering.ratio

    def steering(time: float, yaw: float) -> float:
        position = truck.data.body("tractor").xpos
        east, north = float(position[0]) - _START, float(position[1]) - RADIUS
        outside = float(np.hypot(east, north)) - RADIUS
        error = float(np.angle(np.exp(1j * (np.arctan2(east, -north) - yaw))))
        angle = wheelbase / RADIUS + 0.3 * error + 0.005 * outside
        return ratio * angle * min(time / 2.0, 1.0)

    return drive(truck, steering, speed=speed, duration=_SETTLE + _AVERAGE).after(_SETTLE)
