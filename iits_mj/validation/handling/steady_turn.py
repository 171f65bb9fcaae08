"""ISO 14792, steady circle of 100 m from walking pace to its end, laden and empty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from iits_mj.analytic import YawSideslip, cruise_axle_loads
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.tire_law import cornering_stiffness, friction, lateral_shape
from iits_mj.validation.handling.roll_plane import Leaning, RollPlane

# --- Steady turn of the truck up to its limit, by planar statics with the tires' whole law ---
# What the yaw-sideslip model leaves out is put in: exact angles, each tire's Magic Formula up to
# saturation, load that moves to the outer wheels as the roll plane says and makes them roll harder,
# and what takes load off the steer axle at the fifth wheel: its pull, which grows with the drag of
# the turn, and the trailer's roll moment, which at a hitch angle lifts the tractor's nose. Without
# rolling resistance a gentle turn is that of the yaw-sideslip model. Parameters are the truck's;
# nothing is fitted.
#
# Unknown are lateral velocity, hitch angle, road-wheel angle and drive force; the equations are the
# tractor's balance of forces and yaw moment, and the trailer's yaw moment about the kingpin.

# Scale of forces in the equations [N].
_SCALE = 1e4


@dataclass(frozen=True)
class SteadyTurn:
    """The truck with its payload [kg], ready to be asked for steady states."""

    parameters: TruckParameters
    payload: float
    roll: RollPlane

    @classmethod
    def from_parameters(cls, parameters: TruckParameters, payload: float) -> SteadyTurn:
        """The steady turn of this truck."""
        return cls(parameters, payload, RollPlane.from_parameters(parameters, payload))

    def steer(self, radius: float, lateral: float) -> float:
        """Road-wheel angle [rad] that holds a turn; NaN beyond the limit of grip or of roll-over.

        Args:
          radius: of the steer axle's path [m].
          lateral: acceleration [m/s2].
        """
        leaning = self.roll.level(lateral)
        if leaning is None:
            return float("nan")
        speed = math.sqrt(lateral * radius)
        model = YawSideslip.from_parameters(self.parameters, self.payload, cruise_speed=speed)
        state = model.at(speed).steady_state()
        steer = speed / (radius * state[1])
        guess = np.array([state[0] * steer, state[3] * steer, steer, 0.0])
        state_of = _Balance(self, model, speed, speed / radius, leaning)
        found = optimize.root(state_of, guess, tol=1e-9)
        return float(found.x[2]) if found.success else float("nan")

    def axle_force(self, index: int, slip: float, load: float, transfer: float) -> float:
        """Lateral force of an axle [N] at a slip angle [rad], load [N], share gone outside [1]."""
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
    """The equations at one speed [m/s] and yaw rate [rad/s], as a function of the unknowns (4,)."""

    turn: SteadyTurn
    model: YawSideslip
    speed: float
    rate: float
    leaning: Leaning

    def __call__(self, unknown: FloatArray) -> FloatArray:
        sideways, hitch, steer, drive = unknown
        model, v, rate = self.model, self.speed, self.rate
        p = self.turn.parameters
        resistance = self._resistance()
        loads = cruise_axle_loads(p, self.turn.payload, v)
        # Trailer, in its own frame: its axles first, then what the kingpin must give it.
        at_hitch = sideways - model.L_h * rate
        along = v * math.cos(hitch) - at_hitch * math.sin(hitch)
        across = v * math.sin(hitch) + at_hitch * math.cos(hitch)
        side = moment = 0.0
        first = 1 + len(model.tractor_arms)
        for i, arm in enumerate(model.trailer_arms, start=first):
            slip = -math.atan((across - arm * rate) / along)
            force = self._force(i, slip, loads)
            side += force
            moment -= (arm + model.t_3) * force + self._drag_couple(i, loads)
        center = across - model.L_t1 * rate
        pull = resistance[1] - model.m_t * rate * center
        lateral = model.m_t * rate * along - side
        about_hitch = moment + model.L_t1 * model.m_t * rate * along
        # Tractor: the kingpin's forces turned into its frame, and the load that they shift.
        back = -pull * math.cos(hitch) - lateral * math.sin(hitch)
        push = pull * math.sin(hitch) - lateral * math.cos(hitch)
        lifting = self.leaning.hitch_moment * math.sin(hitch)
        shift = ((-back - resistance[1]) * p.fifth_wheel.height + lifting) / model.wheelbase
        loads[0] -= shift
        loads[1:first] += shift / (first - 1)
        front = self._force(0, steer - math.atan((sideways + model.L_c1 * rate) / v), loads)
        forward = drive * _SCALE + back - front * math.sin(steer) + model.m_c * rate * sideways
        left = push + front * math.cos(steer) - model.m_c * rate * v
        yaw = front * math.cos(steer) * (model.L_c1 - model.t_1) - model.L_h * push
        for i, arm in enumerate(model.tractor_arms, start=1):
            force = self._force(i, -math.atan((sideways - arm * rate) / v), loads)
            left += force
            yaw -= (arm + model.t_2) * force
        yaw -= sum(self._drag_couple(i, loads) for i in range(first))
        return np.array([forward - resistance[0], left, yaw, about_hitch]) / _SCALE

    def _force(self, index: int, slip: float, loads: FloatArray) -> float:
        transfer = float(self.leaning.transfers[index])
        return self.turn.axle_force(index, slip, float(loads[index]), transfer)

    def _drag_couple(self, index: int, loads: FloatArray) -> float:
        """Moment by which the loaded outer wheels of an axle roll harder than the inner [N m]."""
        p = self.turn.parameters
        gone = float(self.leaning.transfers[index] * loads[index])
        return 0.5 * p.axles[index].track * p.tire_common.rolling_resistance * gone

    def _resistance(self) -> tuple[float, float]:
        """Drag and rolling resistance of tractor and trailer [N]."""
        p, payload = self.turn.parameters, self.turn.payload
        loads = cruise_axle_loads(p, payload, self.speed)
        rolling = p.tire_common.rolling_resistance * loads
        drag = 0.5 * p.aerodynamics.density * p.aerodynamics.drag_area * self.speed**2
        share, first = p.aerodynamics.tractor_share, len(p.tractor.axles)
        return (
            float(rolling[:first].sum()) + share * drag,
            float(rolling[first:].sum()) + (1.0 - share) * drag,
        )
