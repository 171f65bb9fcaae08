"""Map network: from a RoadMap or Route to the SUMO net, made by netconvert and kept in a cache."""

from __future__ import annotations

import hashlib
import importlib.util
import itertools
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

import numpy as np

from iits_mj.errors import MapError, TrafficError
from iits_mj.road import RoadMap, Route

CACHE_VARIABLE = "IITS_MJ_CACHE"
TIMEOUT = 120.0  # [s] for netconvert; the largest of our test maps takes 0.3 s.

# What makes netconvert's net agree with the exact geometry within 0.02 m; no turning round at ends.
OPENDRIVE_OPTIONS = (
    "--no-turnarounds",
    "--opendrive.curve-resolution",
    "1",
    "--geometry.max-grade",
    "30",
)
# Distance between shape points of a net made from a route's own geometry [m].
SHAPE_SPACING = 10.0


@dataclass(frozen=True)
class Network:
    """A SUMO net file and where its coordinates lie.

    Attributes:
      path: of the `.net.xml` file.
      offset: what SUMO adds to the map's x and y [m].
      route_edges: ids of the edges along the route where the net was made from the route itself;
        empty where the edges are to be found by the road's ids.
    """

    path: Path
    offset: tuple[float, float]
    route_edges: tuple[str, ...] = ()


def cache_dir() -> Path:
    """Folder for nets made once: $IITS_MJ_CACHE, else iits_mj in the user's cache folder."""
    if os.environ.get(CACHE_VARIABLE):
        return Path(os.environ[CACHE_VARIABLE]).expanduser()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "iits_mj"


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
    first = _run([str(find_netconvert()), "--version"]).splitlines()
    match = re.search(r"Version\s+(\S+)", " ".join(first[:2]))
    return match.group(1) if match else "unknown"


def build_network(route: Route) -> Network:
    """The SUMO net of a route's map: shipped, cached or made now.

    Raises:
      MapError: netconvert cannot use the map; the message gives its reason.
      TrafficError: netconvert is missing or the cache folder cannot be written.
    """
    road_map = route.road_map
    if not road_map.path.is_file():
        return _network_of_geometry(route)
    shipped = road_map.path.with_suffix(".net.xml")
    if shipped.is_file() and _is_packaged(road_map):
        return Network(shipped, _net_offset(shipped))
    target = _cached_file(f"{road_map.content_hash}-{' '.join(OPENDRIVE_OPTIONS)}")
    if not target.is_file():
        _convert_opendrive(road_map, target)
    return Network(target, _net_offset(target))


def _is_packaged(road_map: RoadMap) -> bool:
    """Only the maps that come with the package bring a net that is sure to belong to them."""
    from iits_mj.road.road_map import MAPS

    return road_map.path.resolve().parent == MAPS.resolve()


def _cached_file(key: str) -> Path:
    digest = hashlib.sha256(f"{key}-{netconvert_version()}".encode()).hexdigest()
    folder = cache_dir() / "nets"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrafficError(
            f"cannot make the cache folder {folder} ({error.strerror}); "
            f"set {CACHE_VARIABLE} to a folder that can be written"
        ) from error
    return folder / f"{digest[:32]}.net.xml"


def _convert_opendrive(road_map: RoadMap, target: Path) -> None:
    text = road_map.path.read_text(encoding="utf-8", errors="replace")
    if re.search(r"<junction\b[^>]*\btype\s*=\s*[\"']direct[\"']", text):
        raise MapError(
            f"{road_map.path}: the map has direct junctions (OpenDRIVE 1.7), "
            "which SUMO's netconvert cannot read; drive it without traffic or use another map"
        )
    # An empty junction attribute means "in no junction" but netconvert wants the number.
    text = re.sub(r"\bjunction\s*=\s*([\"'])\1", 'junction="-1"', text)
    with tempfile.TemporaryDirectory(prefix="iits_mj_net_") as folder:
        source = Path(folder) / "map.xodr"
        source.write_text(text, encoding="utf-8")
        command = ["--opendrive", str(source), *OPENDRIVE_OPTIONS]
        _netconvert(command, target, str(road_map.path))


def _network_of_geometry(route: Route) -> Network:
    """A net of one edge per stretch with a constant number of lanes, from the route's own shape."""
    starts = sorted({*route.section_starts(), 0.0})
    nodes, edges, names = [], [], []
    for index, (start, end) in enumerate(itertools.pairwise([*starts, route.length])):
        middle = 0.5 * (start + end)
        lanes = route.lane_count(middle)
        count = max(2, int((end - start) / SHAPE_SPACING) + 1)
        station = np.linspace(start, end, count)
        right = route.boundary_offset(0, station)
        left = route.boundary_offset(lanes, station)
        point = route.evaluate(station, 0.5 * (right + left))
        keep = _corners(point.x, point.y)
        shape = " ".join(
            f"{x:.3f},{y:.3f}" for x, y in zip(point.x[keep], point.y[keep], strict=True)
        )
        names.append(f"route#{index}")
        limit = min(route.speed_limit(middle), 70.0)
        nodes.append((f"n{index}", point.x[0], point.y[0]))
        edges.append(
            f'<edge id="{names[-1]}" from="n{index}" to="n{index + 1}" numLanes="{lanes}" '
            f'width="{float(np.mean(left - right)) / lanes:.3f}" speed="{limit:.3f}" '
            f'spreadType="center" shape="{shape}"/>'
        )
    nodes.append((f"n{len(edges)}", point.x[-1], point.y[-1]))
    node_text = "".join(f'<node id="{n}" x="{x:.3f}" y="{y:.3f}"/>' for n, x, y in nodes)
    texts = (f"<nodes>{node_text}</nodes>", f"<edges>{''.join(edges)}</edges>")
    target = _cached_file("".join(texts))
    if not target.is_file():
        with tempfile.TemporaryDirectory(prefix="iits_mj_net_") as folder:
            files = [Path(folder) / "route.nod.xml", Path(folder) / "route.edg.xml"]
            for file, text in zip(files, texts, strict=True):
                file.write_text(text, encoding="utf-8")
            command = ["-n", str(files[0]), "-e", str(files[1]), "--no-turnarounds"]
            _netconvert(command, target, str(route.road_map.path))
    return Network(target, _net_offset(target), tuple(names))


def _corners(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Indices of the points that are needed to keep a polyline's shape within a millimetre."""
    keep = [0]
    for i in range(1, len(x) - 1):
        dx, dy = x[i + 1] - x[keep[-1]], y[i + 1] - y[keep[-1]]
        across = abs((x[i] - x[keep[-1]]) * dy - (y[i] - y[keep[-1]]) * dx) / np.hypot(dx, dy)
        if across > 1e-3:
            keep.append(i)
    return np.array([*keep, len(x) - 1])


def _netconvert(arguments: list[str], target: Path, name: str) -> None:
    # Written beside the target and moved there, so that a second process never reads half a file.
    with tempfile.TemporaryDirectory(dir=target.parent, prefix="making_") as folder:
        made = Path(folder) / "made.net.xml"
        _run([str(find_netconvert()), *arguments, "--output-file", str(made)], name)
        if not made.is_file() or b"<edge " not in made.read_bytes():
            raise MapError(f"{name}: netconvert found no road in the map that cars may use")
        made.replace(target)


def _run(command: list[str], name: str = "netconvert") -> str:
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


def lane_kinds(net: Path) -> dict[str, str]:
    """OpenDRIVE's type of every lane of a net ("driving", "stop" ...), where the net has it."""
    kinds = {}
    for _, element in ElementTree.iterparse(net, events=("start",)):
        if element.tag == "lane" and element.get("type"):
            kinds[element.get("id", "")] = element.get("type", "")
    return kinds
