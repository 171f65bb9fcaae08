"""The yaw-sideslip model extended by roll, tire lag, side air and traction.

Each extension can be left out; without all of them the equations are those of `YawSideslip`.

Equations. With the coordinates `q` of `roll_bodies` and forward speed v held,

    M q'' = Q,    q'' = u' + [v omega_c, 0, ...],    u = [v_yc, omega_c, omega_t, phi', alpha']

where M has the paper's H for lateral motion and yaw, extended by roll: `v_yc` belongs to the point
of the tractor's body below its CG *at the road*, about which roll is counted, so that roll reaches
the plane only through the heights of the masses and of the roll centers. `q''` are accelerations
over ground: Lagrange's equation holds in the ground frame, and its only inertial term is
`-M[:, 0] v omega_c`. Forces in Q:

- roll: stiffness and damping of `roll_bodies` (suspension, tires, fifth wheel, weights), and the
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
- pneumatic trail: as in `YawSideslip`.

A linear model has no load transfer, no lash and no saturation. Parameters are computed from the
truck's TOML and never fitted to the simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.roll_bodies import FIRST_AXLE, PHI_C, PHI_T, roll_bodies
from iits_mj.analytic.traction import Traction, traction_forces
from iits_mj.analytic.yaw_sideslip import AnyArray, LateralSystem, YawSideslip
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import air_shares, cruise_axle_loads, static_axle_loads

# Shortest relaxation length of the tire plugin [m].
SHORTEST_RELAXATION = 0.1


@dataclass(frozen=True)
class YawRoll:
    """Matrices of the extended model: `n` coordinates (3 without roll), `k` axles.

    Attributes:
      plane: the yaw-sideslip model that it extends.
      inertia, stiffness, damping: shape (n, n), see `roll_bodies`.
      cornering: stiffness of each axle [N/rad], shape (k,).
      patches: lateral displacement of the contact patches by coordinate, shape (k, n).
      work: virtual displacement of the lateral forces, a pneumatic trail behind, shape (k, n).
      on_trailer: 1 for axles of the trailer, 0 for the tractor's, shape (k,).
      relaxation: lengths [m], shape (k,), or None.
      air: `1/2 rho A` of tractor and trailer [kg/m], shape (2,); pressure_centers: shape (2, n).
      traction: effect of the forces that keep the speed, or None.
      spin: angular momentum of an axle's wheels over speed [kg m], shape (k,).
      centers: lateral displacement of the CGs of tractor and trailer, shape (2, n).
    """

    plane: YawSideslip
    inertia: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    cornering: FloatArray
    patches: FloatArray
    work: FloatArray
    on_trailer: FloatArray
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
          payload: on the semitrailer [kg].
          cruise_speed: constant speed [m/s] of axle loads and drag; 0: loads at rest, no drag.
          roll: of bodies and axles.
          relaxation: lag of the lateral tire forces.
          side_air: side force of the air in sideslip.
          wheels: gyroscopic moments, and yaw inertia of wheels that turn at their own speeds.
          traction: effect of drag, rolling resistance and drive.
          pneumatic_trail: as of `YawSideslip`.
          roll_coupling: roll stiffness between the units [N m/rad]; default: the fifth wheel's,
            whose plate is closed. 0: the units roll freely against each other.

        Raises:
          InputError: payload or roll coupling are not allowed.
        """
        fifth_wheel = parameters.couplings[0]
        coupling = fifth_wheel.roll_stiffness if roll_coupling is None else roll_coupling
        coupling = positive("roll_coupling", coupling, "N m/rad", zero=True)
        plane = YawSideslip.from_parameters(
            parameters, payload, cruise_speed=cruise_speed, pneumatic_trail=pneumatic_trail
        )
        damping = fifth_wheel.roll_damping if coupling > 0.0 else 0.0
        bodies = roll_bodies(parameters, payload, coupling, damping)
        inertia = bodies.inertia.copy()
        inertia[:3, :3] = plane.H()[:3, :3]
        on_tractor = len(parameters.lead.axles)
        on_trailer = (np.arange(len(parameters.axles)) >= on_tractor).astype(float)
        spin = bodies.spin_inertia / bodies.rolling_radii**2 if wheels else 0.0 * on_trailer
        unit_yaw = np.where(on_trailer > 0.0, 2, 1)
        np.add.at(inertia, (unit_yaw, unit_yaw), spin * (0.5 * bodies.tracks) ** 2)
        on_drive = on_tractor - 1
        trails = np.repeat(
            [plane.t_1, plane.t_2, plane.t_3], [1, on_drive, len(unit_yaw) - on_tractor]
        )
        rest_loads = static_axle_loads(parameters, payload)
        loads = cruise_axle_loads(parameters, payload, cruise_speed)
        air = parameters.aerodynamics
        forces = None
        cornering = np.concatenate([[plane.C_1], plane.C_2, plane.C_3])
        if traction:
            forces = traction_forces(
                parameters,
                bodies,
                rest_loads=rest_loads,
                loads=loads,
                speed=cruise_speed,
                coupling=coupling,
                roll=roll,
            )
            cornering *= forces.cornering
            trails *= forces.trail
        work = bodies.patches.copy()
        axles = np.arange(len(work))
        work[axles, unit_yaw] -= trails
        lengths = relaxation_lengths(parameters, loads)
        work[axles, FIRST_AXLE + axles] += lengths * loads / cornering
        areas = np.array(air_shares(parameters)) * (air.side_area if side_air else 0.0)
        keep = slice(None) if roll else slice(3)
        return cls(
            plane=plane,
            inertia=inertia[keep, keep],
            stiffness=bodies.stiffness[keep, keep],
            damping=bodies.damping[keep, keep],
            cornering=cornering,
            patches=bodies.patches[:, keep],
            work=work[:, keep],
            on_trailer=on_trailer,
            relaxation=lengths if relaxation else None,
            air=0.5 * air.density * areas,
            pressure_centers=bodies.pressure_centers[:, keep],
            traction=forces,
            spin=spin * bodies.rolling_radii,
            centers=bodies.centers[:, keep],
        )

    def at(self, speed: float) -> RollSystem:
        """State space at constant speed [m/s].

        Raises:
          InputError: the speed is not positive.
        """
        v = positive("speed of the yaw-roll model", speed, "m/s")
        n, axles = len(self.inertia), len(self.cornering)
        rolls = n - 3
        first_rate, first_slip = 4 + rolls, 4 + 2 * rolls
        lag = self.relaxation is not None
        size = first_slip + (axles if lag else 0)
        # u and q by state: velocities (n, size), and roll angles in the rows of q (n, size).
        identity = np.eye(size)
        velocity = np.vstack([identity[:3], identity[first_rate:first_slip]])
        angle = np.vstack([np.zeros((3, size)), identity[4:first_rate]])
        gamma = identity[3]
        slip = -self.patches @ velocity / v - np.outer(self.on_trailer, gamma)
        steer = np.eye(axles)[0]
        followed, direct = (identity[first_slip:], 0.0 * steer) if lag else (slip, steer)
        forces = self.work.T @ (self.cornering[:, None] * followed)
        input_forces = self.work.T @ (self.cornering * direct)
        forces -= self.stiffness @ angle + (self.damping + self._gyroscopic(v)) @ velocity
        sideslip = self.pressure_centers @ velocity + v * np.outer([0.0, 1.0], gamma)
        forces -= self.pressure_centers.T @ (v * self.air[:, None] * sideslip)
        forces -= v * np.outer(self.inertia[:, 0], identity[1])
        if self.traction is not None:
            forces += self.traction.angle @ angle + self.traction.rate @ velocity
            forces += np.outer(self.traction.articulation, gamma)
            input_forces += self.traction.steer
        rates = np.linalg.solve(self.inertia, forces)
        input_rates = np.linalg.solve(self.inertia, input_forces)
        A, B = np.zeros((size, size)), np.zeros(size)
        A[:3], A[first_rate:first_slip] = rates[:3], rates[3:]
        B[:3], B[first_rate:first_slip] = input_rates[:3], input_rates[3:]
        A[3] = identity[1] - identity[2]
        A[4:first_rate] = identity[first_rate:first_slip]
        if self.relaxation is not None:
            A[first_slip:] = (v / self.relaxation)[:, None] * (slip - identity[first_slip:])
            B[first_slip:] = v / self.relaxation * steer
        names = _state_names(rolls, axles, lag=lag)
        return RollSystem(self.plane, v, A, B, names, self.centers, rolls)

    def _gyroscopic(self, v: float) -> FloatArray:
        """Matrix of the wheels' gyroscopic moments, (n, n), antisymmetric."""
        matrix = np.zeros_like(self.inertia)
        if len(matrix) == 3:
            return matrix
        for i, spin in enumerate(self.spin):
            yaw, roll = (2 if self.on_trailer[i] else 1), FIRST_AXLE + i
            matrix[yaw, roll] = spin * v
            matrix[roll, yaw] = -spin * v
        return matrix


@dataclass(frozen=True)
class RollSystem(LateralSystem):
    """`s' = A s + B delta`; the first four states are `YawSideslip`'s, names in `states`.

    Attributes:
      centers: see `YawRoll`; rolls: number of roll angles among the states, 0 without roll.
    """

    centers: FloatArray
    rolls: int

    def cg_accelerations(self, states: AnyArray, rates: AnyArray) -> tuple[AnyArray, AnyArray]:
        """As of `LateralSystem`, at the heights of the CGs."""
        first = 4 + self.rolls
        changes = np.hstack([rates[:, :3], rates[:, first : first + self.rolls]])
        both = changes @ self.centers.T + self.speed * states[:, 1:2]
        return both[:, 0], both[:, 1]

    def roll_angles(self, states: AnyArray) -> tuple[AnyArray, AnyArray]:
        """As of `LateralSystem`."""
        if self.rolls == 0:
            return super().roll_angles(states)
        return states[:, 1 + PHI_C], states[:, 1 + PHI_T]


def relaxation_lengths(parameters: TruckParameters, loads: FloatArray) -> FloatArray:
    """Lateral relaxation length of each axle's tires [m], shape (k,), at axle loads [N], (k,)."""
    common = parameters.tire_common
    tires = np.array([2 * parameters.tires[axle.tire].count for axle in parameters.axles])
    relative = loads / (tires * common.nominal_load)
    length = common.relaxation_lateral * relative**common.relaxation_load_exponent
    return np.asarray(np.maximum(SHORTEST_RELAXATION, length))


def _state_names(rolls: int, axles: int, *, lag: bool) -> tuple[str, ...]:
    names = ["v_yc", "omega_c", "omega_t", "gamma"]
    if rolls:
        angles = ["phi_c", "phi_t", *(f"alpha_{i + 1}" for i in range(axles))]
        names += angles + [f"{angle}'" for angle in angles]
    if lag:
        names += [f"slip_{i + 1}" for i in range(axles)]
    return tuple(names)
