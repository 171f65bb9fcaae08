"""Compares two files of `iits-mj evaluate`: two worlds, or two time steps.

    python benchmarks/trial_agreement.py full.csv fast.csv

Prints, as Markdown, the speed loss [%] and the lane changes of each cell and method in both files,
the loss on the free road, and a summary of the rows. Differences are over the common seeds: the
same traffic if both files are of the full chain, else traffic of the same kind.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr
from trial_sets import trials_of

from controllers.decision.trip import CELLS
from iits_mj.evaluation.figures import POLICY, RULES, STRONGER, CellFigures, figures, same_seeds
from iits_mj.evaluation.trials import Trial
from iits_mj.validation.harness.statistics import Estimate, estimate

METHODS = (*RULES, *STRONGER, POLICY)
HEADER = "| cell | method | trips | loss | its loss | difference | changes | its changes |"


@dataclass(frozen=True)
class Row:
    """A method in a cell: loss [%] and changes in both files, and the difference of the losses."""

    cell: str
    method: str
    loss: tuple[float, float]
    changes: tuple[float, float]
    difference: Estimate

    def __str__(self) -> str:
        """A row of the table."""
        apart = self.difference
        return (
            f"| {self.cell} | {self.method} | {apart.count} | {self.loss[0]:.2f} | "
            f"{self.loss[1]:.2f} | {apart.mean:+.2f} ± {apart.half:.2f} | "
            f"{self.changes[0]:.2f} | {self.changes[1]:.2f} |"
        )


def cells_of(path: Path) -> dict[str, CellFigures]:
    """The figures of a file by cell."""
    return {cell.name: cell for cell in figures(trials_of(path), CELLS, METHODS)}


def compare(cell: str, method: str, pairs: Sequence[tuple[Trial, Trial]]) -> Row:
    """Figures of a method over pairs of trials with the same seed, one from each file."""
    loss = np.array([[100.0 * trial.speed_loss for trial in pair] for pair in pairs]).T
    changes = [
        float(np.mean([trial.changes for trial in trials])) for trials in zip(*pairs, strict=True)
    ]
    return Row(
        cell,
        method,
        (float(loss[0].mean()), float(loss[1].mean())),
        (changes[0], changes[1]),
        estimate(loss[1] - loss[0]),
    )


def together(rows: list[Row]) -> list[str]:
    """Summary of all rows."""
    lines = []
    for name in ("loss", "changes"):
        one, two = np.array([getattr(row, name) for row in rows]).T
        text = f"{name}: mean absolute difference {np.abs(two - one).mean():.2f}"
        if len(rows) > 2:
            text += f", correlation {np.corrcoef(one, two)[0, 1]:.3f}"
        lines.append(text)
    cells = [list(cell) for _, cell in itertools.groupby(rows, key=lambda row: row.cell)]
    losses = [np.array([row.loss for row in cell]) for cell in cells if len(cell) > 2]
    if losses:
        ranks = np.mean([spearmanr(pair).statistic for pair in losses])
        lines.append(f"rank correlation of the methods, mean over the cells: {ranks:.3f}")
    return lines


def main() -> None:
    """Prints the table of two files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    asked = parser.parse_args()
    first, second = cells_of(asked.first), cells_of(asked.second)
    shared = [name for name in first if name in second]
    rows = [
        compare(name, method, pairs)
        for name in shared
        for method in METHODS
        if (pairs := same_seeds(*(f[name].trials.get(method, ()) for f in (first, second))))
    ]
    if not rows:
        sys.exit("no method is in both files in the same cell and on the same seeds")
    print(HEADER, "|---|---|---|---|---|---|---|---|", *rows, "", *together(rows), sep="\n")
    floors = [f"{name}: {first[name].floor:.2f}, {second[name].floor:.2f}" for name in shared]
    print("free road:", "; ".join(floors))


if __name__ == "__main__":
    main()
