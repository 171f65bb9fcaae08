"""Roads from measurements: heights over station, straight or along a measured plan view.

Between the stations the height is a natural cubic spline, so that grade and its change are
continuous; the plan view is a chain of clothoids whose curvature is linear between the stations.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns, read_names
from iits_mj.road.geometry import Arc, Geometry, Line, Spiral
from iits_mj.road.polynomials import Cubic
from iits_mj.road.route import RoadMap, Route
from iits_mj.road.straight import Lanes, one_way_road

__all__ = ["Lanes", "measured_route", "route_from_csv"]

_GRADE_MAX = 0.25
_CURVATURE_MAX = 0.2
# Clothoids whose curvature changes by less become straight lines or arcs [1/m].
_SAME_CURVATURE = 1e-9


def measured_route(
    station: ArrayLike,
    height: ArrayLike,
    heading: ArrayLike | None = None,
    curvature: ArrayLike | None = None,
    lanes: Lanes | None = None,
    name: str = "measured road",
) -> Route:
    """Returns a one-way road from measurements, all of shape (n,).

    The reference line is the middle of the rightmost lane, which lies on the measured heights.

    Args:
      station: increasing [m]; the first is the road's station 0.
      height: [m].
      heading: [rad]; only the first is used, the curvature gives the others; default: 0.
      curvature: positive to the left [1/m]; default: a straight road.
      lanes: default: two of 4 m at 25 m/s.
      name: of the road, for reports.

    Raises:
      InputError: columns do not fit, a number is not finite, or grade or curvature is too large.
    """
    s, z = _columns(name, station, height)
    s = s - s[0]
    bends = np.zeros_like(s) if curvature is None else _columns(name, station, curvature)[1]
    if np.abs(bends).max() > _CURVATURE_MAX:
        raise InputError(
            f"{name}: curvature {np.abs(bends).max():.3g} 1/m is too large for a road: "
            f"at most {_CURVATURE_MAX:g} is allowed"
        )
    first = 0.0 if heading is None else float(_columns(name, station, heading)[1][0])
    content = one_way_road(
        name, float(s[-1]), tuple(_plan_view(s, first, bends)), _spline(s, z), lanes or Lanes()
    )
    return RoadMap(content, name).route()


def route_from_csv(path: str | Path, lanes: Lanes | None = None) -> Route:
    """Reads a road from a CSV file with s_m and z_m, and heading_rad and curvature_1pm if it bends.

    Raises:
      InputError: the file cannot be read, or its columns do not describe a road.
    """
    names = read_names(path, "road")
    extra = [name for name in ("heading_rad", "curvature_1pm") if name in names]
    wanted = [(name,) for name in ("s_m", "z_m", *extra)]
    station, height, *others = read_columns(path, "road", wanted)
    table = dict(zip(extra, others, strict=True))
    heading, curvature = table.get("heading_rad"), table.get("curvature_1pm")
    return measured_route(station, height, heading, curvature, lanes, Path(path).name)


def _columns(name: str, station: ArrayLike, values: ArrayLike) -> tuple[FloatArray, FloatArray]:
    s, v = np.asarray(station, dtype=float), np.asarray(values, dtype=float)
    if s.ndim != 1 or s.size < 3 or v.shape != s.shape:
        raise InputError(f"{name}: columns of equal length of 3 or more are needed")
    if not (np.isfinite(s).all() and np.isfinite(v).all()):
        raise InputError(f"{name} holds numbers that are not finite")
    if (np.diff(s) <= 0.0).any():
        k = int(np.argmax(np.diff(s) <= 0.0))
        raise InputError(f"{name}: stations must rise, after {s[k]:g} m comes {s[k + 1]:g} m")
    return s, v


def _spline(s: FloatArray, z: FloatArray) -> tuple[Cubic, ...]:
    """Records of the natural cubic spline."""
    from scipy.interpolate import CubicSpline

    steep = np.abs(np.diff(z) / np.diff(s))
    if steep.max() > _GRADE_MAX:
        raise InputError(
            f"grade {100.0 * steep.max():.1f} % at {s[int(steep.argmax())]:.0f} m is too large for "
            f"a road: at most {100.0 * _GRADE_MAX:g} % is allowed"
        )
    d, c, b, a = CubicSpline(s, z, bc_type="natural").c
    return tuple(Cubic(*map(float, row)) for row in zip(s[:-1], a, b, c, d, strict=True))


def _plan_view(s: FloatArray, heading: float, bends: FloatArray) -> Iterator[Geometry]:
    """Straight lines, arcs and clothoids one after the other, from the origin."""
    if np.abs(bends).max() < _SAME_CURVATURE:
        yield Line(0.0, 0.0, 0.0, heading, float(s[-1]))
        return
    x = y = 0.0
    for k, length in enumerate(np.diff(s).tolist()):
        place = (float(s[k]), x, y, heading, length)
        before, after = float(bends[k]), float(bends[k + 1])
        piece: Geometry
        if abs(after - before) > _SAME_CURVATURE:
            piece = Spiral(*place, before, after)
        else:
            piece = Arc(*place, before) if abs(before) > _SAME_CURVATURE else Line(*place)
        yield piece
        end = piece.evaluate(length)
        x, y, heading = float(end.x), float(end.y), float(end.heading)
