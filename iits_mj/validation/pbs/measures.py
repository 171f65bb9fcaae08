"""PBS measures of recorded signals and of the paths of a low-speed turn.

Ground coordinates are x along the road, y to the left; signals have uniform samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from iits_mj.analytic.swept_path import (
    Turn,
    frontal_swing,
    outward,
    swept_width,
    tail_swing,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, Unit
from iits_mj.parameters.mass_state import laden_units
from iits_mj.validation.handling.yaw_damping import damping_ratio
from iits_mj.validation.pbs.maneuvers import FROM_REST

# Available friction of the steer tires [1].
PEAK_FRICTION = 0.8
# Share of the road on which the swept width is at most the tracking ability.
TRACKING_SHARE = 0.99
# Stretch of the road whose swept width is one value [m].
_STATION = 0.5


def turn_measures(done: Turn) -> dict[str, float]:
    """Returns swept path, frontal and tail swing of a low-speed turn [m], by standards' keys."""
    corners = done.tracks()
    front = corners[:, :, 1]
    swings = frontal_swing(front, done.radius, done.angle)
    values = {
        "swept_path": swept_width(done.sides(), done.radius, done.angle),
        "frontal_swing": float(swings[0]),
        "tail_swing": float(np.max(tail_swing(corners[:, :, 2]))),
    }
    if len(swings) > 1:
        beyond = outward(front, done.radius, done.angle)
        # The exit runs along y, which begins at the height of the arc's center.
        station = front[..., 1] - done.radius
        values["front_maxima"], values["front_paths"] = front_corner_excess(beyond, station)
    return values


def tracking_ability(points: FloatArray, share: float = TRACKING_SHARE) -> float:
    """Returns the width [m] within which the whole combination runs on a straight road.

    Args:
      points: outer corners of all units [m], shape (n, points, 2).
      share: of the road on which the width is not exceeded.

    Raises:
      InputError: as of `swept_edges`.
    """
    _, right, left = swept_edges(points)
    return float(np.quantile(left - right, share))


def swept_edges(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns stations of a straight road, and its rightmost and leftmost places swept there [m].

    At each place of the road, the outermost of all points as they pass; shape (k,) each.

    Args:
      points: outer corners of all units [m], shape (n, points, 2).

    Raises:
      InputError: a point is not finite, or the road is shorter than the combination.
    """
    x, y = _finite("points", points)[..., 0], points[..., 1]
    # Only places that every point passes.
    first, last = float(x[0].max()), float(x[-1].min())
    edges = np.arange(first, last, _STATION)
    if len(edges) < 2:
        raise InputError(f"the road of {last - first:.1f} m is too short for its swept width")
    bins, inside = np.digitize(x, edges), (x >= first) & (x < edges[-1])
    left, right = np.full(len(edges) + 1, -np.inf), np.full(len(edges) + 1, np.inf)
    np.maximum.at(left, bins[inside], y[inside])
    np.minimum.at(right, bins[inside], y[inside])
    swept = np.isfinite(left - right)[1:-1]
    return edges[:-1][swept], right[1:-1][swept], left[1:-1][swept]


def front_corner_excess(outward: FloatArray, station: FloatArray) -> tuple[float, float]:
    """Returns how far a towed unit's front corner swings beyond that of the unit ahead [m].

    Args:
      outward: distances of each unit's outer front corner to the outside of the exit tangent [m],
        shape (n, units).
      station: of the corners along the exit tangent [m], shape (n, units).

    Returns:
      The greatest difference of the maxima, and the greatest difference of two neighbors' paths at
      one place; both -inf for a single unit.
    """
    maxima, paths = [-np.inf], [-np.inf]
    for unit in range(1, outward.shape[1]):
        maxima.append(float(outward[:, unit].max() - outward[:, unit - 1].max()))
        exits = [np.flatnonzero(station[:, k] > 0.0) for k in (unit - 1, unit)]
        if min(len(places) for places in exits) < 2:
            continue
        ahead, behind = (
            (station[places, k], outward[places, k])
            for places, k in zip(exits, (unit - 1, unit), strict=True)
        )
        along = behind[0][behind[0] < ahead[0][-1]]
        gap = behind[1][: len(along)] - np.interp(along, *ahead)
        paths.append(float(gap.max(initial=-np.inf)))
    return max(maxima), max(paths)


def friction_demand(forces: FloatArray, friction: float = PEAK_FRICTION) -> float:
    """Returns the greatest friction demand of the steer tires, in percent of what is available.

    Args:
      forces: longitudinal, lateral and vertical, of all steer tires [N], shape (n, tires, 3).
      friction: available [1].
    """
    forces = _finite("forces", forces)
    used = np.hypot(forces[..., 0], forces[..., 1]).sum(axis=1)
    return float(100.0 * np.max(used / forces[..., 2].sum(axis=1)) / friction)


def roll_coupled_acceleration(
    parameters: TruckParameters, payload: float, accelerations: FloatArray
) -> FloatArray:
    """Returns the lateral acceleration of the rearmost units that are coupled in roll, (m,).

    The mean of the units by mass times height of the center of gravity, as these accelerations
    act together on one body in roll.

    Args:
      parameters: of the truck.
      payload: of the combination [kg].
      accelerations: of the units' CGs, shape (m, n).
    """
    free = [i for i, unit in enumerate(parameters.units) if not _rolls_along(unit)]
    units = laden_units(parameters, payload)[free[-1] :]
    weights = np.array([unit.mass * unit.cg_height for unit in units])
    return np.asarray(accelerations[:, free[-1] :] @ weights / weights.sum())


def _rolls_along(unit: Unit) -> bool:
    """Whether a unit is coupled in roll to the unit ahead."""
    return unit.coupling is not None and unit.coupling.roll_stiffness > 0.0


def rearward_amplification(front: FloatArray, rear: FloatArray) -> float:
    """Returns the peak lateral acceleration of the rear over that of the steer axle.

    Args:
      front: of the steer axle [m/s2], shape (n,).
      rear: of the last unit, or of its roll-coupled units together [m/s2], shape (n,).

    Raises:
      InputError: a signal is not finite, or the steer axle is not accelerated.
    """
    peak = float(np.max(np.abs(_finite("front", front))))
    if peak == 0.0:
        raise InputError("the steer axle has no lateral acceleration: nothing to amplify")
    return float(np.max(np.abs(_finite("rear", rear)))) / peak


def transient_off_tracking(front: FloatArray, rear: FloatArray) -> float:
    """Returns how far the last axle overshoots the path of the steer axle in a lane change [m].

    Args:
      front: path of the steer axle's center [m], shape (n, 2), x increasing.
      rear: path of the last axle's center [m], shape (n, 2).
    """
    front, rear = _finite("front", front), _finite("rear", rear)
    side = np.sign(front[-1, 1] - front[0, 1])
    passed = (rear[:, 0] >= front[0, 0]) & (rear[:, 0] <= front[-1, 0])
    if side == 0.0 or not passed.any():
        raise InputError("the last axle never passes the lane change, or the lane is not changed")
    beyond = rear[passed, 1] - np.interp(rear[passed, 0], *front.T)
    return float(max(np.max(side * beyond), 0.0))


def yaw_damping(signals: Sequence[FloatArray]) -> float:
    """Returns the damping of the worst of the signals of a free decay, such as yaw rates (n,)."""
    return min(damping_ratio(_finite("signal", signal)) for signal in signals)


def acceleration_time(time: FloatArray, distance: FloatArray) -> float:
    """Returns the time from rest over `FROM_REST` [s]; infinite if it is not reached.

    Args:
      time: [s], shape (n,).
      distance: traveled [m], shape (n,).
    """
    traveled = _finite("distance", distance) - distance[0]
    if traveled[-1] < FROM_REST:
        return float("inf")
    return float(np.interp(FROM_REST, np.maximum.accumulate(traveled), time) - time[0])


def _finite(name: str, values: FloatArray) -> FloatArray:
    if not np.isfinite(values).all():
        raise InputError(f"{name} of the recording hold a value that is not finite")
    return values
