"""Linear lateral model of a combination of any number of units for the steering controller.

The truck is a `YawPlane` whose reference point is the steer axle's center and whose forces act at
the axles' centers; the states of the path and of the steering follow its own.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from iits_mj.analytic.yaw_plane import YawPlane
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import payload_of

# States after those of the units: offset and heading error, road wheel angle, demanded road wheel
# angle, integral of the offset error.
_PATH_STATES = 5


@dataclass(frozen=True)
class LateralModel:
    """A loaded truck of n units on a path.

    The states are the lateral speed w, the yaw rates r of the units, the articulations g of the
    couplings (yaw ahead minus yaw behind), offset and heading error, road wheel angle, demanded
    road wheel angle and the integral of the offset: 2 n + 5.

    Attributes:
      plane: masses, lengths and cornering stiffnesses.
      lag: of the steering and the tires' relaxation [s].
    """

    plane: YawPlane
    lag: float

    @classmethod
    def of(cls, parameters: TruckParameters, gross_mass: float, lag: float) -> LateralModel:
        """The model of a truck at a gross combination mass [kg]."""
        plane = YawPlane.from_parameters(
            parameters, payload_of(parameters, gross_mass), pneumatic_trail=False
        )
        return cls(dataclasses.replace(plane, reference=float(plane.position[0])), lag)

    @property
    def rates(self) -> int:
        """Number of the speeds (w, r of each unit), the first states."""
        return 1 + self.plane.units

    @property
    def motions(self) -> int:
        """Number of the states of the truck alone: the speeds and the articulations."""
        return 2 * self.plane.units

    def matrices(self, speed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous `x' = A x + B u + E kappa`; u is the rate of the demanded angle [rad/s].

        Args:
          speed: [m/s], positive.
        """
        motions, system = self.motions, self.plane.at(speed)
        n = motions + _PATH_STATES
        e, psi, delta, demand, integral = range(motions, n)
        a = np.zeros((n, n))
        a[:motions, :motions], a[:motions, delta] = system.A, system.B
        a[e, 0], a[e, psi] = 1.0, speed
        a[psi, 1] = 1.0
        a[delta, delta], a[delta, demand] = -1.0 / self.lag, 1.0 / self.lag
        a[integral, e] = 1.0
        drive = np.zeros((n, 1))
        drive[demand, 0] = 1.0
        road = np.zeros((n, 1))
        road[psi, 0] = -speed
        return a, drive, road

    def discrete(
        self, speed: float, step: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Exact discrete form over one step [s] with inputs held.

        Returns:
          A (n, n), B (n, 1), E (n, 1) and D (n, rates), the last for disturbing accelerations of
          (w, r of each unit).
        """
        a, drive, road = self.matrices(speed)
        n = a.shape[0]
        inputs = np.hstack([drive, road, np.eye(n)[:, : self.rates]])
        block = np.zeros((n + inputs.shape[1], n + inputs.shape[1]))
        block[:n, :n], block[:n, n:] = a, inputs
        whole = expm(block * step)
        return whole[:n, :n], whole[:n, n : n + 1], whole[:n, n + 1 : n + 2], whole[:n, n + 2 :]

    def steady_acceleration(self, speed: float) -> float:
        """Lateral acceleration in a steady curve by road wheel angle [m/s2 per rad]."""
        a, _, _ = self.matrices(speed)
        own = slice(self.motions)
        steady = np.linalg.solve(a[own, own], -a[own, self.motions + 2])
        return float(speed * steady[1])

    def balance(self, speed: float) -> FloatArray:
        """Road wheel angle by each disturbing acceleration of (w, r) on a straight path, (rates,).

        The truck then moves crabwise: all yaw rates and all accelerations vanish.
        """
        a, _, _ = self.matrices(speed)
        return np.asarray(np.linalg.solve(self.held(a), -np.eye(self.rates))[-1])

    def held(self, a: FloatArray) -> FloatArray:
        """Columns of w, the articulations and the road wheel angle in the rows of the speeds.

        In a steady state of given yaw rates these are the unknowns; shape (rates, rates).
        """
        unknown = [0, *range(self.rates, self.motions), self.motions + 2]
        return np.asarray(a[: self.rates][:, unknown])
