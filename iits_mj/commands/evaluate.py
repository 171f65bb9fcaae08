"""Compare decision makers over the paper's six traffic cells, on paired seeds.

With --quick one short trip a cell is driven, for a look at the table; its figures say little.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from tqdm import tqdm

from iits_mj.commands.output import ResultOptions, finish, prepare_folder
from iits_mj.options import option
from iits_mj.results import Results
from iits_mj.validation import evaluate

QUICK_LENGTH, QUICK_DURATION = 2_000.0, 60.0


@dataclass(frozen=True, kw_only=True)
class Options(evaluate.EvaluateConfig, ResultOptions):
    """Flags of `iits-mj evaluate`."""

    quick: bool = option(False, help="one short trip a cell; ends within a minute")


def run(options: Options) -> int:
    """Drives the trips that are missing and shows the table."""
    if options.quick:
        options = dataclasses.replace(
            options, trials=1, length=QUICK_LENGTH, duration=QUICK_DURATION
        )
    if options.file is not None:
        prepare_folder(options.file.parent, "file")
    return finish(options, lambda: measure(options))


def measure(options: Options) -> Results:
    """The table, with a progress bar while it is driven."""
    with tqdm(unit=" trips", disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        return evaluate.run(options, progress)
