"""Mutation testing of the Python packages: which small faults do the tests notice?

    python tools/mutants_python.py --since main                 # mutants of the changed lines
    python tools/mutants_python.py --full --sample 60 --seed 1  # a sample of every area
    python tools/mutants_python.py --full                       # every mutant; hours

A mutant is the source with one change, see `mutant_operators`. A test that fails, or takes much
longer than before, kills it. Only tests of the mutant's area run, and of these only the tests that
run the changed line, fastest first, up to `--budget` seconds a mutant. The score is the share of
killed mutants among those that are not listed as equivalent in `mutants_equivalent_python.toml`.

The tool records once which test runs which line, then forks one process a mutant from a process
that has imported the libraries. The process compiles the mutant in memory; no file changes.
`DIR/python.csv` has one row a mutant. A second call skips its mutants, except those whose source
has changed; `--again` repeats the surviving ones, for new tests.
"""

from __future__ import annotations

import argparse
import ast
import csv
import importlib
import itertools
import math
import os
import random
import re
import subprocess
import time
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from mutant_operators import mutations
from mutant_runs import COLUMNS, KEY, ROOT, Area, Mutant, coverage_of, digest_of, judge

EQUIVALENT = Path(__file__).with_name("mutants_equivalent_python.toml")
SUMMARY = "python_summary.csv"
SURVIVED = "survived: {file}:{line}: {operator}: {original} -> {mutant}"
EQUIVALENT_KEY = ("file", "function", "operator", "original", "mutant")
# Libraries that the first process imports. They must not import this project's modules.
LIBRARIES = (
    *("numpy", "scipy.linalg", "scipy.optimize", "scipy.interpolate", "casadi", "mujoco"),
    *("cantools", "can", "lxml.etree", "xdist"),
)


AREAS = (
    Area(
        "tracking",
        ("controllers/tracking",),
        ("tests/controllers/tracking", "tests/controllers/test_on_truck.py"),
    ),
    Area(
        "planning",
        ("controllers/planning",),
        ("tests/controllers/planning", "tests/controllers/test_red_light_truck.py"),
    ),
    Area(
        "safe stop",
        ("controllers/safe_stop",),
        ("tests/controllers/safe_stop", "tests/simulation/test_bus_cut.py"),
    ),
    Area(
        "bus receiver",
        tuple(f"iits_mj/j1939/{name}.py" for name in ("receiver", "requests", "command")),
        ("tests/j1939",),
    ),
    Area("predictive cruise control", ("controllers/pcc",), ("tests/controllers/pcc",)),
    Area(
        "traffic bridge",
        ("traffic_bridge/mirror", "traffic_bridge/modes"),
        ("tests/traffic_bridge/mirror", "tests/traffic_bridge/modes"),
    ),
)


# --- choosing mutants -----------------------------------------------------------------------


def mutants_of(area: Area, file: str) -> Iterator[Mutant]:
    """All mutants of a file, without its settings."""
    digest = digest_of(ROOT / file)
    for number, mutation in enumerate(mutations(ast.parse((ROOT / file).read_text()))):
        if mutation.operator != "setting":
            yield Mutant(area, file, number, mutation, digest)


def changed_lines(revision: str) -> dict[str, set[int]]:
    """Lines that changed since a revision, by file."""
    command = ["git", "diff", "-U0", "--no-color", revision, "--", "*.py"]
    text = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    found: dict[str, set[int]] = {}
    file = ""
    for line in text.splitlines():
        if line.startswith("+++ "):
            file = line.removeprefix("+++ b/")
        elif match := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", line):
            start, count = int(match[1]), int(match[2] or 1)
            found.setdefault(file, set()).update(range(start, start + count))
    return found


def choose(arguments: argparse.Namespace) -> dict[str, list[Mutant]]:
    """Mutants by area, as the flags ask for."""
    changed = None if arguments.full else changed_lines(arguments.since)
    chosen: dict[str, list[Mutant]] = {}
    for area in AREAS:
        if arguments.area and area.name not in arguments.area:
            continue
        found = []
        for file in area.files():
            if arguments.only and not file.startswith(arguments.only):
                continue
            lines = None if changed is None else changed.get(file, set())
            found += [
                mutant
                for mutant in mutants_of(area, file)
                if lines is None or mutant.mutation.line in lines
            ]
        if arguments.sample is not None and arguments.sample < len(found):
            found = random.Random(arguments.seed).sample(found, arguments.sample)
        if found:
            chosen[area.name] = found
    return chosen


def equivalent_mutants() -> set[tuple[str, ...]]:
    """File, function, operator, original and mutant of the mutants that change no behavior."""
    entries = tomllib.loads(EQUIVALENT.read_text()).get("equivalent", [])
    return {tuple(entry[name] for name in EQUIVALENT_KEY) for entry in entries}


# --- results --------------------------------------------------------------------------------


def read_rows(path: Path) -> dict[tuple[str, ...], dict[str, str]]:
    """Rows of an earlier run."""
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {tuple(row[name] for name in KEY): row for row in rows}


def write_rows(path: Path, rows: Iterable[dict[str, str]], columns: Sequence[str]) -> None:
    """Writes a table."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def summarize(rows: Iterable[dict[str, str]]) -> list[dict[str, str]]:
    """Mutants, equivalent, killed, survived and score [%] by area."""
    rows = list(rows)
    table = []
    for area in AREAS:
        outcomes = [row["outcome"] for row in rows if row["area"] == area.name]
        if not outcomes:
            continue
        equivalent = outcomes.count("equivalent")
        survived = outcomes.count("survived")
        counted = len(outcomes) - equivalent
        score = 100.0 * (counted - survived) / counted if counted else 100.0
        values = (area.name, len(outcomes), equivalent, counted - survived, survived)
        names = ("area", "mutants", "equivalent", "killed", "survived", "score_percent")
        table.append(dict(zip(names, (*map(str, values), f"{score:.1f}"), strict=True)))
    return table


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The flags."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    lines = parser.add_mutually_exclusive_group()
    lines.add_argument("--since", default="HEAD", help="mutants of the lines changed since it")
    lines.add_argument("--full", action="store_true", help="mutants of every line")
    parser.add_argument("--only", help="only files whose path begins with this")
    parser.add_argument("--area", action="append", choices=[area.name for area in AREAS])
    parser.add_argument("--sample", type=int, help="number of mutants drawn from each area")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--budget", type=float, default=20.0, help="tests of a mutant [s]")
    parser.add_argument("--minutes", type=float, default=math.inf, help="time for all of it")
    parser.add_argument("--again", action="store_true", help="run surviving mutants again")
    parser.add_argument("--out", type=Path, default=Path("out/mutants"))
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the mutants and writes both tables."""
    flags = parse(arguments)
    os.chdir(ROOT)
    # One thread a process: a fork copies no others.
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", COVERAGE_CORE="ctrace")
    for name in LIBRARIES:
        importlib.import_module(name)
    flags.out.mkdir(parents=True, exist_ok=True)
    table = flags.out / "python.csv"
    known = read_rows(table)
    equivalent = equivalent_mutants()
    done: dict[tuple[str, ...], dict[str, str]] = {}
    areas = choose(flags)
    tests = {k: coverage_of(area[0].area, flags.out / "coverage") for k, area in areas.items()}
    end = time.monotonic() + 60.0 * flags.minutes
    # In turn, so that a run that ends early has a sample of every area.
    rounds = itertools.zip_longest(*areas.values())
    for mutant in (m for each in rounds for m in each if m is not None):
        row = known.get(mutant.key)
        again = row is not None and flags.again and row["outcome"] == "survived"
        if tuple(mutant.row("")[column] for column in EQUIVALENT_KEY) in equivalent:
            row = mutant.row("equivalent")
        elif time.monotonic() > end:
            if row is None:
                continue
        elif row is None or again or row["outcome"] == "equivalent":
            row = judge(mutant, tests[mutant.area.name], flags.budget)
        done[mutant.key] = known[mutant.key] = row
        write_rows(table, known.values(), COLUMNS)
        if row["outcome"] == "survived":
            print(SURVIVED.format(**row), flush=True)
    summary = summarize(done.values())
    if summary:
        write_rows(flags.out / SUMMARY, summary, list(summary[0]))
    for entry in summary:
        print(
            "{area}: {killed} killed, {survived} survived, {equivalent} equivalent: "
            "{score_percent} %".format(**entry)
        )


if __name__ == "__main__":
    main()
