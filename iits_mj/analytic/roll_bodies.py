"""Masses, springs and geometry of a combination as its units and axles roll: small motion.

Coordinates `q = [y, psi_1 .. psi_n, phi_1 .. phi_n, alpha_1 .. alpha_k]`: lateral position of the
point of the motor vehicle that lies below its reference (`YawPlane`) at the height of the road, yaw
of the units, roll of their bodies, and roll of every axle; all absolute, roll positive to the right
(left side up). Straight running is symmetric, so that heave, pitch and speed do not occur in the
linear equations of these coordinates.

Lateral positions. A point of unit k at height h and `p` behind its origin, whose coupling j to the
next unit lies at the height `h_j`:

    y = (plane, see `yaw_plane`) - h_1 phi_1 - (h_2 - h_1) phi_2 - ... - (h - h_(k-1)) phi_k

An axle turns about its roll center, which is fixed to the body at `h_r`, `e` above the axle's
center. Its center therefore moves by `e alpha` and its contact patches by `h_r alpha` more than the
roll center.

Inertia is the sum of `m J' J` over the masses and of their roll inertias. Stiffness is the Hessian
of the potential energy at rest:

    springs and bar of an axle   1/2 k_s (alpha - phi)^2,    k_s = k b^2 / 2 + k_aux
    its tires                    1/2 k_t alpha^2,            k_t = n k_z s^2 / 2 (n tires a side)
    coupling j                   1/2 k_j (phi_(j+1) - phi_j)^2
    weights and axle loads       sum of m g z - F_z z with z to second order: z = -h phi^2 / 2

where `b` is the spacing of the springs and `s` the track. The last line tips a body over its roll
centers and, through the load on its coupling, over the unit ahead.

The axle with a roll center is that of Gillespie and MacAdam, "Constant Velocity Yaw/Roll Program",
UMTRI-82-39 (1982); the equations here are Lagrange's of the coordinates above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.yaw_plane import YawPlane, axles_on_road
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model.statics import axle_inertial, sprung, wheel_height
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import (
    air_shares,
    cruise_axle_loads,
    laden_units,
    payload_inertials,
    static_axle_loads,
)
from iits_mj.parameters.units import Axle

# Shortest relaxation length of the tire plugin [m].
SHORTEST_RELAXATION = 0.1


@dataclass(frozen=True)
class RollBody:
    """A mass that rolls with a unit: chassis or load.

    Attributes:
      unit: index; mass: [kg]; position: behind the unit's origin [m]; height: above the road [m];
        inertia_x: about its CG [kg m2].
    """

    unit: int
    mass: float
    position: float
    height: float
    inertia_x: float


@dataclass(frozen=True)
class RollData:
    """What roll adds to a `YawPlane` of n units and k axles.

    Attributes:
      bodies: chassis and loads.
      cg_height: of the laden units [m], shape (n,).
      coupling_height: above the road [m]; coupling_stiffness, coupling_damping: in roll
        [N m/rad], [N m s/rad], shape (n - 1,).
      axle_mass, axle_height, axle_inertia_x: of the axles with their wheels, at the axles' centers.
      arm: of the roll centers above the axles' centers [m].
      load: on the road at rest [N]; cruise_load: the same at constant speed.
      suspension, suspension_damping: of springs and bar in roll [N m/rad], [N m s/rad].
      tires, tires_damping: of each axle on its tires in roll [N m/rad], [N m s/rad].
      spin_inertia: of each axle's wheels about their axle [kg m2]; track, rolling_radius: [m].
      relaxation: lengths of the tires' side forces at the loads of the cruise [m].
      pressure_position: of the air's pressure center behind each unit's origin [m], shape (n,).
      pressure_height: of all of them [m].
      side_area: with its coefficient, of each unit [m2], shape (n,).
      air_density: [kg/m3].

    Attributes of axles have the shape (k,).
    """

    bodies: tuple[RollBody, ...]
    cg_height: FloatArray
    coupling_height: FloatArray
    coupling_stiffness: FloatArray
    coupling_damping: FloatArray
    axle_mass: FloatArray
    axle_height: FloatArray
    axle_inertia_x: FloatArray
    arm: FloatArray
    load: FloatArray
    cruise_load: FloatArray
    suspension: FloatArray
    suspension_damping: FloatArray
    tires: FloatArray
    tires_damping: FloatArray
    spin_inertia: FloatArray
    track: FloatArray
    rolling_radius: FloatArray
    relaxation: FloatArray
    pressure_position: FloatArray
    pressure_height: float
    side_area: FloatArray
    air_density: float

    @classmethod
    def from_parameters(
        cls, parameters: TruckParameters, payload: float, cruise_speed: float = 0.0
    ) -> RollData:
        """Computes the data of a truck.

        Args:
          parameters: of the truck.
          payload: of the combination [kg].
          cruise_speed: constant speed of the cruise loads [m/s].
        """
        p = parameters
        _, axles = axles_on_road(p, payload)
        down = [not axle.lifted(payload) for axle in p.axles]
        loads = static_axle_loads(p, payload)[down]
        cruise = cruise_axle_loads(p, payload, cruise_speed)[down]
        bodies = []
        for i, (unit, load) in enumerate(zip(p.units, payload_inertials(p, payload), strict=True)):
            parts = [sprung(p, unit, payload), *([load] if load else [])]
            # A lifted axle hangs on the chassis.
            parts += [
                axle_inertial(p, axle, wheel_height(p, axle, 0.0))
                for axle in unit.axles
                if axle.lifted(payload)
            ]
            bodies += [
                RollBody(i, part.mass, part.cg_position, part.cg_height, part.inertia_x)
                for part in parts
            ]
        heights = [wheel_height(p, axle, load) for axle, load in zip(axles, loads, strict=True)]
        rolling = [
            axle_inertial(p, axle, height) for axle, height in zip(axles, heights, strict=True)
        ]
        tires = [p.tires[axle.tire] for axle in axles]
        # Both sides: n k_z (s / 2)^2 each.
        squares = np.array([0.5 * t.count * a.track**2 for t, a in zip(tires, axles, strict=True)])
        half_squares = np.array([0.5 * axle.spring_spacing**2 for axle in axles])
        lead, *towed = p.units
        return cls(
            bodies=tuple(bodies),
            cg_height=np.array([body.cg_height for body in laden_units(p, payload)]),
            coupling_height=np.array([coupling.height for coupling in p.couplings]),
            coupling_stiffness=np.array([coupling.roll_stiffness for coupling in p.couplings]),
            coupling_damping=np.array([coupling.roll_damping for coupling in p.couplings]),
            axle_mass=np.array([body.mass for body in rolling]),
            axle_height=np.array(heights),
            axle_inertia_x=np.array([body.inertia_x for body in rolling]),
            arm=np.array([axle.roll_center_height for axle in axles]),
            load=loads,
            cruise_load=cruise,
            suspension=half_squares * [axle.spring_rate for axle in axles]
            + [axle.auxiliary_roll_stiffness for axle in axles],
            suspension_damping=half_squares * [axle.damping for axle in axles],
            tires=squares * [tire.vertical_stiffness for tire in tires],
            tires_damping=squares * [tire.vertical_damping for tire in tires],
            spin_inertia=np.array([2.0 * axle.wheel_inertia_spin for axle in axles]),
            track=np.array([axle.track for axle in axles]),
            rolling_radius=np.array([tire.rolling_radius for tire in tires]),
            relaxation=relaxation_lengths(p, axles, cruise),
            pressure_position=np.array(
                [
                    -lead.front_overhang,
                    *(0.5 * unit.length - unit.front_overhang for unit in towed),
                ]
            ),
            pressure_height=p.aerodynamics.pressure_height,
            side_area=p.aerodynamics.side_area * np.array(air_shares(p)),
            air_density=p.aerodynamics.density,
        )


def relaxation_lengths(
    parameters: TruckParameters, axles: Sequence[Axle], loads: FloatArray
) -> FloatArray:
    """Returns the lateral relaxation length of the axles' tires [m], (k,), at loads [N], (k,)."""
    common = parameters.tire_common
    tires = np.array([2 * parameters.tires[axle.tire].count for axle in axles])
    relative = loads / (tires * common.nominal_load)
    length = common.relaxation_lateral * relative**common.relaxation_load_exponent
    return np.asarray(np.maximum(SHORTEST_RELAXATION, length))


@dataclass(frozen=True)
class RollBodies:
    """Matrices of small motion, N = 1 + 2 n + k coordinates.

    Attributes:
      inertia: [kg, kg m, kg m2], shape (N, N); its first n + 1 rows and columns contain only
        the masses as points.
      stiffness, damping: shape (N, N).
      patches: lateral displacement of the contact patches by coordinate, shape (k, N).
      wheels: that of the axles' centers, shape (k, N).
      hitches: that of the couplings, shape (n - 1, N).
      pressure_centers: that of the air's pressure centers, shape (n, N).
      centers: that of the CGs of the laden units, shape (n, N).
    """

    inertia: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    patches: FloatArray
    wheels: FloatArray
    hitches: FloatArray
    pressure_centers: FloatArray
    centers: FloatArray


def roll_bodies(plane: YawPlane, data: RollData) -> RollBodies:
    """Returns the matrices of a combination."""
    units, axles = plane.units, len(plane.unit)
    first_roll, first_axle = 1 + units, 1 + 2 * units
    size = first_axle + axles
    inertia, stiffness, damping = (np.zeros((size, size)) for _ in range(3))

    def point(unit: int, position: float, height: float) -> FloatArray:
        row = np.zeros(size)
        row[:first_roll] = plane.row(unit, position)
        levels = np.array([0.0, *data.coupling_height[:unit], height])
        row[first_roll : first_roll + unit + 1] = -np.diff(levels)
        return row

    def add_mass(mass: float, row: FloatArray, roll: int, inertia_x: float) -> None:
        inertia[:] += mass * np.outer(row, row)
        inertia[roll, roll] += inertia_x

    def add_weight(weight: float, row: FloatArray) -> None:
        rolls = np.arange(first_roll, first_axle)
        stiffness[rolls, rolls] += weight * row[rolls]

    for body in data.bodies:
        row = point(body.unit, body.position, body.height)
        add_mass(body.mass, row, first_roll + body.unit, body.inertia_x)
        add_weight(body.mass * GRAVITY, row)
    for j in range(units - 1):
        ahead, behind = first_roll + j, first_roll + j + 1
        _couple(stiffness, behind, ahead, float(data.coupling_stiffness[j]))
        _couple(damping, behind, ahead, float(data.coupling_damping[j]))
    patches, wheels = [], []
    for i, unit in enumerate(plane.unit.tolist()):
        roll, alpha, arm = first_roll + unit, first_axle + i, float(data.arm[i])
        roll_center = float(data.axle_height[i]) + arm
        middle = point(unit, float(plane.position[i]), roll_center)
        patch = middle.copy()
        middle[alpha], patch[alpha] = arm, roll_center
        patches.append(patch)
        wheels.append(middle)
        add_mass(float(data.axle_mass[i]), middle, alpha, float(data.axle_inertia_x[i]))
        # The load on the tires acts against the axle's own weight.
        pull = float(data.axle_mass[i] * GRAVITY - data.load[i])
        add_weight(pull, middle)
        stiffness[alpha, alpha] += pull * arm + data.tires[i]
        damping[alpha, alpha] += data.tires_damping[i]
        _couple(stiffness, alpha, roll, float(data.suspension[i]))
        _couple(damping, alpha, roll, float(data.suspension_damping[i]))
    return RollBodies(
        inertia=inertia,
        stiffness=stiffness,
        damping=damping,
        patches=np.array(patches),
        wheels=np.array(wheels),
        hitches=np.array(
            [
                point(j, float(position), float(height))
                for j, (position, height) in enumerate(
                    zip(plane.couplings, data.coupling_height, strict=True)
                )
            ]
        ).reshape(units - 1, size),
        pressure_centers=np.array(
            [
                point(unit, float(position), data.pressure_height)
                for unit, position in enumerate(data.pressure_position)
            ]
        ),
        centers=np.array(
            [
                point(unit, float(position), float(height))
                for unit, (position, height) in enumerate(
                    zip(plane.cg, data.cg_height, strict=True)
                )
            ]
        ),
    )


def _couple(matrix: FloatArray, one: int, other: int, rate: float) -> None:
    """Adds the Hessian of `rate (q_one - q_other)^2 / 2`."""
    matrix[[one, other], [one, other]] += rate
    matrix[[one, other], [other, one]] -= rate
