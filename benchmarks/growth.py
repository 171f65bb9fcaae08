"""How computing times grow with vehicles, road, wheels, trucks, environments and threads.

    python benchmarks/growth.py --csv docs/performance/growth.csv
    python benchmarks/growth.py --csv docs/performance/growth.csv \
        --picture docs/performance/growth.png

The first form measures (a minute and a half) and writes a table; `--only` measures some figures and
keeps the others of the table. The second form draws the table. Processor times are of one core;
speeds of several threads and processes are by wall time and need idle cores.
"""

from __future__ import annotations

import argparse
import copy
import csv
import dataclasses
import functools
import itertools
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from matplotlib.figure import Figure
from mujoco.batch import Batch

from iits_mj.commands.bench import drive, traffic
from iits_mj.commands.bench.clocks import MICROSECONDS, MILLISECONDS, in_turns
from iits_mj.commands.bench.environments import ENVIRONMENT
from iits_mj.commands.bench.physics import SPEED, STATION, highway_truck, player
from iits_mj.core.timing import DYNAMIC_PLANTS, TIMESTEP
from iits_mj.render.plots import PALETTE, dress, to_png
from iits_mj.road import RoadMap
from iits_mj.road.design import Design, build
from iits_mj.road.writer import write
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.truck import Truck
from iits_mj.truck.fleet import TruckFleet
from iits_mj.truck.placement import TruckPlacement
from traffic_bridge import Mirror

DESIGN = Path(__file__).resolve().parents[1] / "tools" / "highway.toml"
STEPS = 100  # of a round
# Of 1, 2, 2, 3 and 4 units.
TRUCKS = ("vecto_tractor", "vecto_40t", "tractor_semitrailer_6x4", "b_double", "a_double")
THREADS = (1, 2)
PROCESSES = 2
ENVIRONMENTS = (2, 8, 64)
EDGE = 20.0  # [m] of the view's end that is empty at the beginning
_JOINT = 60.0  # [m] of the vertical curve between two repetitions of the highway
Points = Iterator[tuple[str, float, float]]
"""Name of a line, x, y."""


def step_by_wheels(names: Sequence[str] = TRUCKS) -> Points:
    """A step of each plant of shipped trucks on a plane, without contacts and sensors."""
    plays: dict[tuple[str, int], Callable[[], None]] = {}
    for name, plant in itertools.product(names, DYNAMIC_PLANTS):
        truck = Truck.load(truck=name, plant=plant, visuals=False)
        truck.reset(speed=SPEED)
        truck.command(accelerator_pedal=0.4)
        truck.detects_contacts = False
        plays[plant, 2 * len(truck.parameters.axles)] = functools.partial(truck.step, STEPS)
    for (plant, wheels), value in in_turns(plays, 30).items():
        yield plant, wheels, value / STEPS * MICROSECONDS


def step_by_trucks(counts: Sequence[int] = (1, 2, 4, 8)) -> Points:
    route, trucks = RoadMap.builtin().route(), {}
    for count in counts:
        fleet = TruckFleet.load([36_000.0] * count, route=route, visuals=False)
        fleet.reset([TruckPlacement(station=400.0 - 40.0 * k, speed=SPEED) for k in range(count)])
        trucks[count] = fleet.trucks[0]
    yield from _steps("trucks in one model", trucks)


def step_by_vehicles(counts: Sequence[int] = (0, 20, 50, 100, 200, 500)) -> Points:
    route, trucks = RoadMap.builtin().route(), {}
    for count in counts:
        mirror = Mirror({"car": count}, visuals=False)
        truck = Truck.load(route=route, visuals=False, edit_spec=mirror.add_to)
        truck.reset(station=STATION, speed=SPEED)
        trucks[count] = truck
    yield from _steps("mirror with so many cars", trucks)


def _steps(name: str, trucks: Mapping[int, Truck], rounds: int = 30) -> Points:
    plays = {str(x): player(truck.model, truck.data, STEPS) for x, truck in trucks.items()}
    for x, value in in_turns(plays, rounds).items():
        yield name, float(x), value / STEPS * MICROSECONDS


def traffic_by_vehicles(counts: Sequence[int] = (20, 60, 120, 250, 500)) -> Points:
    """The traffic of `iits-mj bench` with a longer view; the mirror holds the nearest vehicles."""
    for count in counts:
        view = traffic.CONFIG.view_range * count / traffic.VEHICLES
        fill = max(view - EDGE, EDGE)
        config = dataclasses.replace(
            traffic.CONFIG, view_range=view, fill_ahead=fill, fill_behind=fill
        )
        vehicles, *times = np.median(traffic.timed_steps(config, STEPS), axis=0).tolist()
        for name, seconds in zip(("SUMO", "bridge", "mirror"), times, strict=True):
            yield name, vehicles, seconds * MICROSECONDS


def drive_by_vehicles(counts: Sequence[int] = (20, 60, 120, 250, 500)) -> Points:
    for count in counts:
        with drive.drive_with(TIMESTEP, crowd=count) as simulation:
            cost = drive.cost_of(simulation, cycles=50, rounds=3)
        yield "whole drive", cost.vehicles, cost.whole * MILLISECONDS
        yield "MuJoCo and SUMO calls in it", cost.vehicles, cost.base * MILLISECONDS


def long_highway(repeats: int, path: Path) -> Path:
    """Writes a map with the built-in highway's alignment so many times in a row."""
    design = Design.load(DESIGN)
    once = design.length
    starts = [once * k for k in range(repeats)]

    def shifted(rows: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
        """Rows that begin with a station, for each repetition."""
        return tuple((s + row[0], *row[1:]) for s in starts for row in rows)

    grades = [(0.0, design.initial_grade, _JOINT), *design.grades]
    long = dataclasses.replace(
        design,
        alignment=design.alignment * repeats,
        grades=shifted(grades)[1:],
        road_ends=tuple(s + e for s in starts for e in (0.0, *design.road_ends))[1:],
        extra_lanes=tuple(
            dataclasses.replace(lane, start=s + lane.start, end=s + lane.end)
            for s in starts
            for lane in design.extra_lanes
        ),
        limits=tuple((s + a, s + b, v) for s in starts for a, b, v in design.limits),
        structures=tuple((k, n, s + a, s + b) for s in starts for k, n, a, b in design.structures),
    )
    return write(build(long), path)


def drive_by_road(repeats: Sequence[int] = (1, 2, 4, 8, 16)) -> Points:
    """Each in a process of its own, so that its memory is its own."""
    context = multiprocessing.get_context("spawn")
    for count in repeats:
        with context.Pool(1) as pool:
            length, loading, again, cycle, memory = pool.apply(_long_drive, (count,))
        yield "new map", length, loading
        yield "known map", length, again
        yield "drive", length, cycle
        yield "memory", length, memory


def _long_drive(repeats: int) -> tuple[float, float, float, float, float]:
    with tempfile.TemporaryDirectory() as folder:
        path = long_highway(repeats, Path(folder, "long.xodr"))
        config = DriveConfig(map=path, density="dense", seed=2, duration=600.0)
        begin = time.perf_counter()
        with Simulation(config, visuals=False):
            middle = time.perf_counter()
        with Simulation(config, visuals=False) as simulation:
            loading = middle - begin, time.perf_counter() - middle
            cost = drive.cost_of(simulation, cycles=50, rounds=3)
            length = simulation.route.length / 1e3
            pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory = 1e-6 * pages * resource.getpagesize()
    return length, *loading, cost.whole * MILLISECONDS, memory


def batch_by_environments(seconds: float = 1.0) -> Points:
    """Steps of whole trucks by `mujoco.batch` on threads, and by as many processes."""
    truck = highway_truck()
    for count in ENVIRONMENTS:
        for workers in THREADS:
            batch = Batch(truck.model, nsim=count, nthread=workers)
            for name in ("qpos", "qvel", "ctrl", "plugin_state"):
                rows = batch.bind(name)
                rows[:] = np.reshape(getattr(truck.data, name), rows[0].shape)
            step = functools.partial(batch.step, nstep=STEPS)
            yield f"threads: {workers}", count, 1e-3 * count * STEPS * _rate(step, seconds)
    context = multiprocessing.get_context("spawn")
    for count in ENVIRONMENTS:
        shares = [(len(range(k, count, PROCESSES)), seconds) for k in range(PROCESSES)]
        with context.Pool(PROCESSES, _begin, (context.Barrier(PROCESSES),)) as pool:
            yield f"processes: {PROCESSES}", count, 1e-3 * sum(pool.starmap(_process, shares, 1))


def _begin(barrier: Any) -> None:
    _process.barrier, _process.truck = barrier, highway_truck()  # type: ignore[attr-defined]


def _process(environments: int, seconds: float) -> float:
    """Steps per second of one process, which begins together with the others."""
    truck: Truck = _process.truck  # type: ignore[attr-defined]
    datas = [copy.copy(truck.data) for _ in range(environments)]
    _process.barrier.wait()  # type: ignore[attr-defined]

    def step() -> None:
        for data in datas:
            mujoco.mj_step(truck.model, data, STEPS)

    return environments * STEPS * _rate(step, seconds)


def tasks_by_environments(seconds: float = 2.0) -> Points:
    """Steps of `LaneKeep-v0`, 0.1 s each, on threads of one process and in as many processes."""
    ways: dict[str, dict[str, Any]] = {f"threads: {n}": {"threads": n} for n in THREADS}
    ways["a process for each"] = {"vectorization_mode": "async"}
    for count in ENVIRONMENTS:
        for way, settings in ways.items():
            many = gymnasium.make_vec(f"iits_mj:{ENVIRONMENT}", num_envs=count, **settings)
            many.reset(seed=0)
            step = functools.partial(many.step, many.action_space.sample())
            yield way, count, count * _rate(step, seconds)
            many.close()


def _rate(call: Any, seconds: float) -> float:
    """Calls per second, by wall time, after a first call."""
    call()
    calls, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        call()
        calls += 1
    return calls / (time.perf_counter() - begin)


FIGURES = {
    function.__name__: function
    for function in (
        drive_by_vehicles,
        traffic_by_vehicles,
        drive_by_road,
        step_by_wheels,
        step_by_trucks,
        step_by_vehicles,
        batch_by_environments,
        tasks_by_environments,
    )
}
_TIME, _STEP = "processor time [us]", "mj_step"
# Figure, its lines or all of them, title, label of x and of y.
PANELS: tuple[tuple[str, tuple[str, ...], str, str, str], ...] = (
    ("drive_by_vehicles", (), "Whole drive, 2 ms", "vehicles in view", "ms per simulated second"),
    ("traffic_by_vehicles", (), "Traffic, a step of 0.1 s", "vehicles in view", _TIME),
    ("step_by_vehicles", (), f"{_STEP} of a truck and cars", "cars in the model", _TIME),
    ("step_by_wheels", (), "Step of each plant", "wheels of the truck", _TIME),
    ("step_by_trucks", (), _STEP, "trucks in the model", _TIME),
    ("batch_by_environments", (), "mujoco.batch of trucks", "trucks", "1000 steps per second"),
    ("tasks_by_environments", (), "LaneKeep-v0", "environments", "steps of 0.1 s per second"),
    ("drive_by_road", ("new map", "known map"), "Time to load a road", "road [km]", "s"),
    ("drive_by_road", ("memory",), "Memory of a drive", "road [km]", "MB"),
    ("drive_by_road", ("drive",), "Whole drive, 2 ms", "road [km]", "ms per simulated second"),
)


def draw(rows: Sequence[Mapping[str, str]]) -> Figure:
    """The picture of a table."""
    figure = Figure(figsize=(9.5, 12.5), layout="constrained")
    grid = figure.subplots(5, 2)
    for axes, (name, lines, title, x_label, y_label) in zip(grid.flat, PANELS, strict=True):
        axes.set_prop_cycle(color=PALETTE)
        mine = [row for row in rows if row["figure"] == name]
        for line in lines or dict.fromkeys(row["line"] for row in mine):
            points = [(float(r["x"]), float(r["y"])) for r in mine if r["line"] == line]
            axes.plot(*zip(*points, strict=True), marker="o", markersize=3, label=line)
        dress(axes, title)
        axes.set(xlabel=x_label, ylabel=y_label, xlim=(0, None), ylim=(0, None))
        if len(axes.lines) > 1:
            axes.legend(fontsize=8, frameon=False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=list(FIGURES), default=list(FIGURES))
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    path: Path = arguments.csv
    rows = list(csv.DictReader(path.open())) if path.exists() else []
    if arguments.picture:
        arguments.picture.write_bytes(to_png(draw(rows)))
        return
    for figure in arguments.only:
        print(figure, file=sys.stderr)
        rows = [row for row in rows if row["figure"] != figure]
        for line, x, y in FIGURES[figure]():
            rows.append({"figure": figure, "line": line, "x": f"{x:g}", "y": f"{y:.4g}"})
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, ["figure", "line", "x", "y"], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
