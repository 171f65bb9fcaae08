"""Static roll-over threshold of the compliant truck, by statics in the roll plane.

The sprung bodies of the units, coupled in roll, rest on axles that roll on their tires. On a table
tilted by phi, the tires of an axle give the moment `M_t = min(K_t phi_u, W T cos(phi) / 2)`,
the second after the inner wheels have lifted. With the suspension's `M_s = K_s (phi_b - phi_u)`,

    axle:    M_t = M_s + (n h_rc + m_u g h_u) (sin phi + phi_u cos phi) + W cos phi y
    body:    sum M_s + M_c = sum n (h - h_rc) (sin phi + phi_b cos phi),

about the center of the track and about the roll centers. n is the sprung weight on a support, h its
height, and `y = W sin phi sigma / C` the lateral deflection of the carcass (sigma: relaxation
length, C: cornering stiffness). M_c are the roll moments of the couplings. A coupling is a support
of the unit behind it and a load of the unit ahead. The threshold is the tilt at which this
equilibrium becomes unstable, or at which the upper wheels of all axles but the steer axles have
lifted, in the whole combination or in units that no coupling holds in roll (drawbar, pintle). The
parameters are those of the truck.
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
from iits_mj.analytic.yaw_plane import axles_on_road
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import Coupling, TruckParameters

_STEP = math.radians(0.02)
_LIMIT = math.radians(60.0)
# Change of roll in a step [rad] that the solver may find, and that of a falling truck.
_SMALL, _FALLING = 0.02, 0.15
# Largest scaled moment of an equilibrium; the creep to one: greatest steps, and their size [rad].
_SOLVED, _CREEPS, _RESTING = 1e-8, 3000, 1e-8


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
class _Body:
    """A unit without its axles.

    Attributes:
      supports: its axles on the road; steered: number of them that are steered axles in front.
      height: of the sprung weights that they carry [m].
      load: on its own coupling [N]; coupling: None for the motor vehicle.
    """

    supports: tuple[_Support, ...]
    steered: int
    height: float
    load: float
    coupling: Coupling | None

    def restoring(self, roll: float, pull: Pull) -> float:
        """Restoring less overturning moment of axles and weights [N m] at a roll [rad]."""
        lean = pull.side + roll * pull.down
        moment = 0.0
        for support in self.supports:
            moment += support.moment(roll, pull)
            moment -= support.sprung * (self.height - support.roll_center) * lean
        if self.coupling is not None:
            moment -= self.load * (self.height - self.coupling.height) * lean
        return moment

    def hitch(self, twist: float) -> float:
        """Moment of its coupling at a roll against the unit ahead [N m]."""
        if self.coupling is None:
            return 0.0
        stiffness, angle = self.coupling.roll_stiffness, abs(twist)
        lift = 0.5 * self.coupling.plate_width * self.load
        beyond = stiffness * (angle - self.coupling.roll_lash)
        return math.copysign(min(stiffness * angle, max(lift, beyond)), twist)

    def lifted(self, roll: float, pull: Pull) -> bool:
        """Returns whether the inner wheels of all axles but the steer axles have lifted."""
        return all(s.transfer(roll, pull) == 1.0 for s in self.supports[self.steered :])


@dataclass(frozen=True)
class Leaning:
    """Roll equilibrium of the truck in a turn.

    Attributes:
      transfers: load transfer of each axle on the road, see `_Support.transfer`, shape (k,).
      hitch_moment: roll moment that the first towed unit puts on the motor vehicle [N m].
    """

    transfers: FloatArray
    hitch_moment: float


@dataclass(frozen=True)
class RollPlane:
    """The combination in the roll plane: its bodies, front to rear."""

    bodies: tuple[_Body, ...]

    @classmethod
    def from_parameters(cls, parameters: TruckParameters, payload: float) -> RollPlane:
        """The roll plane of a truck with this payload [kg]."""
        units, axles = axles_on_road(parameters, payload)
        loads = static_axle_loads(parameters, payload)
        lag = relaxation_lengths(parameters, parameters.axles, loads)
        down = [not axle.lifted(payload) for axle in parameters.axles]
        bend = lag[down] / axle_cornering_stiffness(parameters, loads)[down]
        supports = []
        for axle, load, carcass in zip(axles, loads[down], bend, strict=True):
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
        # Of each unit: load on its own coupling, and load and height of the coupling that it bears.
        own = (0.0, *coupling_loads(parameters, payload))
        borne = (*own[1:], 0.0)
        plates = (*(coupling.height for coupling in parameters.couplings), 0.0)
        bodies = []
        for index, (unit, laden) in enumerate(
            zip(parameters.units, laden_units(parameters, payload), strict=True)
        ):
            mine = tuple(s for s, of in zip(supports, units, strict=True) if of == index)
            weight, height = _sprung(laden.mass, laden.cg_height, mine, borne[index] - own[index])
            height = (weight * height + borne[index] * plates[index]) / (weight + borne[index])
            steered = 0 if unit.coupling else len(unit.groups(payload)[0])
            bodies.append(_Body(mine, steered, height, own[index], unit.coupling))
        return cls(tuple(bodies))

    def residual(self, rolls: FloatArray, pull: Pull) -> FloatArray:
        """Restoring less overturning moment of the bodies [N m], shape (n,)."""
        found = np.array(
            [body.restoring(roll, pull) for body, roll in zip(self.bodies, rolls, strict=True)]
        )
        hitch = self._hitches(rolls)
        found[:-1] -= hitch
        found[1:] += hitch
        return found

    def _hitches(self, rolls: FloatArray) -> FloatArray:
        """Roll moments of the couplings [N m], shape (n - 1,)."""
        twists = np.diff(rolls)
        return np.array([b.hitch(float(t)) for b, t in zip(self.bodies[1:], twists, strict=True)])

    def threshold(self) -> float:
        """Tangent of the greatest tilt at which the truck stays upright [g]."""
        tilt, rolls = 0.0, np.zeros(len(self.bodies))
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
        rolls: FloatArray | None = np.zeros(len(self.bodies))
        for side in np.linspace(0.0, lateral / GRAVITY, 20 + round(lateral / 0.02)):
            if rolls is not None:
                rolls = self._settle(rolls, Pull(float(side)))
        if rolls is None:
            return None
        pull = Pull(lateral / GRAVITY)
        transfers = [
            support.transfer(roll, pull)
            for body, roll in zip(self.bodies, rolls, strict=True)
            for support in body.supports
        ]
        hitches = self._hitches(rolls)
        return Leaning(np.array(transfers), float(hitches[0]) if len(hitches) else 0.0)

    def _settle(self, rolls: FloatArray, pull: Pull) -> FloatArray | None:
        """Rolls in equilibrium near other rolls [rad], (n,); None if units tip over."""
        found = self._solve(rolls, pull)
        if found is None or np.max(np.abs(found - rolls)) > _SMALL:
            # A plate may close its lash at once, to an equilibrium that the solver does not reach.
            relaxed = self._relaxed(rolls, pull)
            found = None if relaxed is None else self._solve(relaxed, pull)
        if found is None:
            return None
        lifted = True
        for body, roll in zip(self.bodies, found.tolist(), strict=True):
            if body.coupling is not None and body.coupling.roll_stiffness == 0.0:
                # The units ahead stand alone.
                if lifted:
                    return None
                lifted = True
            lifted = lifted and body.lifted(roll, pull)
        return None if lifted else found

    def _solve(self, rolls: FloatArray, pull: Pull) -> FloatArray | None:
        """Stable equilibrium near other rolls [rad], (n,), or None."""
        weight = sum(support.sprung for body in self.bodies for support in body.supports)

        def scaled(trial: FloatArray) -> FloatArray:
            return self.residual(trial, pull) / (0.1 * weight)

        found = optimize.root(scaled, rolls, tol=1e-9)
        solved = found.success or np.max(np.abs(scaled(found.x))) < _SOLVED
        return np.asarray(found.x) if solved and self._stable(found.x, pull) else None

    def _relaxed(self, rolls: FloatArray, pull: Pull) -> FloatArray | None:
        """Rolls after a creep along the moments, (n,); None if a body falls."""
        rate = 1.0 / np.max(np.abs(np.linalg.eigvals(self._slope(np.zeros_like(rolls), pull))))
        start, rolls = rolls, rolls.copy()
        for _ in range(_CREEPS):
            step = rate * self.residual(rolls, pull)
            rolls = rolls - step
            if np.max(np.abs(rolls - start)) > _FALLING:
                return None
            if np.max(np.abs(step)) < _RESTING:
                break
        return rolls

    def _stable(self, rolls: FloatArray, pull: Pull) -> bool:
        """Returns whether the symmetric part of the residual's slope is positive definite."""
        slope = self._slope(rolls, pull)
        return bool(np.linalg.eigvalsh(0.5 * (slope + slope.T))[0] > 0.0)

    def _slope(self, rolls: FloatArray, pull: Pull) -> FloatArray:
        """Slope of the residual [N m/rad], shape (n, n)."""
        small, base = 1e-7, self.residual(rolls, pull)
        columns = [self.residual(rolls + small * unit, pull) - base for unit in np.eye(len(rolls))]
        return np.column_stack(columns) / small


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
