"""Static roll-over threshold of the compliant truck, by statics in the roll plane.

Two sprung bodies, coupled in roll by the fifth wheel, rest on axles that roll on their tires. On a
table tilted by phi, the tires of an axle give the moment `M_t = min(K_t phi_u, W T cos(phi) / 2)`,
the second after the inner wheels have lifted. With the suspension's `M_s = K_s (phi_b - phi_u)`,

    axle:    M_t = M_s + (n h_rc + m_u g h_u) (sin phi + phi_u cos phi) + W cos phi y
    body:    sum M_s + M_5 = sum n (h - h_rc) (sin phi + phi_b cos phi),

about the center of the track and about the roll centers. n is the sprung weight on a support, h its
height, and `y = W sin phi sigma / C` the lateral deflection of the carcass (sigma: relaxation
length, C: cornering stiffness). The kingpin is a support of the trailer and a load of the tractor.
The threshold is the tilt at which this equilibrium becomes unstable, or at which the upper wheels
of all axles but the steer axle have lifted. The parameters are those of the truck.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from iits_mj.analytic import (
    axle_cornering_stiffness,
    coupling_loads,
    laden_units,
    static_axle_loads,
)
from iits_mj.analytic.roll_bodies import relaxation_lengths
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import Coupling, TruckParameters

_STEP = math.radians(0.02)
_LIMIT = math.radians(60.0)


@dataclass(frozen=True)
class Pull:
    """Acceleration of every mass as shares of g: to the side, and towards the ground."""

    side: float
    down: float = 1.0

    @classmethod
    def tilted(cls, tilt: float) -> Pull:
        """On a table tilted by an angle [rad]."""
        return cls(math.sin(tilt), math.cos(tilt))


@dataclass(frozen=True)
class _Support:
    """An axle: stiffnesses [N m/rad], loads [N], heights [m], compliance of the carcass [m/N]."""

    suspension: float
    tire: float
    load: float
    sprung: float
    track: float
    roll_center: float
    height: float
    carcass: float

    def moment(self, body: float, pull: Pull) -> float:
        """Moment of the suspension on a body that rolls by `body` [N m]."""
        return self.suspension * (body - self._rolls(body, pull)[0])

    def transfer(self, body: float, pull: Pull) -> float:
        """Load transfer to the outer wheels [1]; 1 after the inner wheels have lifted."""
        roll, lifted = self._rolls(body, pull)
        return 1.0 if lifted else 2.0 * self.tire * roll / (self.load * self.track * pull.down)

    def _rolls(self, body: float, pull: Pull) -> tuple[float, bool]:
        """Roll of the axle [rad], and whether its inner wheels have lifted."""
        arm = self.sprung * self.roll_center + (self.load - self.sprung) * self.height
        push, lean = arm * pull.side, arm * pull.down
        # The side force deflects the tires and shifts the load's point of action.
        push += self.load * pull.down * self.load * pull.side * self.carcass
        roll = (self.suspension * body + push) / (self.tire + self.suspension - lean)
        most = 0.5 * self.load * self.track * pull.down
        if self.tire * roll <= most:
            return roll, False
        return (self.suspension * body + push - most) / (self.suspension - lean), True


@dataclass(frozen=True)
class Leaning:
    """Roll equilibrium of the truck in a turn.

    Attributes:
      transfers: load transfer of each axle, see `_Support.transfer`, shape (k,).
      hitch_moment: roll moment that the trailer puts on the tractor [N m].
    """

    transfers: FloatArray
    hitch_moment: float


@dataclass(frozen=True)
class RollPlane:
    """The combination in the roll plane.

    Attributes:
      tractor, trailer: supports of the two bodies.
      tractor_height, trailer_height: of the sprung weights that they carry [m].
      kingpin: load [N]; fifth_wheel: of the truck.
    """

    tractor: tuple[_Support, ...]
    trailer: tuple[_Support, ...]
    tractor_height: float
    trailer_height: float
    kingpin: float
    fifth_wheel: Coupling

    @classmethod
    def from_parameters(cls, parameters: TruckParameters, payload: float) -> RollPlane:
        """The roll plane of a truck with this payload [kg]."""
        trailer, king = laden_units(parameters, payload)[1], coupling_loads(parameters, payload)[0]
        loads = static_axle_loads(parameters, payload)
        supports = []
        lag = relaxation_lengths(parameters, parameters.axles, loads)
        bend = lag / axle_cornering_stiffness(parameters, loads)
        for axle, load, carcass in zip(parameters.axles, loads, bend, strict=True):
            tire = parameters.tires[axle.tire]
            stiffness = tire.count * tire.vertical_stiffness
            height = tire.free_radius - 0.5 * load / stiffness
            supports.append(
                _Support(
                    0.5 * axle.spring_rate * axle.spring_spacing**2 + axle.auxiliary_roll_stiffness,
                    0.5 * stiffness * axle.track**2,
                    float(load),
                    float(load - axle.unsprung_mass * GRAVITY),
                    axle.track,
                    height + axle.roll_center_height,
                    height,
                    float(carcass),
                )
            )
        split = len(parameters.lead.axles)
        front, rear = tuple(supports[:split]), tuple(supports[split:])
        own = _sprung(parameters.lead.mass, parameters.lead.cg_height, front, king)
        above = _sprung(trailer.mass, trailer.cg_height, rear, -king)
        fifth = parameters.couplings[0]
        # The tractor carries its own sprung weight and the kingpin's load at the plate.
        height = (own[0] * own[1] + king * fifth.height) / (own[0] + king)
        return cls(front, rear, height, above[1], king, fifth)

    def coupling(self, twist: float) -> float:
        """Moment of the fifth wheel at a roll of the trailer against the tractor [N m]."""
        stiffness, angle = self.fifth_wheel.roll_stiffness, abs(twist)
        lift = 0.5 * self.fifth_wheel.plate_width * self.kingpin
        beyond = stiffness * (angle - self.fifth_wheel.roll_lash)
        moment = min(stiffness * angle, max(lift, beyond))
        return math.copysign(moment, twist)

    def residual(self, rolls: FloatArray, pull: Pull) -> FloatArray:
        """Restoring less overturning moment of tractor and trailer [N m], shape (2,)."""
        tractor, trailer = rolls
        hitch = self.coupling(trailer - tractor)
        restoring = [-hitch, hitch]
        for i, (supports, body, height) in enumerate(
            (
                (self.tractor, tractor, self.tractor_height),
                (self.trailer, trailer, self.trailer_height),
            )
        ):
            lean = pull.side + body * pull.down
            for support in supports:
                restoring[i] += support.moment(body, pull)
                restoring[i] -= support.sprung * (height - support.roll_center) * lean
        lean = pull.side + trailer * pull.down
        restoring[1] -= self.kingpin * (self.trailer_height - self.fifth_wheel.height) * lean
        return np.array(restoring)

    def threshold(self) -> float:
        """Tangent of the greatest tilt at which the truck stays upright [g]."""
        tilt, rolls = 0.0, np.zeros(2)
        while tilt < _LIMIT:
            next_rolls = self._settle(rolls, Pull.tilted(tilt + _STEP))
            if next_rolls is None:
                break
            tilt, rolls = tilt + _STEP, next_rolls
        return math.tan(tilt)

    def level(self, lateral: float) -> Leaning | None:
        """The truck in a turn on a level road; None if it tips over.

        The lateral acceleration [m/s2] is zero or positive.
        """
        rolls: FloatArray | None = np.zeros(2)
        for side in np.linspace(0.0, lateral / GRAVITY, 20 + round(lateral / 0.02)):
            if rolls is not None:
                rolls = self._settle(rolls, Pull(float(side)))
        if rolls is None:
            return None
        pull = Pull(lateral / GRAVITY)
        units = ((self.tractor, rolls[0]), (self.trailer, rolls[1]))
        transfers = [s.transfer(body, pull) for supports, body in units for s in supports]
        return Leaning(np.array(transfers), self.coupling(float(rolls[1] - rolls[0])))

    def _settle(self, rolls: FloatArray, pull: Pull) -> FloatArray | None:
        """Rolls in equilibrium near other rolls [rad], (2,); None if the truck tips over."""

        def scaled(trial: FloatArray) -> FloatArray:
            return self.residual(trial, pull) / self.kingpin

        found = optimize.root(scaled, rolls, tol=1e-9)
        if not found.success or np.max(np.abs(found.x - rolls)) > 0.02:
            return None
        units = ((self.tractor[1:], found.x[0]), (self.trailer, found.x[1]))
        if all(s.transfer(body, pull) == 1.0 for supports, body in units for s in supports):
            return None
        return np.asarray(found.x) if self._stable(found.x, pull) else None

    def _stable(self, rolls: FloatArray, pull: Pull) -> bool:
        """Returns whether the symmetric part of the residual's slope is positive definite."""
        small = 1e-7
        base = self.residual(rolls, pull)
        slope = np.column_stack(
            [(self.residual(rolls + small * unit, pull) - base) / small for unit in np.eye(2)]
        )
        return bool(np.linalg.eigvalsh(0.5 * (slope + slope.T))[0] > 0.0)


def _sprung(
    mass: float, height: float, supports: tuple[_Support, ...], extra: float
) -> tuple[float, float]:
    """Sprung weight of a unit [N] and its height [m]: the unit less its axles."""
    weight = mass * GRAVITY
    unsprung = [support.load - support.sprung for support in supports]
    moment = weight * height - sum(
        own * support.height for own, support in zip(unsprung, supports, strict=True)
    )
    sprung = weight - sum(unsprung)
    carried = sum(support.sprung for support in supports) - extra
    assert abs(carried - sprung) < 1e-6 * weight, "the axle loads do not carry the weight"
    return sprung, moment / sprung
