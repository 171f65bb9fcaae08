"""Roads from measurements: heights over station, straight or along a measured plan view.

Between the stations the height is a natural cubic spline, so that grade and its change are
continuous. The plan view is a chain of clothoids whose curvature is linear between the stations,
or a natural cubic spline through measured points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.angles import wrap_angles
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns, read_names
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.geometry import Arc, Geometry, Line, ParamPoly3, Spiral
from iits_mj.road.polynomials import Cubic
from iits_mj.road.route import RoadMap, Route
from iits_mj.road.straight import Lanes, plain_road

__all__ = ["Lanes", "measured_route", "road_from_csv", "route_from_csv"]

_GRADE_MAX = 0.25
_CURVATURE_MAX = 0.2
# Clothoids whose curvature changes by less become straight lines or arcs [1/m].
_SAME_CURVATURE = 1e-9
_ROLL_MAX = 0.3  # [rad]
_TURN_MAX = 1.05  # [rad] from one pair of points to the next
_COLUMNS = (
    *("s_m", "x_m", "y_m", "z_m", "heading_rad", "curvature_1pm", "superelevation_rad"),
    *("lanes", "oncoming_lanes", "lane_width_m", "speed_limit_mps"),
)


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
    plan = tuple(_plan_view(s, first, bends))
    rows = [(0.0, lanes or Lanes())]
    content = plain_road(name, float(s[-1]), plan, height_profile(s, z), rows)
    return RoadMap(content, name).route()


def route_from_csv(path: str | Path, lanes: Lanes | None = None) -> Route:
    """Reads a road as `road_from_csv` does.

    Raises:
      InputError: the file cannot be read, or its columns do not describe a road.
    """
    return RoadMap(road_from_csv(path, lanes), Path(path).name).route()


def road_from_csv(
    path: str | Path, lanes: Lanes | None = None, centered: bool = False
) -> OpenDriveMap:
    """Reads a road from a CSV file with a row for each station or point.

    The plan view is that of curvature_1pm over s_m, with heading_rad of the first row; else a
    spline through x_m and y_m; else straight along s_m. Further columns: z_m; superelevation_rad,
    positive where the left side is higher; lanes, oncoming_lanes, lane_width_m and speed_limit_mps,
    which count from their row on. Other columns are not used.

    Args:
      path: of the file.
      lanes: where the file does not say otherwise; default: two of 4 m at 25 m/s.
      centered: the measured line is the line between the two directions of travel; without it, it
        is the middle of the rightmost lane.

    Raises:
      InputError: the file cannot be read, or its columns do not describe a road.
    """
    names = [name for name in read_names(path, "road") if name in _COLUMNS]
    name, points = Path(path).name, {"x_m", "y_m"} <= set(names)
    if not points and "s_m" not in names:
        raise InputError(f"road {str(path)!r}: columns s_m, or x_m and y_m, are needed")
    found = dict(zip(names, read_columns(path, "road", [(n,) for n in names], 3), strict=True))
    if points and not ("s_m" in found and "curvature_1pm" in found):
        s, plan = _spline_plan(name, found["x_m"], found["y_m"])
    else:
        s = _columns(name, found["s_m"], found["s_m"])[0]
        s = s - s[0]
        heading = float(found["heading_rad"][0]) if "heading_rad" in found else 0.0
        bends = found.get("curvature_1pm", np.zeros_like(s))
        plan = tuple(_plan_view(s, heading, _bounded(name, "curvature_1pm", bends, _CURVATURE_MAX)))
    roll = found.get("superelevation_rad", np.zeros_like(s))
    _bounded(name, "superelevation_rad", roll, _ROLL_MAX)
    return plain_road(
        Path(path).stem,
        float(s[-1]),
        plan,
        height_profile(s, found.get("z_m", np.zeros_like(s))),
        _lane_rows(name, s, found, lanes or Lanes()),
        height_profile(s, roll) if roll.any() else (),
        centered,
    )


def _lane_rows(
    name: str, s: FloatArray, found: dict[str, FloatArray], lanes: Lanes
) -> list[tuple[float, Lanes]]:
    """The lanes at each station where they change."""
    limits = {
        "lanes": ("count", 1.0, 20.0),
        "oncoming_lanes": ("oncoming", 0.0, 20.0),
        "lane_width_m": ("width", 2.0, 20.0),
        "speed_limit_mps": ("speed_limit", 0.1, 200.0),
    }
    rows: list[tuple[float, Lanes]] = []
    # The last row is the road's end.
    for k, station in enumerate(s[:-1].tolist()):
        for column, (attribute, low, high) in limits.items():
            if column not in found:
                continue
            value = float(found[column][k])
            whole = column in ("lanes", "oncoming_lanes")
            if not low <= value <= high or (whole and value != int(value)):
                kind = "a whole number from" if whole else "a number from"
                raise InputError(
                    f"{name}: {column} is {value:g} at {station:g} m; {kind} {low:g} to {high:g} "
                    "is allowed"
                )
            change: dict[str, Any] = {attribute: int(value) if whole else value}
            lanes = replace(lanes, **change)
        if not rows or rows[-1][1] != lanes:
            rows.append((station, lanes))
    return rows


def _bounded(name: str, column: str, values: FloatArray, limit: float) -> FloatArray:
    if np.abs(values).max() > limit:
        raise InputError(
            f"{name}: {column} of {np.abs(values).max():.3g} is too large for a road: at most "
            f"{limit:g} is allowed"
        )
    return values


def _spline_plan(
    name: str, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, tuple[Geometry, ...]]:
    """Stations of points, and the natural cubic spline over their chords through them."""
    from scipy.interpolate import CubicSpline

    chords = np.hypot(np.diff(x), np.diff(y))
    if (chords < 1e-3).any():
        raise InputError(f"{name}: point {int(chords.argmin()) + 2} is that before it")
    turns = np.abs(wrap_angles(np.diff(np.arctan2(np.diff(y), np.diff(x)))))
    if turns.max() > _TURN_MAX:
        raise InputError(
            f"{name}: the road turns by {np.degrees(turns.max()):.0f} degrees at point "
            f"{int(turns.argmax()) + 2}; at most {np.degrees(_TURN_MAX):.0f} between two points is "
            "allowed"
        )
    t = np.concatenate(([0.0], np.cumsum(chords)))
    curve = CubicSpline(t, np.column_stack((x, y)), bc_type="natural")
    s, plan = [0.0], []
    for k, chord in enumerate(chords.tolist()):
        # Columns: x and y of the cubic's terms, from the constant on, over p from 0 to 1.
        terms = curve.c[::-1, k].T * chord ** np.arange(4.0)
        heading = float(np.arctan2(terms[1, 1], terms[0, 1]))
        sine, cosine = np.sin(heading), np.cos(heading)
        turned = np.array([[cosine, sine], [-sine, cosine]]) @ terms
        turned[:, 0] = turned[1, 1] = 0.0
        u, v = (Cubic(0.0, *map(float, row))[1:] for row in turned)
        place = (s[-1], float(x[k]), float(y[k]), heading)
        length = ParamPoly3(*place, 1.0, u, v, True).curve_length
        piece = ParamPoly3(*place, length, u, v, True)
        bend = float(np.abs(piece.evaluate(np.linspace(0.0, length, 9)).curvature).max())
        if bend > _CURVATURE_MAX:
            raise InputError(
                f"{name}: the points about number {k + 1} bend with a radius of {1.0 / bend:.1f} "
                f"m, too tight for a road: at least {1.0 / _CURVATURE_MAX:g} m is allowed"
            )
        plan.append(piece)
        s.append(s[-1] + length)
    return np.array(s), tuple(plan)


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


def height_profile(s: FloatArray, z: FloatArray) -> tuple[Cubic, ...]:
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
