"""Soak test: drives of 20 simulated minutes until 24 hours are complete, one CSV row a drive.

    python tools/soak.py --table docs/validation/soak.csv --hours 24

Each drive (chunk) has its own process, seed, load, traffic, map and time step, which follow from
the chunk's number. A row is appended when a chunk is complete. The same command continues after an
interruption: it skips the chunks that have a row. The sums stand in docs/testing.md.

A row fails (and the exit code is 1) after a MuJoCo warning, a number that is not finite, a
collision caused by the truck, a roll-over, memory growth, output on stderr, a process or a
temporary file left behind, or an exit code other than 0.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import gc
import io
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.errors import Error
from iits_mj.core.messages import PlanMode
from iits_mj.core.output_files import write_whole
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road.design import Design, build
from iits_mj.road.writer import write
from iits_mj.simulation import DriveConfig, Observer, Simulation, Telemetry
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep

CHUNK_DURATION = 1200.0  # longest simulated time of a chunk [s]
WARM_UP = 300.0  # simulated time after which the memory must stay constant [s]
GROWTH_MAX = 6.0  # [MB] from the end of the warm-up to the end of the drive
EVENTS = Path(__file__).resolve().parents[1] / "examples" / "traffic_events.toml"
TABLE = Path("docs/validation/soak.csv")
# The page with the summary of that table, between two of these marks.
PAGE, MARK = Path("docs/testing.md"), "<!-- soak -->"
# A lane change counts as recent for this time [s].
RECENT = 4.0
# Below this speed the truck stands [m/s].
_STANDSTILL = 0.1


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """Settings of one drive.

    Attributes:
      map: "highway" or "hills"; mode: of the traffic, see `drive_options`; the others are those of
        `DriveConfig` and `Simulation`.
    """

    number: int
    seed: int
    density: str
    payload: float
    map: str
    mode: str
    traffic_speed: float
    decision: str
    speed_planner: str
    commands: str
    timestep: float

    @classmethod
    def of(cls, number: int) -> Chunk:
        """Returns the chunk of a number; the same one in every run."""
        rng = np.random.default_rng(number)

        def pick(*values: Any) -> Any:
            return values[int(rng.integers(len(values)))]

        return cls(
            number=number,
            seed=1000 + number,
            density=pick("dense", "dense", "medium", "sparse"),
            payload=pick(0.0, 12_000.0, 24_000.0, 36_000.0),
            map=pick("highway", "highway", "hills"),
            mode=pick("inter", "inter", "mobil", "free", "events", "pure", "none"),
            traffic_speed=pick(10.0, 12.5, 15.0),
            decision=pick("ddqn", "ddqn", "lookahead", "aggressive", "mobil", "neutral"),
            speed_planner=pick("pcc", "pcc", "cruise"),
            commands=pick("direct", "direct", "j1939"),
            timestep=pick(0.002, 0.002, 0.005),
        )

    def drive_options(self) -> dict[str, Any]:
        """Returns the fields of `DriveConfig` except the map's file."""
        modes: dict[str, dict[str, Any]] = {
            "inter": {},
            "mobil": {"lane_change": "mobil"},
            "free": {"lane_discipline": "free"},
            "events": {"events": EVENTS},
            "pure": {"traffic_mode": "pure"},
            "none": {"traffic_mode": "none"},
        }
        same = ("seed", "density", "payload", "traffic_speed", "decision", "speed_planner")
        return {
            **{name: getattr(self, name) for name in same},
            "commands": self.commands,
            "duration": CHUNK_DURATION,
            **modes[self.mode],
        }


@dataclass(frozen=True, kw_only=True)
class Row:
    """Result of a chunk: a row of the table, after the columns of the chunk.

    Attributes:
      simulated_s, wall_s: duration [s].
      distance_km: driven.
      warnings: of MuJoCo; not_finite: instants with a number that is not finite in the state, the
        plugin's state, the sensors or the telemetry.
      collisions, caused: collisions, and those that the truck caused; see `cause`.
      rss_warm_mb, rss_end_mb, growth_mb: memory after the warm-up, at the end, and their
        difference; nan for a drive that ends within the warm-up. rss_max_mb: greatest value.
      processes, files: left behind.
      exit_code: of the process; stderr_lines: printed there.
      emergency_brakings: of the planner; lane_changes: completed.
      red_lights_run: stop lines crossed at red.
      ended: reason of the drive's end; note: cause of a collision, or the first line of stderr.
    """

    simulated_s: float = 0.0
    wall_s: float = 0.0
    distance_km: float = 0.0
    warnings: int = 0
    not_finite: int = 0
    collisions: int = 0
    caused: int = 0
    rss_warm_mb: float = math.nan
    rss_end_mb: float = math.nan
    growth_mb: float = math.nan
    rss_max_mb: float = math.nan
    processes: int = 0
    files: int = 0
    exit_code: int = 0
    stderr_lines: int = 0
    emergency_brakings: int = 0
    lane_changes: int = 0
    red_lights_run: int = 0
    failed: bool = False
    ended: str = ""
    note: str = ""

    def faults(self) -> list[str]:
        """Returns what a chunk must not have, by column."""
        forbidden = ("warnings", "not_finite", "caused", "processes", "files", "exit_code")
        found = [name for name in (*forbidden, "stderr_lines") if getattr(self, name)]
        if self.growth_mb > GROWTH_MAX:
            found.append("growth_mb")
        if self.failed and not self.collisions:
            found.append("ended")
        return found


HEADER = [field.name for kind in (Chunk, Row) for field in dataclasses.fields(kind)]


# --- the cause of a collision -----------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A collision as `cause` sees it.

    Attributes:
      truck_speed: [m/s].
      ahead: of the truck's front bumper, along the road, to the vehicle's centre [m]; negative
        behind the bumper.
      length: of the truck [m].
      truck_changed, vehicle_changed: it changed lanes within `RECENT`, or is doing so.
    """

    truck_speed: float
    ahead: float
    length: float
    truck_changed: bool
    vehicle_changed: bool


def cause(contact: Contact) -> tuple[bool, str]:
    """Returns whether the truck caused a collision, and the rule.

    The rules are those of a driver's duties: keep distance to the vehicle ahead, and change lanes
    only without danger to others.
    """
    if contact.truck_speed < _STANDSTILL:
        return False, "the truck stood still"
    if contact.truck_changed:
        return True, "the truck changed lanes"
    if contact.ahead < -contact.length:
        return False, "the vehicle hit the truck's rear"
    if contact.vehicle_changed:
        return False, "the vehicle changed lanes into the truck"
    if contact.ahead > 0.0:
        return True, "the truck hit the vehicle ahead"
    return False, "the vehicle beside the truck left its lane"


class Watch(Observer):
    """Observer that counts numbers that are not finite and keeps the last seconds for `cause`.

    Attributes:
      not_finite: instants with such a number.
      warm: memory after the warm-up [MB], nan before.
    """

    def __init__(self) -> None:
        self.not_finite = 0
        self.warm = math.nan
        self._last: deque[tuple[DriveFrame, VehicleFrame]] = deque(
            maxlen=round(RECENT / CYCLE_PERIOD)
        )

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Checks the numbers of one instant."""
        assert isinstance(simulation, Simulation)
        data = simulation.truck.data
        arrays = (data.qpos, data.qvel, data.act, data.plugin_state, data.sensordata)
        self.not_finite += not all(np.isfinite(values).all() for values in arrays)
        self._last.append((frame, simulation.vehicles))
        if math.isnan(self.warm) and frame.time >= WARM_UP:
            self.warm = rss_now()

    def contact(self, name: str, simulation: Simulation) -> Contact:
        """Returns the facts of a collision with a vehicle that just happened."""
        frame, vehicles = self._last[-1]
        vehicle = next((v for v in vehicles if v.id == name), None)
        size = simulation.truck.footprint
        ahead = math.nan
        if vehicle is not None:
            ahead = vehicle.station - (frame.ego.station + size.front_overhang)
        changing = (PlanMode.LANE_CHANGE, PlanMode.ABORT)
        lanes = {seen.lane for seen, _ in self._last}
        theirs = {lane for _, seen in self._last for v, lane in _lanes(seen) if v == name}
        return Contact(
            truck_speed=frame.ego.speed,
            ahead=ahead,
            length=size.length,
            truck_changed=len(lanes) > 1
            or any(seen.trajectory.mode in changing for seen, _ in self._last),
            vehicle_changed=len(theirs) > 1
            or (vehicle is not None and abs(vehicle.lateral_speed) > 0.1),
        )


def _lanes(vehicles: VehicleFrame) -> Iterator[tuple[str, int]]:
    return zip(vehicles.ids, vehicles.lanes.tolist(), strict=True)


def rss_now() -> float:
    """Returns the memory of this process [MB], after Python's garbage collection."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


# --- one chunk --------------------------------------------------------------------------------


def hills() -> Design:
    """Returns a winding road of 20 km with grades up to 6 %, curves down to 120 m, a third lane."""
    rng = np.random.default_rng(0)
    alignment: list[tuple[float, float, float, float, float]] = []
    sign, total = 1.0, 0.0
    while total < 20_000.0:
        bend = sign / float(rng.uniform(120.0, 500.0))
        arc = float(rng.uniform(0.4, 0.9)) / abs(bend)
        roll, spiral = -0.03 * sign, 70.0
        straight = float(rng.uniform(80.0, 350.0))
        for element in (
            (straight, 0.0, 0.0, 0.0, 0.0),
            (spiral, 0.0, bend, 0.0, roll),
            (arc, bend, bend, roll, roll),
            (spiral, bend, 0.0, roll, 0.0),
        ):
            alignment.append(element)
            total += element[0]
        sign = -sign
    stations = np.arange(500.0, total - 400.0, 700.0)
    slopes = rng.uniform(0.01, 0.06, len(stations)) * np.where(np.arange(len(stations)) % 2, -1, 1)
    grades = tuple((float(s), float(g), 200.0) for s, g in zip(stations, slopes, strict=True))
    return Design(
        name="soak hills",
        lane_width=3.75,
        lanes=2,
        left_shoulder=0.5,
        right_shoulder=1.5,
        speed_limit=70.0 / 3.6,
        alignment=tuple(alignment),
        grades=grades,
    )


def drive(chunk: Chunk, folder: Path, duration: float) -> Row:
    """Drives a chunk in this process; the files go into the folder."""
    road = write(build(hills()), folder / "hills.xodr") if chunk.map == "hills" else None
    options = chunk.drive_options() | {"duration": duration}
    config = DriveConfig(map=road, **options)
    watch, begin = Watch(), time.monotonic()
    note, caused = "", 0
    with (
        Simulation(config, visuals=False, timestep=chunk.timestep) as simulation,
        Telemetry(folder / "telemetry.csv") as telemetry,
    ):
        try:
            summary = simulation.run([watch, telemetry])
        except Error:
            summary = simulation.summary()
        end = rss_now()
        if summary.collision:
            name = simulation.ended.split(" with ")[1].split(" at the ")[0]
            contact = watch.contact(name, simulation)
            caused, rule = cause(contact)
            note = f"{rule}; truck {contact.truck_speed:.1f} m/s, vehicle {contact.ahead:.1f} m"
            note += " ahead of its bumper"
    not_finite = watch.not_finite + any("nan" in line for line in _lines(folder / "telemetry.csv"))
    return Row(
        simulated_s=round(summary.duration, 1),
        wall_s=round(time.monotonic() - begin, 1),
        distance_km=round(summary.distance / 1e3, 3),
        warnings=sum(summary.warnings.values()),
        not_finite=not_finite,
        collisions=int(summary.collision),
        caused=int(caused),
        rss_warm_mb=round(watch.warm, 1),
        rss_end_mb=round(end, 1),
        growth_mb=round(end - watch.warm, 1),
        rss_max_mb=round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        emergency_brakings=summary.emergency_brakings,
        lane_changes=summary.lane_changes,
        red_lights_run=summary.red_lights_run,
        failed=summary.failed,
        ended=summary.ended,
        note=note,
    )


def _lines(path: Path) -> Iterable[str]:
    return path.read_text().splitlines() if path.is_file() else ()


def run_chunk(chunk: Chunk, duration: float = CHUNK_DURATION) -> Row:
    """Drives a chunk in its own process, and looks for what it leaves behind."""
    with tempfile.TemporaryDirectory(prefix="soak_") as name:
        folder, scratch = Path(name) / "work", Path(name) / "tmp"
        folder.mkdir()
        scratch.mkdir()
        command = [sys.executable, __file__, "--chunk", str(chunk.number)]
        process = subprocess.Popen(
            [*command, "--duration", str(duration)],
            cwd=folder,
            env=os.environ | {"TMPDIR": str(scratch), "OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            output, errors = process.communicate()
        except BaseException:
            process.terminate()
            process.wait()
            raise
        kept = {"telemetry.csv", "hills.xodr"}
        left = [p for p in folder.rglob("*") if p.name not in kept] + list(scratch.rglob("*"))
    try:
        row = Row(**json.loads(output.splitlines()[-1]))
    except (IndexError, ValueError, TypeError):
        row = Row(failed=True, ended="no result")
    lines = [line for line in errors.splitlines() if line.strip()]
    return dataclasses.replace(
        row,
        processes=len(session_members(process.pid)),
        files=len(left),
        exit_code=process.returncode,
        stderr_lines=len(lines),
        note=row.note or (lines[-1][:200] if lines else ""),
    )


def session_members(session: int) -> list[int]:
    """Returns the processes of a session, without ended ones that nobody has waited for."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(path.parent.name))
    return found


# --- the table --------------------------------------------------------------------------------


def read_rows(table: Path) -> list[dict[str, str]]:
    """Returns the rows of a table; none without a file.

    Raises:
      Error: the table has other columns.
    """
    if not table.is_file():
        return []
    with table.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    if reader.fieldnames != HEADER:
        raise Error(f"{table}: has other columns than this version; name another table")
    return rows


def pending(rows: Iterable[Mapping[str, str]], hours: float) -> Iterator[Chunk]:
    """Yields the chunks that have no row, in order, until the hours are complete.

    `rows` may grow between two chunks.
    """
    number = 0
    while simulated_hours(rows) < hours:
        done = {int(row["number"]) for row in rows}
        if number not in done:
            yield Chunk.of(number)
        number += 1


def simulated_hours(rows: Iterable[Mapping[str, str]]) -> float:
    """Returns the simulated time of all rows [h]."""
    return math.fsum(float(row["simulated_s"]) for row in rows) / 3600.0


def append(table: Path, chunk: Chunk, row: Row) -> dict[str, str]:
    """Adds a row to a table and returns it; an interruption leaves the old or the new table."""
    columns = dataclasses.asdict(chunk) | dataclasses.asdict(row)
    values = {name: str(value) for name, value in columns.items()}
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, HEADER, lineterminator="\n")
    writer.writeheader()
    writer.writerows([*read_rows(table), values])
    write_whole(table, text.getvalue().encode(), "soak table")
    return values


def summary(rows: Sequence[Mapping[str, str]]) -> str:
    """Returns the sums of the rows by map and traffic mode as a Markdown table."""
    titles = [
        *("map", "traffic", "drives", "h", "km", "warnings", "not finite", "collisions"),
        *("caused by the truck", "other failures", "growth, mean and max [MB]", "left behind"),
    ]
    lines = [f"| {' | '.join(titles)} |", "|---|---|" + "---:|" * (len(titles) - 2)]
    kinds = sorted({(row["map"], row["mode"]) for row in rows})
    for name in (*kinds, ("all", "")):
        chosen = [row for row in rows if name[0] == "all" or (row["map"], row["mode"]) == name]

        def total(*columns: str, among: Sequence[Mapping[str, str]] = chosen) -> float:
            return math.fsum(float(row[column]) for row in among for column in columns)

        growth = [float(row["growth_mb"]) for row in chosen]
        growth = [value for value in growth if math.isfinite(value)]
        other = sum(row["failed"] == "True" and row["collisions"] == "0" for row in chosen)
        other += sum(row["exit_code"] != "0" or row["stderr_lines"] != "0" for row in chosen)
        cells = [
            *(*name, f"{len(chosen)}", f"{total('simulated_s') / 3600.0:.2f}"),
            *(f"{total('distance_km'):.0f}", f"{total('warnings'):.0f}"),
            *(f"{total('not_finite'):.0f}", f"{total('collisions'):.0f}"),
            *(f"{total('caused'):.0f}", f"{other}"),
            f"{math.fsum(growth) / len(growth):.1f}, {max(growth):.1f}" if growth else "-",
            f"{total('processes', 'files'):.0f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def write_summary(page: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Replaces the table between the marks of a page; a page without marks stays as it is."""
    text = page.read_text(encoding="utf-8") if page.is_file() else ""
    parts = text.split(MARK)
    if len(parts) == 3:
        write_whole(page, f"{MARK}\n{summary(rows)}\n{MARK}".join(parts[::2]).encode(), "page")


def main(arguments: list[str] | None = None) -> int:
    """Command line; 1 when a row has a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--table", type=Path, default=TABLE)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated hours in all")
    parser.add_argument("--duration", type=float, default=CHUNK_DURATION, help="of a chunk [s]")
    parser.add_argument("--chunk", type=int, help="drive this chunk alone and print its row")
    options = parser.parse_args(arguments)
    if options.chunk is not None:
        row = drive(Chunk.of(options.chunk), Path.cwd(), options.duration)
        print(json.dumps(dataclasses.asdict(row)))
        return 0
    # SystemExit ends the chunk's process and removes its folder.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    rows = read_rows(options.table)
    if options.table == TABLE:
        write_summary(PAGE, rows)
    faults = 0
    for chunk in pending(rows, options.hours):
        row = run_chunk(chunk, options.duration)
        rows.append(append(options.table, chunk, row))
        faults += bool(row.faults())
        if options.table == TABLE:
            write_summary(PAGE, rows)
        print(
            f"{chunk.number:4d} {simulated_hours(rows):6.2f} h  {row.simulated_s:6.0f} s in "
            f"{row.wall_s:4.0f} s  {chunk.map} {chunk.mode} {chunk.density}: {row.ended}"
            f"{'  FAULT: ' + ', '.join(row.faults()) if row.faults() else ''}",
            flush=True,
        )
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
