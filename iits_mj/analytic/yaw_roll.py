"""The yaw-plane model of any combination extended by roll, tire lag, side air and traction.

Each extension can be left out; without all of them the equations are those of `YawPlane`.

Equations. With the coordinates `q` of `roll_bodies` and forward speed v held,

    M q'' = Q,    q'' = u' + [v omega_1, 0, ...],    u = [v_y, omega, phi', alpha']

where M is that of `YawPlane` for lateral motion and yaw, extended by roll: `v_y` belongs to the
point of the lead unit's body below its reference *at the road*, about which roll is counted, so
that roll reaches the plane only through the heights of the masses and of the roll centers. `q''`
are accelerations over ground: Lagrange's equation holds in the ground frame, and its only inertial
term is `-M[:, 0] v omega_1`. Forces in Q:

- roll: stiffness and damping of `roll_bodies` (suspension, tires, couplings, weights), and the
  lateral velocity that rolling axles give to their contact patches. The carcass deflects sideways
  by `F sigma / C` and takes the axle load along: a roll moment `F F_z sigma / C`;
- relaxation: the force of axle i follows a slip that lags, `sigma_i / v s_i' = slip_i - s_i`, with
  the relaxation length `sigma = sigma_0 (F_z / F_z0)^n` of its tires (Pacejka, Tire and Vehicle
  Dynamics, 3rd ed., section 7.2.1, linear);
- side air: `-1/2 rho A v v_y` at the pressure center of each unit, v_y its lateral velocity in the
  unit's frame (still air; `v_y / v` is the sideslip of the stream);
- wheels: the angular momentum `J v / r` of the wheels of an axle couples its roll to the yaw of its
  unit (gyroscopic moment), and as left and right wheel must turn at different speeds when the unit
  yaws, they add `J (s / 2 r)^2` to its yaw inertia, J of both wheels, s the track;
- traction: drag, rolling resistance and the drive that balances them, see `traction`;
- pneumatic trail: as in `YawPlane`.

A linear model has no load transfer, no lash and no saturation. Parameters are computed from the
truck's TOML and never fitted to the simulation.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.roll_bodies import RollBodies, RollData, roll_bodies
from iits_mj.analytic.traction import Traction, traction_forces
from iits_mj.analytic.yaw_plane import (
    AnyArray,
    IntArray,
    LateralSystem,
    YawPlane,
    articulation_rates,
    plane_states,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.parameters import TruckParameters


@dataclass(frozen=True)
class YawRoll:
    """Matrices of the extended model: n units, k axles, N coordinates (n + 1 without roll).

    Attributes:
      plane: the yaw-plane model that it extends.
      inertia, stiffness, damping: shape (N, N), see `roll_bodies`.
      cornering: stiffness of each axle [N/rad], shape (k,).
      patches: lateral displacement of the contact patches by coordinate, shape (k, N).
      work: virtual displacement of the lateral forces, a pneumatic trail behind, shape (k, N).
      relaxation: lengths [m], shape (k,), or None.
      air: `1/2 rho A` of each unit [kg/m], shape (n,); pressure_centers: shape (n, N).
      traction: effect of the forces that keep the speed, or None.
      spin: angular momentum of an axle's wheels over speed [kg m], shape (k,).
      centers: lateral displacement of the units' CGs, shape (n, N).
    """

    plane: YawPlane
    inertia: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    cornering: FloatArray
    patches: FloatArray
    work: FloatArray
    relaxation: FloatArray | None
    air: FloatArray
    pressure_centers: FloatArray
    traction: Traction | None
    spin: FloatArray
    centers: FloatArray

    @classmethod
    def from_parameters(
        cls,
        parameters: TruckParameters,
        payload: float,
        *,
        cruise_speed: float = 0.0,
        roll: bool = True,
        relaxation: bool = True,
        side_air: bool = True,
        wheels: bool = True,
        traction: bool = True,
        pneumatic_trail: bool = True,
        roll_coupling: float | None = None,
    ) -> YawRoll:
        """Computes the model from the truck's parameters.

        Args:
          parameters: of the truck.
          payload: of the combination [kg].
          cruise_speed: constant speed [m/s] of axle loads and drag; 0: loads at rest, no drag.
          roll: of bodies and axles.
          relaxation: lag of the lateral tire forces.
          side_air: side force of the air in sideslip.
          wheels: gyroscopic moments, and yaw inertia of wheels that turn at their own speeds.
          traction: effect of drag, rolling resistance and drive.
          pneumatic_trail: as of `YawPlane`.
          roll_coupling: roll stiffness of the couplings that have one [N m/rad]; default: theirs,
            as of a fifth wheel whose plate is closed. 0: the units roll freely.

        Raises:
          InputError: payload or roll coupling are not allowed.
        """
        plane = YawPlane.from_parameters(
            parameters, payload, cruise_speed=cruise_speed, pneumatic_trail=pneumatic_trail
        )
        data = RollData.from_parameters(parameters, payload, cruise_speed)
        if roll_coupling is not None:
            given = positive("roll_coupling", roll_coupling, "N m/rad", zero=True)
            stiff = np.where(data.coupling_stiffness > 0.0, given, 0.0)
            damping = data.coupling_damping * (given > 0.0)
            data = dataclasses.replace(data, coupling_stiffness=stiff, coupling_damping=damping)
        bodies = roll_bodies(plane, data)
        forces = None
        if traction:
            forces = traction_forces(
                parameters, payload, plane, data, bodies, speed=cruise_speed, roll=roll
            )
        return cls.of(
            plane,
            data,
            bodies,
            roll=roll,
            relaxation=relaxation,
            side_air=side_air,
            wheels=wheels,
            traction=forces,
        )

    @classmethod
    def of(
        cls,
        plane: YawPlane,
        data: RollData,
        bodies: RollBodies,
        *,
        roll: bool = True,
        relaxation: bool = True,
        side_air: bool = True,
        wheels: bool = True,
        traction: Traction | None = None,
    ) -> YawRoll:
        """Assembles the model of a combination given by arrays.

        Args:
          plane: units and axles.
          data: what roll adds.
          bodies: `roll_bodies(plane, data)`.
          roll: as of `from_parameters`.
          relaxation: as of `from_parameters`.
          side_air: as of `from_parameters`.
          wheels: as of `from_parameters`.
          traction: None leaves it out.
        """
        flat = 1 + plane.units
        inertia = bodies.inertia.copy()
        inertia[:flat, :flat] = plane.inertia_matrix()
        spin = data.spin_inertia / data.rolling_radius**2 * float(wheels)
        yaw = 1 + plane.unit
        np.add.at(inertia, (yaw, yaw), spin * (0.5 * data.track) ** 2)
        cornering, trails = plane.cornering, plane.trail
        if traction is not None:
            cornering, trails = cornering * traction.cornering, trails * traction.trail
        axles = np.arange(len(cornering))
        work = bodies.patches.copy()
        work[axles, yaw] -= trails
        work[axles, 1 + 2 * plane.units + axles] += data.relaxation * data.cruise_load / cornering
        keep = slice(None) if roll else slice(flat)
        return cls(
            plane=plane,
            inertia=inertia[keep, keep],
            stiffness=bodies.stiffness[keep, keep],
            damping=bodies.damping[keep, keep],
            cornering=cornering,
            patches=bodies.patches[:, keep],
            work=work[:, keep],
            relaxation=data.relaxation if relaxation else None,
            air=0.5 * data.air_density * data.side_area * float(side_air),
            pressure_centers=bodies.pressure_centers[:, keep],
            traction=traction,
            spin=spin * data.rolling_radius,
            centers=bodies.centers[:, keep],
        )

    def at(self, speed: float) -> RollSystem:
        """State space at constant speed [m/s].

        Raises:
          InputError: the speed is not positive.
        """
        v = positive("speed of the yaw-roll model", speed, "m/s")
        units, axles = self.plane.units, len(self.cornering)
        flat, plane_size = 1 + units, 2 * units
        rolls = len(self.inertia) - flat
        first_rate, first_slip = plane_size + rolls, plane_size + 2 * rolls
        lag = self.relaxation is not None
        size = first_slip + (axles if lag else 0)
        # u and q by state: velocities (N, size), and roll angles in the rows of q (N, size).
        identity = np.eye(size)
        velocity = np.vstack([identity[:flat], identity[first_rate:first_slip]])
        angle = np.vstack([np.zeros((flat, size)), identity[plane_size:first_rate]])
        gamma = identity[flat:plane_size]
        # Yaw of the lead unit over that of each unit, by state.
        behind = np.tri(units, units - 1, -1) @ gamma
        slip = -self.patches @ velocity / v - behind[self.plane.unit]
        steer = self.plane.steer
        followed, direct = (identity[first_slip:], 0.0 * steer) if lag else (slip, steer)
        forces = self.work.T @ (self.cornering[:, None] * followed)
        input_forces = self.work.T @ (self.cornering * direct)
        forces -= self.stiffness @ angle + (self.damping + self._gyroscopic(v)) @ velocity
        sideslip = self.pressure_centers @ velocity + v * behind
        forces -= self.pressure_centers.T @ (v * self.air[:, None] * sideslip)
        forces -= v * np.outer(self.inertia[:, 0], identity[1])
        if self.traction is not None:
            forces += self.traction.angle @ angle + self.traction.rate @ velocity
            forces += self.traction.articulation @ gamma
            input_forces += self.traction.steer
        rates = np.linalg.solve(self.inertia, forces)
        input_rates = np.linalg.solve(self.inertia, input_forces)
        A, B = np.zeros((size, size)), np.zeros(size)
        A[:flat], A[first_rate:first_slip] = rates[:flat], rates[flat:]
        B[:flat], B[first_rate:first_slip] = input_rates[:flat], input_rates[flat:]
        A[flat:plane_size, 1:flat] = articulation_rates(units)
        A[plane_size:first_rate] = identity[first_rate:first_slip]
        if self.relaxation is not None:
            A[first_slip:] = (v / self.relaxation)[:, None] * (slip - identity[first_slip:])
            B[first_slip:] = v / self.relaxation * steer
        names = _state_names(units, rolls, axles, lag=lag)
        return RollSystem(self.plane, v, A, B, names, self.centers, rolls)

    def _gyroscopic(self, v: float) -> FloatArray:
        """Matrix of the wheels' gyroscopic moments, (N, N), antisymmetric."""
        matrix = np.zeros_like(self.inertia)
        if len(matrix) == 1 + self.plane.units:
            return matrix
        yaw: IntArray = 1 + self.plane.unit
        roll = 1 + 2 * self.plane.units + np.arange(len(yaw))
        matrix[yaw, roll] = self.spin * v
        matrix[roll, yaw] = -self.spin * v
        return matrix


@dataclass(frozen=True)
class RollSystem(LateralSystem):
    """`s' = A s + B delta`; the first 2 n states are those of `YawPlane`, names in `states`.

    Attributes:
      centers: see `YawRoll`; rolls: number of roll angles among the states, 0 without roll.
    """

    centers: FloatArray
    rolls: int

    def cg_accelerations(self, states: AnyArray, rates: AnyArray) -> AnyArray:
        """As of `LateralSystem`, at the heights of the CGs."""
        flat, first = 1 + self.model.units, 2 * self.model.units + self.rolls
        changes = np.hstack([rates[:, :flat], rates[:, first : first + self.rolls]])
        return np.asarray(changes @ self.centers.T + self.speed * states[:, 1:2])

    def roll_angles(self, states: AnyArray) -> AnyArray:
        """As of `LateralSystem`."""
        if self.rolls == 0:
            return super().roll_angles(states)
        first = 2 * self.model.units
        return states[:, first : first + self.model.units]


def _state_names(units: int, rolls: int, axles: int, *, lag: bool) -> tuple[str, ...]:
    names = list(plane_states(units))
    if rolls:
        angles = [f"phi_{i + 1}" for i in range(units)] + [f"alpha_{i + 1}" for i in range(axles)]
        names += angles + [f"{angle}'" for angle in angles]
    if lag:
        names += [f"slip_{i + 1}" for i in range(axles)]
    return tuple(names)
