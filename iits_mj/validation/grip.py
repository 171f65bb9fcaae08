"""How much side force the tires can give, by the tire's law with loads as at rest.

The tires' friction holds on a surface of 0.8 and scales with the surface's.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize

from iits_mj.analytic import static_axle_loads
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TireCommon, TruckParameters
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.tire_law import cornering_stiffness, friction, lateral_shape


def grip_limit(parameters: TruckParameters, payload: float, surface: float) -> float:
    """Lateral acceleration [g] with every tire at its best at once and loads as at rest.

    An upper bound: load that moves to the outer tires, pull and drag only take from it.
    """
    loads = static_axle_loads(parameters, payload)
    best = [
        load * _friction(parameters, index, float(load), surface)
        for index, load in enumerate(loads)
    ]
    return float(np.sum(best) / np.sum(loads))


def effort(
    parameters: TruckParameters, payload: float, surface: float, index: int, slip: FloatArray
) -> FloatArray:
    """Share of its greatest side force that an axle gives, 1 beyond the peak, shape (n,).

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
    """Peak friction of an axle's tires [1] at the axle's load [N]."""
    tire, common = parameters.tires[parameters.axles[index].tire], parameters.tire_common
    each = load / (2 * tire.count)
    return float(friction(each, common.friction_lateral, common)) * surface / DEFAULT_FRICTION


def _peak(common: TireCommon) -> float:
    """`B tan(alpha)` at which the Magic Formula peaks: `C atan(...) = 90 deg`, for C above 1."""
    wanted, curve = math.tan(0.5 * math.pi / common.shape_lateral), common.curvature_lateral
    found = optimize.brentq(lambda b: b - curve * (b - math.atan(b)) - wanted, 0.0, 10.0 * wanted)
    return float(found)
