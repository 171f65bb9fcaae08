"""Mutation score of the plugin's C++: which small faults do the tests of the plugin find?

    python tools/mutants_cpp.py                        # what changed since the branch left main
    python tools/mutants_cpp.py --full --sample 400 --seed 1
    python tools/mutants_cpp.py --full                 # everything, overnight

One library holds all mutants (tools/cpp_mutations.py). The tests run once to record which mutants
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
from cpp_mutations import PACKAGE, Mutant

ROOT = PACKAGE.parent
TESTS = ROOT / "tests" / "plugin"
EQUIVALENT = Path(__file__).with_name("mutants_equivalent.toml")
FIELDS = [
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
    """Lines of the plugin that differ from a commit, by file."""
    command = ["git", "diff", "-U0", "--no-color", since, "--", "iits_mj/plugin"]
    diff = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    lines: dict[str, set[int]] = {}
    file = ""
    for line in diff.splitlines():
        if line.startswith("+++ "):
            file = line.removeprefix("+++ b/iits_mj/plugin/")
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


def build(mutants: list[Mutant], folder: Path) -> tuple[Path, set[int]]:
    """Compiles one library with all mutants; returns it and the mutants that do not compile."""
    library = folder / "libiits_mj_plugin.so"
    stamp = folder / "stamp.json"
    state = {"mutants": [m.key for m in mutants], "code": digest(cpp_mutations.sources())}
    if stamp.exists() and (kept := json.loads(stamp.read_text()))["state"] == as_json(state):
        return library, set(kept["broken"])
    shutil.rmtree(folder, ignore_errors=True)
    overlay = folder / "include"
    header = Path(__file__).with_name("cpp_mutations.h")
    flags = [*FLAGS, "-include", str(header), f"-I{overlay}", *cpp_mutations.include_flags()]
    compiler = os.environ.get("CXX", "c++")
    broken: set[int] = set()
    while True:
        places: dict[Path, dict[int, tuple[int, int]]] = {}
        for file in dict.fromkeys(mutant.file for mutant in mutants):
            code = (PACKAGE / "plugin" / file).read_bytes().decode("latin-1")
            chosen = [m for m in mutants if m.file == file and m.number not in broken]
            text, place = cpp_mutations.render(code, chosen)
            path = overlay / "plugin" / file
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists() or path.read_bytes() != text.encode("latin-1"):
                path.write_bytes(text.encode("latin-1"))
            places[path] = place
        units = [overlay / "plugin" / p.name for p in (PACKAGE / "plugin").glob("*.cc")]
        units = [u if u in places else PACKAGE / "plugin" / u.name for u in units]
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
            raise RuntimeError(f"the mutated plugin does not compile:\n{errors[:3000]}")
        broken |= blamed
    mujoco_folder = Path(cpp_mutations.include_flags()[1][2:]).parent
    engine = next(mujoco_folder.glob("libmujoco.so.*"))
    link = [compiler, "-shared", *map(str, objects), str(engine), f"-Wl,-rpath,{engine.parent}"]
    subprocess.run([*link, "-o", str(library)], check=True)
    script = folder / "c++"
    script.write_text(COMPILER.format(build=folder, compiler=compiler, flags=" ".join(flags)))
    script.chmod(0o755)
    stamp.write_text(json.dumps({"state": state, "broken": sorted(broken)}))
    return library, broken


# Test files of a law's area; these run first.
AREAS = {
    "tire|road": "tire",
    "spatial": "aerodynamics|tire",
    "fifth_wheel": "fifth_wheel",
    "steering": "steering",
    "aerodynamics": "aerodynamics",
    "air_brake|brake_control|dead_time|reservoir|wheel_brake": "air_brake|manuals",
    "endurance|retarder": "retarder|air_brake|powertrain",
    "shift_.*|gearbox": "gearbox|powertrain",
    "engine|driveline|gears|powertrain": "powertrain|gearbox(?!_hunting)|retarder",
    "lookup|number": "powertrain$|tire|steering|air_brake$|air_brake_supply",
}


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
    """The tests of the plugin, in processes forked from this one, which has imported everything."""

    def __init__(self, library: Path, count: int, area_only: bool, tests: str) -> None:
        import mujoco
        import pytest

        self.library, self.count = library, count
        self.area_only, self.tests = area_only, tests
        self.last_reached = ""
        self.reached: dict[Path, set[int]] = {}
        self.seconds: dict[Path, float] = {}
        load = mujoco.mj_loadPluginLibrary
        open_library = ctypes.CDLL

        def redirected(path: Any) -> Any:
            return str(library) if str(path).endswith(library.name) else path

        mujoco.mj_loadPluginLibrary = lambda path: load(redirected(path))
        ctypes.CDLL = lambda path, *a, **k: open_library(redirected(path), *a, **k)  # type: ignore
        for program in library.parent.glob("*.program"):
            program.unlink()
        os.environ["CXX"] = str(library.with_name("c++"))
        sys.path.insert(0, str(ROOT))
        os.chdir(ROOT)
        with open(os.devnull, "w") as null, contextlib.redirect_stdout(null):
            pytest.main([*PYTEST, "--collect-only", str(TESTS)])
        self.switch = ctypes.c_int.in_dll(ctypes.CDLL(str(library)), "iits_mutant")
        array = ctypes.c_ubyte * (1 << 16)
        self.flags = array.in_dll(ctypes.CDLL(str(library)), "iits_reached")

    def run(self, number: int, files: list[Path], limit: float) -> tuple[str, str]:
        """Runs test files on a mutant; returns outcome and the first test that failed."""
        import pytest

        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.setsid()
            log = os.open(self.library.with_name("last.log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(log, 1)
            os.dup2(log, 2)
            os.environ["IITS_MUTANT"] = str(max(number, 0))
            self.switch.value = number
            watcher = Watcher()
            ended_with = pytest.main([*PYTEST, *map(str, files)], plugins=[watcher])
            reached = "".join(f"{i} " for i in range(1, self.count + 1) if self.flags[i])
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
        kept_in = self.library.with_name("reached.json")
        kept = json.loads(kept_in.read_text()) if kept_in.exists() else {}
        for path in sorted(TESTS.glob("test_*.py")):
            if not re.match(self.tests, path.stem):
                continue
            state = digest([path, *(sorted(TESTS.glob("laws*.*")) if "law" in path.name else ())])
            if kept.get(path.name, {}).get("state") != state:
                begin = time.monotonic()
                outcome, failed = self.run(-1, [path], 600)
                if outcome != "survived":
                    raise RuntimeError(f"without a mutant, {path.name} fails: {outcome} {failed}")
                seconds, reached = time.monotonic() - begin, self.last_reached.split()
                kept[path.name] = {"state": state, "seconds": seconds, "reached": reached}
                kept_in.write_text(json.dumps(kept))
            self.seconds[path] = kept[path.name]["seconds"]
            self.reached[path] = {int(number) for number in kept[path.name]["reached"]}

    def judge(self, mutant: Mutant) -> tuple[str, str]:
        """Runs the test files that reach the mutant, those of its own subject and fast ones first.

        A file with a program of the laws cannot tell what it reaches, so it always runs.
        """
        subject = Path(mutant.file).stem
        area = next((tests for laws, tests in AREAS.items() if re.fullmatch(laws, subject)), "")
        files = [p for p, r in self.reached.items() if mutant.number in r or "CXX" in p.read_text()]
        if self.area_only:
            files = [p for p in files if re.fullmatch(f"test_({area}|laws).*", p.stem)]
        files.sort(key=lambda p: (not re.match(f"test_({area}|laws)", p.stem), self.seconds[p]))
        for path in files:
            outcome, by = self.run(mutant.number, [path], 20 + 15 * self.seconds[path])
            if outcome != "survived":
                return outcome, f"{path.name}::{by}" if outcome == "killed" else by
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
    """Lines of a Markdown table: killed of all, by file and by operator."""
    same = equivalent()
    for what in ("file", "operator"):
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
    parser.add_argument("--area", action="store_true", help="only the tests of a law's own area")
    parser.add_argument("--tests", default="", help="regular expression of the test files")
    parser.add_argument("--only", default="", help="regular expression of the files")
    return parser.parse_args()


def main() -> int:
    """Runs the mutants that have no result yet, and prints the tables."""
    options = parse()
    mutants = [m for path in cpp_mutations.sources() for m in cpp_mutations.find(path)]
    if not options.full:
        lines = changed_lines(options.since or default_base())
        mutants = [m for m in mutants if m.line in lines.get(m.file, ())]
    if options.sample and options.sample < len(mutants):
        chosen = random.Random(options.seed).sample(range(len(mutants)), options.sample)
        mutants = [mutants[i] for i in sorted(chosen)]
    mutants = [m for m in mutants if re.search(options.only, m.file)]
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out.resolve() / "cpp.csv"
    known = {key(row): row for row in read(results)}
    wanted = {m.key for m in mutants}
    again = {None: (), "survived": ("survived",), "all": (*FOUND, "survived")}[options.again]
    mutants = cpp_mutations.number(mutants)
    to_run = [m for m in mutants if m.key not in known or known[m.key]["outcome"] in again]
    # In random order, the results are a random sample at any time.
    random.Random(options.seed).shuffle(to_run)
    print(f"{len(wanted)} mutants of the plugin, {len(to_run)} of them to run", flush=True)
    if to_run:
        library, broken = build(mutants, options.out.resolve() / "build")
        tests = Tests(library, len(mutants), options.area, options.tests)
        tests.measure()
        print(f"the tests pass without a mutant in {sum(tests.seconds.values()):.0f} s", flush=True)
        for done, mutant in enumerate(to_run, 1):
            begin = time.monotonic()
            outcome, by = "did not compile", ""
            if mutant.number not in broken:
                outcome, by = tests.judge(mutant)
            known[mutant.key] = {
                **{name: str(getattr(mutant, name)) for name in FIELDS if hasattr(mutant, name)},
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
