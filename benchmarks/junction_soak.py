"""Soak test of junctions: the truck and the traffic of whole maps; a CSV row is ten minutes.

    python benchmarks/junction_soak.py --table out/junctions.csv town.xodr other.xodr
    python benchmarks/junction_soak.py --table out/junctions.csv --summary

Each row is ten simulated minutes on a map with `scope="map"`:

- `traffic`: SUMO's traffic alone. Boxes of all vehicles are compared every 0.1 s, those of both
  units of articulated trucks. Vehicles of one queue that stand behind each other do not touch.
- `truck`: drives of the truck, one after another, on the map's routes in turn.

A row fails if the truck or two vehicles touch, or if a vehicle or the truck stands for longer than
two cycles of the map's lights (90 s each on a map without lights). The same command continues after
an interruption: it skips the rows of the table. The exit code is 1 if a row fails.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import io
import itertools
import math
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj.core.boxes import axis_gaps
from iits_mj.core.errors import Error
from iits_mj.core.output_files import write_whole
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import RoadMap, Route
from iits_mj.simulation import DriveConfig, Observer, Simulation
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.parts import load_map
from traffic_bridge import MapNetwork, PureSim, TrafficConfig
from traffic_bridge.mirror.looks import LOOKS
from traffic_bridge.mirror.slots import Slot
from traffic_bridge.mirror.units import VehicleUnits

DURATION = 600.0  # simulated time of a row [s]
CYCLE = 90.0  # of a map without lights [s]
STANDSTILL = 0.1  # [m/s]
SPEED_LIMIT = 12.5  # of the traffic [m/s]
TIMESTEP = 0.005  # of the physics [s]
WAIT = 4.0  # added to two cycles for starting again [s]
PARTS = ("traffic", "truck")


@dataclass
class Row:
    """Result of ten minutes.

    Attributes:
      map, part, seed: see the module.
      simulated_s, wall_s: duration [s]; drives: of the truck; vehicles: mean number.
      cycle_s: longest cycle of the map's lights [s].
      collisions: drives that ended with a contact of the truck; touches: pairs of vehicles whose
        boxes touched; teleports, warnings: collisions that SUMO reported.
      truck_stand_s, stand_s: longest standstill of the truck and of a vehicle [s].
      red_lights: run by the truck; braking: hardest one of a vehicle, positive [m/s2].
      note: of the first fault.
    """

    map: str
    part: str
    seed: int
    simulated_s: float = 0.0
    wall_s: float = 0.0
    drives: int = 0
    vehicles: float = 0.0
    cycle_s: float = CYCLE
    collisions: int = 0
    touches: int = 0
    sumo_collisions: int = 0
    truck_stand_s: float = 0.0
    stand_s: float = 0.0
    red_lights: int = 0
    braking: float = 0.0
    note: str = ""

    @property
    def faults(self) -> list[str]:
        """The columns that fail."""
        names = ["collisions", "touches", "red_lights"]
        found = [name for name in names if getattr(self, name)]
        limit = 2.0 * self.cycle_s + WAIT
        return found + [n for n in ("truck_stand_s", "stand_s") if getattr(self, n) > limit]


HEADER = [field.name for field in dataclasses.fields(Row)]


class TrafficWatch:
    """Follows the boxes, standstills and brakings of the traffic.

    Args:
      config: whose types the vehicles have.
      row: that takes the results.
    """

    def __init__(self, config: TrafficConfig, row: Row) -> None:
        self._types = sorted(config.types, key=lambda kind: kind.look == "articulated")
        self._number = {kind.name: k for k, kind in enumerate(self._types)}
        looks = [LOOKS[kind.look](kind) for kind in self._types]
        self._units = VehicleUnits(self._types, looks, config.step_length)
        self._step = config.step_length
        self._names: tuple[str, ...] = ()
        self._since: dict[str, float] = {}
        self._touched: set[tuple[str, str]] = set()
        self._count = 0
        self.row = row

    def look(self, frame: VehicleFrame, time: float, boxes: bool) -> None:
        """Takes a frame; `boxes`: compares the vehicles with each other."""
        row, ids = self.row, frame.ids
        self._count += 1
        row.vehicles += (len(frame) - row.vehicles) / self._count
        if not len(frame):
            self._since.clear()
            return
        stands = frame.column("speed") < STANDSTILL
        self._since = {
            name: self._since.get(name, time)
            for name, still in zip(ids, stands.tolist(), strict=True)
            if still
        }
        for name, since in self._since.items():
            if time - since > row.stand_s:
                row.stand_s = time - since
                if row.stand_s > 2.0 * row.cycle_s + WAIT and not row.note:
                    row.note = f"{name} stands at {time:.0f} s"
        row.braking = max(row.braking, -float(frame.column("acceleration").min()))
        if boxes:
            self._compare(frame, time)

    def _compare(self, frame: VehicleFrame, time: float) -> None:
        order = sorted(range(len(frame)), key=lambda k: self._kind(frame.ids[k]))
        names = tuple(frame.ids[k] for k in order)
        if names != self._names:
            slots = [Slot(k, self._kind(name), 0, name) for k, name in enumerate(names)]
            self._units.set_slots(slots)
            self._names = names
        self._units.take(frame, np.array(order, dtype=np.intp))
        self._units.move(0.0)
        outlines = [self._units.outline(k) for k in range(len(self._units.slots))]
        x, y, *shape = np.array([dataclasses.astuple(outline)[:6] for outline in outlines]).T
        own, others = ([row[k] for row in shape] for k in ((slice(None), None), (None,)))
        gaps = axis_gaps(x - x[:, None], y - y[:, None], own, others)
        touch = np.logical_and.reduce([gap <= 0.0 for gap in gaps])
        for a, b in zip(*np.nonzero(np.triu(touch, 1)), strict=True):
            pair = tuple(sorted({self._units.slots[k].vehicle or "" for k in (a, b)}))
            if len(pair) == 2 and pair not in self._touched:
                self._touched.add(pair)  # type: ignore[arg-type]
                self.row.touches += 1
                place = f"({x[a]:.0f}, {y[a]:.0f})"
                self.row.note = self.row.note or f"{pair[0]}, {pair[1]} at {time:.1f} s {place}"

    def _kind(self, name: str) -> int:
        return self._number[name.partition(".")[0]]


class DriveWatch(Observer):
    """Follows the truck's standstill and the traffic around it."""

    period = 0.1

    def __init__(self, watch: TrafficWatch, begin: float) -> None:
        self._watch, self._begin = watch, begin
        self._since: float | None = None

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Takes an instant of a drive."""
        assert isinstance(simulation, Simulation)
        row, time = self._watch.row, self._begin + frame.time
        self._watch.look(simulation.vehicles, time, boxes=False)
        if frame.ego.speed >= STANDSTILL:
            self._since = None
            return
        self._since = time if self._since is None else self._since
        if time - self._since > row.truck_stand_s:
            row.truck_stand_s = time - self._since
            if row.truck_stand_s > 2.0 * row.cycle_s + WAIT and not row.note:
                place = f"{frame.ego.station:.0f} m of {simulation.config.route}"
                row.note = f"the truck stands at {place}: {frame.trajectory.reason}"


def traffic_alone(path: Path, row: Row, density: str, duration: float) -> None:
    """Runs the traffic of a map without the truck."""
    config = TrafficConfig(density=density, scope="map", speed_limit=SPEED_LIMIT)
    watch = TrafficWatch(config, row)
    with PureSim(load_map(path).route(), config, seed=row.seed) as traffic:
        frame = traffic.reset()
        while traffic.time < duration - 1e-6:
            frame = traffic.step()
            watch.look(frame, traffic.time, boxes=True)
            row.sumo_collisions += len(traffic.session.api.simulation.getCollisions())
    row.simulated_s = duration


def truck_drives(path: Path, row: Row, density: str, duration: float) -> None:
    """Drives the truck on the map's routes in turn until the duration is complete."""
    watch: TrafficWatch | None = None
    routes = list(routes_of(load_map(path)))
    first = row.seed
    while row.simulated_s < duration - 1.0:
        config = DriveConfig(
            map=path,
            seed=1000 * row.seed + row.drives,
            density=density,
            traffic_scope="map",
            traffic_speed=SPEED_LIMIT,
            duration=duration - row.simulated_s,
            route=routes[(first + row.drives) % len(routes)],
        )
        row.drives += 1
        with Simulation(config, visuals=False, timestep=TIMESTEP) as simulation:
            if watch is None:
                watch = TrafficWatch(TrafficConfig(), row)
            try:
                summary = simulation.run([DriveWatch(watch, row.simulated_s)])
            except Error:
                summary = simulation.summary()
        row.simulated_s += summary.duration
        row.red_lights += summary.red_lights_run
        if summary.failed:
            row.collisions += 1
            place = f"{summary.duration:.1f} s, seed {config.seed}, {config.route}"
            row.note = row.note or f"{summary.ended} after {place}"


def routes_of(road_map: RoadMap) -> Iterator[str]:
    """Yields the truck's routes between the map's ends, as text for `RoadMap.route`."""
    network = MapNetwork.of(road_map)
    for path in network.routes():
        roads = [edge.removeprefix("-").partition("#")[0] for edge in path.edges]
        along = "roads:" + ",".join(dict.fromkeys(roads))
        try:
            route = road_map.route(along=along)
        except Error:
            continue
        if len(roads) > 1 and _fits(route):
            yield along


def _fits(route: Route) -> bool:
    """Whether a truck can drive a route: it is long enough."""
    return route.length > 60.0


def cycle_of(road_map: RoadMap) -> float:
    """Longest cycle of a map's lights [s]; `CYCLE` without lights."""
    lights = MapNetwork.of(road_map).lights
    cycles = [math.fsum(duration for duration, _ in light.phases) for light in lights]
    return max(cycles, default=CYCLE)


def read_rows(table: Path) -> list[Row]:
    """Returns the rows of a table; none without a file."""
    if not table.is_file():
        return []
    with table.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        kinds = {field.name: field.type for field in dataclasses.fields(Row)}
        make = {"int": int, "float": float, "str": str}
        return [
            Row(**{name: make[str(kinds[name])](text) for name, text in entry.items()})
            for entry in reader
        ]


def write_rows(table: Path, rows: Iterable[Row]) -> None:
    """Writes a table; an interruption leaves the old or the new one."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for row in rows:
        values = dataclasses.asdict(row).values()
        writer.writerow([f"{v:.2f}" if isinstance(v, float) else v for v in values])
    write_whole(table, text.getvalue().encode(), "junction table")


def summary(rows: Sequence[Row]) -> str:
    """Returns the sums of the rows by map and part as a Markdown table."""
    lines = [
        "| map | part | rows | min | vehicles | contacts of the truck | contacts of vehicles | "
        "longest standstill of truck, vehicles [s] | allowed [s] | red lights run |",
        "|---|---|" + "---:|" * 8,
    ]
    key = lambda row: (row.map, row.part)  # noqa: E731
    for (name, part), group in itertools.groupby(sorted(rows, key=key), key=key):
        some = list(group)
        lines.append(
            f"| {name} | {part} | {len(some)} | {sum(r.simulated_s for r in some) / 60.0:.0f} | "
            f"{np.mean([r.vehicles for r in some]):.1f} | {sum(r.collisions for r in some)} | "
            f"{sum(r.touches for r in some)} | {max(r.truck_stand_s for r in some):.0f}, "
            f"{max(r.stand_s for r in some):.0f} | {2 * some[0].cycle_s:.0f} | "
            f"{sum(r.red_lights for r in some)} |"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Command line; 1 if a row fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maps", nargs="*", type=Path, help="OpenDRIVE files")
    parser.add_argument("--table", type=Path, required=True, help="CSV file to continue")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--density", default="dense")
    parser.add_argument("--duration", type=float, default=DURATION, help="of a row [s]")
    parser.add_argument("--part", choices=PARTS, action="append")
    parser.add_argument("--summary", action="store_true", help="prints the table's sums")
    options = parser.parse_args(arguments)
    rows = read_rows(options.table)
    done = {(row.map, row.part, row.seed) for row in rows}
    seeds, parts = range(options.seeds), options.part or PARTS
    for seed, path, part in itertools.product(seeds, options.maps, parts):
        if (path.stem, part, seed) in done:
            continue
        row = Row(path.stem, part, seed, cycle_s=cycle_of(load_map(path)))
        begin = time.monotonic()
        run = traffic_alone if part == "traffic" else truck_drives
        run(path, row, options.density, options.duration)
        row.wall_s = time.monotonic() - begin
        rows.append(row)
        write_rows(options.table, rows)
        stand = f"{row.truck_stand_s:.0f}, {row.stand_s:.0f}"
        fault = f"  FAULT: {', '.join(row.faults)}; {row.note}" if row.faults else ""
        print(f"{row.map} {part} {seed}: stood {stand} s, {row.wall_s:.0f} s{fault}", flush=True)
    if options.summary:
        print(summary(rows))
    return 1 if any(row.faults for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
