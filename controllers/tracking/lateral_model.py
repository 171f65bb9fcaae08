"""Linear lateral model of the tractor-semitrailer for the steering controller.

Small angles, constant speed, linear tires; the reference point is the steer axle centre. With
lateral speed w there, yaw rates r and r_t and articulation g, virtual work in the coordinates
(y, psi, psi_t) gives `M x' = f(x, delta)`; see `LateralModel.matrices`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import laden_units, payload_of, static_axle_loads
from iits_mj.parameters.tire_law import cornering_stiffness

# State: lateral speed, yaw rate, trailer yaw rate, articulation, offset and heading error,
# road wheel angle, demanded road wheel angle, integral of the offset error.
STATES = ("w", "r", "r_t", "articulation", "e", "psi", "delta", "demand", "integral")


@dataclass(frozen=True)
class LateralModel:
    """Masses, lengths and cornering stiffnesses of a loaded truck.

    Attributes:
      mass, cg, inertia: of the tractor [kg], behind the steer axle [m], yaw about CG [kg m2].
      trailer_mass, trailer_cg, trailer_inertia: loaded; CG behind the kingpin.
      kingpin: behind the steer axle [m].
      axles, trailer_axles: (position [m], cornering stiffness of the axle [N/rad]).
      lag: of the steering and the tires' relaxation [s].
    """

    mass: float
    cg: float
    inertia: float
    trailer_mass: float
    trailer_cg: float
    trailer_inertia: float
    kingpin: float
    axles: tuple[tuple[float, float], ...]
    trailer_axles: tuple[tuple[float, float], ...]
    lag: float

    @classmethod
    def of(cls, parameters: TruckParameters, gross_mass: float, lag: float) -> LateralModel:
        """The model of a truck at a gross combination mass [kg]."""
        p = parameters
        load = payload_of(p, gross_mass)
        trailer = laden_units(p, load)[1]
        axles = tuple(
            (axle.position, _axle_stiffness(axle, float(on_axle), p))
            for axle, on_axle in zip(p.axles, static_axle_loads(p, load), strict=True)
        )
        return cls(
            mass=p.lead.mass,
            cg=p.lead.cg_position,
            inertia=p.lead.inertia_z,
            trailer_mass=trailer.mass,
            trailer_cg=trailer.cg_position,
            trailer_inertia=trailer.inertia_z,
            kingpin=p.couplings[0].position,
            axles=axles[: len(p.lead.axles)],
            trailer_axles=axles[len(p.lead.axles) :],
            lag=lag,
        )

    def matrices(self, speed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous `x' = A x + B u + E kappa`; u is the rate of the demanded angle [rad/s].

        Args:
          speed: [m/s], positive.
        """
        v, c, b = speed, self.kingpin, self.trailer_cg
        m1, m2, a1 = self.mass, self.trailer_mass, self.cg
        couple = m1 * a1 + m2 * c
        inertia = np.array(
            [
                [m1 + m2, -couple, -m2 * b],
                [-couple, self.inertia + m1 * a1**2 + m2 * c**2, m2 * b * c],
                [-m2 * b, m2 * b * c, self.trailer_inertia + m2 * b**2],
            ]
        )
        # Generalized forces over (w, r, r_t, articulation, delta).
        force = np.zeros((3, 5))
        for position, stiffness in self.axles:
            arm = np.array([1.0, -position, 0.0])
            slip = np.array([1.0 / v, -position / v, 0.0, 0.0, -float(position == 0.0)])
            force -= stiffness * np.outer(arm, slip)
        for position, stiffness in self.trailer_axles:
            arm = np.array([1.0, -c, -position])
            slip = np.array([1.0 / v, -c / v, -position / v, 1.0, 0.0])
            force -= stiffness * np.outer(arm, slip)
        force[:, 1] -= v * np.array([m1 + m2, -couple, -m2 * b])
        motion = np.linalg.solve(inertia, force)
        n = len(STATES)
        a = np.zeros((n, n))
        a[0:3, 0:4] = motion[:, 0:4]
        a[0:3, 6] = motion[:, 4]
        a[3, 1], a[3, 2] = 1.0, -1.0
        a[4, 0], a[4, 5] = 1.0, v
        a[5, 1] = 1.0
        a[6, 6], a[6, 7] = -1.0 / self.lag, 1.0 / self.lag
        a[8, 4] = 1.0
        drive = np.zeros((n, 1))
        drive[7, 0] = 1.0
        road = np.zeros((n, 1))
        road[5, 0] = -v
        return a, drive, road

    def discrete(
        self, speed: float, step: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Exact discrete form over one step [s] with inputs held.

        Returns:
          A (9, 9), B (9, 1), E (9, 1) and D (9, 3), the last for disturbing accelerations of
          (w, r, r_t).
        """
        a, drive, road = self.matrices(speed)
        n = a.shape[0]
        inputs = np.hstack([drive, road, np.eye(n)[:, :3]])
        block = np.zeros((n + 5, n + 5))
        block[:n, :n], block[:n, n:] = a, inputs
        whole = expm(block * step)
        return whole[:n, :n], whole[:n, n : n + 1], whole[:n, n + 1 : n + 2], whole[:n, n + 2 :]

    def steady_acceleration(self, speed: float) -> float:
        """Lateral acceleration in a steady curve by road wheel angle [m/s2 per rad]."""
        a, _, _ = self.matrices(speed)
        steady = np.linalg.solve(a[:4, :4], -a[:4, 6])
        return float(speed * steady[1])

    def balance(self, speed: float) -> FloatArray:
        """Road wheel angle by each disturbing acceleration of (w, r, r_t) on a straight path, (3,).

        The truck then moves crabwise: both yaw rates and all three accelerations vanish.
        """
        a, _, _ = self.matrices(speed)
        held = a[:3][:, [0, 3, 6]]
        return np.asarray(np.linalg.solve(held, -np.eye(3))[2])


def _axle_stiffness(axle: Axle, load: float, parameters: TruckParameters) -> float:
    """Cornering stiffness of a whole axle [N/rad] under its static load [N]."""
    tire = parameters.tires[axle.tire]
    tires = 2 * tire.count
    return tires * float(cornering_stiffness(load / tires, tire, parameters.tire_common))
