"""Mutation score of the plugin and the kernels: which small faults in C++ do the tests find?

    python tools/mutants_cpp.py                        # what changed since the branch left main
    python tools/mutants_cpp.py --full --sample 400 --seed 1
    python tools/mutants_cpp.py --full                 # everything, overnight
    python tools/mutants_cpp.py --full --only kernels  # one of the two libraries

A library holds all its mutants (tools/cpp_mutations.py). The tests run once to record which mutants
each test file reaches, and once more per mutant in a forked process: the files that reach it, the
fastest first, until a test fails. A crash or a run beyond the time limit counts as killed as well.
Results go into DIR/cpp.csv; a second run continues there. tools/mutants_equivalent.toml lists
mutants that change no result, with the reason; they do not count.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import csv
import ctypes
import hashlib
import json
import os
import random
import re
import select
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cpp_mutations
from cpp_mutations import KERNELS, PACKAGE, PLUGIN, Library, Mutant

ROOT = PACKAGE.parent
TESTS = ROOT / "tests"
EQUIVALENT = Path(__file__).with_name("mutants_equivalent.toml")
FIELDS = [
    "area",
    "file",
    "line",
    "at",
    "operator",
    "original",
    "mutant",
    "outcome",
    "by",
    "seconds",
    "source",
]
FLAGS = ["-std=c++17", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-w", "-DNDEBUG"]
PYTEST = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow"]
FOUND = ("killed", "crash", "timeout")

# Compiles the program that a test wants from the mutated headers, and only once.
COMPILER = """#!/bin/sh
for word; do
  case "$word" in *.cc) source=$word ;; -shared) kind=$word ;; esac
  program=$word
done
kept={build}/$(basename "$source").program
if [ ! "$kept" -nt "$source" ]; then
  {compiler} -O1 {flags} $kind "$source" -o "$kept.$$" && mv "$kept.$$" "$kept" || exit 1
fi
cp "$kept" "$program"
"""


def changed_lines(since: str) -> dict[str, set[int]]:
    """Lines of the libraries that differ from a commit, by file."""
    folders = [f"iits_mj/{library.folder}" for library in TEST_FILES]
    command = ["git", "diff", "-U0", "--no-color", since, "--", *folders]
    diff = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    lines: dict[str, set[int]] = {}
    file = ""
    for line in diff.splitlines():
        if line.startswith("+++ "):
            file = line.removeprefix("+++ b/iits_mj/")
        elif hunk := re.match(r"@@ .* \+(\d+)(?:,(\d+))? @@", line):
            first, count = int(hunk[1]), int(hunk[2] or 1)
            lines.setdefault(file, set()).update(range(first, first + count))
    return lines


def default_base() -> str:
    """Where this branch left main; on main itself, the commit before."""
    command = ["git", "merge-base", "HEAD", "main"]
    base = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    return base.stdout.strip() if base.stdout.strip() not in ("", head.stdout.strip()) else "HEAD~1"


def digest(paths: list[Path]) -> str:
    """Of the contents of files."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def as_json(value: Any) -> Any:
    """The value as JSON returns it, where tuples are lists."""
    return json.loads(json.dumps(value))


def build(library: Library, mutants: list[Mutant], folder: Path) -> tuple[Path, set[int]]:
    """Compiles one library with all mutants; returns it and the mutants that do not compile."""
    built = folder / library.name
    stamp = folder / "stamp.json"
    numbered = [(m.number, m.key) for m in mutants]
    state = {"mutants": numbered, "code": digest(library.sources())}
    if stamp.exists() and (kept := json.loads(stamp.read_text()))["state"] == as_json(state):
        return built, set(kept["broken"])
    shutil.rmtree(folder, ignore_errors=True)
    overlay = folder / "include"
    header = Path(__file__).with_name("cpp_mutations.h")
    flags = [*FLAGS, "-include", str(header), f"-I{overlay}", *cpp_mutations.include_flags()]
    compiler = os.environ.get("CXX", "c++")
    broken: set[int] = set()
    while True:
        places: dict[Path, dict[int, tuple[int, int]]] = {}
        for file in dict.fromkeys(mutant.file for mutant in mutants):
            code = (PACKAGE / file).read_bytes().decode("latin-1")
            chosen = [m for m in mutants if m.file == file and m.number not in broken]
            text, place = cpp_mutations.render(code, chosen)
            path = overlay / file
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists() or path.read_bytes() != text.encode("latin-1"):
                path.write_bytes(text.encode("latin-1"))
            places[path] = place
        units = sorted((PACKAGE / library.folder).rglob("*.cc"))
        mutated = [overlay / unit.relative_to(PACKAGE) for unit in units]
        units = [m if m in places else unit for m, unit in zip(mutated, units, strict=True)]
        objects, blamed, errors = [], set(), ""
        for unit in units:
            objects.append(folder / f"{unit.stem}.o")
            command = [compiler, *flags, "-O2", "-fvisibility=hidden", "-fmax-errors=0", "-c"]
            command += [str(unit), "-o", str(objects[-1])]
            result = subprocess.run(command, capture_output=True, text=True)
            if result.returncode:
                errors = result.stderr
                for path, place in places.items():
                    blamed |= set(cpp_mutations.blamed(errors, path, place))
        if not errors:
            break
        if not blamed:
            raise RuntimeError(f"{library.name} with mutants does not compile:\n{errors[:3000]}")
        broken |= blamed
    link = [compiler, "-shared", *map(str, objects)]
    if library is PLUGIN:
        mujoco_folder = Path(cpp_mutations.include_flags()[1][2:]).parent
        engine = next(mujoco_folder.glob("libmujoco.so.*"))
        link += [str(engine), f"-Wl,-rpath,{engine.parent}"]
    subprocess.run([*link, "-o", str(built)], check=True)
    script = folder / "c++"
    script.write_text(COMPILER.format(build=folder, compiler=compiler, flags=" ".join(flags)))
    script.chmod(0o755)
    stamp.write_text(json.dumps({"state": state, "broken": sorted(broken)}))
    return built, broken


# Tests of each library.
TEST_FILES = {
    PLUGIN: ("plugin/test_*.py", "truck/test_plant.py"),
    KERNELS: (
        *("kernels/test_*.py", "controllers/tracking/test_*.py", "controllers/planning/test_*.py"),
        *("controllers/pcc/test_*.py", "traffic_bridge/m*/test_*.py"),
        *("controllers/decision/test_rules.py", "controllers/decision/test_worlds.py"),
        "controllers/decision/test_fast_world*.py",
        *("traffic_bridge/network/test_lane_poses.py", "road/test_reference_line.py"),
        *("truck/test_state.py", "simulation/test_gaps.py", "core/test_neighbors.py"),
    ),
}
# Test files of a law's subject.
LAWS = {
    "tire|road": "tire",
    "spatial": "aerodynamics|tire",
    "fifth_wheel": "fifth_wheel",
    "steering": "steering",
    "aerodynamics": "aerodynamics",
    "air_brake|brake_control|dead_time|reservoir|wheel_brake": "air_brake|manuals",
    "endurance|retarder": "retarder|air_brake|powertrain",
    "shift_.*|gearbox": "gear|powertrain",
    "engine|driveline|gears|gear_loss|powertrain": "powertrain|gear|retarder",
    "lookup|number": "powertrain$|tire|steering|air_brake$|air_brake_supply",
    "planar": "planar",
}
# Area of a source and the area's test files; these run first.
AREAS = {
    **{laws: ("plugin", f"plugin/test_({tests}|laws)") for laws, tests in LAWS.items()},
    "vehicle|statics|forces|loads|motion|pose|api|plant": ("planar plant", "truck/test_plant"),
    "lateral|longitudinal|driveline_inverse|rounding": ("tracking", "controllers/tracking/"),
    "trajectory|boxes|following|neighbors|speed_plan|interpolation": (
        "planning",
        "controllers/planning/|simulation/|core/",
    ),
    "decision_rules|fast_traffic|fast_world|numpy_random": (
        "decision",
        "controllers/decision/",
    ),
    "interior_point|node_system|vectors|speed_passes": (
        "predictive cruise control",
        "controllers/pcc/",
    ),
    "mirror|vehicles": ("traffic bridge", "traffic_bridge/"),
    "reference_line|truck_state": ("road and truck", "(road|truck)/"),
    "arithmetic|kernels|vehicle_columns": ("kernels", "kernels/"),
}


def area_of(file: str) -> tuple[str, str]:
    """Area of a source, and a regular expression of the test files that run first."""
    areas = (a for names, a in AREAS.items() if re.fullmatch(names, Path(file).stem))
    return next(areas, ("plugin", "plugin/"))


class Watcher:
    """A pytest plugin that keeps the first test that failed."""

    def __init__(self) -> None:
        self.failed = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Of a test."""
        if report.failed and not self.failed:
            self.failed = report.nodeid.split("::", 1)[-1]

    def pytest_collectreport(self, report: Any) -> None:
        """Of a file that cannot be imported."""
        if report.failed and not self.failed:
            self.failed = report.nodeid


class Tests:
    """The tests of libraries, in processes forked from this one, which has imported everything."""

    def __init__(
        self, libraries: dict[Library, Path], folder: Path, count: int, area_only: bool, tests: str
    ) -> None:
        import pytest

        self.libraries, self.folder, self.count = libraries, folder, count
        self.area_only = area_only
        self.last_reached = ""
        self.reached: dict[Path, set[int]] = {}
        self.seconds: dict[Path, float] = {}
        self.files = {
            path: library.folder
            for library in libraries
            for pattern in TEST_FILES[library]
            for path in sorted(TESTS.glob(pattern))
            if re.search(tests, str(path.relative_to(TESTS)))
        }
        for library, built in libraries.items():
            os.environ[library.variable] = str(built)
            if library is PLUGIN:
                os.environ["CXX"] = str(built.with_name("c++"))
                for program in built.parent.glob("*.program"):
                    program.unlink()
        sys.path.insert(0, str(ROOT))
        os.chdir(ROOT)
        with open(os.devnull, "w") as null, contextlib.redirect_stdout(null):
            pytest.main([*PYTEST, "--collect-only", *map(str, self.files)])
        loaded = [ctypes.CDLL(str(built)) for built in libraries.values()]
        array = ctypes.c_ubyte * (1 << 16)
        self.switches = [ctypes.c_int.in_dll(library, "iits_mutant") for library in loaded]
        self.flags = [array.in_dll(library, "iits_reached") for library in loaded]

    def run(self, number: int, files: list[Path], limit: float) -> tuple[str, str]:
        """Runs test files on a mutant; returns outcome and the first test that failed."""
        import pytest

        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.setsid()
            log = os.open(self.folder / "last.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(log, 1)
            os.dup2(log, 2)
            os.environ["IITS_MUTANT"] = str(max(number, 0))
            for switch in self.switches:
                switch.value = number
            watcher = Watcher()
            ended_with = pytest.main([*PYTEST, *map(str, files)], plugins=[watcher])
            numbers = range(1, self.count + 1)
            reached = "".join(f"{i} " for i in numbers if any(flags[i] for flags in self.flags))
            text = f"{int(ended_with)}\n{watcher.failed}\n{reached if number < 0 else ''}"
            with os.fdopen(writing, "w") as pipe:
                pipe.write(text)
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as pipe:
            ended = select.select([pipe], [], [], limit)[0]
            with contextlib.suppress(ProcessLookupError):
                if not ended:
                    os.killpg(child, signal.SIGKILL)
            text = pipe.read()
        os.waitpid(child, 0)
        if not ended:
            return "timeout", files[0].name
        if not text:
            return "crash", files[0].name
        code, failed, self.last_reached = text.split("\n")
        # 5: no test was collected, as where a marker excludes all.
        return ("survived", "") if int(code) in (0, 5) else ("killed", failed)

    def measure(self) -> None:
        """Runs each test file once, without a mutant: they must pass, and tell what they reach."""
        kept_in = self.folder / "reached.json"
        kept = json.loads(kept_in.read_text()) if kept_in.exists() else {}
        stamps = [built.with_name("stamp.json") for built in self.libraries.values()]
        for path in self.files:
            name = str(path.relative_to(TESTS))
            helpers = [p for p in path.parent.glob("*.*") if not p.name.startswith("test_")]
            state = digest([path, *sorted(helpers), *stamps])
            if kept.get(name, {}).get("state") != state:
                begin = time.monotonic()
                outcome, failed = self.run(-1, [path], 600)
                if outcome != "survived":
                    raise RuntimeError(f"without a mutant, {name} fails: {outcome} {failed}")
                seconds, reached = time.monotonic() - begin, self.last_reached.split()
                kept[name] = {"state": state, "seconds": seconds, "reached": reached}
                kept_in.write_text(json.dumps(kept))
            self.seconds[path] = kept[name]["seconds"]
            self.reached[path] = {int(number) for number in kept[name]["reached"]}

    def judge(self, mutant: Mutant) -> tuple[str, str]:
        """Runs the test files that reach the mutant, those of its own subject and fast ones first.

        A file with a program of the laws cannot tell what it reaches, so it always runs.
        """
        folder = mutant.file.split("/")[0]
        files = [
            p
            for p, tested in self.files.items()
            if tested == folder and (mutant.number in self.reached[p] or "CXX" in p.read_text())
        ]
        own = {
            p
            for p in files
            if re.match(area_of(mutant.file)[1], str(p.relative_to(TESTS).with_suffix("")))
        }
        files = [p for p in files if p in own or not self.area_only]
        files.sort(key=lambda p: (p not in own, self.seconds[p]))
        for path in files:
            outcome, by = self.run(mutant.number, [path], 20 + 15 * self.seconds[path])
            if outcome != "survived":
                name = path.relative_to(TESTS)
                return outcome, f"{name}::{by}" if outcome == "killed" else by
        return "survived", "" if files else "no test reaches it"


def equivalent() -> dict[tuple[str, ...], str]:
    """Keys of the mutants that change no result, with the reason."""
    entries = tomllib.loads(EQUIVALENT.read_text())["mutant"] if EQUIVALENT.exists() else []
    names = ("file", "source", "at", "original", "mutant")
    return {tuple(str(entry[name]) for name in names): entry["reason"] for entry in entries}


def key(row: dict[str, str]) -> tuple[str, ...]:
    """Key of a row of the results; equal to `Mutant.key`."""
    return row["file"], row["source"], row["at"], row["original"], row["mutant"]


def read(path: Path) -> list[dict[str, str]]:
    """Rows of earlier results, if there are any."""
    if not path.exists():
        return []
    with path.open() as lines:
        return list(csv.DictReader(lines))


def table(rows: list[dict[str, str]]) -> Iterator[str]:
    """Lines of a Markdown table: killed of all, by area, file and operator."""
    same = equivalent()
    for what in ("area", "file", "operator"):
        yield f"| {what} | mutants | equivalent | killed | survived | score |"
        yield "|---|---|---|---|---|---|"
        counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
        for row in rows:
            outcome = "killed" if row["outcome"] in FOUND else row["outcome"]
            if outcome == "survived" and key(row) in same:
                outcome = "equivalent"
            if outcome != "did not compile":
                counts[row[what]][outcome] += 1
                counts["all"][outcome] += 1
        for name in sorted(counts, key=lambda n: (n == "all", n)):
            c = counts[name]
            real = c["killed"] + c["survived"]
            score = f"{100 * c['killed'] / real:.0f} %" if real else "-"
            yield (
                f"| {name} | {c.total()} | {c['equivalent']} | {c['killed']} | {c['survived']} "
                f"| {score} |"
            )
        yield ""


def parse() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--since", metavar="REV", help="mutate lines that differ from this commit")
    which.add_argument("--full", action="store_true", help="mutate everything")
    parser.add_argument("--sample", type=int, metavar="N", help="a random sample of the mutants")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--out", type=Path, default=Path("out/mutants"), metavar="DIR")
    parser.add_argument("--again", choices=("survived", "all"), help="judge mutants once more")
    parser.add_argument("--area", action="store_true", help="only the tests of a source's own area")
    parser.add_argument("--tests", default="", help="regular expression of the test files")
    parser.add_argument("--only", default="", help="regular expression of the sources")
    return parser.parse_args()


def main() -> int:
    """Runs the mutants that have no result yet, and prints the tables."""
    options = parse()
    mutants = [
        mutant
        for library in TEST_FILES
        for path in library.sources()
        for mutant in cpp_mutations.find(path, library)
        if re.search(options.only, mutant.file)
    ]
    if not options.full:
        lines = changed_lines(options.since or default_base())
        mutants = [m for m in mutants if m.line in lines.get(m.file, ())]
    if options.sample and options.sample < len(mutants):
        chosen = random.Random(options.seed).sample(range(len(mutants)), options.sample)
        mutants = [mutants[i] for i in sorted(chosen)]
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out.resolve() / "cpp.csv"
    known = {key(row): row for row in read(results)}
    wanted = {m.key for m in mutants}
    again = {None: (), "survived": ("survived",), "all": (*FOUND, "survived")}[options.again]
    mutants = cpp_mutations.number(mutants)
    to_run = [m for m in mutants if m.key not in known or known[m.key]["outcome"] in again]
    # In random order, the results are a random sample at any time.
    random.Random(options.seed).shuffle(to_run)
    print(f"{len(wanted)} mutants of the C++, {len(to_run)} of them to run", flush=True)
    if to_run:
        folder = options.out.resolve() / "build"
        libraries, broken = {}, set()
        for library in TEST_FILES:
            own = [m for m in mutants if m.file.startswith(f"{library.folder}/")]
            if own:
                libraries[library], failed = build(library, own, folder / library.folder)
                broken |= failed
        tests = Tests(libraries, folder, len(mutants), options.area, options.tests)
        tests.measure()
        print(f"the tests pass without a mutant in {sum(tests.seconds.values()):.0f} s", flush=True)
        for done, mutant in enumerate(to_run, 1):
            begin = time.monotonic()
            outcome, by = "did not compile", ""
            if mutant.number not in broken:
                outcome, by = tests.judge(mutant)
            known[mutant.key] = {
                **{name: str(getattr(mutant, name)) for name in FIELDS if hasattr(mutant, name)},
                "area": area_of(mutant.file)[0],
                "outcome": outcome,
                "by": by,
                "seconds": f"{time.monotonic() - begin:.1f}",
            }
            write(results, list(known.values()))
            if done % 20 == 0:
                print(f"{done} of {len(to_run)}", flush=True)
    rows = [row for name, row in known.items() if name in wanted]
    print("\n".join(table(rows)))
    same = equivalent()
    for row in rows:
        if row["outcome"] == "survived" and key(row) not in same:
            place = f"{row['file']}:{row['line']}"
            print(f"survived: {place}: {row['original']}  ->  {row['mutant'] or 'nothing'}")
    return 0


def write(path: Path, rows: list[dict[str, str]]) -> None:
    """Replaces the results, so that a stopped run leaves a whole file."""
    with path.with_suffix(".part").open("w", newline="") as lines:
        writer = csv.DictWriter(lines, FIELDS)
        writer.writeheader()
        writer.writerows(rows)
    path.with_suffix(".part").replace(path)


if __name__ == "__main__":
    sys.exit(main())
