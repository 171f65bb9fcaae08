"""The paper's kinematic tractor-semitrailer: a bicycle that pulls a unicycle, without tire slip.

    x' = v cos(theta)      y' = v sin(theta)      theta' = v tan(phi) / L      phi' = omega
    psi' = -v (sin(psi) / L_2 + L_1 / (L L_2) cos(psi) tan(phi) + tan(phi) / L)

(x, y) is the center of the tractor's fixed axles, phi the road-wheel angle, and psi the trailer's
heading minus the tractor's: the articulation of `iits_mj.core.messages` is `-psi`. L_1 is the
distance of the hitch *behind* the fixed axles' center; ours lies ahead, so L_1 is negative.
Our own derivation gives the printed equation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center


@dataclass(frozen=True, slots=True)
class Kinematic:
    """Lengths [m]: wheelbase L, hitch L_1 behind the fixed axles, trailer L_2."""

    L: float
    L_1: float
    L_2: float

    @classmethod
    def from_parameters(cls, parameters: TruckParameters) -> Kinematic:
        """Lengths to the centers of the axle groups."""
        front, *drive = parameters.lead.axles
        center = group_center(drive)
        return cls(
            L=center - front.position,
            L_1=parameters.couplings[0].position - center,
            L_2=group_center(parameters.units[1].axles),
        )

    def derivative(self, state: FloatArray, speed: float, steer_rate: float) -> FloatArray:
        """Time derivative of `[x, y, theta, phi, psi]`, shape (5,).

        Args:
          state: [m, m, rad, rad, rad].
          speed: of the fixed axles' center [m/s], may be negative.
          steer_rate: of the road-wheel angle [rad/s].
        """
        _, _, theta, phi, psi = state
        turn = math.tan(phi) / self.L
        swing = math.sin(psi) / self.L_2 + self.L_1 / self.L_2 * math.cos(psi) * turn + turn
        return np.array(
            [
                speed * math.cos(theta),
                speed * math.sin(theta),
                speed * turn,
                steer_rate,
                -speed * swing,
            ]
        )

    def simulate(self, time: FloatArray, speed: FloatArray, steer: FloatArray) -> FloatArray:
        """States over time, shape (n, 5), from a straight truck at the origin (Runge-Kutta 4).

        Args:
          time: increasing [s], shape (n,).
          speed: [m/s], shape (n,).
          steer: road-wheel angle [rad], shape (n,), below a right angle.

        Raises:
          InputError: the vectors do not fit, or a value is not allowed.
        """
        if not len(time) == len(speed) == len(steer):
            raise InputError(f"lengths {len(time)}, {len(speed)}, {len(steer)}: must be equal")
        if not np.all(np.diff(time) > 0.0) or not np.all(np.isfinite([*time, *speed])):
            raise InputError("time must increase, and time and speed must be finite")
        if not np.all(np.abs(steer) < 0.5 * math.pi):
            raise InputError("steer must stay below a right angle, and be finite")
        states = np.zeros((len(time), 5))
        states[0, 3] = steer[0]
        for i in range(len(time) - 1):
            h = time[i + 1] - time[i]
            v = 0.5 * (speed[i] + speed[i + 1])
            omega = (steer[i + 1] - steer[i]) / h
            s = states[i]
            k1 = self.derivative(s, v, omega)
            k2 = self.derivative(s + 0.5 * h * k1, v, omega)
            k3 = self.derivative(s + 0.5 * h * k2, v, omega)
            k4 = self.derivative(s + h * k3, v, omega)
            states[i + 1] = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return states

    def steer_axle(self, states: FloatArray) -> FloatArray:
        """Ground track of the steer axle center [m], shape (n, 2), from states (n, 5)."""
        return states[:, :2] + self.L * _heading(states[:, 2])

    def trailer_axle(self, states: FloatArray) -> FloatArray:
        """Ground track of the trailer group's center [m], shape (n, 2), from states (n, 5)."""
        hitch = states[:, :2] - self.L_1 * _heading(states[:, 2])
        return hitch - self.L_2 * _heading(states[:, 2] + states[:, 4])

    def off_tracking(self, radius: float) -> float:
        """Steady radius of the trailer group's path minus the steer axle's [m]; negative, inside.

        Args:
          radius: of the steer axle's path [m].

        Raises:
          InputError: the radius is too small for the tractor or the trailer.
        """
        if not (math.isfinite(radius) and radius > self.L):
            raise InputError(f"radius {radius!r} m must be greater than the wheelbase {self.L:g} m")
        rear_squared = radius**2 - self.L**2 + self.L_1**2 - self.L_2**2
        if rear_squared <= 0.0:
            raise InputError(f"radius {radius!r} m is too small for a trailer of {self.L_2:g} m")
        return math.sqrt(rear_squared) - radius


def _heading(angle: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(angle), np.sin(angle)])
