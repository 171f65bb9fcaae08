"""Rollover margin of the truck: static threshold and rearward amplification.

The threshold follows from the truck's parameters, its mass and the payload's height. The lateral
acceleration of towed units exceeds the steer axle's by the rearward amplification. Curvature and
cross-slope use a part of the threshold; lane changes may use the rest.

Fifth wheels and turntables join units in roll, drawbars do not: the weakest group of joined units
counts, with the amplification of the unit that swings most.

Statics of a group in the roll plane: one body rolls by `phi` on the springs of all axles, each of
which rolls by `phi_u` on its tires until its inner wheels lift (Winkler, Rollover of heavy
commercial vehicles, UMTRI 1999). With the side force `a` as share of g, sprung load n, roll center
h_rc, unsprung weight m_u at h_u, load W, track T and the carcass that bends aside by
`y = W a sigma / C`,

    axle:    min(K_t phi_u, W T / 2) = K_s (phi - phi_u) + (n h_rc + m_u h_u) (a + phi_u) + W y
    body:    sum K_s (phi - phi_u) = sum n (h - h_rc) (a + phi).

The threshold is the greatest `a` with an equilibrium in which not all axles behind the steer axle
have lifted. The fifth wheel counts as rigid in roll: where its plate opens the real one is lower.
The load on a drawbar and its side force act at its height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.road_preview import STEERING_LAG
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.parameters.mass_state import coupling_loads, laden_units, static_axle_loads
from iits_mj.parameters.tire_law import cornering_stiffness

_ROLLS = np.linspace(0.002, 0.30, 150)
_SPEEDS = np.array([3.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0])
# Couplings without stiffness in roll.
_ROLL_FREE = ("drawbar_eye", "pintle")
# Margins are computed for multiples of this mass [kg], as an estimate of the mass fluctuates.
_MASS_STEP = 500.0


def roll_threshold(parameters: TruckParameters, payload: float) -> float:
    """Steady lateral acceleration at which the truck rolls over on a level road [m/s2].

    Args:
      parameters: of the truck, with the payload's height.
      payload: [kg].

    Raises:
      InputError: the payload is not allowed.
    """
    bodies, loads = laden_units(parameters, payload), static_axle_loads(parameters, payload)
    on_axles = iter(loads.tolist())
    # Of each group: loaded axles with their loads [N], and moments of weights and of the load on a
    # drawbar about the ground [N m].
    groups: list[tuple[list[tuple[Axle, float]], list[float]]] = []
    for unit, body, on_coupling in zip(
        parameters.units, bodies, (0.0, *coupling_loads(parameters, payload)), strict=True
    ):
        if unit.coupling is None:
            groups.append(([], []))
        elif unit.coupling.kind in _ROLL_FREE:
            carried = on_coupling * unit.coupling.height
            groups[-1][1].append(carried)
            groups.append(([], [-carried]))
        axles, moments = groups[-1]
        axles += [(axle, load) for axle, load in zip(unit.axles, on_axles, strict=False) if load]
        moments.append(GRAVITY * (body.mass * body.cg_height))
    return min(_group_threshold(parameters, axles, sum(moments)) for axles, moments in groups)


def _group_threshold(
    parameters: TruckParameters, loaded: list[tuple[Axle, float]], moment: float
) -> float:
    """Threshold of units that roll as one body [m/s2].

    Args:
      parameters: of the truck.
      loaded: the axles, and the load of each [N].
      moment: of the weight about the ground, sum of weight times height [N m].
    """
    axles, load = [axle for axle, _ in loaded], np.array([on_axle for _, on_axle in loaded])
    tires = [parameters.tires[axle.tire] for axle in axles]
    common = parameters.tire_common
    vertical = np.array([tire.count * tire.vertical_stiffness for tire in tires])
    track = np.array([axle.track for axle in axles])
    unsprung = np.array([axle.unsprung_mass for axle in axles]) * GRAVITY
    height = np.array([tire.free_radius for tire in tires]) - 0.5 * load / vertical
    center = height + np.array([axle.roll_center_height for axle in axles])
    spring = np.array(
        [0.5 * a.spring_rate * a.spring_spacing**2 + a.auxiliary_roll_stiffness for a in axles]
    )
    carcass = np.empty(len(axles))
    for i, tire in enumerate(tires):
        each = load[i] / (2 * tire.count)
        lag = common.relaxation_lateral
        lag *= (each / common.nominal_load) ** common.relaxation_load_exponent
        stiffness = 2 * tire.count * float(cornering_stiffness(each, tire, common))
        carcass[i] = load[i] ** 2 * lag / stiffness
    sprung = load - unsprung
    body_height = (moment - float(unsprung @ height)) / float(sprung.sum())
    lever = float(sprung @ (body_height - center))
    arm = sprung * center + unsprung * height
    limit = 0.5 * load * track
    stiff = 0.5 * vertical * track**2
    fixed = np.array([not axle.steered for axle in axles])
    return GRAVITY * _greatest(spring, stiff, arm, carcass, limit, lever, fixed)


def _greatest(
    spring: FloatArray,
    tire: FloatArray,
    arm: FloatArray,
    carcass: FloatArray,
    limit: FloatArray,
    lever: float,
    fixed_axles: BoolArray,
) -> float:
    """Greatest side force in equilibrium, as share of g; arrays of shape (axles,)."""
    best = 0.0
    lifted = np.zeros(len(spring), dtype=bool)
    for roll in _ROLLS:
        side = 0.0
        for _ in range(len(spring) + 1):
            # phi_u = (K_s phi + (arm + carcass) a - M) / D, lifted: M = W T / 2, else M in D.
            give = np.where(lifted, spring - arm, spring + tire - arm)
            fixed = (spring * roll - np.where(lifted, limit, 0.0)) / give
            per_side = (arm + carcass) / give
            held = float((spring * (roll - fixed)).sum()) - lever * roll
            side = held / (lever + float((spring * per_side).sum()))
            more = ~lifted & (tire * (fixed + per_side * side) > limit)
            if not more.any():
                break
            lifted |= more
        if lifted[fixed_axles].all():
            break
        best = max(best, side)
    return best


def rearward_amplification(model: LateralModel, speed: float, frequency: float) -> float:
    """Greatest ratio of a towed unit's lateral acceleration to the steer axle's, in a sine.

    The accelerations of towed units are those of their CG; 1 for a truck without trailer.

    Args:
      model: of the loaded truck.
      speed: [m/s], positive.
      frequency: of the maneuver [Hz]; a lane change of duration T is one sine of 1 / T.
    """
    a, _, _ = model.matrices(speed)
    s, own, delta = 2j * math.pi * frequency, model.motions, model.motions + 2
    w, *rates = np.linalg.solve(s * np.eye(own) - a[:own, :own], a[:own, delta])[: model.rates]
    felt = s * w + speed * rates[0]
    ratios, origin, plane = [], felt, model.plane
    for cg, coupling, rate in zip(plane.cg, [*plane.couplings, 0.0], rates, strict=True):
        ratios.append(float(abs((origin - cg * s * rate) / felt)))
        origin = origin - coupling * s * rate
    return max(ratios[1:], default=1.0)


@dataclass(frozen=True)
class RollMargin:
    """Rollover margin of a truck of one mass.

    Attributes:
      threshold: steady lateral acceleration at which it rolls over [m/s2].
      amplification: of the towed units over the steer axle at seven speeds, shape (7,), 1 at least.
    """

    threshold: float
    amplification: FloatArray

    @classmethod
    def of(cls, parameters: TruckParameters, mass: float, frequency: float) -> RollMargin:
        """The margin at a gross mass [kg], for maneuvers of a frequency [Hz]."""
        empty = parameters.gross_mass(0.0)
        payload = min(max(mass - empty, 0.0), parameters.payload_max)
        model = LateralModel.of(parameters, empty + payload, STEERING_LAG)
        amplification = [rearward_amplification(model, float(v), frequency) for v in _SPEEDS]
        return cls(roll_threshold(parameters, payload), np.maximum(amplification, 1.0))

    def amplified(self, speed: float) -> float:
        """Rearward amplification at a speed [m/s], 1 at least."""
        return float(np.interp(speed, _SPEEDS, self.amplification))


class RollMargins:
    """Rollover margins by mass, computed on first use.

    Args:
      parameters: of the truck, with the payload's height.
      frequency: of the quickest lane change [Hz].
    """

    def __init__(self, parameters: TruckParameters, frequency: float) -> None:
        self._parameters = parameters
        self._frequency = frequency
        self._known: dict[float, RollMargin] = {}

    def at(self, mass: float) -> RollMargin:
        """The margin at a gross mass [kg], to half a tonne."""
        step = _MASS_STEP * round(mass / _MASS_STEP)
        if step not in self._known:
            self._known[step] = RollMargin.of(self._parameters, step, self._frequency)
        return self._known[step]


def curve_speed_by_roll(
    curvature: FloatArray, superelevation: FloatArray, acceleration: float
) -> FloatArray:
    """Greatest speed at a lateral acceleration by bend and cross-slope, shape as curvature [m/s].

    `|v^2 kappa + g tan(superelevation)| <= a` to the outside of the bend.
    """
    room = acceleration - np.sign(curvature) * GRAVITY * np.tan(superelevation)
    return np.asarray(np.sqrt(np.maximum(room, 0.1) / np.maximum(np.abs(curvature), 1e-6)))
