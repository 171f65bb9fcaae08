"""Linear effect of the forces that keep the truck's speed on its lateral motion.

A force F along the heading of its unit acts at a point that roll moves aside by `y'` (relative to
the tractor's body at the road, or to the kingpin). Its work on the coordinates of `roll_bodies` is

    on the tractor:  Q_y = F beta_c,   Q_beta_c = -F y'
    on the trailer:  Q = -F gamma on the kingpin's displacement,  Q_beta_t = -F y'_t,
                     Q_beta_c = -F y'_kingpin,   next to F beta_c as on the tractor

from its longitudinal displacement to second order, `x = -x_0 beta^2 / 2 - y' beta`. At constant
speed all F sum up to zero, and with them the terms `F beta_c`. So the trailer's resistance T steers
the tractor with T gamma at the fifth wheel, and drive and drag turn a rolling body.

As an axle rolls by alpha on its tires (stiffness k_t, track s), its outer wheel carries more, and
rolling resistance f turns it out of the bend with -f k_t alpha. Its outer drive wheel has the
smaller radius at the same torque, which gives `F s^2 alpha / (12 r)`, as the rolling radius falls
by a third of the deflection. The steer axle's resistance follows the road wheels: `-F delta`.

Drag and drive lift the tractor's nose: its pitch p (nose down) tilts the axis of the hitch's yaw.
The units' relative roll becomes `phi_t - phi_c + p gamma`, and a part of the fifth wheel's roll
moment turns the tractor.

A driving or dragged tire has less side force: its lateral slip is relative to the speed of the
tread, hence `C / (1 + kappa)`, and combined slip (similarity method, Pacejka, Tire and
Vehicle Dynamics, section 4.3.1) bends cornering stiffness and pneumatic trail as the lateral slip
of the same normalized size `rho = |F_x| / (mu F_z)` would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.roll_bodies import FIRST_AXLE, PHI_C, PHI_T, RollBodies
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TireCommon, TruckParameters
from iits_mj.parameters.mass_state import air_shares, group_center, rolling_resistances
from iits_mj.parameters.tire_law import friction, lateral_shape


@dataclass(frozen=True)
class Traction:
    """Generalized forces of `n` coordinates, and factors for the tires of `k` axles.

    Attributes:
      angle: by roll angles [N m/rad], rate: by their rates [N m s/rad], shape (n, n).
      articulation: by the hitch angle [N/rad]; steer: by the road-wheel angle [N/rad], shape (n,).
      cornering, trail: factors of cornering stiffness and pneumatic trail, shape (k,).
    """

    angle: FloatArray
    rate: FloatArray
    articulation: FloatArray
    steer: FloatArray
    cornering: FloatArray
    trail: FloatArray


def traction_forces(
    parameters: TruckParameters,
    bodies: RollBodies,
    *,
    rest_loads: FloatArray,
    loads: FloatArray,
    speed: float,
    coupling: float,
    roll: bool,
) -> Traction:
    """Returns the terms of drag, rolling resistance and drive at constant speed on a level road.

    Args:
      parameters: of the truck.
      bodies: for the geometry.
      rest_loads: on the axles at rest [N], shape (k,).
      loads: on the axles at this speed [N], shape (k,).
      speed: at which drag is taken [m/s].
      coupling: roll stiffness of the fifth wheel [N m/rad].
      roll: False leaves the coordinates of roll out (n = 3).
    """
    air, axles = parameters.aerodynamics, parameters.axles
    on_tractor, size = len(parameters.lead.axles), bodies.patches.shape[1]
    drag = 0.5 * air.density * air.drag_area * speed**2
    drags = drag * np.array(air_shares(parameters))
    common = parameters.tire_common
    rolling = rolling_resistances(parameters, loads)
    resistance = rolling * loads
    driven = np.array([axle.driven for axle in axles])
    drive = (drag + resistance.sum()) / driven.sum() * driven
    axle_forces = drive - resistance
    angle, rate = np.zeros((size, size)), np.zeros((size, size))

    def aside(force: float, row: FloatArray, *, on_trailer: bool) -> None:
        kingpin = _roll_part(bodies.hitch)
        if on_trailer:
            angle[2] -= force * (_roll_part(row) - kingpin)
            angle[1] -= force * kingpin
        else:
            angle[1] -= force * _roll_part(row)

    for i, force in enumerate(axle_forces):
        on_trailer, alpha = i >= on_tractor, FIRST_AXLE + i
        aside(float(force), bodies.wheels[i], on_trailer=on_trailer)
        unit = 2 if on_trailer else 1
        angle[unit, alpha] -= rolling[i] * bodies.tire_roll[i]
        angle[unit, alpha] += drive[i] * bodies.tracks[i] ** 2 / (12.0 * bodies.rolling_radii[i])
        rate[unit, alpha] -= rolling[i] * bodies.tire_roll_damping[i]
    for i in range(2):
        aside(float(-drags[i]), bodies.pressure_centers[i], on_trailer=i == 1)
    friction_x = [
        friction(
            load / (2 * parameters.tires[axle.tire].count), common.friction_longitudinal, common
        )
        for axle, load in zip(axles, loads, strict=True)
    ]
    rho = np.abs(axle_forces) / (np.array(friction_x) * loads)
    articulation = (drags[1] + resistance[on_tractor:].sum()) * bodies.hitch
    tilt = coupling * tractor_pitch(parameters, loads - rest_loads)
    angle[1, [PHI_C, PHI_T]] += tilt, -tilt
    angle[2, [PHI_C, PHI_T]] -= tilt, -tilt
    articulation[[PHI_C, PHI_T]] += tilt, -tilt
    keep = slice(None) if roll else slice(3)
    return Traction(
        angle=angle[keep, keep],
        rate=rate[keep, keep],
        articulation=articulation[keep],
        steer=-resistance[0] * bodies.patches[0][keep],
        cornering=_side_share(common, rho) / (1.0 + axle_forces / (common.slip_stiffness * loads)),
        trail=_trail_share(rho),
    )


def tractor_pitch(parameters: TruckParameters, load_changes: FloatArray) -> float:
    """Pitch [rad], nose down, of the tractor when its axle loads change [N], shape (k,)."""
    tractor = parameters.lead
    rises = []
    for axle, change in zip(tractor.axles, load_changes[: len(tractor.axles)], strict=True):
        tire = parameters.tires[axle.tire]
        compliance = 0.5 / axle.spring_rate + 0.5 / (tire.count * tire.vertical_stiffness)
        rises.append(-compliance * float(change))
    front, *drive = tractor.axles
    return (float(np.mean(rises[1:])) - rises[0]) / (group_center(drive) - front.position)


def _side_share(common: TireCommon, rho: FloatArray) -> FloatArray:
    """Magic Formula over its initial slope at normalized slip rho, any shape."""
    rho = np.maximum(rho, 1e-6)
    return np.asarray(lateral_shape(rho / common.shape_lateral, common) / rho)


def _trail_share(rho: FloatArray) -> FloatArray:
    """Pneumatic trail of the brush model over that at no slip, at normalized slip rho."""
    slide = np.minimum(1.0, rho / 3.0)
    return np.asarray((1.0 - slide) ** 3 / (1.0 - slide + slide**2 / 3.0))


def _roll_part(row: FloatArray) -> FloatArray:
    part = row.copy()
    part[:3] = 0.0
    return part
