"""Reader of SUMO's floating-car data (`--fcd-output`): XML, CSV or Parquet, also compressed.

`Trajectories` lie on one road: the chain of edges that most vehicles drive. The stations come from
the data: the distance that vehicles drive from one edge to the next gives the distance between the
beginnings of the edges.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import BoolArray, FloatArray, IndexArray, IntArray
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import open_packed
from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.table import Table
from traffic_bridge.datasets.trajectories import Trajectories
from traffic_bridge.vehicles.types import KINDS, default_types

MISFIT = 5.0  # [m]: tolerance between the positions of a side edge from its two ends
LANE_WIDTH = 3.2  # [m], SUMO's default
MARKS = ("timestep_time", "vehicle_id", "vehicle_pos", "vehicle_lane")
_ATTRIBUTES = ("id", "type", "speed", "pos", "lane", "acceleration", "posLat", "leaderID")

Step = tuple[int, int]
Size = tuple[str, float, float]
UNKNOWN: Size = ("car", 5.0, 1.8)  # SUMO's default passenger car


def _stations_along(
    name: NDArray[np.str_],
    time: FloatArray,
    edge: NDArray[np.str_],
    position: FloatArray,
    speed: FloatArray,
) -> tuple[FloatArray, BoolArray, tuple[str, ...]]:
    """Stations along the chain of edges that most vehicles drive; rows on it; notes in words."""
    edges, number = np.unique(edge, return_inverse=True)
    ways = _ways(name, time, number.astype(np.int64), position, speed)
    count = Counter({step: len(found) for step, found in ways.items()})
    length = {step: float(np.median(found)) for step, found in ways.items()}
    chain = _chain(int(np.bincount(number).argmax()), count)
    begin = {chain[0]: 0.0}
    for a, b in itertools.pairwise(chain):
        begin[b] = begin[a] + length[a, b]
    _add_skipped(begin, length)
    table = np.array([begin.get(e, np.nan) for e in range(len(edges))])
    station = table[number] + position
    keep = np.isfinite(station)
    left_out = len(edges) - len(begin)
    notes = (
        f"{int((~keep).sum())} rows on {left_out} edges beside the most driven chain of "
        f"{len(begin)} are left out",
    )
    return np.where(keep, station, 0.0), keep, notes if left_out else ()


def _ways(
    name: NDArray[np.str_],
    time: FloatArray,
    edge: IntArray,
    position: FloatArray,
    speed: FloatArray,
) -> dict[Step, list[float]]:
    """Distances between the beginnings of two edges, from each vehicle that passed both."""
    _, vehicle = np.unique(name, return_inverse=True)
    order = np.lexsort((time, vehicle))
    gaps, same = np.diff(time[order]), np.diff(vehicle[order]) == 0
    usual = float(np.median(gaps[same])) if same.any() else 0.0
    passed = same & (np.diff(edge[order]) != 0) & (gaps < 1.5 * usual)
    a, b = order[:-1][passed], order[1:][passed]
    driven = 0.5 * (speed[a] + speed[b]) * gaps[passed]
    ways: dict[Step, list[float]] = {}
    for k, way in enumerate((position[a] + driven - position[b]).tolist()):
        ways.setdefault((int(edge[a[k]]), int(edge[b[k]])), []).append(way)
    return ways


def _chain(start: int, count: Counter[Step]) -> list[int]:
    """The chain of edges forward and back from an edge, along the most driven steps."""
    chain = [start]
    while onward := {b: n for (a, b), n in count.items() if a == chain[-1] and b not in chain}:
        chain.append(max(sorted(onward), key=onward.__getitem__))
    while back := {a: n for (a, b), n in count.items() if b == chain[0] and a not in chain}:
        chain.insert(0, max(sorted(back), key=back.__getitem__))
    return chain


def _add_skipped(begin: dict[int, float], length: Mapping[Step, float]) -> None:
    """Adds edges that lie between two edges of the chain, such as those inside junctions."""
    for e in sorted({e for step in length for e in step} - begin.keys()):
        before = [begin[a] + way for (a, b), way in length.items() if b == e and a in begin]
        after = [begin[b] - way for (a, b), way in length.items() if a == e and b in begin]
        if before and after and abs(float(np.median(before)) - float(np.median(after))) < MISFIT:
            begin[e] = float(np.median(before))


def read_fcd(table: Table, path: Path, *, types: Mapping[str, Size] | None = None) -> Trajectories:
    """Trajectories of floating-car data with `pos`, `speed` and `lane`.

    The lane index is SUMO's, from the right; inside junctions it is that of the edge before.
    Offsets are `posLat` if it is stored.

    Args:
      table: columns `time`, `id`, `lane`, `pos`, `speed`, optionally `type`, `acceleration`,
        `posLat` and `leaderID`; also with `timestep_` and `vehicle_` before these names.
      path: of the file.
      types: kind, length and width [m] by SUMO's type; ours are known, others are cars of 5 m.

    Raises:
      InputError: a column is missing, or a value is impossible.
    """

    def column(name: str) -> tuple[str, str]:
        return name, f"vehicle_{name}"

    name = table.texts(*column("id"))
    lane = table.texts(*column("lane"))
    # CSV has lines for instants without vehicles; vehicles off the network have no lane.
    there = np.flatnonzero((name != "") & (lane != ""))
    if not there.size:
        raise InputError(f"data set {path}: no vehicles in lanes")
    off = int(((name != "") & (lane == "")).sum())
    beside = (f"{off} rows of vehicles in no lane are left out",) if off else ()

    def numbers(what: str) -> FloatArray:
        found = table.numbers(*column(what), finite=False)
        good = np.ones(table.rows, dtype=bool)
        good[there] = np.isfinite(found[there])
        table.must(good, what, found, "must be a finite number")
        return found[there]

    edge, index = _split(table, there, lane[there])
    time = table.numbers("time", "timestep_time")[there]
    speed, position = numbers("speed"), numbers("pos")
    station, keep, notes = _stations_along(name[there], time, edge, position, speed)
    index = _through_junctions(name[there], time, edge, index)
    kind, length, width, unknown = _sizes(table, there, types or {})
    has_leader = table.has(*column("leaderID"))
    offset = numbers("posLat") if table.has(*column("posLat")) else np.zeros(there.size)
    rows = Rows(
        source=f"data set {path}",
        where=lambda k: table.where(int(there[keep][k])),
        name=name[there][keep],
        kind=kind[keep],
        length=length[keep],
        width=width[keep],
        time=time[keep],
        lane=index[keep],
        station=station[keep],
        offset=offset[keep],
        speed=speed[keep],
        acceleration=numbers("acceleration")[keep] if table.has(*column("acceleration")) else None,
        leader=table.texts(*column("leaderID"))[there][keep] if has_leader else None,
        speed_column=table.name(*column("speed")),
    )
    return assemble(rows, int(index[keep].max()) + 1, LANE_WIDTH, (*beside, *notes, *unknown))


def read_fcd_xml(path: Path) -> Table:
    """The `vehicle` elements of an XML file as a table.

    Raises:
      InputError: it is not well-formed, or not floating-car data.
    """
    columns: dict[str, list[str]] = {name: [] for name in ("time", *_ATTRIBUTES)}
    seen: set[str] = set()
    lines: list[int] = []
    time = [""]
    parser = expat.ParserCreate()

    def start(element: str, attributes: dict[str, str]) -> None:
        if element == "timestep":
            time[0] = attributes.get("time", "")
        elif element == "vehicle":
            columns["time"].append(time[0])
            seen.update(attributes)
            for name in _ATTRIBUTES:
                columns[name].append(attributes.get(name, ""))
            lines.append(parser.CurrentLineNumber)
        elif element == "fcd-export":
            seen.add("time")

    parser.StartElementHandler = start
    try:
        with open_packed(path) as file:
            parser.ParseFile(file)
    except expat.ExpatError as error:
        raise InputError(f"data set {path}: not well-formed XML: {error}") from error
    except (OSError, EOFError) as error:
        raise InputError(f"data set {path}: cannot be read: {error}") from error
    if "time" not in seen:
        raise InputError(f"data set {path}: XML without the element 'fcd-export'")
    if not lines:
        raise InputError(f"data set {path}: no vehicles")
    arrays: dict[str, Any] = {
        name: np.array(values) for name, values in columns.items() if name in seen
    }
    return Table(path, arrays, lambda row: f"line {lines[row]}")


def _split(
    table: Table, there: IndexArray, lane: NDArray[np.str_]
) -> tuple[NDArray[np.str_], IntArray]:
    """Edge and index of SUMO lanes such as `-1#2_0`."""
    names, which = np.unique(lane, return_inverse=True)
    parts = [str(name).rpartition("_") for name in names]
    good = np.array(
        [bool(edge) and index.isdecimal() and len(index) < 4 for edge, _, index in parts]
    )
    right = np.ones(table.rows, dtype=bool)
    right[there] = good[which]
    shown = np.full(table.rows, "", dtype=lane.dtype)
    shown[there] = lane
    table.must(right, "lane", shown, "must be a SUMO lane, as in 'edge_0'")
    edges = np.array([edge for edge, _, _ in parts])
    indices = np.array([int(index) for _, _, index in parts], dtype=np.int64)
    return edges[which], indices[which]


def _through_junctions(
    name: NDArray[np.str_], time: FloatArray, edge: NDArray[np.str_], index: IntArray
) -> IntArray:
    """Lane indices; inside junctions those before the junction, or else after it."""
    inside = np.char.startswith(edge, ":")
    if not inside.any() or inside.all():
        return index
    _, number = np.unique(name, return_inverse=True)
    order = np.lexsort((time, number))
    result, inside, number = index[order], inside[order], number[order]
    places = np.arange(len(order))
    before = np.maximum.accumulate(np.where(inside, -1, places))
    after = np.minimum.accumulate(np.where(inside, len(places), places)[::-1])[::-1]
    before_good = (before >= 0) & (number[before] == number)
    after = np.minimum(after, len(places) - 1)
    after_good = (number[after] == number) & ~inside[after]
    source = np.where(before_good, before, np.where(after_good, after, places))
    filled = np.empty_like(index)
    filled[order] = result[source]
    return filled


def _sizes(
    table: Table, there: IndexArray, types: Mapping[str, Size]
) -> tuple[NDArray[np.str_], FloatArray, FloatArray, tuple[str, ...]]:
    """Kind, length and width [m] of each row's vehicle, and notes in words."""
    known: dict[str, Size] = {t.kind: (t.kind, t.length, t.width) for t in default_types()}
    known.update(types)
    if any(kind not in KINDS for kind, _, _ in known.values()):
        raise InputError(f"types {dict(types)!r}: kinds are {', '.join(KINDS)}")
    count = there.size
    if not table.has("type", "vehicle_type"):
        kind, length, width = UNKNOWN
        note = f"vehicles have no type: all are cars of {length:g} m"
        return np.full(count, kind), np.full(count, length), np.full(count, width), (note,)
    names, which = np.unique(table.texts("type", "vehicle_type")[there], return_inverse=True)
    # SUMO writes "car@v12" for a vehicle with its own copy of the type.
    bases = [str(name).partition("@")[0] for name in names]
    sizes = [known.get(base, UNKNOWN) for base in bases]
    kinds, lengths, widths = (np.array(column)[which] for column in zip(*sizes, strict=True))
    strange = sorted({base for base in bases if base not in known})
    notes = (f"of unknown type, taken for cars of 5 m: {', '.join(strange)[:200]}",)
    return kinds, lengths, widths, notes if strange else ()
