"""Effect of each option of `iits-mj train`: a shorter training with and without it.

    python benchmarks/training_options.py --out out/options --seeds 0 1 > docs/training_options.csv

Every training is a process of its own in a folder of its own; an interrupted run continues. A row
is one of a training's six validations, 30 trips in the fast world on seeds that the training does
not use; figures are those of `training.csv`.

With the default charge on changes and the default discount, a training of this length would stay at
the policy without lane changes. Here changes are cheaper, the future counts less, and updates are
more frequent.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from iits_mj.core.tables import read_table

# Settings with which a short training shows a difference.
SHORT = ["--change-charge", "40", "--discount", "0.99", "--updates-per-decision", "0.5"]
# Changes of the defaults.
OPTIONS = {
    "defaults": [],
    "no mirror": ["--no-mirror"],
    "no standardized": ["--no-standardized"],
    "gap 0": ["--gap", "0"],
    "no dueling": ["--no-dueling"],
    "average-rate 0": ["--average-rate", "0"],
    "guided-share 0": ["--guided-share", "0"],
}
FIGURES = ("score_per_s", "speed_loss", "changes_per_trip", "unsafe_per_trip", "collisions")
COLUMNS = ("decisions", *(f"validation_{name}" for name in FIGURES))
VALIDATIONS = 6


def train(name: str, seed: int, decisions: int, out: Path) -> None:
    """Runs or continues a training; a finished training ends at once."""
    folder = out / f"{name.replace(' ', '_')}-{seed}"
    flags = ["--decisions", str(decisions), "--seed", str(seed), "--jobs", "1"]
    flags += [*SHORT, *OPTIONS[name], "--epsilon-decisions", str(decisions // 2)]
    flags += ["--learning-rate-decisions", str(decisions)]
    flags += ["--evaluate-interval", str(decisions // VALIDATIONS)]
    if (folder / "checkpoint.pt").exists():
        flags.append("--resume")
    command = [sys.executable, "-m", "iits_mj.cli", "train", "--out", str(folder), *flags]
    with (out / f"{folder.name}.log").open("a", encoding="utf-8") as log:
        subprocess.run(command, stdout=log, stderr=log, check=True)


def figures(name: str, seed: int, out: Path) -> list[list[str]]:
    """The rows of a finished training, one for each validation."""
    table = out / f"{name.replace(' ', '_')}-{seed}" / "training.csv"
    names, rows = read_table(table, "training table")
    places = [names.index(column) for column in COLUMNS]
    return [[name, str(seed), *(row[i] for i in places)] for row in rows]


def main() -> None:
    """Runs the missing trainings and prints the table as CSV."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/options"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--decisions", type=int, default=120_000)
    parser.add_argument("--options", nargs="+", default=list(OPTIONS), choices=list(OPTIONS))
    parser.add_argument("--at-a-time", type=int, default=1)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    runs = [(name, seed) for seed in asked.seeds for name in asked.options]
    with ThreadPoolExecutor(asked.at_a_time) as pool:
        list(pool.map(lambda run: train(*run, asked.decisions, asked.out), runs))
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["option", "seed", "decisions", *FIGURES])
    for name, seed in runs:
        table.writerows(figures(name, seed, asked.out))


if __name__ == "__main__":
    main()
