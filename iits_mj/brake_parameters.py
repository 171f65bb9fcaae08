"""Numbers of the air brakes, as `mjcf/truck.toml` and its table give them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class AirBrakeScalars:
    """Scalar and per-axle figures of the air brakes (six axles, front to rear)."""

    dead_time: tuple[float, ...]
    build_up_time_constant: tuple[float, ...]
    release_time_constant: tuple[float, ...]
    supply_rise_rate: float
    supply_fall_rate: float
    torque_per_pressure: tuple[float, ...]
    push_out_pressure: float
    hysteresis_pressure: float
    pressure_max: float
    abs_release_slip: float
    abs_reapply_slip: float
    abs_speed_min: float
    stiffness: float
    parking_torque: float
    mass_light: float
    mass_heavy: float


@dataclass(frozen=True)
class AirBrake(AirBrakeScalars):
    """Air brakes with the pressure table.

    Attributes:
      demand: demanded deceleration, positive and increasing [m/s2], shape (n,).
      pressure_light, pressure_heavy: pressure [Pa] of (front, drive, trailer) circuits at the two
        masses, shape (n, 3).
    """

    demand: FloatArray
    pressure_light: FloatArray
    pressure_heavy: FloatArray
