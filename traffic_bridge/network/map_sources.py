"""OpenStreetMap extracts and SUMO nets as OpenDRIVE maps, converted by netconvert."""

from __future__ import annotations

import hashlib
import os
import tempfile
from dataclasses import replace
from pathlib import Path

from iits_mj.core.errors import InputError, MapError, TrafficError
from iits_mj.road import RoadMap
from iits_mj.road.converted import with_arcs, with_terrain
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.opendrive import parse
from iits_mj.road.terrain import read_terrain
from iits_mj.road.writer import to_xml
from iits_mj.road.xml_input import read_file
from traffic_bridge.network.light_programs import read_programs
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
SIZE_MAX = 512 * 2**20  # bytes of a source: a region of OpenStreetMap
REVISION = "2"  # of the changes that this module makes to a map; part of the cache key
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


def read_map(path: Path) -> RoadMap:
    """Returns a map of any supported format; messages name its own file.

    Raises:
      MapError, TrafficError: as `opendrive_file`.
    """
    return RoadMap.from_opendrive(opendrive_file(path), str(path))


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
      terrain: file with heights of the roads, see `read_terrain`.
      along: the route on which the stations of a terrain lie; see `RoadMap.route`.

    Raises:
      InputError: the heights cannot be used.
      MapError: the map cannot be used; the message has the reason.
      TrafficError: netconvert is missing or does not end.
    """
    name = path.name.lower()
    if not name.endswith(SOURCES):
        raise InputError(f"{path}: a map's name ends with {', '.join(SOURCES)}")
    if left_hand and not name.endswith(OSM_ENDINGS):
        raise InputError(f"{path}: --left-hand is for OpenStreetMap extracts")
    if name.endswith(".xodr"):
        content = parse(read_file(path), str(path))
    else:
        read_file(path, SIZE_MAX)
        content = _netconvert(path, left_hand)
    if terrain is None:
        return content
    return with_terrain(content, read_terrain(terrain, content, along))


def _netconvert(path: Path, left_hand: bool) -> OpenDriveMap:
    """Runs netconvert on an OpenStreetMap extract or a SUMO net."""
    with tempfile.TemporaryDirectory(prefix="iits_mj_") as folder:
        made = Path(folder) / "map.xodr"
        arguments = [*_PLAIN, "--output-file", str(Path(folder) / "unused.net.xml")]
        arguments += ["--opendrive-output", str(made), "--opendrive-output.lefthand-left"]
        if path.name.lower().endswith(NET_ENDINGS):
            arguments += ["--sumo-net-file", str(path.resolve())]
        else:
            arguments += ["--osm-files", str(path.resolve()), *_OSM_OPTIONS]
            arguments += ["--lefthand"] if left_hand else []
        try:
            run_netconvert(arguments, str(path))
        except (MapError, TrafficError) as error:
            raise type(error)(str(error).removesuffix(ADVICE)) from error
        text = made.read_bytes() if made.is_file() else b""
    if b"<road " not in text:
        raise MapError(f"{path}: netconvert found no road that trucks may use")
    found = parse(text, str(path))
    # netconvert writes one road for each direction, with left lanes for left-hand traffic.
    left = all(lane.id >= 0 for road in found.roads for lane in road.sections[0].lanes)
    roads = tuple(replace(road, left_hand=left) for road in found.roads)
    is_net = path.name.lower().endswith(NET_ENDINGS)
    programs = read_programs(path, SIZE_MAX) if is_net else ()
    return with_arcs(replace(found, name=path.name, roads=roads, light_programs=programs))
