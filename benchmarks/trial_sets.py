"""Evaluates several sets of test trips: files of `iits-mj evaluate`, one for each `--seed`.

    python benchmarks/trial_sets.py first.csv second.csv

Prints, as Markdown, the policy against the best of the paper's rules in the common cells and
methods of all files: speed loss [%], the difference over the same trips with half of its 95 %
interval, p of Student's and Wilcoxon's tests, Student's p corrected by Holm for the number of
cells, and lane changes a trip; then the difference over the trips of all these cells.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from controllers.decision.trip import CELLS
from iits_mj.core.errors import InputError
from iits_mj.evaluation.figures import POLICY, RULES, CellFigures, figures, over_all
from iits_mj.evaluation.trials import EMPTY, Trial, read_trials

METHODS = (*RULES, POLICY)
HEADER = (
    f"| cell | trips | best rule | its loss | {POLICY} | difference | p (t; Wilcoxon) | corrected "
    "| rule's changes | its changes | its changes less the rule's |"
)


def trials_of(path: Path) -> list[Trial]:
    """The trials of a file; the program ends with the reason if the file cannot be read."""
    if not path.exists():
        sys.exit(f"file of trials {str(path)!r} does not exist")
    try:
        return list(read_trials(path, print).values())
    except InputError as error:
        sys.exit(str(error))


def check_together(sets: Sequence[Sequence[Trial]]) -> None:
    """Ends the program if the sets have different settings, or share a trip."""
    trials = [trial for own in sets for trial in own]
    tasks = {trial.task for trial in trials}
    if len(tasks) < len(trials):
        sys.exit("a trip is in more than one file: name sets of different --seed")
    for name in ("world", "payload", "timestep", "length_limit", "duration_limit"):
        if len(found := {getattr(trial, name) for trial in trials}) > 1:
            sys.exit(f"the files hold trips of different {name}: {sorted(found)}")
    if len(found := {trial.weights for trial in trials if trial.method == POLICY}) != 1:
        sys.exit(f"all files must have the same policy, they have {len(found)}: {sorted(found)}")


def shared(sets: Sequence[Sequence[Trial]]) -> list[CellFigures]:
    """Figures of the common cells and methods of all sets."""
    cells = [
        (density, speed)
        for density, speed in CELLS
        if all(POLICY in methods_of(own, density, speed) for own in sets)
    ]
    methods = [
        name
        for name in METHODS
        if all(name in methods_of(own, *cell) for own in sets for cell in cells)
    ]
    if not cells or len(methods) < 2:
        sys.exit(f"no cell has {POLICY} and one of {', '.join(RULES)} in all files")
    return figures([trial for own in sets for trial in own], cells, methods)


def methods_of(trials: Sequence[Trial], density: str, speed: float) -> set[str]:
    """The methods that drove in a cell."""
    return {t.method for t in trials if (t.density, t.traffic_speed) == (density, speed)}


def row(cell: CellFigures) -> str:
    """A row of the table."""
    best, versus, more = cell.best, cell.against[cell.best], cell.more_changes[cell.best]
    return (
        f"| {cell.name} | {versus.count} | {best} | {cell.loss[best].mean:.1f} | "
        f"{cell.loss[POLICY].mean:.1f} | {versus.mean:+.2f} ± {versus.half:.2f} | "
        f"{versus.t_p:.2g}; {versus.wilcoxon_p:.2g} | {cell.holm:.2g} | "
        f"{cell.changes[best].mean:.1f} | {cell.changes[POLICY].mean:.1f} | "
        f"{more.mean:+.2f} ± {more.half:.2f} |"
    )


def main() -> None:
    """Prints the table of several files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE.csv")
    files = parser.parse_args().files
    # All sets share the drives on the free road.
    sets = [[trial for trial in trials_of(path) if trial.density != EMPTY] for path in files]
    check_together(sets)
    cells = shared(sets)
    print(HEADER, "|---" * 11 + "|", *(row(cell) for cell in cells), sep="\n")
    for rule in {cell.best: None for cell in cells}:
        if whole := over_all(cells, POLICY, rule):
            print(
                f"\nall {whole.count} trips, {POLICY} less {rule}: {whole.mean:+.2f} ± "
                f"{whole.half:.2f}, p = {whole.t_p:.2g}; {whole.wilcoxon_p:.2g}"
            )


if __name__ == "__main__":
    main()
