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
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

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
from iits_mj.evaluation.sweep.design import Point, Sweep, SweepConfig
from iits_mj.evaluation.sweep.runs import SweepRun
from iits_mj.scale.shards import Plan, Shards, run_sharded

_PRINTED, _LISTED = 5, 20  # of the worst runs: in the summary, in the page


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
    sweep_runs.check_names(sweep)
    prepare_folder(options.out)
    sweep_runs.check_folder(options.out, sweep.identity())
    boundary = None
    with _Driver(options, sweep) as drive:
        if options.adaptive is not None:
            boundary = _locate(options, sweep, drive, options.adaptive)
        elif options.samples is not None:
            drive(sweep.sample(options.samples, options.seed))
        else:
            drive(sweep.grid())
    return _finish(options, sweep, list(drive.driven.values()), boundary)


class _Driver(ExitStack):
    """Drives the points that are not stored yet; all are in `driven`, in their order."""

    def __init__(self, options: Options, sweep: Sweep) -> None:
        super().__init__()
        self.driven: dict[Point, SweepRun] = {}
        self._options = options
        self._shards = Shards(options.out / "shards", SweepRun, "runs")
        self._plan: Plan[Point, SweepRun] = Plan(
            work=functools.partial(sweep_runs.drive_point, sweep=sweep),
            task_of=operator.attrgetter("values"),
            describe=sweep_runs.describe,
            what="runs",
            size=options.shard,
        )
        pool = SharedPool(pool_of(options, sweep_runs.sweep_code) or worker_pool)
        self._pool = self.enter_context(pool)
        self._report = self.enter_context(task("driving", options.adaptive, "runs"))

    def __call__(self, points: Sequence[Point]) -> list[SweepRun]:
        found: dict[Point, SweepRun] = {}
        before = len(self.driven)

        def keep(rows: Sequence[SweepRun]) -> None:
            found.update((row.values, row) for row in rows)
            self._report(before + len(found), total=self._options.adaptive or len(points))

        run_sharded(self._plan, points, self._shards, keep, self._options.jobs, self._pool)
        self.driven.update((point, found[point]) for point in points)
        return [found[point] for point in points]


def _locate(options: Options, sweep: Sweep, drive: _Driver, limit: int) -> Boundary:
    """Drives an adaptive design of at most `limit` points."""
    axes = sweep.continuous()
    counts = [len(axis.values) or (5 if len(axes) <= 2 else 3) for axis in axes]
    if limit < math.prod(counts):
        grid = " x ".join(map(str, counts))
        raise InputError(f"adaptive {limit} is less than the first grid of {grid} points")
    boundary = Boundary(counts)
    while nodes := boundary.ask(limit - len(boundary.found)):
        points = []
        for node in nodes:
            shares = dict(zip(axes, boundary.share(node), strict=True))
            points.append(tuple((axis.name, axis.at(shares.get(axis, 0.0))) for axis in sweep.axes))
        for node, row in zip(nodes, drive(points), strict=True):
            name = sweep_runs.outcome(row, options)[0]
            boundary.found[node] = None if name == "error" else name
    return boundary


def _boundary_text(sweep: Sweep, boundary: Boundary) -> str:
    """Where the boundaries are, and the grid that shows them as well."""
    if not (widths := boundary.widths()):
        return "All outcomes are the same: no boundary was found."
    places = " and ".join(
        f"{width * (axis.ends[1] - axis.ends[0]):.3g} of {sweep.label(axis.name)}"
        for axis, width in zip(sweep.continuous(), widths, strict=True)
    )
    grid, count = boundary.equal_grid(), len(boundary.found)
    found = f"{count} runs locate the boundaries between the outcomes within {places} on the sides"
    if grid <= count:
        return f"{found} of cells, no better than a grid of {grid} points: give --adaptive more."
    times = f"{grid / count:.1f} times as many"
    return f"{found} of cells; a grid with these steps has {grid} points, {times}."


def _finish(
    options: Options, sweep: Sweep, runs: Sequence[SweepRun], boundary: Boundary | None
) -> int:
    """Writes all files and prints the summary; returns the exit code."""
    # Load matplotlib only for the report.
    from iits_mj.evaluation.sweep.pictures import draw_sweep
    from iits_mj.render import plots
    from iits_mj.render.pages import Page, Section, picture_section

    rows = list(sweep_runs.table_rows(sweep, runs, options))
    sweep_runs.write_runs(options.out / "runs.csv", rows)
    counts = Counter(row["outcome"] for row in rows)
    count_text = ", ".join(f"{counts[name]} {name}" for name in sweep_runs.OUTCOMES)
    lines = [f"{len(rows)} runs: {count_text}."]
    lines += [] if boundary is None else [_boundary_text(sweep, boundary)]
    begun = Counter(r["events"] for r in rows if r["outcome"] in ("near miss", "comfortable"))
    if len(begun) > 1:
        fewer = sum(count for events, count in begun.items() if events < max(begun))
        lines.append(f"In {fewer} runs without collision fewer events began than in the others.")
    order = sorted(range(len(rows)), key=lambda k: sweep_runs.severity(runs[k], rows[k]["outcome"]))
    worst = [rows[k] for k in order[:_LISTED]]
    table = [("outcome", *map(sweep.label, sweep.swept), "reason")]
    table += [
        (row["outcome"], *(row[name] for name in sweep.swept), row["reason"][:60]) for row in worst
    ]
    with task("writing the report"):
        figure, sentence = draw_sweep(sweep, runs, options, boundary)
        png = plots.to_png(figure, 120)
        write_whole(options.out / "sweep.png", png, "picture")
        sentences = [*lines, sweep_runs.limits_text(options), *([sentence] if sentence else [])]
        commands = [
            (*cells, f"`{r['command']}`") for cells, r in zip(table[1:], worst, strict=True)
        ]
        parts = [
            Section(sentences=sentences),
            picture_section("Outcomes", png),
            Section("The worst runs", header=(*table[0], "command"), rows=commands),
        ]
        lead = f"iits-mj {iits_mj.__version__}; {options.scenario.name}"
        page = Page("iits-mj sweep", lead, parts).write(options.out / "sweep.html")
    if options.json:
        about = {"command": "sweep", "version": iits_mj.__version__, "seed": options.seed}
        found = {"outcomes": dict(counts), "notes": lines[1:], "runs": rows}
        print(json.dumps(about | found, allow_nan=False))
    else:
        shown = ["", "the worst runs:", aligned(table[: _PRINTED + 1])]
        show("\n".join([*lines, *shown, "", f"the worst again: {worst[0]['command']}"]))
        print(f"report: {page} (rows: {options.out / 'runs.csv'})")
    return 1 if counts["error"] else 0
