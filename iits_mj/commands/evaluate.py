"""Compare decision makers in the paper's six traffic cells, all in the same traffic.

--quick drives one short trip in each cell to show the table; its figures have no significance.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import iits_mj
from controllers import decision
from controllers.decision.prices import Prices
from iits_mj.commands.output import (
    ClusterOptions,
    ResultOptions,
    finish,
    pool_of,
    prepare_file,
    prepare_folder,
)
from iits_mj.commands.terminal import show
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import remark, task
from iits_mj.core.results import Results
from iits_mj.envs.baselines import load_baseline
from iits_mj.evaluation import evaluate
from iits_mj.evaluation.drives import trial_code
from iits_mj.evaluation.figures import summarize
from iits_mj.evaluation.trials import Task, Trial
from iits_mj.scale.shards import Plan, Shards, run_sharded

if TYPE_CHECKING:
    from iits_mj.evaluation.hoel2020 import Driver

QUICK_LENGTH = 500.0
KEPT = "evaluate.csv"


@dataclass(frozen=True, kw_only=True)
class Options(evaluate.EvaluateConfig, ClusterOptions, ResultOptions):
    """Flags of `iits-mj evaluate`."""

    scenario: str = option(
        "paper",
        help="paper: its traffic cells; hoel2020: the published truck scenario of Hoel et al., in "
        "which a policy trained there joins the methods",
        choices=("paper", "hoel2020"),
        group="traffic",
    )
    quick: bool = option(False, help="one short trip in each cell, within minutes", group="run")


def run(options: Options) -> int:
    """Drives the missing trips, shows the table, writes the report; returns the exit code."""
    if options.scenario == "hoel2020":
        return _hoel2020(options)
    if options.quick:
        options = dataclasses.replace(options, trials=1, length=QUICK_LENGTH)
    if options.report is not None:
        prepare_folder(options.report, "report")
        options = dataclasses.replace(options, file=options.file or options.report / KEPT)
    if options.ray is not None and options.file is None:
        raise InputError("--ray needs a file for the trials: add --file FILE.csv or --report DIR")
    if options.file is not None:
        prepare_file(options.file, "--file")
    trials = drive(options)
    results, cells = summarize(trials, options)
    show(results.to_json(iits_mj.__version__) if options.json else to_text(results))
    if options.report is not None and cells:
        # Load matplotlib only for reports.
        from iits_mj.evaluation.page import write_page

        web, text = write_page(results, cells, trials, options, options.report)
        stream = sys.stderr if options.json else sys.stdout
        print(f"report: {web} (the same as Markdown: {text})", file=stream)
    return 0 if results.ok else 1


# Flags that also have a meaning in another scenario than the paper's.
_COMMON = (
    *("scenario", "trials", "methods", "weights", "seeds", "seed", "jobs", "file", "json"),
    *("report", "lane_change_price", "imposed_braking_price", "left_lane_price", "quick"),
)


def _hoel2020(options: Options) -> int:
    """Compares the methods in the scenario of Hoel et al. (2020)."""
    from iits_mj.evaluation import hoel2020

    for field in dataclasses.fields(options):
        if field.name not in _COMMON and getattr(options, field.name) != field.default:
            flag = field.name.replace("_", "-")
            raise InputError(f"--{flag} has no meaning with --scenario hoel2020: leave it out")
    if options.file is not None:
        prepare_file(options.file, "--file")
    first = evaluate.trial_seed(0, 0, options)
    seeds = range(first, first + (1 if options.quick else options.trials))
    makers = functools.partial(_driver, weights=options.weights, prices=options.prices())

    def measure() -> Results:
        with task("driving", unit="episodes") as report:
            episodes = hoel2020.evaluate(
                (*options.names(), _LEARNED),
                makers,
                seeds,
                options.jobs,
                lambda done, total: report(done, total=total),
            )
        if options.file is not None:
            hoel2020.write(options.file, episodes)
        return hoel2020.summarize(episodes)

    return finish(options, measure)


_LEARNED = "dqn (Stable-Baselines3)"


def _driver(method: str, weights: Path | None, prices: Prices | None) -> Driver:
    """Returns the driver of a method in the scenario of Hoel et al. (2020)."""
    from iits_mj.evaluation.hoel2020 import PolicyDriver, StackDriver

    if method == _LEARNED:
        return PolicyDriver(load_baseline("iits_mj/Hoel2020-v0", "dqn"))
    learned = method == "ddqn"
    file = None if weights is None or not learned else str(weights)
    return StackDriver(decision.make(method, file, prices if learned else None))


def drive(options: Options) -> list[Trial]:
    """Drives the trials and shows the progress; returns them."""
    with task("driving", unit="trips") as report:

        def progress(done: int, total: int) -> None:
            report(done, total=total)

        drive_all = None if options.ray is None else functools.partial(_on_cluster, options)
        return evaluate.run(options, progress, remark, drive_all)


def _on_cluster(
    options: Options,
    tasks: Sequence[Task],
    jobs: int,
    drive: Callable[[Task], Trial],
    keep: Callable[[Trial], None],
) -> None:
    """Drives trials in shards on a Ray cluster.

    The shards stay beside the file until all trials are done: a stopped run continues from them.
    """
    if not tasks:
        return
    if options.file is None:
        raise InputError("the trials of a cluster need a file")
    shards = Shards(options.file.with_name(f"{options.file.name}.shards"), Trial, "trials")
    plan: Plan[Task, Trial] = Plan(
        drive, operator.attrgetter("task"), evaluate.describe, what="trials", size=options.shard
    )

    def keep_all(rows: Sequence[Trial]) -> None:
        for row in rows:
            keep(row)

    pool = pool_of(options, functools.partial(trial_code, options.trial_world))
    run_sharded(plan, tasks, shards, keep_all, jobs, pool)
    shards.clear()


def to_text(results: Results) -> str:
    """Returns the tables and the checks that fall short; the report shows all checks."""
    short = [f"falls short: {check.shortfall()}" for check in results.short()]
    return "\n".join([*results.notes, "", *short, results.count_text()])
