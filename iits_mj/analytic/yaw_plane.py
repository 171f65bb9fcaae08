"""Linear yaw-plane model of a combination of any number of units.

Derivation. A unit's origin is its coupling point, of the motor vehicle its first axle. With the
couplings at `c` behind the origins, a point `p` behind the origin of unit k lies at

    y = y_1 - c_1 psi_1 - ... - c_(k-1) psi_(k-1) - p psi_k = q_p [y_1, psi_1 ... psi_n]

for small angles, where `y_1` belongs to a reference point of the motor vehicle (positions of unit 1
are then counted from it). Lagrange's equations in these ground coordinates are

    M q'' = Q,    M = sum over units of m q_cg q_cg' + diag(0, I_z),

and over the velocities in the motor vehicle's frame, `u = [v_y, omega_1 ... omega_n]` with
`q'' = u' + [v omega_1, 0 ...]`,

    M u' = Q - v M[:, 0] omega_1.

An axle at p on unit k has the slip angle

    alpha = share delta - q_p u / v - (gamma_1 + ... + gamma_(k-1)),

with the articulation `gamma_j = psi_j - psi_(j+1)`, and gives `Q = C alpha q_(p + t)`: its force
acts a pneumatic trail t behind its center. For two units these are the paper's equations (Section
"Lateral - Dynamic Yaw-Sideslip Model") with its misprints corrected: in the virtual work the paper
prints plus signs for the inertial terms and, for the trailer, omega_2. With them understeer turns
into oversteer. `docs/derivation` derives the equations of n units by sympy, and the paper's.

Parameters are computed from the truck's TOML and never fitted to the simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import cruise_axle_loads, group_center, laden_units
from iits_mj.parameters.tire_law import axle_cornering_stiffness
from iits_mj.parameters.units import Axle

AnyArray = NDArray[Any]
IntArray = NDArray[np.int64]

# An eigenvalue smaller than this is zero but for rounding [1/s].
_DRIFT = 1e-9


@dataclass(frozen=True)
class YawPlane:
    """A combination of n units with k axles on the road, by arrays.

    Attributes:
      mass, inertia: of the laden units [kg], in yaw about their CGs [kg m2], shape (n,).
      cg: behind each unit's origin [m], shape (n,).
      couplings: of the next unit behind each unit's origin [m], shape (n - 1,).
      unit: index of each axle's unit, shape (k,), front to rear.
      position: of each axle behind its unit's origin [m], shape (k,).
      cornering: stiffness of each axle [N/rad], shape (k,).
      steer: angle of each axle over that of the first one, shape (k,).
      trail: pneumatic, of each axle [m], shape (k,).
      reference: point of the motor vehicle whose lateral velocity is the first state, behind its
        origin [m].
    """

    mass: FloatArray
    inertia: FloatArray
    cg: FloatArray
    couplings: FloatArray
    unit: IntArray
    position: FloatArray
    cornering: FloatArray
    steer: FloatArray
    trail: FloatArray
    reference: float = 0.0

    def __post_init__(self) -> None:
        units, axles = len(self.mass), len(self.unit)
        lengths = {
            "inertia": (len(self.inertia), units),
            "cg": (len(self.cg), units),
            "couplings": (len(self.couplings), units - 1),
            "position": (len(self.position), axles),
            "cornering": (len(self.cornering), axles),
            "steer": (len(self.steer), axles),
            "trail": (len(self.trail), axles),
        }
        for name, (found, needed) in lengths.items():
            if found != needed:
                raise InputError(f"{name} has {found} values; {needed} are needed")
        if sorted(set(self.unit.tolist())) != list(range(units)):
            raise InputError(
                f"axles are on the units {self.unit.tolist()}; each of {units} needs one"
            )

    @classmethod
    def from_parameters(
        cls,
        parameters: TruckParameters,
        payload: float,
        *,
        cruise_speed: float = 0.0,
        pneumatic_trail: bool = True,
    ) -> YawPlane:
        """Computes the model from the truck's parameters; its reference is the lead unit's CG.

        Args:
          parameters: of the truck.
          payload: of the combination [kg].
          cruise_speed: the tires' stiffness is that of the axle loads at this constant speed [m/s],
            which drag and rolling resistance shift to the rear; 0: loads at rest.
          pneumatic_trail: False: the lateral forces act at the axles' centers.
        """
        units, axles = axles_on_road(parameters, payload)
        bodies = laden_units(parameters, payload)
        loads = cruise_axle_loads(parameters, payload, cruise_speed)
        names = [axle.name for axle in parameters.axles]
        stiffness = dict(zip(names, axle_cornering_stiffness(parameters, loads), strict=True))
        trails = [parameters.tires[axle.tire].pneumatic_trail for axle in axles]
        front, rear = parameters.lead.groups(payload)
        center = group_center(rear)
        return cls(
            mass=np.array([body.mass for body in bodies]),
            inertia=np.array([body.inertia_z for body in bodies]),
            cg=np.array([body.cg_position for body in bodies]),
            couplings=np.array([coupling.position for coupling in parameters.couplings]),
            unit=units,
            position=np.array([axle.position for axle in axles]),
            cornering=np.array(
                [
                    yielding_stiffness(axle, float(stiffness[axle.name]), parameters)
                    for axle in axles
                ]
            ),
            # All steered wheels turn about a center on the line through the rear group's middle.
            steer=np.array(
                [
                    (center - axle.position) / (center - front[0].position) if axle.steered else 0.0
                    for axle in axles
                ]
            ),
            trail=np.array(trails) * float(pneumatic_trail),
            reference=bodies[0].cg_position,
        )

    @property
    def units(self) -> int:
        """Number of units."""
        return len(self.mass)

    def group(self, unit: int) -> float:
        """Center of a unit's axles that are not steered, behind its origin [m]."""
        return float(np.mean(self.position[(self.unit == unit) & (self.steer == 0.0)]))

    @property
    def wheelbase(self) -> float:
        """First axle to the center of the motor vehicle's fixed axles [m]."""
        return self.group(0) - float(self.position[0])

    def row(self, unit: int, position: float) -> FloatArray:
        """Lateral displacement by `[y, psi_1 ... psi_n]` of a point behind a unit's origin [m]."""
        row = np.zeros(1 + self.units)
        row[0] = 1.0
        row[1 : 1 + unit] = -self.couplings[:unit]
        row[1 + unit] = -position
        row[1] += self.reference
        return row

    def centers(self) -> FloatArray:
        """Rows of the units' CGs, shape (n, n + 1)."""
        return np.array([self.row(unit, float(cg)) for unit, cg in enumerate(self.cg)])

    def inertia_matrix(self) -> FloatArray:
        """Returns M, shape (n + 1, n + 1)."""
        matrix = np.zeros((1 + self.units, 1 + self.units))
        diagonal = np.diag_indices(len(matrix))
        for unit, (mass, row) in enumerate(zip(self.mass, self.centers(), strict=True)):
            # One triangle and the diagonal, so that the matrix is symmetric to the last digit.
            matrix += np.triu(np.outer(row, mass * row), 1)
            matrix[diagonal] += mass * row**2
            matrix[1 + unit, 1 + unit] += self.inertia[unit]
        return np.asarray(matrix + np.triu(matrix, 1).T)

    def forces(self, speed: float) -> FloatArray:
        """Generalized forces by the states and delta at a speed [m/s], shape (n + 1, 2 n + 1).

        The inertial term `-v M[:, 0] omega_1` is among them.
        """
        v = positive("speed of the yaw-plane model", speed, "m/s")
        rates, states = 1 + self.units, 2 * self.units
        forces = np.zeros((rates, states + 1))
        for i, unit in enumerate(self.unit.tolist()):
            slip = np.zeros(states + 1)
            slip[:rates] = self.row(unit, float(self.position[i])) / v
            slip[rates : rates + unit] = 1.0
            slip[states] = -self.steer[i]
            work = self.row(unit, float(self.position[i] + self.trail[i]))
            forces -= self.cornering[i] * np.outer(work, slip)
        forces[:, 1] -= v * self.inertia_matrix()[:, 0]
        return forces

    def at(self, speed: float) -> LateralSystem:
        """State space `s' = A s + B delta` at constant speed [m/s].

        Raises:
          InputError: the speed is not positive.
        """
        rates, states = 1 + self.units, 2 * self.units
        motion = np.linalg.solve(self.inertia_matrix(), self.forces(speed))
        A, B = np.zeros((states, states)), np.zeros(states)
        A[:rates], B[:rates] = motion[:, :states], motion[:, states]
        A[rates:, 1:rates] = articulation_rates(self.units)
        return LateralSystem(self, float(speed), A, B, plane_states(self.units))


def axles_on_road(parameters: TruckParameters, payload: float) -> tuple[IntArray, tuple[Axle, ...]]:
    """Returns the axles that are not lifted with a payload [kg], and the index of their units."""
    found = [
        (index, axle)
        for index, unit in enumerate(parameters.units)
        for axle in unit.axles
        if not axle.lifted(payload)
    ]
    return np.array([index for index, _ in found]), tuple(axle for _, axle in found)


def yielding_stiffness(axle: Axle, stiffness: float, parameters: TruckParameters) -> float:
    """Returns the cornering stiffness [N/rad] of an axle whose knuckles may turn by its side force.

    The force of a wheel end acts behind the kingpin by caster and pneumatic trail t, so that a
    knuckle with centering stiffness k turns by `F t / k` out of the slip.
    """
    own = axle.self_steering
    if own is None:
        return stiffness
    lever = own.trail + parameters.tires[axle.tire].pneumatic_trail
    return stiffness * own.stiffness / (own.stiffness + 0.5 * stiffness * lever)


def articulation_rates(units: int) -> FloatArray:
    """Returns the matrix of `gamma' = omega_j - omega_(j+1)`, shape (n - 1, n)."""
    return np.eye(units - 1, units) - np.eye(units - 1, units, 1)


def plane_states(units: int) -> tuple[str, ...]:
    """Returns the names of the plane's states: velocity, yaw rates, articulations."""
    rates = [f"omega_{i + 1}" for i in range(units)]
    return ("v_y", *rates, *(f"gamma_{i + 1}" for i in range(units - 1)))


@dataclass(frozen=True)
class LateralSystem:
    """`s' = A s + B delta` with `s = [v_y, omega_1 .. omega_n, gamma_1 .. gamma_(n-1), ...]`.

    Attributes:
      model: numbers of the combination; speed: [m/s]; states: their names.
    """

    model: YawPlane
    speed: float
    A: FloatArray
    B: FloatArray
    states: tuple[str, ...]

    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A [1/s], the least damped first."""
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
        """Steady state of the equations for a constant road-wheel angle [rad]."""
        return np.asarray(-np.linalg.solve(self.A, self.B) * steer, dtype=float)

    def frequency_response(self, frequency: FloatArray) -> NDArray[np.complex128]:
        """`s / delta` at frequencies [Hz] of shape (m,); result of shape (m, states)."""
        points = 2j * math.pi * np.atleast_1d(frequency)
        return np.array([np.linalg.solve(p * np.eye(len(self.B)) - self.A, self.B) for p in points])

    def cg_accelerations(self, states: AnyArray, rates: AnyArray) -> AnyArray:
        """Lateral accelerations of the units' CGs [m/s2], shape (m, n).

        Args:
          states: shape (m, states), may be complex amplitudes.
          rates: their time derivatives, of the same shape.
        """
        return self.accelerations(self.model.centers(), states, rates)

    def accelerations(self, rows: FloatArray, states: AnyArray, rates: AnyArray) -> AnyArray:
        """Lateral accelerations of points [m/s2], (m, points), by their rows (`YawPlane.row`)."""
        velocity = rates[:, : rows.shape[1]]
        return np.asarray(velocity @ rows.T + self.speed * states[:, 1:2])

    def steer_axle_acceleration(self, states: AnyArray, rates: AnyArray) -> AnyArray:
        """Lateral acceleration of the first axle's center at the road [m/s2], shape (m,).

        Args:
          states: shape (m, states), may be complex amplitudes.
          rates: their time derivatives, of the same shape.
        """
        front = self.model.row(0, float(self.model.position[0]))
        return self.accelerations(front[None, :], states, rates)[:, 0]

    def roll_angles(self, states: AnyArray) -> AnyArray:
        """Roll of the units [rad], shape (m, n), from states (m, states); here zero."""
        return np.zeros((len(states), self.model.units))
