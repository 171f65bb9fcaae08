"""Linear lateral model of a combination of any number of units for the steering controller.

Small angles, constant speed, linear tires; the reference point is the steer axle's center. With
lateral speed w there, yaw rates r of the units and articulations g between them, virtual work in
the coordinates (y, psi of each unit) gives `M x' = f(x, delta)`; see `LateralModel.matrices`.

A unit's origin is the coupling to the unit ahead. With the couplings at c behind the origins, a
point at p on unit k moves aside with `q (w, r)`, `q = (1, -c of the units ahead, -p, 0 behind)`,
and against the unit's own axis with `q (w, r) + v (g of the couplings ahead)`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import (
    group_center,
    laden_units,
    payload_of,
    static_axle_loads,
)
from iits_mj.parameters.tire_law import axle_cornering_stiffness

# States after those of the units: offset and heading error, road wheel angle, demanded road wheel
# angle, integral of the offset error.
_PATH_STATES = 5


class LateralAxle(NamedTuple):
    """An axle on its unit.

    Attributes:
      position: behind the unit's origin [m]; stiffness: cornering stiffness of the axle [N/rad].
      steer: angle over that of the first axle; 0 for an axle that is not steered.
    """

    position: float
    stiffness: float
    steer: float = 0.0


@dataclass(frozen=True)
class LateralUnit:
    """A loaded unit.

    Attributes:
      mass, cg, inertia: [kg], behind the unit's origin [m], in yaw about the CG [kg m2].
      axles: front to rear, without lifted ones.
      coupling: of the unit behind, behind this one's origin [m]; 0 for the last unit.
    """

    mass: float
    cg: float
    inertia: float
    axles: tuple[LateralAxle, ...]
    coupling: float = 0.0

    @property
    def group(self) -> float:
        """Mean position of the axles that are not steered [m]."""
        return float(np.mean([axle.position for axle in self.axles if not axle.steer]))


@dataclass(frozen=True)
class LateralModel:
    """Masses, lengths and cornering stiffnesses of a loaded truck of n units.

    The states are the lateral speed w, the yaw rates r of the units, the articulations g of the
    couplings (yaw ahead minus yaw behind), offset and heading error, road wheel angle, demanded
    road wheel angle and the integral of the offset: 2 n + 5.

    Attributes:
      units: front to rear.
      lag: of the steering and the tires' relaxation [s].
    """

    units: tuple[LateralUnit, ...]
    lag: float

    @classmethod
    def of(cls, parameters: TruckParameters, gross_mass: float, lag: float) -> LateralModel:
        """The model of a truck at a gross combination mass [kg]."""
        p = parameters
        load = payload_of(p, gross_mass)
        stiffness = iter(axle_cornering_stiffness(p, static_axle_loads(p, load)).tolist())
        # All steered wheels turn about a center on the line through the rear group's middle.
        front, rear = p.lead.groups(load)
        center, first = group_center(rear), front[0].position
        units, couplings = [], [*(c.position for c in p.couplings), 0.0]
        for unit, laden, coupling in zip(p.units, laden_units(p, load), couplings, strict=True):
            axles = tuple(
                LateralAxle(
                    position=axle.position,
                    stiffness=_yielding(axle, own, p),
                    steer=(center - axle.position) / (center - first) if axle.steered else 0.0,
                )
                for axle, own in zip(unit.axles, stiffness, strict=False)
                if not axle.lifted(load)
            )
            body = laden.mass, laden.cg_position, laden.inertia_z
            units.append(LateralUnit(*body, axles, coupling))
        return cls(tuple(units), lag)

    @property
    def rates(self) -> int:
        """Number of the speeds (w, r of each unit), the first states."""
        return 1 + len(self.units)

    @property
    def motions(self) -> int:
        """Number of the states of the truck alone: the speeds and the articulations."""
        return 2 * len(self.units)

    def arms(self) -> Iterator[tuple[int, LateralUnit, FloatArray]]:
        """Each unit's index, the unit, and `q` of its origin, shape (rates,)."""
        ahead = np.zeros(self.rates)
        ahead[0] = 1.0
        for k, unit in enumerate(self.units):
            yield k, unit, ahead.copy()
            ahead[1 + k] = -unit.coupling

    def matrices(self, speed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous `x' = A x + B u + E kappa`; u is the rate of the demanded angle [rad/s].

        Args:
          speed: [m/s], positive.
        """
        v, rates, motions = speed, self.rates, self.motions
        inertia = np.zeros((rates, rates))
        momentum = np.zeros(rates)
        # Generalized forces over (w, r, g, delta).
        force = np.zeros((rates, motions + 1))
        for k, unit, origin in self.arms():
            arm = origin.copy()
            arm[1 + k] = -unit.cg
            inertia += np.triu(np.outer(arm, unit.mass * arm), 1)
            inertia[np.diag_indices(rates)] += unit.mass * arm**2
            inertia[1 + k, 1 + k] += unit.inertia
            momentum += unit.mass * arm
            for axle in unit.axles:
                arm = origin.copy()
                arm[1 + k] = -axle.position
                slip = np.concatenate([arm / v, np.zeros(len(self.units))])
                slip[rates : rates + k] = 1.0
                slip[motions] = -axle.steer
                force -= axle.stiffness * np.outer(arm, slip)
        force[:, 1] -= v * momentum
        inertia += np.triu(inertia, 1).T
        motion = np.linalg.solve(inertia, force)
        n = motions + _PATH_STATES
        e, psi, delta, demand, integral = range(motions, n)
        a = np.zeros((n, n))
        a[:rates, :motions] = motion[:, :motions]
        a[:rates, delta] = motion[:, motions]
        for k in range(rates, motions):
            a[k, k - rates + 1], a[k, k - rates + 2] = 1.0, -1.0
        a[e, 0], a[e, psi] = 1.0, v
        a[psi, 1] = 1.0
        a[delta, delta], a[delta, demand] = -1.0 / self.lag, 1.0 / self.lag
        a[integral, e] = 1.0
        drive = np.zeros((n, 1))
        drive[demand, 0] = 1.0
        road = np.zeros((n, 1))
        road[psi, 0] = -v
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


def _yielding(axle: Axle, stiffness: float, parameters: TruckParameters) -> float:
    """Cornering stiffness [N/rad] of an axle whose knuckles may turn by its side force.

    The force of a wheel end acts behind the kingpin by caster and pneumatic trail t, so that a
    knuckle with centering stiffness k turns by `F t / k` out of the slip.
    """
    own = axle.self_steering
    if own is None:
        return stiffness
    lever = own.trail + parameters.tires[axle.tire].pneumatic_trail
    return stiffness * own.stiffness / (own.stiffness + 0.5 * stiffness * lever)
