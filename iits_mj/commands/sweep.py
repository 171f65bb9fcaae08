"""Drive a scenario at many values of its parameters and map collisions, near misses and the rest.

SCENARIO is a file of events with a table [parameters], or an OpenSCENARIO file with its parameter
declarations. --param sweeps a parameter, or any option of a drive by its name. The points are a
grid, --samples of a Latin hypercube, or --adaptive ones, which locate the boundaries between the
outcomes.

Writes runs.csv, sweep.html and sweep.png into --out. The folder keeps finished drives: the same
command continues with the rest, on this machine or on a Ray cluster, with the same results. Exit
code: 1 if a drive could not be done, whatever the outcomes are.
"""

from __future__ import annotations

import functools
import json
import math
import operator
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import iits_mj
from iits_mj.commands.output import ClusterOptions, pool_of, prepare_folder
from iits_mj.commands.terminal import show
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.output_files import write_whole
from iits_mj.core.process_pool import SharedPool, worker_pool
from iits_mj.core.progress import task
from iits_mj.core.results import aligned
from iits_mj.evaluation.sweep import runs as sweep_runs
from iits_mj.evaluation.sweep.boundary import Boundary
from iits_mj.evaluation.sweep.design import Point, Sweep, SweepConfig, number_text
from iits_mj.evaluation.sweep.runs import SweepRun
from iits_mj.scale.shards import Plan, Shards, run_sharded

_WORST = 5  # runs in the summary
_LISTED = 20  # in the page


@dataclass(frozen=True, kw_only=True)
class Options(SweepConfig, ClusterOptions):
    """Flags of `iits-mj sweep`."""

    out: Path = option(
        Path("out/sweep"), help="folder for all output", metavar="DIR", group="output"
    )
    json: bool = option(False, help="print the runs as one JSON object", group="output")


def run(options: Options) -> int:
    """Drives the missing points, writes all files, prints the summary; returns the exit code."""
    sweep = Sweep.of(options)
    prepare_folder(options.out)
    sweep_runs.check_folder(options.out, sweep.identity())
    driven: dict[Point, SweepRun] = {}
    boundary = None
    with task("driving", options.adaptive, "runs") as report:
        drive = _Driver(options, sweep, driven, report)
        with drive.pool:
            if options.adaptive is not None:
                boundary = _locate(options, sweep, drive, options.adaptive)
            else:
                drive(
                    sweep.grid()
                    if options.samples is None
                    else sweep.sample(options.samples, options.seed)
                )
    return _finish(options, sweep, list(driven.values()), boundary)


class _Driver:
    """Drives points that are not stored yet, and adds all to `driven` in their order."""

    def __init__(
        self, options: Options, sweep: Sweep, driven: dict[Point, SweepRun], report: Any
    ) -> None:
        self._options, self._driven, self._report = options, driven, report
        self._shards = Shards(options.out / "shards", SweepRun, "runs")
        self._plan: Plan[Point, SweepRun] = Plan(
            work=functools.partial(sweep_runs.drive_point, sweep=sweep),
            task_of=operator.attrgetter("values"),
            describe=sweep_runs.describe,
            what="runs",
            size=options.shard,
        )
        self.pool = SharedPool(pool_of(options, sweep_runs.sweep_code) or worker_pool)

    def __call__(self, points: Sequence[Point]) -> list[SweepRun]:
        found: dict[Point, SweepRun] = {}
        before = len(self._driven)
        total = self._options.adaptive or before + len(points)

        def keep(rows: Sequence[SweepRun]) -> None:
            found.update((row.values, row) for row in rows)
            self._report(before + len(found), total=total)

        run_sharded(self._plan, points, self._shards, keep, self._options.jobs, self.pool)
        self._driven.update((point, found[point]) for point in points)
        return [found[point] for point in points]


def _locate(options: Options, sweep: Sweep, drive: _Driver, limit: int) -> Boundary:
    """Drives an adaptive design of at most `limit` points."""
    axes = sweep.continuous()
    # As many as a grid has by default in the plane; fewer where they would be many.
    first = 5 if len(axes) <= 2 else 3
    counts = [len(axis.values) or first for axis in axes]
    if limit < math.prod(counts):
        grid = " x ".join(map(str, counts))
        raise InputError(f"adaptive {limit} is less than the first grid of {grid} points")
    boundary = Boundary(counts)
    fixed = {axis.name: axis.values[0] for axis in sweep.axes if len(axis.values) == 1}
    while nodes := boundary.ask(limit - len(boundary.found)):
        places = [dict(zip(axes, boundary.share(node), strict=True)) for node in nodes]
        points = []
        for place in places:
            texts = fixed | {axis.name: axis.at(share) for axis, share in place.items()}
            points.append(tuple((axis.name, texts[axis.name]) for axis in sweep.axes))
        for node, row in zip(nodes, drive(points), strict=True):
            name = sweep_runs.outcome(row, options)[0]
            boundary.found[node] = None if name == "error" else name
    return boundary


def _boundary_text(sweep: Sweep, boundary: Boundary) -> str:
    """Where the boundaries are, and the grid that shows them as well."""
    widths = boundary.widths()
    if not widths:
        return "All outcomes are the same: there is no boundary between the first points."
    axes = sweep.continuous()
    texts = [
        f"{number_text(float(f'{width * (axis.high - axis.low):.3g}'))} of {sweep.label(axis.name)}"
        for axis, width in zip(axes, widths, strict=True)
    ]
    grid, count = boundary.equal_grid(), len(boundary.found)
    return (
        f"{count} runs locate the boundaries between the outcomes within {' and '.join(texts)} on "
        f"the sides of cells; a grid with these steps has {grid} points, "
        f"{grid / count:.1f} times as many."
    )


def _finish(
    options: Options, sweep: Sweep, runs: Sequence[SweepRun], boundary: Boundary | None
) -> int:
    rows = list(sweep_runs.table_rows(sweep, runs, options))
    sweep_runs.write_runs(options.out / "runs.csv", rows)
    notes = [] if boundary is None else [_boundary_text(sweep, boundary)]
    begun = Counter(r["events"] for r in rows if r["outcome"] in ("near miss", "comfortable"))
    if len(begun) > 1:
        fewer = sum(count for events, count in begun.items() if events < max(begun))
        notes.append(f"In {fewer} runs without collision fewer events began than in the others.")
    order = sorted(range(len(rows)), key=lambda k: sweep_runs.severity(runs[k], rows[k]["outcome"]))
    worst = [rows[k] for k in order]
    with task("writing the report"):
        page = _write(options, sweep, runs, boundary, worst, notes)
    counts = Counter(row["outcome"] for row in rows)
    failed = [row for row in rows if row["outcome"] == "error"]
    if options.json:
        about = {"command": "sweep", "version": iits_mj.__version__, "seed": options.seed}
        found = {"outcomes": dict(counts), "notes": notes, "runs": rows}
        print(json.dumps(about | found, allow_nan=False))
        return 1 if failed else 0
    lines = [f"{len(rows)} runs: " + ", ".join(f"{counts[o]} {o}" for o in sweep_runs.OUTCOMES)]
    table = [("outcome", *sweep.names, "reason")]
    table += [_cells(sweep, row) for row in worst[:_WORST]]
    lines += [*notes, "", "the worst runs:", aligned(table)]
    lines += ["", f"the worst again: {worst[0]['command']}"]
    show("\n".join(lines))
    print(f"report: {page} (rows: {options.out / 'runs.csv'})")
    return 1 if failed else 0


def _cells(sweep: Sweep, row: dict[str, Any]) -> tuple[str, ...]:
    return (row["outcome"], *(row[name] for name in sweep.names), row["reason"][:60])


def _write(
    options: Options,
    sweep: Sweep,
    runs: Sequence[SweepRun],
    boundary: Boundary | None,
    worst: Sequence[dict[str, Any]],
    notes: Sequence[str],
) -> Path:
    """Writes the picture and the page; returns the path of the page."""
    # Load matplotlib only for the report.
    from iits_mj.evaluation.sweep.pictures import draw_sweep
    from iits_mj.render import plots
    from iits_mj.render.pages import Page, Section, picture_section

    figure, sentence = draw_sweep(sweep, runs, options, boundary)
    png = plots.to_png(figure, 120)
    write_whole(options.out / "sweep.png", png, "picture")
    counts = Counter(row["outcome"] for row in worst)
    pet = "" if options.near_pet is None else f", PET below {options.near_pet:g} s"
    limits = (
        f"A near miss has a time to collision below {options.near_ttc:g} s, a DRAC above "
        f"{options.near_drac:g} m/s2, a deceleration of the truck above "
        f"{options.near_deceleration:g} m/s2{pet}. A failure is a roll-over, a road departure or a "
        "simulation that diverged."
    )
    header = ("outcome", *(sweep.label(name) for name in sweep.names), "reason", "command")
    sections = [
        Section(sentences=[*notes, limits, *([sentence] if sentence else [])]),
        picture_section("Outcomes", png),
        Section("Numbers of runs", header=("outcome", "runs"), rows=[
            (name, str(counts[name])) for name in sweep_runs.OUTCOMES
        ]),
        Section("The worst runs", header=header, rows=[
            (*_cells(sweep, row), f"`{row['command']}`") for row in worst[:_LISTED]
        ]),
    ]  # fmt: skip
    lead = f"iits-mj {iits_mj.__version__}; {options.scenario.name}, {len(runs)} runs"
    return Page("iits-mj sweep", lead, sections).write(options.out / "sweep.html")
