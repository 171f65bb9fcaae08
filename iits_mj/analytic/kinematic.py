"""Kinematic model of any combination: a bicycle that pulls a chain of unicycles, without slip.

    x' = v cos(theta)      y' = v sin(theta)      theta' = v tan(phi) / L      phi' = omega

(x, y) is the center of the motor vehicle's fixed axles and phi the road-wheel angle. A towed unit
has the length `L_k` from its coupling to the center of its axles; the coupling to the next unit
lies `b` behind that center (negative: ahead of it, as most fifth wheels). With the speed `v_k` of
that center, the yaw rate `r_k` and the angle `e = heading of the next unit minus own`,

    L_(k+1) r_(k+1) = -v_k sin(e) - b r_k cos(e)        v_(k+1) = v_k cos(e) - b r_k sin(e).

`psi_k` is the heading of unit k minus the motor vehicle's; the articulation of
`iits_mj.core.messages` is `-psi_2`. For two units these are the paper's equations, which
`docs/derivation` derives.
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
    """Lengths of a combination of n units.

    Attributes:
      L: wheelbase to the center of the fixed axles [m].
      hitches: of each coupling behind the center of the axles of the unit ahead [m], (n - 1,).
      lengths: of the towed units, from coupling to the center of the axles [m], (n - 1,).
    """

    L: float
    hitches: tuple[float, ...]
    lengths: tuple[float, ...]

    @classmethod
    def from_parameters(
        cls, parameters: TruckParameters, payload: float | None = None
    ) -> Kinematic:
        """Lengths to the centers of the axle groups that carry a payload [kg]; default: laden."""
        load = parameters.payload_max if payload is None else payload
        front, rear = parameters.lead.groups(load)
        towed = [group_center(unit.groups(load)[0]) for unit in parameters.units[1:]]
        centers = [group_center(rear), *towed]
        return cls(
            L=centers[0] - front[0].position,
            hitches=tuple(
                coupling.position - center
                for coupling, center in zip(parameters.couplings, centers, strict=False)
            ),
            lengths=tuple(towed),
        )

    @property
    def units(self) -> int:
        """Number of units."""
        return 1 + len(self.lengths)

    def swing(self, psi: FloatArray, speed: float, rate: float) -> FloatArray:
        """Rates of the towed units' headings against the motor vehicle's [rad/s], (n - 1,).

        Args:
          psi: those headings [rad], shape (n - 1,).
          speed: of the fixed axles' center [m/s], may be negative.
          rate: yaw rate of the motor vehicle [rad/s].
        """
        rates = np.empty(len(self.lengths))
        v, r, heading = speed, rate, 0.0
        for k, (hitch, length) in enumerate(zip(self.hitches, self.lengths, strict=True)):
            bend = float(psi[k]) - heading
            sine, cosine = math.sin(bend), math.cos(bend)
            v, r = v * cosine - hitch * r * sine, (-v * sine - hitch * r * cosine) / length
            rates[k], heading = r - rate, float(psi[k])
        return rates

    def derivative(self, state: FloatArray, speed: float, steer_rate: float) -> FloatArray:
        """Time derivative of `[x, y, theta, phi, psi_2 .. psi_n]`, shape (n + 3,).

        Args:
          state: [m, m, rad, rad, rad ..].
          speed: of the fixed axles' center [m/s], may be negative.
          steer_rate: of the road-wheel angle [rad/s].
        """
        theta, phi = float(state[2]), float(state[3])
        rate = speed * math.tan(phi) / self.L
        plane = [speed * math.cos(theta), speed * math.sin(theta), rate, steer_rate]
        return np.concatenate([plane, self.swing(state[4:], speed, rate)])

    def simulate(self, time: FloatArray, speed: FloatArray, steer: FloatArray) -> FloatArray:
        """States over time, shape (m, n + 3), from a straight truck at the origin (Runge-Kutta 4).

        Args:
          time: increasing [s], shape (m,).
          speed: [m/s], shape (m,).
          steer: road-wheel angle [rad], shape (m,), below a right angle.

        Raises:
          InputError: the vectors do not fit, or a value is not allowed.
        """
        if not len(time) == len(speed) == len(steer):
            raise InputError(f"lengths {len(time)}, {len(speed)}, {len(steer)}: must be equal")
        if not np.all(np.diff(time) > 0.0) or not np.all(np.isfinite([*time, *speed])):
            raise InputError("time must increase, and time and speed must be finite")
        if not np.all(np.abs(steer) < 0.5 * math.pi):
            raise InputError("steer must stay below a right angle, and be finite")
        states = np.zeros((len(time), 3 + self.units))
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
        """Ground track of the steer axle center [m], shape (m, 2), from states (m, n + 3)."""
        return states[:, :2] + self.L * _heading(states[:, 2])

    def trailer_axle(self, states: FloatArray, unit: int = -1) -> FloatArray:
        """Ground track of the center of a unit's axles [m], (m, 2); default: of the last unit."""
        unit %= self.units
        track, heading = states[:, :2], states[:, 2]
        for k in range(unit):
            track = track - self.hitches[k] * _heading(heading)
            heading = states[:, 2] + states[:, 4 + k]
            track = track - self.lengths[k] * _heading(heading)
        return track

    def off_tracking(self, radius: float) -> float:
        """Steady radius of the last unit's path minus the steer axle's [m]; negative, inside.

        Args:
          radius: of the steer axle's path [m].

        Raises:
          InputError: the radius is too small for a unit.
        """
        if not (math.isfinite(radius) and radius > self.L):
            raise InputError(f"radius {radius!r} m must be greater than the wheelbase {self.L:g} m")
        squared = radius**2 - self.L**2
        for hitch, length in zip(self.hitches, self.lengths, strict=True):
            squared += hitch**2 - length**2
            if squared <= 0.0:
                raise InputError(f"radius {radius!r} m is too small for a unit of {length:g} m")
        return math.sqrt(squared) - radius


def _heading(angle: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(angle), np.sin(angle)])
