"""OpenStreetMap extracts and SUMO nets as OpenDRIVE maps, converted by netconvert."""

from __future__ import annotations

import hashlib
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, MapError
from iits_mj.core.tables import read_columns, read_names
from iits_mj.road import RoadMap
from iits_mj.road.converted import Terrain, with_arcs, with_terrain
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.opendrive import parse
from iits_mj.road.writer import to_xml
from iits_mj.road.xml_input import parse_xml, read_file
from traffic_bridge.network.nets import (
    ADVICE,
    cache_dir,
    netconvert_version,
    run_netconvert,
    unwritable,
)

OSM_ENDINGS = (".osm", ".osm.xml", ".osm.gz")
NET_ENDINGS = (".net.xml", ".net.xml.gz")
SOURCES = (".xodr", *OSM_ENDINGS, *NET_ENDINGS)
TERRAIN_ENDINGS = (".csv", ".tif", ".tiff")
SIZE_MAX = 512 * 2**20  # bytes of a source: a region of OpenStreetMap
NODE_SPACING = 25.0  # [m] between nodes that get a height from a GeoTIFF, at most
EARTH_RADIUS = 6_371_000.0  # [m]
REVISION = "1"  # of the changes that this module makes to a map; part of the cache key
_PLAIN = ("--no-turnarounds", "--xml-validation", "never")
# Curbs of 10 m let a truck turn; the other options are those that SUMO's manual proposes for OSM.
_OSM_OPTIONS = (
    *("--geometry.remove", "--ramps.guess", "--junctions.join", "--remove-edges.isolated"),
    *("--tls.guess-signals", "--tls.discard-simple", "--tls.join"),
    *("--keep-edges.by-vclass", "truck", "--output.street-names", "--osm.elevation"),
    *("--default.junctions.radius", "10"),
)


def opendrive_file(path: Path) -> Path:
    """Returns the OpenDRIVE file of a map: the file itself, or one in the cache made of it.

    Args:
      path: OpenDRIVE, an OpenStreetMap extract or a SUMO net, by the ending of its name.

    Raises:
      MapError: netconvert cannot use the source; the message has its reason.
      TrafficError: netconvert is missing or does not end, or the cache cannot be written.
    """
    if not is_source(path):
        return path
    content = read_file(path, SIZE_MAX)
    key = b" ".join((content, netconvert_version().encode(), REVISION.encode()))
    folder = cache_dir() / "converted"
    target = folder / f"{path.name}.{hashlib.sha256(key).hexdigest()[:16]}.xodr"
    if not target.is_file():
        text = to_xml(convert(path))
        partial = target.with_name(f"{target.name}.{os.getpid()}")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            partial.write_text(text, encoding="utf-8", newline="\n")
            partial.replace(target)
        except OSError as error:
            raise unwritable(folder, error) from error
    return target


def is_source(path: Path) -> bool:
    """Whether a file is an OpenStreetMap extract or a SUMO net, by the ending of its name."""
    return path.name.lower().endswith((*OSM_ENDINGS, *NET_ENDINGS))


def convert(
    path: Path, left_hand: bool = False, terrain: Path | None = None, along: str | None = None
) -> OpenDriveMap:
    """Returns a map of any supported format as OpenDRIVE records.

    Args:
      path: OpenDRIVE, an OpenStreetMap extract or a SUMO net, by the ending of its name.
      left_hand: OpenStreetMap roads are driven on the left; other sources say it themselves.
      terrain: heights of the roads, see `read_terrain`; or, for OpenStreetMap, a GeoTIFF with
        heights over longitude and latitude.
      along: the route on which the stations of a terrain lie; see `RoadMap.route`.

    Raises:
      InputError: the heights cannot be used.
      MapError: the map cannot be used; the message has the reason.
      TrafficError: netconvert is missing or does not end.
    """
    name = path.name.lower()
    if not name.endswith(SOURCES):
        raise InputError(f"{path}: a map's name ends with {', '.join(SOURCES)}")
    picture = terrain is not None and terrain.suffix.lower() in (".tif", ".tiff")
    if terrain is not None and terrain.suffix.lower() not in TERRAIN_ENDINGS:
        raise InputError(f"{terrain}: a file of heights ends with {', '.join(TERRAIN_ENDINGS)}")
    if not name.endswith(OSM_ENDINGS) and (picture or left_hand):
        wrong = "--heights with a GeoTIFF" if picture else "--left-hand"
        raise InputError(f"{path}: {wrong} is for OpenStreetMap extracts")
    if name.endswith(".xodr"):
        content = parse(read_file(path), str(path))
    else:
        content = _netconvert(path, left_hand, terrain if picture else None)
    if terrain is None or picture:
        return content
    return with_terrain(content, read_terrain(terrain, content, along))


def _netconvert(path: Path, left_hand: bool, picture: Path | None) -> OpenDriveMap:
    """Runs netconvert on an OpenStreetMap extract or a SUMO net."""
    with tempfile.TemporaryDirectory(prefix="iits_mj_") as folder:
        made = Path(folder) / "map.xodr"
        arguments = [*_PLAIN, "--output-file", str(Path(folder) / "unused.net.xml")]
        arguments += ["--opendrive-output", str(made), "--opendrive-output.lefthand-left"]
        if path.name.lower().endswith(NET_ENDINGS):
            arguments += ["--sumo-net-file", str(path.resolve())]
        else:
            source = path.resolve()
            if picture is not None:
                if not picture.is_file():
                    raise InputError(f"{picture}: there is no such file")
                source = Path(folder) / "dense.osm"
                source.write_bytes(dense_osm(read_file(path, SIZE_MAX), str(path)))
                arguments += ["--heightmap.geotiff", str(picture.resolve())]
            arguments += ["--osm-files", str(source), *_OSM_OPTIONS]
            arguments += ["--lefthand"] if left_hand else []
        run_netconvert(arguments, str(path))
        text = made.read_bytes() if made.is_file() else b""
    if b"<road " not in text:
        raise MapError(f"{path}: netconvert found no road that trucks may use{ADVICE}")
    content = parse(text, str(path))
    # netconvert writes one road for each direction, with left lanes for left-hand traffic.
    left = all(lane.id >= 0 for road in content.roads for lane in road.sections[0].lanes)
    roads = tuple(replace(road, left_hand=left) for road in content.roads)
    return with_arcs(replace(content, name=path.name, roads=roads))


def dense_osm(content: bytes, source: str) -> bytes:
    """Returns an OpenStreetMap extract with nodes at most `NODE_SPACING` apart on its roads.

    netconvert takes the heights of a GeoTIFF at nodes.

    Raises:
      MapError: it is no OpenStreetMap extract.
    """
    root = parse_xml(content, source)
    try:
        places = {
            node.attrib["id"]: np.array([float(node.attrib[name]) for name in ("lat", "lon")])
            for node in root.findall("node")
        }
        for way in root.findall("way"):
            if any(tag.get("k") == "highway" for tag in way.findall("tag")):
                _densify(root, way, places)
    except (KeyError, ValueError) as error:
        raise MapError(f"{source}: is no OpenStreetMap extract: {error}") from error
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _densify(root: Element, way: Element, places: dict[str, FloatArray]) -> None:
    """Puts nodes between those of a way; new ids are negative, as editors of OSM have them."""
    ends = [node.attrib["ref"] for node in way.findall("nd") if node.get("ref") in places]
    for node in way.findall("nd"):
        way.remove(node)
    for number, name in enumerate(ends):
        SubElement(way, "nd", ref=name)
        if number + 1 == len(ends):
            return
        start, step = places[name], places[ends[number + 1]] - places[name]
        shrink = np.array([1.0, np.cos(np.radians(start[0]))])
        distance = EARTH_RADIUS * float(np.hypot(*(np.radians(step) * shrink)))
        parts = int(np.ceil(distance / NODE_SPACING))
        for part in range(1, parts):
            latitude, longitude = start + step * (part / parts)
            identity = str(-len(places) - 1)
            places[identity] = np.array([latitude, longitude])
            SubElement(root, "node", id=identity, lat=repr(latitude), lon=repr(longitude))
            SubElement(way, "nd", ref=identity)


def read_terrain(path: Path, content: OpenDriveMap, along: str | None) -> Terrain:
    """Reads heights of a map from a CSV table with z_m over a place or over a station.

    Places are x_m and y_m of the map, or easting_m and northing_m of its projection; between them
    the height is linear on triangles, and outside them it is that of the nearest place. A station
    s_m is that of a route; every other point has the height of the nearest point of the route.

    Raises:
      InputError: the file cannot be read, has other columns, or places that are not near the map.
    """
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
