"""Where in its lane the tractor has to be so that the trailer stays inside it too.

In a steady turn the trailer's axles run beside the path of the steer axle: at walking pace on the
inside by `kappa k` with k half the sum of the squared lengths, faster more and more to the outside,
as its tires need slip. The steer axle is placed half of that to the other side, so that tractor and
trailer have the same room. What counts are all speeds from standstill to the bend's own.
"""

from __future__ import annotations

import numpy as np

from controllers.planning.following import curve_speed
from controllers.planning.road_preview import RoadPreview
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters

# Speeds at which off-tracking is computed [m/s].
_SPEEDS = np.array([0.5, 4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0])
# Kept between the truck's side and the lane's edge by the tractor itself [m].
_MARGIN = 0.15
# The shift turns in over about twice this way, as the trailer does [m].
_SMOOTHING = 25.0
_LAG = 0.1


def off_tracking(model: LateralModel, speed: float) -> float:
    """Trailer's axle group beside the steer axle's path, over the path's curvature [m2].

    Steady turn of the linear model; positive to the inside. The distance [m] is this times the
    curvature [1/m], which holds for radii well above the truck's length.

    Args:
      model: of the loaded truck.
      speed: [m/s], positive.
    """
    a, _, _ = model.matrices(speed)
    # Unit curvature: both yaw rates are v, and lateral speed, articulation and steer angle follow.
    w, articulation, _ = np.linalg.solve(a[:3][:, [0, 3, 6]], -(a[:3, 1] + a[:3, 2]) * speed)
    trailer = float(np.mean([position for position, _ in model.trailer_axles]))
    heading = -w / speed
    beside = -(model.kingpin * heading + trailer * (heading - articulation))
    return float(beside - 0.5 * (model.kingpin + trailer) ** 2)


def lane_shift(
    preview: RoadPreview,
    parameters: TruckParameters,
    mass: float,
    curve_acceleration: float,
) -> FloatArray:
    """Wanted offset of the steer axle from the lanes' middles, shape (lanes, n) [m].

    Args:
      preview: of the road.
      parameters: of the truck.
      mass: gross combination mass [kg].
      curve_acceleration: lateral acceleration that bounds the speed in curves [m/s2].
    """
    model = LateralModel.of(parameters, mass, _LAG)
    gains = np.array([off_tracking(model, float(speed)) for speed in _SPEEDS])
    curvature = preview.curvature
    fastest = np.minimum(
        curve_speed(curvature, curve_acceleration), preview.speed_limit.max(axis=0)
    )
    slow, fast = curvature * gains[0], curvature * np.interp(fastest, _SPEEDS, gains)
    both = np.array([np.zeros_like(slow), slow, fast])
    shift = -0.5 * (both.min(axis=0) + both.max(axis=0))
    count = 2 * round(0.5 * _SMOOTHING / preview.step) + 1
    window = np.full(count, 1.0 / count)
    for _ in range(2):
        shift = np.convolve(np.pad(shift, count // 2, mode="edge"), window, mode="valid")
    free = preview.half_width - 0.5 * parameters.semitrailer.width - _MARGIN
    free = np.maximum(free, 0.0)
    return np.asarray(np.clip(shift[None, :], -free, free))
