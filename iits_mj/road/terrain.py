"""Heights of a terrain at the places of a map, from tables and GeoTIFF files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns, read_names
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.route import RoadMap

Terrain = Callable[[FloatArray, FloatArray], FloatArray]
SEMI_MAJOR_AXIS, FLATTENING = 6378137.0, 1.0 / 298.257223563  # of WGS 84


def read_terrain(path: Path, content: OpenDriveMap, along: str | None) -> Terrain:
    """Reads heights of a map from a CSV table with z_m over a place or a station, or a GeoTIFF.

    Places are x_m and y_m of the map, or easting_m and northing_m of its projection; between them
    the height is linear on triangles, and outside them it is that of the nearest place. A station
    s_m is that of a route; every other point has the height of the nearest point of the route. A
    GeoTIFF has heights over longitude and latitude; see `read_geotiff`.

    Args:
      path: of the file.
      content: the map.
      along: the route on which the stations lie; see `RoadMap.route`.

    Raises:
      InputError: the file cannot be read, has other columns, or places that are not near the map.
    """
    if path.suffix.lower() in (".tif", ".tiff"):
        grid, place = read_geotiff(path), geographic(content)
        return lambda x, y: grid(*place(x, y))
    names = read_names(path, "table of heights")
    if "s_m" in names:
        station, z = read_columns(path, "table of heights", (("s_m",), ("z_m",)))
        if (np.diff(station) <= 0.0).any():
            raise InputError(f"{path}: the stations s_m must rise")
        route = RoadMap(content, content.name).route(along=along)

        def over_stations(x: FloatArray, y: FloatArray) -> FloatArray:
            places = [route.locate(*point)[0] for point in zip(x, y, strict=True)]
            return np.interp(places, station, z)

        return over_stations
    wanted = (("x_m", "easting_m"), ("y_m", "northing_m"), ("z_m",))
    x, y, z = read_columns(path, "table of heights", wanted, rows=3)
    if "x_m" not in names:
        x, y = x - content.offset[0], y - content.offset[1]
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
    from scipy.spatial import QhullError

    places = np.column_stack((x, y))
    try:
        inside = LinearNDInterpolator(places, z)
    except QhullError as error:
        raise InputError(f"{path}: the places lie on one line; use s_m and z_m") from error
    nearest = NearestNDInterpolator(places, z)
    # ours: a table that covers less than half of the map belongs to another place.
    ends = np.array([[g.x, g.y] for road in content.roads for g in road.geometries])
    covered = float(np.mean(np.isfinite(inside(ends))))
    if covered < 0.5:
        raise InputError(
            f"{path}: its places cover {100.0 * covered:.0f} % of the map, which reaches from "
            f"x, y = {_pair(ends.min(axis=0))} to {_pair(ends.max(axis=0))} m; at least 50 % is "
            "needed"
        )

    def over_places(x: FloatArray, y: FloatArray) -> FloatArray:
        height = inside(x, y)
        return np.where(np.isfinite(height), height, nearest(x, y))

    return over_places


def _pair(point: FloatArray) -> str:
    return f"{point[0]:.0f}, {point[1]:.0f}"


def read_geotiff(path: Path) -> Terrain:
    """Reads heights over longitude and latitude [degrees] from a GeoTIFF.

    Between the centers of its pixels the height is bilinear. Tags as in OGC 19-008 (GeoTIFF 1.1):
    33550 is the size of a pixel, 33922 the place of one, 34735 the kind of coordinates.

    Raises:
      InputError: it cannot be read, or its coordinates are not longitude and latitude.
    """
    from PIL import Image
    from scipy.interpolate import RegularGridInterpolator

    try:
        with Image.open(path) as picture:
            tags = dict(picture.tag_v2)  # type: ignore[attr-defined]
            heights = np.asarray(picture, dtype=float)
    except (OSError, ValueError, AttributeError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: is not a GeoTIFF that can be read: {error}") from error
    keys = tags.get(34735, ())
    kinds = {keys[i]: keys[i + 3] for i in range(4, len(keys) - 3, 4)}
    if heights.ndim != 2 or not {33550, 33922} <= tags.keys() or kinds.get(1024) != 2:
        raise InputError(
            f"{path}: a GeoTIFF with one height a pixel over longitude and latitude (EPSG:4326) "
            "is needed"
        )
    (width, height), (column, row, _, longitude, latitude) = tags[33550][:2], tags[33922][:5]
    # A tie point belongs to a pixel's corner unless the raster type is "point".
    center = 0.0 if kinds.get(1025) == 2 else 0.5
    lon = longitude + (np.arange(heights.shape[1]) - column + center) * width
    lat = latitude - (np.arange(heights.shape[0]) - row + center) * height
    missing = float(str(tags.get(42113, "nan")).strip("\0 ") or "nan")
    heights = np.where(heights == missing, np.nan, heights)
    grid = RegularGridInterpolator((lat[::-1], lon), heights[::-1], bounds_error=False)

    def terrain(x: FloatArray, y: FloatArray) -> FloatArray:
        found = np.asarray(grid(np.column_stack((y, x))))
        if not np.isfinite(found).all():
            k = int(np.argmin(np.isfinite(found)))
            raise InputError(
                f"{path}: has no height at longitude {x[k]:g}, latitude {y[k]:g}; it reaches from "
                f"{lon[0]:g}, {lat[-1]:g} to {lon[-1]:g}, {lat[0]:g}"
            )
        return found

    return terrain


def geographic(
    content: OpenDriveMap,
) -> Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Returns the function from x and y of a map [m] to longitude and latitude [degrees].

    The map names a transverse Mercator projection (`utm` or `tmerc`) on WGS 84. Its inverse is
    Krueger's series to the third order of the third flattening, exact to a millimeter within 1000
    km of the central meridian.

    Raises:
      InputError: the map names another projection, or none.
    """
    given: dict[str, str] = dict(re.findall(r"\+(\w+)(?:=(\S+))?", content.geo_reference))
    kind = given.get("proj")
    try:
        if kind == "utm":
            meridian, base, scale, east = 6.0 * float(given["zone"]) - 183.0, 0.0, 0.9996, 5e5
            north = 1e7 if "south" in given else 0.0
        elif kind == "tmerc":
            meridian, base = float(given.get("lon_0", "0")), float(given.get("lat_0", "0"))
            scale = float(given.get("k", given.get("k_0", "1")))
            east, north = float(given.get("x_0", "0")), float(given.get("y_0", "0"))
        else:
            raise ValueError("only utm and tmerc are known")
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{content.name}: a GeoTIFF needs the map's projection as utm or tmerc; its "
            f"geoReference is {content.geo_reference!r}"
        ) from error
    n = FLATTENING / (2.0 - FLATTENING)
    radius = scale * SEMI_MAJOR_AXIS / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    to_plane = (
        n / 2.0 - 2.0 * n**2 / 3.0 + 5.0 * n**3 / 16.0,
        13.0 * n**2 / 48.0 - 3.0 * n**3 / 5.0,
        61.0 * n**3 / 240.0,
    )
    to_sphere = (
        n / 2.0 - 2.0 * n**2 / 3.0 + 37.0 * n**3 / 96.0,
        n**2 / 48.0 + n**3 / 15.0,
        17.0 * n**3 / 480.0,
    )
    to_ellipsoid = (
        2.0 * n - 2.0 * n**2 / 3.0 - 2.0 * n**3,
        7.0 * n**2 / 3.0 - 8.0 * n**3 / 5.0,
        56.0 * n**3 / 15.0,
    )
    phi = math.radians(base)
    excentricity = 2.0 * math.sqrt(n) / (1.0 + n)
    conformal = math.atan(
        math.sinh(
            math.atanh(math.sin(phi)) - excentricity * math.atanh(excentricity * math.sin(phi))
        )
    )
    start = conformal + sum(c * math.sin(2 * j * conformal) for j, c in enumerate(to_plane, 1))

    def place(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        xi = start + (y + content.offset[1] - north) / radius
        eta = (x + content.offset[0] - east) / radius
        terms = [(2 * j, c) for j, c in enumerate(to_sphere, 1)]
        xi_sphere = xi - sum(c * np.sin(j * xi) * np.cosh(j * eta) for j, c in terms)
        eta_sphere = eta - sum(c * np.cos(j * xi) * np.sinh(j * eta) for j, c in terms)
        chi = np.arcsin(np.sin(xi_sphere) / np.cosh(eta_sphere))
        latitude = chi + sum(c * np.sin(2 * j * chi) for j, c in enumerate(to_ellipsoid, 1))
        longitude = np.arctan2(np.sinh(eta_sphere), np.cos(xi_sphere))
        return meridian + np.degrees(longitude), np.degrees(latitude)

    return place
