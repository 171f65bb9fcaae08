"""Steady turn up to the limit, by planar statics with the full law of the tires.

Beyond the yaw-sideslip model it has exact angles; the Magic Formula of each tire up to saturation;
load transfer to the outer wheels from the roll plane, which gives them more rolling resistance;
and two forces at the first coupling that take load off the steer axle: the pull, which grows with
the drag of the turn, and the roll moment of the first towed unit, which at a hitch angle lifts the
front of the motor vehicle. The axle loads of towed units are those of straight driving. Without
rolling resistance a gentle turn equals that of the yaw-sideslip model. All parameters are those of
the truck; nothing is fitted.

The unknowns are lateral velocity, hitch angles, road-wheel angle and drive force. The equations are
the balance of forces and yaw moment of the motor vehicle, and the yaw moment of each towed unit
about its coupling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from iits_mj.analytic import YawPlane, cruise_axle_loads, static_axle_loads
from iits_mj.analytic.yaw_plane import axles_on_road
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import Axle, TireCommon, TruckParameters
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
        hitches = state[1 + model.units :] * steer
        guess = np.array([state[0] * steer, *hitches, steer, 0.0])
        balance = _Balance.of(self, model, speed, speed / radius, leaning)
        found = optimize.root(balance, guess, tol=1e-9)
        return float(found.x[-2]) if found.success else float("nan")

    def axle_force(self, axle: Axle, slip: float, load: float, transfer: float) -> float:
        """Lateral force of an axle [N] by slip angle [rad], load [N] and load transfer [1]."""
        common = self.parameters.tire_common
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
    """Residual of the equations at a speed [m/s] and yaw rate [rad/s], by the unknowns (n + 2,).

    Attributes:
      turn, model: of the truck; leaning: its roll in this turn.
      axles: on the road; loads: of them on a straight road [N], shape (k,).
      rolling: resistances over load, shape (k,); resistance: with drag, of the units [N], (n,).
    """

    turn: SteadyTurn
    model: YawPlane
    speed: float
    rate: float
    leaning: Leaning
    axles: tuple[Axle, ...]
    loads: FloatArray
    rolling: FloatArray
    resistance: FloatArray

    @classmethod
    def of(
        cls, turn: SteadyTurn, model: YawPlane, speed: float, rate: float, leaning: Leaning
    ) -> _Balance:
        """Returns the balance with what does not depend on the unknowns."""
        p, payload = turn.parameters, turn.payload
        every = cruise_axle_loads(p, payload, speed)
        down = [not axle.lifted(payload) for axle in p.axles]
        loads, rolling = every[down], rolling_resistances(p, every)[down]
        air = p.aerodynamics
        drag = 0.5 * air.density * air.mean_drag_area(speed) * speed**2
        resistance = drag * np.array(air_shares(p))
        np.add.at(resistance, model.unit, rolling * loads)
        _, axles = axles_on_road(p, payload)
        return cls(turn, model, speed, rate, leaning, axles, loads, rolling, resistance)

    def __call__(self, unknown: FloatArray) -> FloatArray:
        sideways, *hitches, steer, drive = unknown.tolist()
        model, rate, loads = self.model, self.rate, self.loads.copy()
        # Of each unit, from its reference (lead unit) or coupling: distances, then velocities.
        origin = np.array([model.reference, *np.zeros(model.units - 1)])
        hitch_arms, center_arms = model.couplings - origin[:-1], model.cg - origin
        along, across = [self.speed], [sideways]
        for bend, arm in zip(hitches, hitch_arms.tolist(), strict=True):
            at_hitch, sine, cosine = across[-1] - arm * rate, math.sin(bend), math.cos(bend)
            ahead = along[-1]
            along.append(ahead * cosine - at_hitch * sine)
            across.append(ahead * sine + at_hitch * cosine)
        # Forces of the unit behind on a unit, in the frame of that unit.
        back = push = 0.0
        turning = []
        for unit in range(model.units - 1, 0, -1):
            side, moment, _ = self._axle_forces(unit, along[unit], across[unit], 0.0, loads)
            center = float(center_arms[unit])
            inertia = float(model.mass[unit]) * rate
            pull = float(self.resistance[unit]) - back
            pull -= inertia * (across[unit] - center * rate)
            lateral = inertia * along[unit] - side - push
            if unit < model.units - 1:
                moment -= float(hitch_arms[unit]) * push
            turning.append(moment + center * inertia * along[unit])
            sine, cosine = math.sin(hitches[unit - 1]), math.cos(hitches[unit - 1])
            back, push = -pull * cosine - lateral * sine, pull * sine - lateral * cosine
        if hitches:
            # The first coupling shifts load between the axles of the motor vehicle.
            p, front = self.turn.parameters, int(np.sum(model.steer[model.unit == 0] != 0.0))
            first = int(np.sum(model.unit == 0))
            lifting = self.leaning.hitch_moment * math.sin(hitches[0])
            gain = (-back - float(self.resistance[1:].sum())) * p.couplings[0].height
            shift = (gain + lifting) / model.wheelbase
            loads[:front] -= shift / front
            loads[front:first] += shift / (first - front)
        side, yaw, dragged = self._axle_forces(0, self.speed, sideways, steer, loads)
        inertia = float(model.mass[0]) * rate
        forward = drive * _SCALE + back - dragged + inertia * sideways - float(self.resistance[0])
        left = push + side - inertia * self.speed
        if hitches:
            yaw -= float(hitch_arms[0]) * push
        return np.array([forward, left, yaw, *turning]) / _SCALE

    def _axle_forces(
        self, unit: int, along: float, across: float, steer: float, loads: FloatArray
    ) -> tuple[float, float, float]:
        """Side force [N], yaw moment [N m] and drag of steered axles [N] of a unit.

        About its reference or coupling, where its velocity is `along`, `across` [m/s].
        """
        model = self.model
        side = moment = dragged = 0.0
        for i in np.flatnonzero(model.unit == unit).tolist():
            arm = float(model.position[i]) - (model.reference if unit == 0 else 0.0)
            turned = steer * float(model.steer[i])
            slip = turned - math.atan((across - arm * self.rate) / along)
            transfer, load = float(self.leaning.transfers[i]), float(loads[i])
            force = self.turn.axle_force(self.axles[i], slip, load, transfer)
            side += force * math.cos(turned)
            dragged += force * math.sin(turned)
            moment -= (arm + float(model.trail[i])) * force * math.cos(turned)
            # The outer wheels roll harder.
            moment -= 0.5 * self.axles[i].track * float(self.rolling[i]) * transfer * load
        return side, moment, dragged


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
