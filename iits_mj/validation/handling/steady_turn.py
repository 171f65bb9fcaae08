"""Steady turn up to the limit, by planar statics with the full law of the tires.

Beyond the yaw-sideslip model it has exact angles; the Magic Formula of each tire up to saturation;
load transfer to the outer wheels from the roll plane, which gives them more rolling resistance; and
two forces at the fifth wheel that take load off the steer axle: the pull, which grows with the drag
of the turn, and the roll moment of the trailer, which at a hitch angle lifts the front of the
tractor. Without rolling resistance a gentle turn equals that of the yaw-sideslip model. All
parameters are those of the truck; nothing is fitted.

The unknowns are lateral velocity, hitch angle, road-wheel angle and drive force. The equations are
the balance of forces and yaw moment of the tractor, and the yaw moment of the trailer about the
kingpin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from iits_mj.analytic import YawPlane, cruise_axle_loads, static_axle_loads
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TireCommon, TruckParameters
from iits_mj.parameters.mass_state import air_shares, rolling_resistances
from iits_mj.parameters.tire_law import cornering_stiffness, friction, lateral_shape
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.validation.handling.roll_plane import Leaning, RollPlane

# Scale of forces in the equations [N].
_SCALE = 1e4


@dataclass(frozen=True)
class SteadyTurn:
    """Steady turns of the truck with a payload [kg]."""

    parameters: TruckParameters
    payload: float
    roll: RollPlane

    @classmethod
    def from_parameters(cls, parameters: TruckParameters, payload: float) -> SteadyTurn:
        """Steady turns of this truck."""
        return cls(parameters, payload, RollPlane.from_parameters(parameters, payload))

    def steer(self, radius: float, lateral: float) -> float:
        """Road-wheel angle [rad] of a turn; NaN beyond the limit of grip or of roll-over.

        The radius [m] is that of the steer axle's path, the lateral acceleration is in m/s2.
        """
        leaning = self.roll.level(lateral)
        if leaning is None:
            return float("nan")
        speed = math.sqrt(lateral * radius)
        model = YawPlane.from_parameters(self.parameters, self.payload, cruise_speed=speed)
        state = model.at(speed).steady_state()
        steer = speed / (radius * state[1])
        guess = np.array([state[0] * steer, state[3] * steer, steer, 0.0])
        state_of = _Balance(self, model, speed, speed / radius, leaning)
        found = optimize.root(state_of, guess, tol=1e-9)
        return float(found.x[2]) if found.success else float("nan")

    def axle_force(self, index: int, slip: float, load: float, transfer: float) -> float:
        """Lateral force of an axle [N] by slip angle [rad], load [N] and load transfer [1]."""
        axle, common = self.parameters.axles[index], self.parameters.tire_common
        tire = self.parameters.tires[axle.tire]
        total = 0.0
        for side in (1.0 - transfer, 1.0 + transfer):
            each = 0.5 * load * side / tire.count
            if each <= 0.0:
                continue
            most = float(friction(each, common.friction_lateral, common)) * each
            stretch = float(cornering_stiffness(each, tire, common)) * math.tan(slip) / most
            share = lateral_shape(stretch / common.shape_lateral, common)
            total += tire.count * most * float(share)
        return total


@dataclass(frozen=True)
class _Balance:
    """Residual of the equations at a speed [m/s] and yaw rate [rad/s], by the unknowns (4,)."""

    turn: SteadyTurn
    model: YawPlane
    speed: float
    rate: float
    leaning: Leaning

    def __call__(self, unknown: FloatArray) -> FloatArray:
        sideways, hitch, steer, drive = unknown
        model, v, rate = self.model, self.speed, self.rate
        p = self.turn.parameters
        resistance = self._resistance()
        loads = cruise_axle_loads(p, self.turn.payload, v)
        # Trailer, in its own frame: forces of its axles, then those at the kingpin.
        behind, center_arm = float(model.couplings[0] - model.reference), float(model.cg[1])
        masses, places = model.mass, model.position - model.reference * (model.unit == 0)
        at_hitch = sideways - behind * rate
        along = v * math.cos(hitch) - at_hitch * math.sin(hitch)
        across = v * math.sin(hitch) + at_hitch * math.cos(hitch)
        side = moment = 0.0
        first = int(np.sum(model.unit == 0))
        for i, arm in enumerate(places[first:].tolist(), start=first):
            slip = -math.atan((across - arm * rate) / along)
            force = self._force(i, slip, loads)
            side += force
            moment -= (arm + model.trail[i]) * force + self._drag_couple(i, loads)
        center = across - center_arm * rate
        pull = resistance[1] - masses[1] * rate * center
        lateral = masses[1] * rate * along - side
        about_hitch = moment + center_arm * masses[1] * rate * along
        # Tractor: forces at the kingpin in its frame, and the load transfer by them.
        back = -pull * math.cos(hitch) - lateral * math.sin(hitch)
        push = pull * math.sin(hitch) - lateral * math.cos(hitch)
        lifting = self.leaning.hitch_moment * math.sin(hitch)
        shift = ((-back - resistance[1]) * p.couplings[0].height + lifting) / model.wheelbase
        loads[0] -= shift
        loads[1:first] += shift / (first - 1)
        front = self._force(0, steer - math.atan((sideways - places[0] * rate) / v), loads)
        forward = drive * _SCALE + back - front * math.sin(steer) + masses[0] * rate * sideways
        left = push + front * math.cos(steer) - masses[0] * rate * v
        yaw = front * math.cos(steer) * -(places[0] + model.trail[0]) - behind * push
        for i, arm in enumerate(places[1:first].tolist(), start=1):
            force = self._force(i, -math.atan((sideways - arm * rate) / v), loads)
            left += force
            yaw -= (arm + model.trail[i]) * force
        yaw -= sum(self._drag_couple(i, loads) for i in range(first))
        return np.array([forward - resistance[0], left, yaw, about_hitch]) / _SCALE

    def _force(self, index: int, slip: float, loads: FloatArray) -> float:
        transfer = float(self.leaning.transfers[index])
        return self.turn.axle_force(index, slip, float(loads[index]), transfer)

    def _drag_couple(self, index: int, loads: FloatArray) -> float:
        """Yaw moment of an axle by the greater rolling resistance of its outer wheels [N m]."""
        p = self.turn.parameters
        gone = float(self.leaning.transfers[index] * loads[index])
        return 0.5 * p.axles[index].track * float(rolling_resistances(p, loads)[index]) * gone

    def _resistance(self) -> tuple[float, float]:
        """Drag plus rolling resistance of tractor and of trailer [N]."""
        p, payload = self.turn.parameters, self.turn.payload
        loads = cruise_axle_loads(p, payload, self.speed)
        rolling = rolling_resistances(p, loads) * loads
        drag = 0.5 * p.aerodynamics.density * p.aerodynamics.drag_area * self.speed**2
        share, first = air_shares(p)[0], len(p.lead.axles)
        return (
            float(rolling[:first].sum()) + share * drag,
            float(rolling[first:].sum()) + (1.0 - share) * drag,
        )


def grip_limit(parameters: TruckParameters, payload: float, surface: float) -> float:
    """Upper bound of the lateral acceleration [g]: every tire at its peak, with loads at rest.

    Load transfer to the outer tires, pull and drag reduce it.
    """
    loads = static_axle_loads(parameters, payload)
    best = [load * _friction(parameters, i, float(load), surface) for i, load in enumerate(loads)]
    return float(np.sum(best) / np.sum(loads))


def effort(
    parameters: TruckParameters, payload: float, surface: float, index: int, slip: FloatArray
) -> FloatArray:
    """Side force of an axle as a share of its greatest, 1 beyond the peak, shape (n,).

    Args:
      parameters: of the truck.
      payload: [kg].
      surface: friction of the road [1].
      index: of the axle, from the front.
      slip: angle [rad], shape (n,).
    """
    common = parameters.tire_common
    tire = parameters.tires[parameters.axles[index].tire]
    load = float(static_axle_loads(parameters, payload)[index])
    each = load / (2 * tire.count)
    most = each * _friction(parameters, index, load, surface)
    stiffness = float(cornering_stiffness(each, tire, common))
    stretch = np.tan(np.abs(slip)) * stiffness / (common.shape_lateral * most)
    stretch = np.minimum(stretch, _peak(common))
    return lateral_shape(stretch, common)


def _friction(parameters: TruckParameters, index: int, load: float, surface: float) -> float:
    """Peak friction [1] of the tires of an axle at the axle's load [N].

    The parameters hold on a surface of 0.8; the friction scales with that of the surface.
    """
    tire, common = parameters.tires[parameters.axles[index].tire], parameters.tire_common
    each = load / (2 * tire.count)
    return float(friction(each, common.friction_lateral, common)) * surface / DEFAULT_FRICTION


def _peak(common: TireCommon) -> float:
    """`B tan(alpha)` at which the Magic Formula peaks: `C atan(...) = 90 deg`, for C above 1."""
    wanted, curve = math.tan(0.5 * math.pi / common.shape_lateral), common.curvature_lateral
    found = optimize.brentq(lambda b: b - curve * (b - math.atan(b)) - wanted, 0.0, 10.0 * wanted)
    return float(found)
