"""Monte Carlo over the uncertainty of the truck's parameters.

Shows the distribution of handling, brake and fuel figures, the share of trucks that meets the
standards, and the parameters on which each figure depends. --folder keeps the finished trucks: the
same command continues with the rest, on this machine or on a Ray cluster, with the same results.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from iits_mj.commands.output import (
    ClusterOptions,
    ResultOptions,
    finish,
    pool_of,
    prepare_folder,
)
from iits_mj.core.options import option
from iits_mj.core.output_files import TemporaryFolder
from iits_mj.core.progress import task
from iits_mj.core.results import Results
from iits_mj.evaluation import parameter_uncertainty as uncertainty
from iits_mj.evaluation.parameter_uncertainty import Sample, SampleTask
from iits_mj.scale.shards import Plan, Shards, run_sharded

QUICK_SAMPLES = 4


@dataclass(frozen=True, kw_only=True)
class Options(uncertainty.MonteCarloConfig, ClusterOptions, ResultOptions):
    """Flags of `iits-mj montecarlo`."""

    folder: Path | None = option(
        None, help="folder for finished trucks and samples.csv", metavar="DIR", group="output"
    )
    quick: bool = option(False, help="four trucks, within a minute", group="run")


def run(options: Options) -> int:
    """Measures the missing trucks and shows the figures; returns the exit code."""
    if options.folder is not None:
        prepare_folder(options.folder, "folder")
        return finish(options, functools.partial(_measure, options, options.folder))
    with TemporaryFolder("montecarlo") as folder:
        return finish(options, functools.partial(_measure, options, folder))


def _measure(options: Options, folder: Path) -> Results:
    names = [field.name for field in fields(uncertainty.MonteCarloConfig)]
    settings = {name: getattr(options, name) for name in names}
    if options.quick:
        settings["samples"] = QUICK_SAMPLES
    config = uncertainty.MonteCarloConfig(**settings)
    tasks = uncertainty.tasks_of(config)
    # Each version of the code has its own folder.
    shards = Shards(folder / f"shards-{uncertainty.sample_code()}", Sample, "samples")
    rows: list[Sample] = []
    plan: Plan[SampleTask, Sample] = Plan(
        work=functools.partial(
            uncertainty.measure,
            spread_file=config.spread,
            truck=config.truck,
            lateral=config.lateral,
            longitudinal=config.longitudinal,
        ),
        task_of=operator.attrgetter("task"),
        describe=uncertainty.describe,
        what="trucks",
        size=options.shard,
    )
    with task("measuring", len(tasks), "trucks") as report:

        def keep(found: Sequence[Sample]) -> None:
            rows.extend(found)
            report(len(rows))

        pool = pool_of(options, uncertainty.sample_code)
        run_sharded(plan, tasks, shards, keep, options.jobs, pool)
    order = {task: place for place, task in enumerate(tasks)}
    rows.sort(key=lambda row: order[row.task])
    uncertainty.write_samples(folder / "samples.csv", config, rows)
    return uncertainty.summarize(config, rows)
