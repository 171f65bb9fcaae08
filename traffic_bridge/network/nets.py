"""Map network: from a RoadMap to the SUMO net, made by netconvert and kept in a cache."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from iits_mj.errors import InputError, MapError, TrafficError
from iits_mj.road import RoadMap, Route
from iits_mj.road.road_map import MAPS
from iits_mj.road.route import USABLE_LANE_WIDTH
from traffic_bridge.network.map_repair import opendrive_for_netconvert
from traffic_bridge.network.netconvert import find_netconvert, netconvert_version, run_netconvert

__all__ = ["Network", "build_network", "cache_dir", "find_netconvert", "lane_kinds"]

CACHE_VARIABLE = "IITS_MJ_CACHE"

# [m/s2] across, at most, in a turn: what drivers take at junctions in town (judgement).
TURN_ACCELERATION = 3.0
# What makes netconvert's net agree with the exact geometry within 0.02 m, names the OpenDRIVE lanes
# it was made of, and lets nobody turn round at ends.
OPENDRIVE_OPTIONS = (
    "--no-turnarounds",
    "--output.original-names",
    "--opendrive.internal-shapes",
    "--opendrive.curve-resolution",
    "1",
    "--geometry.max-grade",
    "30",
    "--junctions.limit-turn-speed",
    str(TURN_ACCELERATION),
    "--precision",
    "3",
)
REVISION = "2"  # of what we do to nets after netconvert: raised when that changes
_SEAL = "<!-- sha256 "


@dataclass(frozen=True)
class Network:
    """A SUMO net file and where its coordinates lie.

    Attributes:
      path: of the `.net.xml` file.
      offset: what SUMO adds to the map's x and y [m].
    """

    path: Path
    offset: tuple[float, float]


def cache_dir() -> Path:
    """Folder for nets made once: $IITS_MJ_CACHE, else iits_mj in the user's cache folder."""
    if os.environ.get(CACHE_VARIABLE):
        return Path(os.environ[CACHE_VARIABLE]).expanduser()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "iits_mj"


def build_network(source: RoadMap | Route) -> Network:
    """The SUMO net of a map (of a route's map): shipped, cached or made now.

    A cached net belongs to the map's content, netconvert's version and our options; a file that was
    damaged since is made again. Processes that make one net at once each write their own file and
    move it into place whole.

    Raises:
      InputError: it is neither a map nor a route.
      MapError: netconvert cannot use the map; the message gives its reason.
      TrafficError: netconvert is missing or the cache folder cannot be written.
    """
    road_map = source.road_map if isinstance(source, Route) else source
    if not isinstance(road_map, RoadMap):
        raise InputError(f"a network is made of a RoadMap or a Route, not of {source!r}")
    shipped = road_map.path.with_suffix(".net.xml")
    # Only the maps that come with the package bring a net that is sure to belong to them.
    if road_map.path.resolve().parent == MAPS.resolve() and shipped.is_file():
        return Network(shipped, _net_offset(shipped))
    content = opendrive_for_netconvert(road_map)
    target = _cached_file(content)
    if not _is_whole(target):
        _make(content, target, str(road_map.path))
    return Network(target, _net_offset(target))


def lane_kinds(net: Path) -> dict[str, str]:
    """OpenDRIVE's type of every lane of a net ("driving", "stop" ...), where the net has it."""
    kinds = {}
    for _, element in ElementTree.iterparse(net, events=("start",)):
        if element.tag == "lane" and element.get("type"):
            kinds[element.get("id", "")] = element.get("type", "")
    return kinds


def _cached_file(content: bytes) -> Path:
    made_by = " ".join((*OPENDRIVE_OPTIONS, netconvert_version(), REVISION))
    key = content + made_by.encode()
    folder = cache_dir() / "nets"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from error
    return folder / f"{hashlib.sha256(key).hexdigest()[:32]}.net.xml"


def _unwritable(folder: Path, error: OSError) -> TrafficError:
    return TrafficError(
        f"cannot write to the cache folder {folder} ({error.strerror}); "
        f"set {CACHE_VARIABLE} to a folder that can be written"
    )


def _is_whole(net: Path) -> bool:
    """Whether a cached file is there and still what was written: it ends with its own hash."""
    try:
        body, seal, digest = net.read_bytes().rpartition(_SEAL.encode())
    except OSError:
        return False
    return bool(seal) and digest.split()[:1] == [hashlib.sha256(body).hexdigest().encode()]


def _make(content: bytes, target: Path, name: str) -> None:
    try:
        # Beside the target, so that it can be moved there in one go.
        folder = tempfile.TemporaryDirectory(dir=target.parent, prefix="making_")
    except OSError as error:
        raise _unwritable(target.parent, error) from error
    with folder:
        source, made = Path(folder.name) / "map.xodr", Path(folder.name) / "made.net.xml"
        source.write_bytes(content)
        arguments = ["--opendrive", str(source), *OPENDRIVE_OPTIONS, "--output-file", str(made)]
        run_netconvert(arguments, name)
        text = made.read_text(encoding="utf-8") if made.is_file() else ""
        if "<edge " not in text:
            raise MapError(f"{name}: netconvert found no road in the map that cars may use")
        # The leading comment holds date and paths: a net made again must be the same.
        text = re.sub(r"<!--.*?-->\s*", "", text, count=1, flags=re.DOTALL)
        text = re.sub(r"<lane [^>]*>", _close_if_narrow, text)
        digest = hashlib.sha256(text.encode()).hexdigest()
        made.write_text(f"{text}{_SEAL}{digest} -->\n", encoding="utf-8", newline="\n")
        made.replace(target)


def _close_if_narrow(lane: re.Match[str]) -> str:
    """A lane that is still opening or closing is nobody's: there is no room beside the next."""
    width = re.search(r'\bwidth="([^"]*)"', lane[0])
    if width is None or float(width[1]) >= USABLE_LANE_WIDTH:
        return lane[0]
    bare = re.sub(r' (dis)?allow="[^"]*"', "", lane[0])
    return bare.replace("<lane ", '<lane disallow="all" ', 1)


def _net_offset(net: Path) -> tuple[float, float]:
    """`netOffset` of a net file.

    Raises:
      TrafficError: the file is not a SUMO net.
    """
    try:
        for _, element in ElementTree.iterparse(net, events=("start",)):
            if element.tag == "location":
                x, y = (float(value) for value in element.get("netOffset", "").split(","))
                return x, y
    except (ElementTree.ParseError, ValueError, OSError) as error:
        raise TrafficError(f"{net}: not a SUMO network: {error}") from error
    raise TrafficError(f"{net}: not a SUMO network: it has no <location netOffset=...>")
