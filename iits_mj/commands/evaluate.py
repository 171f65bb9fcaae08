"""Compare decision makers over the paper's six traffic cells, on the same traffic for all.

With --quick one short trip a cell is driven, for a look at the table; its figures say little.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass

from tqdm import tqdm

import iits_mj
from iits_mj.commands.output import ResultOptions, prepare_file, prepare_folder
from iits_mj.options import option
from iits_mj.results import Results
from iits_mj.validation import evaluate
from iits_mj.validation.evaluate_results import shortfall, summarize
from iits_mj.validation.trials import Trial

QUICK_LENGTH = 500.0
KEPT = "evaluate.csv"


@dataclass(frozen=True, kw_only=True)
class Options(evaluate.EvaluateConfig, ResultOptions):
    """Flags of `iits-mj evaluate`."""

    quick: bool = option(False, help="one short trip a cell; ends within minutes")


def run(options: Options) -> int:
    """Drives the trips that are missing, shows the table and writes the page; 0 or 1."""
    if options.quick:
        options = dataclasses.replace(options, trials=1, length=QUICK_LENGTH)
    if options.report is not None:
        prepare_folder(options.report, "report")
        options = dataclasses.replace(options, file=options.file or options.report / KEPT)
    if options.file is not None:
        prepare_file(options.file, "--file")
    trials = drive(options)
    results, cells = summarize(trials, options)
    print(results.to_json(iits_mj.__version__) if options.json else to_text(results))
    if options.report is not None and cells:
        # matplotlib is loaded by those who want pictures.
        from iits_mj.commands.evaluate_page import write_page

        web, text = write_page(results, cells, trials, options, options.report)
        stream = sys.stderr if options.json else sys.stdout
        print(f"report: {web} (the same as Markdown: {text})", file=stream)
    return 0 if results.ok else 1


def drive(options: Options) -> list[Trial]:
    """The trials, with a progress bar while they are driven."""
    with tqdm(unit=" trips", disable=None, smoothing=0.05) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)
            bar.refresh()

        def say(text: str) -> None:
            tqdm.write(text, file=sys.stderr)

        return evaluate.run(options, progress, say)


def to_text(results: Results) -> str:
    """The tables, and of the checks those that fall short: all of them are on the page."""
    short = [check for check in results.checks if not check.ok]
    lines = [*results.notes, ""]
    lines += [f"falls short: {shortfall(check)}" for check in short]
    held = len(results.checks) - len(short)
    return "\n".join([*lines, f"{held} of {len(results.checks)} checks hold"])
