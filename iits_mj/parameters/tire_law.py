"""The tire's load dependence, shared by the analytic models and (in C++) by the tire plugin.

Cornering stiffness is the Magic Formula's `K_y = p sin(2 atan(Fz / (s Fz0)))` (Pacejka, Tire and
Vehicle Dynamics, eq. 4.E25 without camber), scaled so that a tire at its `cornering_load` has
`K_y = cornering_coefficient cornering_load`. Friction falls linearly with relative load.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.parameters.truck import Tire, TireCommon, TruckParameters


def cornering_stiffness(load: ArrayLike, tire: Tire, common: TireCommon) -> FloatArray:
    """Returns the cornering stiffness of one tire [N/rad] at vertical load [N], any shape.

    `K_y(Fz) = c Fz1 f(Fz) / f(Fz1)` with `f(Fz) = sin(2 atan(Fz / (s Fz0)))` and `Fz1` the load at
    which the coefficient `c` holds; zero for a lifted tire.
    """
    shape = _load_shape(np.maximum(np.asarray(load, dtype=float), 0.0), common)
    scale = tire.cornering_coefficient * tire.cornering_load
    return np.asarray(scale * shape / _load_shape(tire.cornering_load, common))


def axle_cornering_stiffness(parameters: TruckParameters, loads: FloatArray) -> FloatArray:
    """Returns the cornering stiffness of each axle [N/rad], (axles,), at axle loads [N]."""
    stiffness = []
    for axle, load in zip(parameters.axles, loads, strict=True):
        tire = parameters.tires[axle.tire]
        tires = 2 * tire.count
        one = cornering_stiffness(load / tires, tire, parameters.tire_common)
        stiffness.append(tires * float(one))
    return np.array(stiffness)


def nominal_cornering_coefficient(tire: Tire, common: TireCommon) -> float:
    """Returns `K_y / Fz0` at the nominal load `Fz0` [1/rad], as the tire plugin takes it."""
    return float(cornering_stiffness(common.nominal_load, tire, common)) / common.nominal_load


def _load_shape(load: ArrayLike, common: TireCommon) -> FloatArray:
    relative = np.asarray(load, dtype=float) / common.nominal_load
    return np.asarray(np.sin(2.0 * np.arctan(relative / common.load_saturation)))


def lateral_shape(stretch: ArrayLike, common: TireCommon) -> FloatArray:
    """Returns the side force of the Magic Formula over its peak, any shape (Pacejka, eq. 4.6).

    Args:
      stretch: `B tan(alpha)`, which is `K_y tan(alpha) / (C mu Fz)`.
      common: gives shape `C` and curvature `E`.
    """
    b = np.asarray(stretch, dtype=float)
    bent = b - common.curvature_lateral * (b - np.arctan(b))
    return np.asarray(np.sin(common.shape_lateral * np.arctan(bent)))


def friction(load: ArrayLike, nominal_friction: float, common: TireCommon) -> FloatArray:
    """Returns peak friction `mu0 (1 - slope (Fz / Fz0 - 1))` at load [N], not below 0.

    Args:
      load: vertical load of one tire [N], any shape.
      nominal_friction: `mu0`, at nominal load (lateral or longitudinal).
      common: gives nominal load and slope.
    """
    relative = np.maximum(np.asarray(load, dtype=float), 0.0) / common.nominal_load
    factor = 1.0 - common.friction_load_slope * (relative - 1.0)
    return np.asarray(nominal_friction * np.maximum(factor, 0.0))
