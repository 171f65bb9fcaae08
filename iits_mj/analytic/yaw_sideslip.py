"""The paper's dynamic yaw-sideslip model of the tractor-semitrailer, derived again and corrected.

Symbols are the paper's (Section "Lateral - Dynamic Yaw-Sideslip Model"). The generalized velocities
are `q' = [v, v_yc, omega_c, omega_t]`: speed and lateral velocity of the tractor's CG in the
tractor's frame, yaw rates of tractor and trailer. Speed is constant, angles are small, and the
hitch angle is `gamma = beta_c - beta_t`, so that `gamma' = omega_c - omega_t`.

Kinematics. The hitch lies `L_h` behind the tractor's CG, the trailer's CG `L_t1` behind the hitch.
The trailer CG's lateral velocity *in the tractor's frame* is

    v_yt = v_yc - L_h omega_c - L_t1 omega_t.

Kinetic energy gives the paper's matrix H, which is correct. The velocities are components in a
frame that turns with omega_c: Lagrange's equation in quasi-coordinates (Boltzmann-Hamel) leaves
the terms `m_c v omega_c` and `m_t v omega_c` on the side of the inertia forces. Hence in the
virtual work

    -m_c omega_c v dy_c - m_t omega_c v dy_t,    dy_t = dy_c - L_h dbeta_c - L_t1 dbeta_t.

The paper prints plus signs and, for the trailer, omega_t: understeer turns into oversteer, and the
laden truck is unstable at 80 km/h. With omega_t, `v_yt` would have to be measured in the trailer's
frame, `v_yt + v gamma`.

Slip angles. A trailer axle `d` behind the hitch has, in the *trailer's* frame, the lateral velocity
`v_yc - L_h omega_c - d omega_t + v gamma`. So, for lateral forces `F = C alpha` (positive to the
left),

    alpha_1 = delta - (v_yc + L_c1 omega_c) / v
    alpha_2 = -(v_yc - (L_c2 -/+ i_2) omega_c) / v
    alpha_3 = -(v_yc - L_h omega_c - d omega_t) / v - gamma.

The paper prints no tire law; without gamma in alpha_3 the trailer never aligns. In its notation
`i_2` is half the tandem's spacing, while `i_3` is the full spacing of two neighbors of the
tri-axle, whose middle axle lies L_t2 behind the trailer's CG.

Our addition: the lateral force acts a pneumatic trail `t` behind the axle's center, which changes
the arms of the virtual work and not the slip angles. `pneumatic_trail=False` removes it.

Parameters are computed from the truck's TOML and never fitted to the simulation. Every step of the
derivation is in `docs/derivation`, in words in `docs/analytic.md`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import cruise_axle_loads, laden_units
from iits_mj.parameters.tire_law import axle_cornering_stiffness

AnyArray = NDArray[Any]

# An eigenvalue smaller than this is zero but for rounding [1/s].
_DRIFT = 1e-9


@dataclass(frozen=True)
class YawSideslip:
    """Numbers of the linear yaw-sideslip model, in the paper's symbols.

    Attributes:
      m_c, m_t: masses of tractor and laden semitrailer [kg]; I_c, I_t: yaw inertias [kg m2].
      L_c1, L_h: tractor CG to steer axle, to hitch [m]; L_t1: hitch to trailer CG [m].
      tractor_arms: fixed tractor axles behind the tractor's CG [m], `L_c2 -/+ i_2`, shape (n,).
      trailer_arms: trailer axles behind the *hitch* [m], `L_t1 + L_t2 + (-i_3, 0, i_3)`.
      C_1: cornering stiffness of the steer axle [N/rad].
      C_2, C_3: of the fixed tractor axles, shape (n,), and of the trailer axles, shape (m,).
      t_1, t_2, t_3: pneumatic trails of the three groups [m].
    """

    m_c: float
    m_t: float
    I_c: float
    I_t: float
    L_c1: float
    L_h: float
    L_t1: float
    tractor_arms: FloatArray
    trailer_arms: FloatArray
    C_1: float
    C_2: FloatArray
    C_3: FloatArray
    t_1: float = 0.0
    t_2: float = 0.0
    t_3: float = 0.0

    @classmethod
    def from_parameters(
        cls,
        parameters: TruckParameters,
        payload: float,
        *,
        cruise_speed: float = 0.0,
        pneumatic_trail: bool = True,
    ) -> YawSideslip:
        """Computes the model from the truck's parameters.

        Args:
          parameters: of the truck.
          payload: on the semitrailer [kg].
          cruise_speed: the tires' stiffness is that of the axle loads at this constant speed [m/s],
            which drag and rolling resistance shift to the rear; 0: loads at rest.
          pneumatic_trail: see the module's text.
        """
        tractor, fifth_wheel = parameters.lead, parameters.couplings[0]
        trailer = laden_units(parameters, payload)[1]
        front, *drive = tractor.axles
        loads = cruise_axle_loads(parameters, payload, cruise_speed)
        stiffness = axle_cornering_stiffness(parameters, loads)
        trails = [
            parameters.tires[axle.tire].pneumatic_trail if pneumatic_trail else 0.0
            for axle in (front, drive[0], parameters.units[1].axles[0])
        ]
        split = 1 + len(drive)
        return cls(
            m_c=tractor.mass,
            m_t=trailer.mass,
            I_c=tractor.inertia_z,
            I_t=trailer.inertia_z,
            L_c1=tractor.cg_position - front.position,
            L_h=fifth_wheel.position - tractor.cg_position,
            L_t1=trailer.cg_position,
            tractor_arms=np.array([axle.position - tractor.cg_position for axle in drive]),
            trailer_arms=np.array([axle.position for axle in parameters.units[1].axles]),
            C_1=float(stiffness[0]),
            C_2=stiffness[1:split],
            C_3=stiffness[split:],
            t_1=trails[0],
            t_2=trails[1],
            t_3=trails[2],
        )

    @property
    def wheelbase(self) -> float:
        """Steer axle to the center of the fixed tractor axles [m]."""
        return self.L_c1 + float(np.mean(self.tractor_arms))

    def H(self) -> FloatArray:
        """The paper's inertia matrix H, shape (4, 4)."""
        m_c, m_t, L_h, L_t1 = self.m_c, self.m_t, self.L_h, self.L_t1
        return np.array(
            [
                [m_c + m_t, -L_h * m_t, -L_t1 * m_t, 0.0],
                [-L_h * m_t, m_t * L_h**2 + self.I_c, L_h * L_t1 * m_t, 0.0],
                [-L_t1 * m_t, L_h * L_t1 * m_t, m_t * L_t1**2 + self.I_t, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )

    def A_h(self, speed: float) -> FloatArray:
        """The corrected state matrix A_h, shape (4, 4), at `speed` [m/s]."""
        v = positive("speed of the yaw-sideslip model", speed, "m/s")
        # Rows: generalized forces on y_c, beta_c, beta_t; last row: gamma' = omega_c - omega_t.
        matrix = np.zeros((4, 4))
        for stiffness, slip, arm in self._axles(v):
            matrix[:3] += stiffness * np.outer(arm, slip)
        # Inertial terms with minus signs, both with the tractor's yaw rate.
        matrix[0, 1] -= (self.m_c + self.m_t) * v
        matrix[1, 1] += self.m_t * self.L_h * v
        matrix[2, 1] += self.m_t * self.L_t1 * v
        matrix[3] = [0.0, 1.0, -1.0, 0.0]
        return matrix

    def B_h(self) -> FloatArray:
        """The input vector B_h, shape (4,), for the road-wheel angle delta [rad]."""
        return self.C_1 * np.array([1.0, self.L_c1 - self.t_1, 0.0, 0.0])

    def _axles(self, v: float) -> list[tuple[float, FloatArray, FloatArray]]:
        """(C, slip by state (4,), virtual displacement of its force (3,)) per axle."""
        front = np.array([-1.0 / v, -self.L_c1 / v, 0.0, 0.0])
        rows = [(self.C_1, front, np.array([1.0, self.L_c1 - self.t_1, 0.0]))]
        for stiffness, arm in zip(self.C_2, self.tractor_arms, strict=True):
            slip = np.array([-1.0 / v, arm / v, 0.0, 0.0])
            rows.append((float(stiffness), slip, np.array([1.0, -(arm + self.t_2), 0.0])))
        for stiffness, arm in zip(self.C_3, self.trailer_arms, strict=True):
            slip = np.array([-1.0 / v, self.L_h / v, arm / v, -1.0])
            work = np.array([1.0, -self.L_h, -(arm + self.t_3)])
            rows.append((float(stiffness), slip, work))
        return rows

    def at(self, speed: float) -> LateralSystem:
        """State space `s' = A s + B delta` at constant speed [m/s]."""
        inverse = np.linalg.inv(self.H())
        A, B = inverse @ self.A_h(speed), inverse @ self.B_h()
        return LateralSystem(self, float(speed), A, B, ("v_yc", "omega_c", "omega_t", "gamma"))


@dataclass(frozen=True)
class LateralSystem:
    """`s' = A s + B delta` with `s = [v_yc, omega_c, omega_t, gamma]` at one speed [m/s]."""

    model: YawSideslip
    speed: float
    A: FloatArray
    B: FloatArray
    states: tuple[str, ...]

    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A [1/s], shape (4,), the least damped first."""
        values = np.linalg.eigvals(self.A).astype(np.complex128)
        return values[np.argsort(-values.real)]

    def damping_ratio(self) -> float:
        """The smallest damping ratio `-Re / |.|` of all modes; negative when unstable.

        A real eigenvalue counts 1 when it decays, -1 when it grows, and 0 when it does neither.
        """
        values = self.eigenvalues()
        size = np.maximum(np.abs(values), _DRIFT)
        return float(np.min(-values.real / size))

    @property
    def stable(self) -> bool:
        """True when every eigenvalue decays; one that is zero but for rounding does not."""
        return bool(self.eigenvalues()[0].real < -_DRIFT)

    def steady_state(self, steer: float = 1.0) -> FloatArray:
        """Steady state of the equations, shape (4,), for a constant road-wheel angle [rad]."""
        return np.asarray(-np.linalg.solve(self.A, self.B) * steer, dtype=float)

    def frequency_response(self, frequency: FloatArray) -> NDArray[np.complex128]:
        """`s / delta` at frequencies [Hz] of shape (n,); result of shape (n, 4)."""
        points = 2j * math.pi * np.atleast_1d(frequency)
        return np.array([np.linalg.solve(p * np.eye(len(self.B)) - self.A, self.B) for p in points])

    def cg_accelerations(self, states: AnyArray, rates: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Lateral accelerations of the CGs of tractor and trailer [m/s2], shape (n,) each.

        Args:
          states: shape (n, k), may be complex amplitudes.
          rates: their time derivatives, of the same shape.
        """
        model = self.model
        tractor = rates[:, 0] + self.speed * states[:, 1]
        return tractor, tractor - model.L_h * rates[:, 1] - model.L_t1 * rates[:, 2]

    def steer_axle_acceleration(self, states: AnyArray, rates: AnyArray) -> AnyArray:
        """Lateral acceleration of the steer axle's center at the road [m/s2], shape (n,).

        Args:
          states: shape (n, k), may be complex amplitudes.
          rates: their time derivatives, of the same shape.
        """
        return rates[:, 0] + self.model.L_c1 * rates[:, 1] + self.speed * states[:, 1]

    def roll_angles(self, states: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Roll of tractor and trailer [rad], shape (n,) each, from states (n, k); here zero."""
        return np.zeros_like(states[:, 0]), np.zeros_like(states[:, 0])
