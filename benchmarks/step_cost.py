"""Cost of a step: `iits-mj bench`, repeated in new processes, with medians and spread.

    python benchmarks/step_cost.py --repeats 5 > step_cost.md

Each repeat is a process of its own, so that memory layout and machine load vary as for users; the
table gives the median and the full spread. Compare ratios rather than times.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
from collections import defaultdict


def measure(repeats: int, flags: list[str]) -> tuple[dict[str, list[float]], dict[str, str]]:
    values: dict[str, list[float]] = defaultdict(list)
    units: dict[str, str] = {}
    for _ in range(repeats):
        run = subprocess.run(
            [sys.executable, "-m", "iits_mj.cli", "bench", "--json", *flags],
            capture_output=True,
            text=True,
            check=False,
        )
        if not run.stdout:
            sys.exit(run.stderr.strip())
        for check in json.loads(run.stdout)["checks"]:
            values[check["name"]].append(check["value"])
            units[check["name"]] = check["unit"]
    return values, units


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    arguments, flags = parser.parse_known_args()
    values, units = measure(arguments.repeats, flags)
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, ")
    print(f"{arguments.repeats} processes\n")
    print("| figure | median | from | to | unit |\n|---|---|---|---|---|")
    for name, series in values.items():
        middle = statistics.median(series)
        print(f"| {name} | {middle:.4g} | {min(series):.4g} | {max(series):.4g} | {units[name]} |")


if __name__ == "__main__":
    main()
