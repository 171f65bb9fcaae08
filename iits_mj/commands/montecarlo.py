"""Draw trucks from what is not known of the figures, and measure them all.

Distribution of handling, brake and fuel figures, shares that hold the standards, and which
parameter each figure hangs on. What is done is kept in shards in --folder; the same command goes on
with the rest, on this machine or on a Ray cluster, and the figures are the same.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands.output import (
    ClusterOptions,
    ResultOptions,
    finish,
    pool_of,
    prepare_folder,
    progress_of,
)
from iits_mj.core.options import option
from iits_mj.core.results import Results
from iits_mj.evaluation import montecarlo
from iits_mj.evaluation.montecarlo import Sample, SampleTask, measure, sample_code
from iits_mj.scale.shards import Plan, Shards, run_sharded

SAMPLES = "samples.csv"
QUICK_SAMPLES = 4


@dataclass(frozen=True, kw_only=True)
class Options(montecarlo.MonteCarloConfig, ClusterOptions, ResultOptions):
    """Flags of `iits-mj montecarlo`."""

    folder: Path | None = option(
        None, help="keeps the trucks that are measured, and samples.csv", metavar="DIR"
    )
    quick: bool = option(False, help="four trucks; ends within a minute")


def run(options: Options) -> int:
    """Measures the trucks that are missing, shows the figures; 0 or 1."""
    if options.folder is not None:
        prepare_folder(options.folder, "folder")
        return finish(options, functools.partial(_measure, options, options.folder))
    with tempfile.TemporaryDirectory() as folder:
        return finish(options, functools.partial(_measure, options, Path(folder)))


def _measure(options: Options, folder: Path) -> Results:
    config = montecarlo.MonteCarloConfig(
        samples=QUICK_SAMPLES if options.quick else options.samples,
        payload=options.payload,
        timestep=options.timestep,
        spread=options.spread,
        seed=options.seed,
    )
    tasks = montecarlo.tasks_of(config)
    # Trucks of another version of the code lie in another folder.
    shards = Shards(folder / f"shards-{sample_code()}", Sample, "samples")
    rows: list[Sample] = []
    plan: Plan[SampleTask, Sample] = Plan(
        work=functools.partial(measure, spread_file=config.spread),
        task_of=_task_of,
        describe=montecarlo.describe,
        what="trucks",
        size=options.shard,
    )
    with progress_of(len(tasks), "trucks") as advance:

        def keep(found: Sequence[Sample]) -> None:
            rows.extend(found)
            advance(len(found))

        run_sharded(plan, tasks, shards, keep, options.jobs, pool_of(options, sample_code))
    order = {task: place for place, task in enumerate(tasks)}
    rows.sort(key=lambda row: order[row.task])
    montecarlo.write_samples(folder / SAMPLES, config, rows)
    return montecarlo.summarize(config, rows)


def _task_of(row: Sample) -> SampleTask:
    return row.task
