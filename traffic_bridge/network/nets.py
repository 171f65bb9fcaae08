"""Map network: from a RoadMap to the SUMO net, made by netconvert and kept in a cache."""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree.ElementTree import Element

from iits_mj.core.errors import InputError, MapError, TrafficError
from iits_mj.road import RoadMap, Route
from iits_mj.road.elements import Lane, LaneSection, Road
from iits_mj.road.route import MAPS, USABLE_LANE_WIDTH
from iits_mj.road.writer import to_xml
from iits_mj.road.xml_input import content_hash, parse_xml, read_file

# --- SUMO's netconvert: found, run, and its refusals told in one sentence ---

TIMEOUT = 120.0  # [s]; the largest of our test maps takes 0.3 s.


def find_netconvert() -> Path:
    """The netconvert program: of this Python environment, of PATH, or of the eclipse-sumo package.

    Raises:
      TrafficError: there is none.
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
        "netconvert is missing: SUMO needs it to read a map; install it with: "
        "pip install eclipse-sumo"
    )


@cache
def netconvert_version() -> str:
    """Version of netconvert, as text."""
    first = run_netconvert(["--version"]).splitlines()
    match = re.search(r"Version\s+(\S+)", " ".join(first[:2]))
    return match.group(1) if match else "unknown"


def run_netconvert(arguments: list[str], name: str = "netconvert") -> str:
    """Runs netconvert and returns what it prints; `name` is the map's in errors.

    Raises:
      MapError: its exit code or its messages say that it failed.
      TrafficError: it is missing, or did not end in time.
    """
    command = [str(find_netconvert()), *arguments]
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise TrafficError(f"{name}: netconvert cannot be run: {error}") from error
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error:")]
    if result.returncode != 0 or errors:
        reason = "; ".join(dict.fromkeys(line.removeprefix("Error:").strip() for line in errors))
        raise MapError(
            f"{name}: SUMO's netconvert cannot use the map: "
            f"{reason or result.stderr.strip() or f'exit code {result.returncode}'}"[:600]
        )
    return result.stdout


# --- What of a map has to be said otherwise before netconvert reads it as we do ---
# netconvert reads limits of lanes only, not of roads; takes an empty `junction` for a number;
# ignores a limit that is none; and dies on direct junctions. The geometry stays as it is.

UNLIMITED = 70.0  # [m/s], what SUMO is told where a road has no limit


def opendrive_for_netconvert(road_map: RoadMap) -> bytes:
    """The map as OpenDRIVE that netconvert reads rightly; made from memory where it has no file.

    Raises:
      MapError: the file cannot be read any more, or has changed since the map was read, or has
        direct junctions.
    """
    if road_map.path.is_file():
        content = read_file(road_map.path)
        _check_unchanged(road_map, content)
    else:
        content = to_xml(road_map.content).encode()
    root = parse_xml(content, str(road_map.path))
    for junction in root.findall("junction"):
        if junction.get("type") == "direct":
            raise MapError(
                f"{road_map.path}: the map has direct junctions (OpenDRIVE 1.7), "
                "which SUMO's netconvert cannot read; drive it without traffic or use another map"
            )
    for item in root.findall("road"):
        # An empty attribute means "in no junction", but netconvert wants the number.
        if not item.get("junction", "").strip():
            item.set("junction", "-1")
        road = road_map.roads.get(item.get("id", ""))
        if road is not None:
            _set_speeds(item, road)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _check_unchanged(road_map: RoadMap, content: bytes) -> None:
    if content_hash(content) != road_map.content_hash:
        raise MapError(
            f"{road_map.path}: the file has changed since the map was read; read it anew"
        )


def _set_speeds(item: Element, road: Road) -> None:
    """Writes the limit of every driving lane into the lane itself, in m/s."""
    sections = sorted(item.iter("laneSection"), key=lambda section: float(section.get("s", "0")))
    # A section that begins beyond the road's end is in the file only.
    for element, (start, end, section) in zip(sections, road.section_spans(), strict=False):
        for lane_item in element.iter("lane"):
            lane = section.lane(int(lane_item.get("id", "0")))
            if lane is None or not lane.is_driving or lane.id == 0:
                continue
            speeds = _speeds(road, section, lane, start, end)
            if not speeds:
                continue
            for old in lane_item.findall("speed"):
                lane_item.remove(old)
            for offset, limit in speeds:
                value = f"{UNLIMITED if math.isinf(limit) else min(limit, UNLIMITED):.6g}"
                ElementTree.SubElement(
                    lane_item, "speed", {"sOffset": repr(offset), "max": value, "unit": "m/s"}
                )


def _speeds(
    road: Road, section: LaneSection, lane: Lane, start: float, end: float
) -> list[tuple[float, float]]:
    """(distance from the section's start [m], limit [m/s]): the lane's own, else the road's.

    A road inside a junction that says nothing is left alone: netconvert takes the limits of the
    roads before and after it, and what its bend allows.
    """
    if lane.speeds:
        return list(lane.speeds)
    if not road.types and road.junction is not None:
        return []
    inner = [record.s for record in road.types if start < record.s < end]
    return [(s - section.s, road.speed_at(s)) for s in (start, *inner)]


# --- Map network: from a RoadMap to the SUMO net, made by netconvert and kept in a cache ---

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
