"""Masses, springs and geometry of the truck as its units and axles roll: matrices of small motion.

Coordinates `q = [y_c, beta_c, beta_t, phi_c, phi_t, alpha_1 ... alpha_n]`: lateral position of the
point of the tractor's body that lies below its CG at the height of the road, yaw of tractor and
trailer, roll of their bodies, and roll of every axle; all absolute, roll positive to the right
(left side up). Straight running is symmetric, so that heave, pitch and speed do not occur in the
linear equations of these coordinates.

Lateral positions. A point of the tractor `x` ahead of its CG, and a point of the trailer `d` behind
the kingpin (fifth wheel at `L_h` behind the CG and height `h_f`), both at height `h`:

    y = y_c + x beta_c - h phi_c
    y = y_c - L_h beta_c - h_f phi_c - d beta_t - (h - h_f) phi_t

An axle turns about its roll center, which is fixed to the body at `h_r`, `e` above the axle's
center. Its center therefore moves by `e alpha` and its contact patches by `h_r alpha` more than the
roll center.

Inertia is the sum of `m J' J` over the masses and of their roll inertias. Stiffness is the Hessian
of the potential energy at rest:

    springs and bar of an axle   1/2 k_s (alpha - phi)^2,    k_s = k b^2 / 2 + k_aux
    its tires                    1/2 k_t alpha^2,            k_t = n k_z s^2 / 2 (n tires a side)
    fifth wheel                  1/2 k_f (phi_t - phi_c)^2
    weights and axle loads       sum of m g z - F_z z with z to second order: z = -h phi^2 / 2

where `b` is the spacing of the springs and `s` the track. The last line tips a body over its roll
centers and, through the kingpin's load, over the fifth wheel.

The axle with a roll center is that of Gillespie and MacAdam, "Constant Velocity Yaw/Roll Program",
UMTRI-82-39 (1982); the equations here are Lagrange's of the coordinates above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model.statics import axle_inertial, sprung, wheel_height
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import laden_units, payload_inertials, static_axle_loads

PHI_C, PHI_T, FIRST_AXLE = 3, 4, 5


@dataclass(frozen=True)
class RollBodies:
    """Matrices of small motion, `n` coordinates, `k` axles.

    Attributes:
      inertia: [kg, kg m, kg m2], shape (n, n); its first three rows and columns contain only
        the masses as points.
      stiffness, damping: shape (n, n).
      patches: lateral displacement of the contact patches by coordinate, shape (k, n).
      wheels: that of the axles' centers, shape (k, n).
      hitch: that of the fifth wheel, shape (n,).
      tire_roll, tire_roll_damping: of each axle on its tires [N m/rad], [N m s/rad], shape (k,).
      pressure_centers: that of the air's pressure centers of tractor and trailer, shape (2, n).
      centers: that of the CGs of tractor and laden trailer, shape (2, n).
      spin_inertia: of each axle's wheels about their axle [kg m2]; tracks, rolling_radii: [m].
    """

    inertia: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    patches: FloatArray
    wheels: FloatArray
    hitch: FloatArray
    tire_roll: FloatArray
    tire_roll_damping: FloatArray
    pressure_centers: FloatArray
    centers: FloatArray
    spin_inertia: FloatArray
    tracks: FloatArray
    rolling_radii: FloatArray


class _Geometry:
    """Rows of lateral displacement of points of the two units."""

    def __init__(self, parameters: TruckParameters) -> None:
        self.size = FIRST_AXLE + len(parameters.axles)
        self.origin = parameters.lead.cg_position
        self.coupling = parameters.couplings[0]

    def tractor(self, position: float, height: float) -> FloatArray:
        """Of a point [m] behind the steer axle."""
        row = np.zeros(self.size)
        row[[0, 1, PHI_C]] = 1.0, self.origin - position, -height
        return row

    def trailer(self, position: float, height: float) -> FloatArray:
        """Of a point [m] behind the kingpin."""
        row = self.tractor(self.coupling.position, self.coupling.height)
        row[[2, PHI_T]] = -position, -(height - self.coupling.height)
        return row


def roll_bodies(
    parameters: TruckParameters, payload: float, coupling: float, coupling_damping: float
) -> RollBodies:
    """The matrices of the truck with `payload` [kg].

    Args:
      parameters: of the truck.
      payload: on the semitrailer [kg].
      coupling: roll stiffness between the units [N m/rad].
      coupling_damping: its damping [N m s/rad].
    """
    geometry = _Geometry(parameters)
    size, p = geometry.size, parameters
    inertia, stiffness, damping = (np.zeros((size, size)) for _ in range(3))
    loads = static_axle_loads(p, payload)
    tractor, trailer = sprung(p, p.lead, payload), sprung(p, p.units[1], payload)
    cargo = payload_inertials(p, payload)[1]
    assert cargo is not None

    def add_mass(mass: float, row: FloatArray, roll: int, inertia_x: float) -> None:
        inertia[:] += mass * np.outer(row, row)
        inertia[roll, roll] += inertia_x

    def add_weight(weight: float, height: float, *, on_trailer: bool) -> None:
        if on_trailer:
            stiffness[PHI_C, PHI_C] -= weight * p.couplings[0].height
            stiffness[PHI_T, PHI_T] -= weight * (height - p.couplings[0].height)
        else:
            stiffness[PHI_C, PHI_C] -= weight * height

    add_mass(
        tractor.mass,
        geometry.tractor(tractor.cg_position, tractor.cg_height),
        PHI_C,
        tractor.inertia_x,
    )
    add_weight(tractor.mass * GRAVITY, tractor.cg_height, on_trailer=False)
    for body in (trailer, cargo):
        row = geometry.trailer(body.cg_position, body.cg_height)
        add_mass(body.mass, row, PHI_T, body.inertia_x)
        add_weight(body.mass * GRAVITY, body.cg_height, on_trailer=True)
    _couple(stiffness, PHI_T, PHI_C, coupling)
    _couple(damping, PHI_T, PHI_C, coupling_damping)

    tires = [p.tires[axle.tire] for axle in p.axles]
    # Both sides: n k_z (s / 2)^2 each.
    squares = np.array([0.5 * t.count * a.track**2 for t, a in zip(tires, p.axles, strict=True)])
    tire_roll = squares * [tire.vertical_stiffness for tire in tires]
    tire_roll_damping = squares * [tire.vertical_damping for tire in tires]
    patches, wheels = [], []
    for i, (axle, load) in enumerate(zip(p.axles, loads, strict=True)):
        on_trailer = i >= len(p.lead.axles)
        unit, alpha = PHI_T if on_trailer else PHI_C, FIRST_AXLE + i
        arm = axle.roll_center_height
        roll_center = wheel_height(p, axle, load) + arm
        point = geometry.trailer if on_trailer else geometry.tractor
        middle = point(axle.position, roll_center)
        patch = middle.copy()
        middle[alpha], patch[alpha] = arm, roll_center
        patches.append(patch)
        wheels.append(middle)
        body = axle_inertial(p, axle, roll_center - arm)
        add_mass(body.mass, middle, alpha, body.inertia_x)
        # The load on the tires acts against the axle's own weight.
        pull = axle.unsprung_mass * GRAVITY - load
        add_weight(pull, roll_center, on_trailer=on_trailer)
        stiffness[alpha, alpha] += pull * arm + tire_roll[i]
        damping[alpha, alpha] += tire_roll_damping[i]
        half_square = 0.5 * axle.spring_spacing**2
        rate = axle.spring_rate * half_square + axle.auxiliary_roll_stiffness
        _couple(stiffness, alpha, unit, rate)
        _couple(damping, alpha, unit, axle.damping * half_square)

    pressure_height = p.aerodynamics.pressure_height
    middle_of_body = 0.5 * p.units[1].length - p.units[1].front_overhang
    laden = laden_units(p, payload)[1]
    return RollBodies(
        inertia=inertia,
        stiffness=stiffness,
        damping=damping,
        patches=np.array(patches),
        wheels=np.array(wheels),
        hitch=geometry.trailer(0.0, p.couplings[0].height),
        tire_roll=tire_roll,
        tire_roll_damping=tire_roll_damping,
        pressure_centers=np.array(
            [
                geometry.tractor(-p.lead.front_overhang, pressure_height),
                geometry.trailer(middle_of_body, pressure_height),
            ]
        ),
        centers=np.array(
            [
                geometry.tractor(p.lead.cg_position, p.lead.cg_height),
                geometry.trailer(laden.cg_position, laden.cg_height),
            ]
        ),
        spin_inertia=np.array([2.0 * axle.wheel_inertia_spin for axle in p.axles]),
        tracks=np.array([axle.track for axle in p.axles]),
        rolling_radii=np.array([p.tires[axle.tire].rolling_radius for axle in p.axles]),
    )


def _couple(matrix: FloatArray, one: int, other: int, rate: float) -> None:
    """Adds the Hessian of `rate (q_one - q_other)^2 / 2`."""
    matrix[[one, other], [one, other]] += rate
    matrix[[one, other], [other, one]] -= rate
