"""Linear effect of the forces that keep the truck's speed on its lateral motion.

A force F along the heading of unit k acts at a point that roll moves aside by `y'_1 + ... + y'_k`,
where `y'_j` is what the roll of units and axles adds on unit j, up to its coupling. The work of F
on the coordinates of `roll_bodies` is

    Q_y = F beta_k,    Q_psi_j = -F y'_j - F (beta_j - beta_k) dx_j,

from its longitudinal displacement to second order, with `dx_j` the part of unit j in the row of the
point on the road. At constant speed all F sum up to zero, and with them the terms of a common
heading: what is left is that the resistance T of all units behind a coupling pulls along their own
headings, and steers the units ahead with `-T gamma` at the coupling. Drive and drag turn a rolling
body.

As an axle rolls by alpha on its tires (stiffness k_t, track s), its outer wheel carries more, and
rolling resistance f turns it out of the bend with -f k_t alpha. Its outer drive wheel has the
smaller radius at the same torque, which gives `F s^2 alpha / (12 r)`, as the rolling radius falls
by a third of the deflection. The resistance of steered wheels follows them: `-F delta`.

Drag and drive lift the motor vehicle's nose: its pitch p (nose down) tilts the axis of the first
coupling's yaw. The units' relative roll becomes `phi_2 - phi_1 + p gamma`, and a part of the
coupling's roll moment turns the motor vehicle. The pitch of towed units is neglected.

A driving or dragged tire has less side force: its lateral slip is relative to the speed of the
tread, hence `C / (1 + kappa)`, and combined slip (similarity method, Pacejka, Tire and
Vehicle Dynamics, section 4.3.1) bends cornering stiffness and pneumatic trail as the lateral slip
of the same normalized size `rho = |F_x| / (mu F_z)` would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.roll_bodies import RollBodies, RollData
from iits_mj.analytic.yaw_plane import YawPlane, axles_on_road
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TireCommon, TruckParameters
from iits_mj.parameters.mass_state import (
    air_shares,
    cruise_axle_loads,
    group_center,
    rolling_resistances,
)
from iits_mj.parameters.tire_law import friction, lateral_shape


@dataclass(frozen=True)
class Traction:
    """Generalized forces of N coordinates, and factors for the tires of k axles.

    Attributes:
      angle: by roll angles [N m/rad], rate: by their rates [N m s/rad], shape (N, N).
      articulation: by the articulations [N/rad], shape (N, units - 1).
      steer: by the road-wheel angle [N/rad], shape (N,).
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
    payload: float,
    plane: YawPlane,
    data: RollData,
    bodies: RollBodies,
    *,
    speed: float,
    roll: bool,
) -> Traction:
    """Returns the terms of drag, rolling resistance and drive at constant speed on a level road.

    Args:
      parameters: of the truck.
      payload: of the combination [kg].
      plane: of the same truck.
      data: of the same truck, with axle loads at this speed.
      bodies: for the geometry.
      speed: at which drag is taken [m/s].
      roll: False leaves the coordinates of roll out.
    """
    air, units, size = parameters.aerodynamics, plane.units, bodies.patches.shape[1]
    first_roll, first_axle = 1 + units, 1 + 2 * units
    _, axles = axles_on_road(parameters, payload)
    loads, common = data.cruise_load, parameters.tire_common
    area = air.mean_drag_area(speed) if speed > 0.0 else air.drag_area
    drags = 0.5 * air.density * area * speed**2 * np.array(air_shares(parameters))
    rolling = _rolling_resistances(parameters, payload, speed)
    resistance = rolling * loads
    driven = np.array([axle.driven for axle in axles])
    drive = (drags.sum() + resistance.sum()) / driven.sum() * driven
    axle_forces = drive - resistance
    angle, rate = np.zeros((size, size)), np.zeros((size, size))

    def aside(force: float, row: FloatArray, unit: int) -> None:
        rolls = first_roll + np.arange(unit + 1)
        angle[rolls - units, rolls] -= force * row[rolls]
        angle[1 + unit, first_axle:] -= force * row[first_axle:]

    for i, unit in enumerate(plane.unit.tolist()):
        aside(float(axle_forces[i]), bodies.wheels[i], unit)
        yaw, alpha = 1 + unit, first_axle + i
        angle[yaw, alpha] -= rolling[i] * data.tires[i]
        angle[yaw, alpha] += drive[i] * data.track[i] ** 2 / (12.0 * data.rolling_radius[i])
        rate[yaw, alpha] -= rolling[i] * data.tires_damping[i]
    for unit, drag in enumerate(drags):
        aside(float(-drag), bodies.pressure_centers[unit], unit)
    behind = [drags[j + 1 :].sum() + resistance[plane.unit > j].sum() for j in range(units - 1)]
    articulation = np.reshape(behind, (-1, 1)) * bodies.hitches
    if units > 1:
        tilt = data.coupling_stiffness[0] * lead_pitch(parameters, payload, loads - data.load)
        relative = np.zeros(size)
        relative[[first_roll, first_roll + 1]] = tilt, -tilt
        angle[1] += relative
        angle[2] -= relative
        articulation[0] += relative
    friction_x = [
        friction(
            load / (2 * parameters.tires[axle.tire].count), common.friction_longitudinal, common
        )
        for axle, load in zip(axles, loads, strict=True)
    ]
    rho = np.abs(axle_forces) / (np.array(friction_x) * loads)
    keep = slice(None) if roll else slice(first_roll)
    return Traction(
        angle=angle[keep, keep],
        rate=rate[keep, keep],
        articulation=articulation[:, keep].T,
        steer=-(resistance * plane.steer) @ bodies.patches[:, keep],
        cornering=side_share(common, rho) / (1.0 + axle_forces / (common.slip_stiffness * loads)),
        trail=_trail_share(rho),
    )


def _rolling_resistances(parameters: TruckParameters, payload: float, speed: float) -> FloatArray:
    """Rolling resistance over load of the axles on the road, shape (k,)."""
    found = rolling_resistances(parameters, cruise_axle_loads(parameters, payload, speed))
    return found[[not axle.lifted(payload) for axle in parameters.axles]]


def lead_pitch(parameters: TruckParameters, payload: float, load_changes: FloatArray) -> float:
    """Returns the pitch [rad], nose down, of the motor vehicle when its axle loads change.

    Args:
      parameters: of the truck.
      payload: of the combination [kg].
      load_changes: of the axles on the road [N], front to rear; those of towed units are ignored.
    """
    front, rear = parameters.lead.groups(payload)
    rises = []
    for axle, change in zip((*front, *rear), load_changes, strict=False):
        tire = parameters.tires[axle.tire]
        compliance = 0.5 / axle.spring_rate + 0.5 / (tire.count * tire.vertical_stiffness)
        rises.append(-compliance * float(change))
    steered = len(front)
    rise = float(np.mean(rises[steered:]) - np.mean(rises[:steered]))
    return rise / (group_center(rear) - group_center(front))


def side_share(common: TireCommon, rho: FloatArray) -> FloatArray:
    """Returns side force over its initial slope times slip at normalized slip rho, any shape."""
    rho = np.maximum(rho, 1e-6)
    return np.asarray(lateral_shape(rho / common.shape_lateral, common) / rho)


def _trail_share(rho: FloatArray) -> FloatArray:
    """Pneumatic trail of the brush model over that at no slip, at normalized slip rho."""
    slide = np.minimum(1.0, rho / 3.0)
    return np.asarray((1.0 - slide) ** 3 / (1.0 - slide + slide**2 / 3.0))
