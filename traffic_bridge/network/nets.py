"""Makes the SUMO net of a map with netconvert and keeps it in a cache."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from xml.etree import ElementTree

from iits_mj.core.cache import CACHE_VARIABLE, cache_folder
from iits_mj.core.errors import InputError, MapError, TrafficError
from iits_mj.core.progress import remark
from iits_mj.road import RoadMap, Route
from iits_mj.road.route import MAPS, USABLE_LANE_WIDTH
from traffic_bridge.network.light_programs import with_programs, without_misplaced_lights
from traffic_bridge.network.net_file import ORIGIN, WALKER, NetFile
from traffic_bridge.network.netconvert_input import BRIDGE, opendrive_for_netconvert
from traffic_bridge.network.stop_lines import stop_offsets
from traffic_bridge.network.walkways import (
    OPTIONS as WALKWAY_OPTIONS,
)
from traffic_bridge.network.walkways import (
    has_sidewalks,
    lines_before,
    read_crossings,
    with_painted_crossings,
    with_vehicle_lanes,
)

TIMEOUT = 120.0  # [s]; the largest test map takes 0.3 s
MEMORY_MAX = 4 * 2**30  # bytes of netconvert
TURN_ACCELERATION = 3.0  # [m/s2] lateral, accepted by drivers at junctions in town (judgement)
# With these options the net agrees with the exact geometry within 0.02 m, names the OpenDRIVE lane
# of each of its lanes, and has no U-turns at the ends of roads.
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
REVISION = "5"  # of the changes that this module makes to a net; part of the cache key
WALKWAY_REVISION = "5"  # the same, of nets with walkways
ADVICE = "; a drive with traffic-mode none needs no net"
_OTHER_TURNS = {"l": "r", "r": "l", "L": "R", "R": "L"}
_SEAL = "<!-- sha256 "


def cache_dir() -> Path:
    """The folder of cached nets: $IITS_MJ_CACHE, else iits_mj in the user's cache folder."""
    folder = cache_folder()
    if folder is None:
        raise TrafficError(
            f"there is no home folder for cached nets; set {CACHE_VARIABLE} to a folder"
        )
    return folder


def build_network(source: RoadMap | Route, whole: bool = True, walkways: bool = False) -> NetFile:
    """Returns the SUMO net of a map (or a route's map): shipped, cached or newly made.

    If netconvert refuses the map of a route, and the net need not be `whole`, the net has the
    roads of the route only. A net with `walkways` has sidewalks and crossings for pedestrians.

    A cached net belongs to the map's content, netconvert's version and the options used; a damaged
    file is made again. Processes that make the same net at the same time each write their own file
    and move it into place.

    Raises:
      InputError: `source` is neither a map nor a route, or has no sidewalks for `walkways`.
      MapError: netconvert cannot use the map; the message states its reason.
      TrafficError: netconvert is missing, the cache folder cannot be written, or the net file
        cannot be read.
    """
    road_map = source.road_map if isinstance(source, Route) else source
    if not isinstance(road_map, RoadMap):
        raise InputError(f"a network is made of a RoadMap or a Route, not of {source!r}")
    if walkways:
        if not any(map(has_sidewalks, road_map.roads.values())):
            raise InputError(f"pedestrians need sidewalks: {road_map.name} has no sidewalk lanes")
        return NetFile.read(_net_file(road_map, None, walkways=True))
    shipped = road_map.path.with_suffix(".net.xml")
    # Only a net shipped with the package certainly belongs to the map in the same folder.
    if road_map.path.resolve().parent == MAPS.resolve() and shipped.is_file():
        return NetFile.read(shipped)
    if whole or not isinstance(source, Route):
        return NetFile.read(_net_file(road_map, None))
    try:
        return NetFile.read(_net_file(road_map, None))
    except MapError as error:
        roads = {part.road_id for part in source.segments}
        try:
            target = _net_file(road_map, roads)
        except MapError:
            raise error from None
        remark(f"{str(error).removesuffix(ADVICE)}; the traffic has the roads of the route only")
        return NetFile.read(target)


def _net_file(road_map: RoadMap, only: set[str] | None, walkways: bool = False) -> Path:
    """The net of a map, or of some of its roads, in the cache."""
    content = opendrive_for_netconvert(road_map, only)
    target = _cached_file(content, road_map.left_hand, walkways)
    if not _is_whole(target):
        _make(content, road_map.left_hand, target, road_map, walkways)
    return target


def _cached_file(content: bytes, left_hand: bool, walkways: bool) -> Path:
    extra = (*WALKWAY_OPTIONS, WALKWAY_REVISION) if walkways else ()
    made_by = " ".join((*OPENDRIVE_OPTIONS, netconvert_version(), REVISION, str(left_hand), *extra))
    key = content + made_by.encode()
    folder = cache_dir() / "nets"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    return folder / f"{hashlib.sha256(key).hexdigest()[:32]}.net.xml"


def unwritable(folder: Path, error: OSError) -> TrafficError:
    """The error for a cache folder that cannot be written."""
    return TrafficError(
        f"cannot write to the cache folder {folder} ({error.strerror}); "
        f"set {CACHE_VARIABLE} to a folder that can be written"
    )


def _is_whole(net: Path) -> bool:
    """Whether a cached file exists and ends with the hash of its content."""
    try:
        body, seal, digest = net.read_bytes().rpartition(_SEAL.encode())
    except OSError:
        return False
    return bool(seal) and digest.split()[:1] == [hashlib.sha256(body).hexdigest().encode()]


def _make(content: bytes, left_hand: bool, target: Path, road_map: RoadMap, walkways: bool) -> None:
    name = road_map.name
    try:
        # In the target's folder, so that the file can be moved in one operation.
        folder = tempfile.TemporaryDirectory(dir=target.parent, prefix="making_")
    except OSError as error:
        raise unwritable(target.parent, error) from error
    with folder:
        source, made = Path(folder.name) / "map.xodr", Path(folder.name) / "made.net.xml"
        source.write_bytes(content)
        text = _converted(source, made, name)
        if walkways:
            text = with_vehicle_lanes(_converted(source, made, name, WALKWAY_OPTIONS), text, name)
        text = with_programs(text, road_map.content.light_programs, road_map.roads)
        if left_hand:
            text = _mirrored(text)
        text = without_misplaced_lights(text, road_map.roads)
        if walkways:
            text = with_painted_crossings(text, road_map.roads)
        # Lanes through a direct junction belong to no road of the map.
        text = re.sub(rf'\s*<param key="{ORIGIN}" value="{BRIDGE}[^"]*" ?/>', "", text)
        made.write_text(text, encoding="utf-8", newline="\n")
        net = NetFile.read(made)
        offsets = stop_offsets(net, road_map.roads)
        if walkways:
            lines = lines_before(net, read_crossings(made, road_map.roads))
            offsets |= {lane: max(line, offsets.get(lane, 0.0)) for lane, line in lines.items()}
        text = re.sub(r'<lane id="([^"]*)"[^>]*?(/?)>', partial(_with_stop_line, offsets), text)
        digest = hashlib.sha256(text.encode()).hexdigest()
        made.write_text(f"{text}{_SEAL}{digest} -->\n", encoding="utf-8", newline="\n")
        made.replace(target)


def _converted(source: Path, made: Path, name: str, options: Sequence[str] = ()) -> str:
    """The net that netconvert makes of an OpenDRIVE file, with narrow lanes closed."""
    arguments = ["--opendrive", str(source), *OPENDRIVE_OPTIONS, *options]
    run_netconvert([*arguments, "--output-file", str(made)], name)
    text = made.read_text(encoding="utf-8") if made.is_file() else ""
    if "<edge " not in text:
        raise MapError(f"{name}: netconvert found no road in the map that cars may use{ADVICE}")
    # The leading comment holds a date and paths; without it one map gives one file.
    text = re.sub(r"<!--.*?-->\s*", "", text, count=1, flags=re.DOTALL)
    return re.sub(r"<lane [^>]*>", _close_if_narrow, text)


def _mirrored(text: str) -> str:
    """The net of a mirrored map as a net with left-hand traffic at the map's own place.

    netconvert's own left-hand nets have other shapes inside junctions than the map.
    """
    root = ElementTree.fromstring(text)
    root.set("lefthand", "true")
    for element in root.iter():
        for key in ("shape", "outlineShape"):
            if shape := element.get(key):
                element.set(key, " ".join(map(_below, shape.split())))
        if element.tag == "junction":
            element.set("y", _opposite(element.attrib["y"]))
        elif element.tag == "connection":
            element.set("dir", _OTHER_TURNS.get(element.attrib["dir"], element.attrib["dir"]))
        elif element.tag == "location":
            element.set("netOffset", _below(element.attrib["netOffset"]))
            left, low, right, high = element.attrib["convBoundary"].split(",")
            element.set("convBoundary", f"{left},{_opposite(high)},{right},{_opposite(low)}")
        elif element.tag == "param" and element.get("key") == ORIGIN:
            names = (name.rpartition("_") for name in element.attrib["value"].split())
            element.set("value", " ".join(f"{road}_{-int(lane)}" for road, _, lane in names))
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _below(point: str) -> str:
    """A point "x,y" or "x,y,z" on the other side of the x axis."""
    x, y, *z = point.split(",")
    return ",".join((x, _opposite(y), *z))


def _opposite(number: str) -> str:
    return number[1:] if number.startswith("-") else f"-{number}"


def _with_stop_line(offsets: Mapping[str, float], lane: re.Match[str]) -> str:
    """Adds the distance of its stop line to a lane."""
    offset = offsets.get(lane[1])
    if offset is None:
        return lane[0]
    stop = f'<stopOffset value="{offset:.2f}"/>'
    if lane[2]:
        return f"{lane[0][:-2]}>{stop}</lane>"
    return lane[0] + stop


def _close_if_narrow(lane: re.Match[str]) -> str:
    """Closes a lane where it opens or ends and is too narrow for a vehicle."""
    width = re.search(r'\bwidth="([^"]*)"', lane[0])
    walkway = f'allow="{WALKER}"' in lane[0]
    if width is None or walkway or float(width[1]) >= USABLE_LANE_WIDTH:
        return lane[0]
    bare = re.sub(r' (dis)?allow="[^"]*"', "", lane[0])
    return bare.replace("<lane ", '<lane disallow="all" ', 1)


def find_netconvert() -> Path:
    """Path of netconvert: in this Python environment, on PATH, or in the package eclipse-sumo.

    The package is in the extra `maps`.

    Raises:
      TrafficError: netconvert is not installed.
    """
    own = Path(sys.prefix) / "bin" / "netconvert"
    if own.is_file():
        return own
    found = shutil.which("netconvert")
    if found:
        return Path(found)
    package = importlib.util.find_spec("sumo")
    for location in (package.submodule_search_locations or ()) if package else ():
        candidate = Path(location) / "bin" / "netconvert"
        if candidate.is_file():
            return candidate
    raise TrafficError(
        "netconvert is missing: SUMO needs it to read a map other than the built-in highway; "
        f"install it with: pip install 'iits-mj[maps]'{ADVICE}"
    )


@cache
def netconvert_version() -> str:
    """Version of netconvert as text."""
    first = run_netconvert(["--version"]).splitlines()
    match = re.search(r"Version\s+(\S+)", " ".join(first[:2]))
    return match.group(1) if match else "unknown"


def run_netconvert(arguments: list[str], name: str = "netconvert") -> str:
    """Runs netconvert and returns its output; `name` is the map's name in errors.

    Raises:
      MapError: its exit code or its messages report a failure.
      TrafficError: it is missing, does not end in time, or needs more than `MEMORY_MAX`.
    """
    # The shell sets the limit before netconvert begins.
    limited = f'ulimit -v {MEMORY_MAX // 1024}; exec "$@"'
    command = ["/bin/sh", "-c", limited, "sh", str(find_netconvert()), *arguments]
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise TrafficError(
            f"{name}: SUMO's netconvert did not finish this map within {TIMEOUT:g} s{ADVICE}"
        ) from error
    except OSError as error:
        raise TrafficError(f"{name}: netconvert cannot be run: {error}") from error
    if "bad_alloc" in result.stderr:
        raise TrafficError(
            f"{name}: SUMO's netconvert needs more than {MEMORY_MAX >> 30} GB for this map{ADVICE}"
        )
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error:")]
    if result.returncode != 0 or errors:
        told = (line.removeprefix("Error:").strip().rstrip(".") for line in errors)
        reason = "; ".join(dict.fromkeys(told))
        raise MapError(
            f"{name}: SUMO's netconvert cannot use the map: "
            f"{reason or result.stderr.strip() or f'exit code {result.returncode}'}"[:600]
            + ADVICE
        )
    return result.stdout
