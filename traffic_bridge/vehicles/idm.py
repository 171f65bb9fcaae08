"""The Intelligent Driver Model in closed form: acceleration, equilibrium, string stability.

Treiber, Hennecke and Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62 (2000), 1805-1824, equations 2 and 3 with exponent 4; stability as in
Treiber and Kesting, "Traffic Flow Dynamics" (2013), chapter 15, here for SUMO's time step. All
functions take arrays of any shapes that broadcast.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.errors import InputError

if TYPE_CHECKING:
    from traffic_bridge.vehicles.types import VehicleType

EXPONENT = 4
LEAST_GAP = 0.1  # [m]: smaller gaps count as this one, to avoid a division by zero


@dataclass(frozen=True)
class IdmParameters:
    """Parameters of one driver of the Intelligent Driver Model.

    Attributes:
      desired_speed: v0 [m/s]; time_headway: T [s]; minimum_gap: s0 [m].
      acceleration, deceleration: a and b, both positive [m/s2].

    Raises:
      InputError: a value is not finite and positive.
    """

    desired_speed: float
    time_headway: float
    minimum_gap: float
    acceleration: float
    deceleration: float

    def __post_init__(self) -> None:
        """Checks the values."""
        for entry in dataclasses.fields(self):
            value = getattr(self, entry.name)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0.0):
                raise InputError(f"IDM {entry.name} = {value!r}: must be finite and positive")

    def as_array(self) -> NDArray[np.float64]:
        """The five values, shape (5,), in the order of `PARAMETERS`."""
        return np.array(dataclasses.astuple(self), dtype=float)

    @classmethod
    def from_array(cls, values: ArrayLike) -> IdmParameters:
        """The inverse of `as_array`."""
        return cls(*(float(value) for value in np.asarray(values, dtype=float)))

    @classmethod
    def of_type(cls, vehicle_type: VehicleType, desired_speed: float) -> IdmParameters:
        """The parameters of a vehicle type, with the given desired speed [m/s]."""
        return cls(
            desired_speed,
            vehicle_type.time_headway,
            vehicle_type.minimum_gap,
            vehicle_type.acceleration,
            vehicle_type.deceleration,
        )


PARAMETERS = tuple(entry.name for entry in dataclasses.fields(IdmParameters))


def acceleration(parameters: ArrayLike, gap: Any, speed: Any, leader_speed: Any) -> Any:
    """IDM acceleration [m/s2]: a [1 - (v / v0)^4 - (s* / s)^2], s* = s0 + max(0, v T + v dv / ...).

    Args:
      parameters: shape (5, ...), in the order of `PARAMETERS`.
      gap: bumper to bumper [m].
      speed: own [m/s].
      leader_speed: [m/s].
    """
    v0, headway, least, a, b = np.asarray(parameters, dtype=float)
    approach = speed * (speed - leader_speed) / (2.0 * np.sqrt(a * b))
    wanted = least + np.maximum(0.0, speed * headway + approach)
    ratio = (speed / v0) ** 2
    return a * (1.0 - ratio * ratio - (wanted / np.maximum(gap, LEAST_GAP)) ** 2)


def equilibrium_gap(parameters: ArrayLike, speed: ArrayLike) -> Any:
    """Gap at which vehicles follow at a constant speed [m]: (s0 + v T) / sqrt(1 - (v / v0)^4).

    Raises:
      InputError: a speed is not from zero to below the desired speed.
    """
    v0, headway, least, _, _ = np.asarray(parameters, dtype=float)
    speed = np.asarray(speed, dtype=float)
    if not ((speed >= 0.0) & (speed < v0)).all():
        raise InputError(f"speed {speed!r}: there is an equilibrium from 0 to below {v0!r} m/s")
    return (least + speed * headway) / np.sqrt(1.0 - (speed / v0) ** EXPONENT)


def equilibrium_flow(parameters: ArrayLike, speed: ArrayLike, length: float) -> Any:
    """Flow of equal vehicles at equilibrium [1/s]: v / (s_e(v) + length)."""
    speed = np.asarray(speed, dtype=float)
    return speed / (equilibrium_gap(parameters, speed) + length)


def slopes(parameters: IdmParameters, speed: float) -> tuple[float, float, float]:
    """Derivatives of the acceleration at equilibrium: by gap, own speed and the leader's speed."""
    p = parameters
    gap = float(equilibrium_gap(p.as_array(), speed))
    wanted = p.minimum_gap + speed * p.time_headway
    root = 2.0 * math.sqrt(p.acceleration * p.deceleration)
    interaction = 2.0 * p.acceleration * wanted / gap**2
    by_gap = interaction * wanted / gap
    by_leader = interaction * speed / root
    free = EXPONENT * p.acceleration * speed ** (EXPONENT - 1) / p.desired_speed**EXPONENT
    return by_gap, -free - interaction * p.time_headway - by_leader, by_leader


def gain(
    parameters: IdmParameters, speed: float, frequency: ArrayLike, step: float = 0.1
) -> NDArray[np.float64]:
    """Gain of a follower on small speed oscillations of its leader: string stability.

    The model is linearized at equilibrium and integrated as in SUMO: v(k+1) = v(k) + dt a(k),
    x(k+1) = x(k) + dt v(k+1). A string of vehicles is unstable if the gain exceeds one.

    Args:
      parameters: of follower and leader.
      speed: of the equilibrium [m/s].
      frequency: [Hz], shape (n,).
      step: time step [s].

    Returns:
      Ratio of the speed amplitudes, follower over leader, shape (n,).
    """
    by_gap, by_speed, by_leader = slopes(parameters, speed)
    z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * step)
    spring = step * step * z * by_gap / (z - 1.0)
    ratio = (step * by_leader + spring) / (z - 1.0 - step * by_speed + spring)
    return np.asarray(np.abs(ratio))
