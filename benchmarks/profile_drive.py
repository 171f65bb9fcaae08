"""Where the time of a drive goes: a sampled profile by part, as a table and a picture.

    pip install py-spy==0.4.1
    python benchmarks/profile_drive.py --name "version 0.1.0" --csv docs/performance/profile.csv
    python benchmarks/profile_drive.py --picture docs/performance/profile.png \
        --csv docs/performance/profile.csv

The first form samples the drive of `iits-mj bench` a thousand times a second and adds a column to
the table, in milliseconds per simulated second; `--python` names the interpreter of another
version's environment. The second form draws the table. A sample belongs to the innermost part whose
function is in its stack.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from iits_mj.render.plots import GRID, INK, PALETTE

SECONDS = 120
RATE = 1000
# Parts with the functions that belong to them, outermost first.
PARTS = {
    "MuJoCo, mj_step": ("Truck.step",),
    "MuJoCo, mj_forward": ("bring_up_to_date",),
    "SUMO": ("simulation.step", "simulationStep"),
    "observation of the truck": ("Simulation._observe",),
    "tracking": ("Stack.control",),
    "predictive cruise control": ("PccReference.update",),
    "trajectory planner": ("Planner.plan",),
    "decision maker and its observation": ("Stack.plan",),
    "traffic bridge": ("PureSim.step",),
    "mirror in MuJoCo": ("Simulation._move_bodies",),
    "frame, summary, loop": ("Simulation.cycle",),
}
DRIVE = f"""
from iits_mj.simulation import DriveConfig, Simulation
config = DriveConfig(density="dense", duration={SECONDS}.0, seed=2)
simulation = Simulation(config, visuals=False)
while not simulation.ended:
    simulation.cycle()
"""


def sample(python: str) -> dict[str, float]:
    """Time of each part [ms per simulated second]."""
    with tempfile.TemporaryDirectory() as folder:
        script, raw = Path(folder, "drive.py"), Path(folder, "raw.txt")
        script.write_text(DRIVE)
        command = ["py-spy", "record", "-r", str(RATE), "-f", "raw", "-o", str(raw), "--"]
        subprocess.run([*command, python, str(script)], check=True, capture_output=True)
        counts: Counter[str] = Counter()
        for line in raw.read_text().splitlines():
            stack, _, number = line.rpartition(" ")
            functions = [frame.split(" (")[0] for frame in stack.split(";")]
            if "Simulation.cycle" not in functions:
                continue
            known = {name: part for part, names in PARTS.items() for name in names}
            counts[next(known[f] for f in reversed(functions) if f in known)] += int(number)
    return {part: 1e3 * counts[part] / RATE / SECONDS for part in PARTS}


def draw(table: list[dict[str, str]], picture: Path) -> None:
    from matplotlib.figure import Figure

    names = [name for name in table[0] if name != "part"]
    figure = Figure(figsize=(9.5, 1.1 + 0.8 * len(names)), layout="constrained")
    axes = figure.subplots()
    left = dict.fromkeys(names, 0.0)
    colors = [*PALETTE, *(f"{color}99" for color in PALETTE)]
    for row, color in zip(table, colors, strict=False):
        widths = [float(row[name]) for name in names]
        axes.barh(names, widths, left=list(left.values()), color=color, label=row["part"])
        left = {name: left[name] + float(row[name]) for name in names}
    for name, total in left.items():
        axes.text(total, name, f" {total:.1f} ms", va="center", color=INK, fontsize=9)
    axes.invert_yaxis()
    axes.set_xlim(right=1.12 * max(left.values()))
    axes.set_xlabel("milliseconds of one core per simulated second", color=INK)
    axes.grid(True, axis="x", color=GRID)
    axes.set_axisbelow(True)
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8
    )
    figure.savefig(picture, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, required=True)
    parser.add_argument("--name", help="of the column to add or to replace")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    path = arguments.csv
    rows = list(csv.DictReader(path.open())) if path.exists() else [{"part": p} for p in PARTS]
    if arguments.name:
        found = sample(arguments.python)
        for row in rows:
            row[arguments.name] = f"{found[row['part']]:.2f}"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    if arguments.picture:
        draw(rows, arguments.picture)


if __name__ == "__main__":
    main()
