"""Runs the tests of an area against mutants of its sources, each in a forked process.

The first process imports the libraries, never this project. A child puts the mutant's syntax tree
in place of the module's source, so that no file changes.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.machinery
import importlib.util
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import coverage
import hypothesis
import pytest
from mutant_operators import Mutation, mutations

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = (
    *("area", "file", "line", "function", "operator", "original", "mutant", "outcome", "test"),
    *("seconds", "digest"),
)
# Columns that identify a mutant.
KEY = ("file", "line", "operator", "original", "mutant", "digest")


@dataclass(frozen=True)
class Area:
    """Sources that are mutated, and the tests that must notice it."""

    name: str
    sources: tuple[str, ...]
    tests: tuple[str, ...]

    def files(self) -> list[str]:
        """Its source files, relative to the root."""
        found = (p for source in self.sources for p in python_files(ROOT / source))
        return [str(path.relative_to(ROOT)) for path in found if path.name != "__init__.py"]

    def test_files(self) -> list[str]:
        """Its test files, relative to the root."""
        found = (p for tests in self.tests for p in python_files(ROOT / tests))
        return [str(path.relative_to(ROOT)) for path in found if path.name.startswith("test_")]


@dataclass(frozen=True)
class Mutant:
    """A mutation of a file; `number` is its place among the file's mutations."""

    area: Area
    file: str
    number: int
    mutation: Mutation
    digest: str

    @property
    def original(self) -> str:
        """Source of the replaced node, in one line."""
        return _one_line(self.mutation.node)

    @property
    def text(self) -> str:
        """Source of the new node, in one line."""
        return _one_line(ast.fix_missing_locations(self.mutation.replacement))

    def row(self, outcome: str, test: str = "", seconds: float = 0.0) -> dict[str, str]:
        """Its row of the table."""
        m = self.mutation
        values = (
            *(self.area.name, self.file, m.line, m.function, m.operator, self.original, self.text),
            *(outcome, test, f"{seconds:.2f}", f"{self.digest}:{self.number}"),
        )
        return dict(zip(COLUMNS, map(str, values), strict=True))

    @property
    def key(self) -> tuple[str, ...]:
        """Its values in the columns `KEY`."""
        row = self.row("")
        return tuple(row[name] for name in KEY)


@dataclass(frozen=True)
class LineTests:
    """Tests by file and line, and their times [s]."""

    seconds: dict[str, float]
    lines: dict[str, dict[int, set[str]]]

    def tests(self, mutant: Mutant, budget: float) -> dict[str, float]:
        """Tests that run a mutant's line, fastest first, and their times; up to a budget [s]."""
        lines = self.lines.get(mutant.file, {})
        first, last = mutant.mutation.lines
        reached = lines if mutant.mutation.at_import else range(first, last + 1)
        names = {name for line in reached for name in lines.get(line, ())}
        chosen: dict[str, float] = {}
        total = 0.0
        for name in sorted(names, key=lambda name: (self.seconds[name], name)):
            total += self.seconds[name]
            if chosen and total > budget:
                break
            chosen[name] = self.seconds[name]
        return chosen


# --- processes ------------------------------------------------------------------------------


def in_process(work: Callable[[TextIO], None], limit: Callable[[str], float]) -> list[str]:
    """Lines that `work` writes in a forked process; the last is "TIMEOUT" if it was too slow.

    Args:
      work: gets the file to write to.
      limit: CPU time [s] that a line gives the process until the next line; ten times that by the
        clock.
    """
    reader, writer = os.pipe()
    process = os.fork()
    if process == 0:
        status = 1
        try:
            os.setsid()
            null = os.open(os.devnull, os.O_RDWR)
            for descriptor in (0, 1, 2):
                os.dup2(null, descriptor)
            os.close(reader)
            with os.fdopen(writer, "w", buffering=1) as out:
                work(out)
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    lines: list[str] = []
    rest, allowed, begun, used = b"", limit(""), time.monotonic(), 0.0
    while True:
        ready, _, _ = select.select([reader], [], [], 0.5)
        if not ready:
            if _cpu_time(process) - used < allowed and time.monotonic() - begun < 10.0 * allowed:
                continue
            lines.append("TIMEOUT")
            break
        data = os.read(reader, 1 << 16)
        if not data:
            break
        *whole, rest = (rest + data).split(b"\n")
        for line in whole:
            lines.append(line.decode())
            allowed = limit(lines[-1])
        begun, used = time.monotonic(), _cpu_time(process)
    os.close(reader)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return lines


def _cpu_time(process: int) -> float:
    """CPU time of a process [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run_pytest(arguments: Sequence[str], plugin: object) -> int:
    """Runs tests in this process. Hypothesis draws the same examples each time and no smaller."""
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
    hypothesis.settings.register_profile(
        "mutants", database=None, derandomize=True, phases=phases, deadline=None
    )
    hypothesis.settings.load_profile("mutants")
    options = ["-q", "-n0", "-m", "not slow", "-p", "no:cacheprovider", "--no-header"]
    return int(pytest.main([*options, *arguments], plugins=[plugin]))


class MutantLoader(importlib.machinery.SourceFileLoader):
    """Loads a module from a syntax tree instead of its file."""

    def __init__(self, name: str, path: str, tree: ast.Module) -> None:
        super().__init__(name, path)
        self.tree = tree

    def get_code(self, fullname: str) -> Any:  # noqa: ARG002
        """The code of the tree."""
        return compile(self.tree, self.path, "exec")


class MutantFinder:
    """Finds one module, the mutant, before every other finder."""

    def __init__(self, file: str, tree: ast.Module) -> None:
        self.name = file.removesuffix(".py").replace("/", ".")
        if self.name in sys.modules:
            raise RuntimeError(f"{self.name} is imported before its mutants")
        self.loader = MutantLoader(self.name, str(ROOT / file), tree)

    def find_spec(self, name: str, path: object = None, target: object = None) -> Any:  # noqa: ARG002
        """The mutant's specification, or None for another module."""
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(name, self.loader.path, loader=self.loader)


class Chosen:
    """Pytest plugin: runs the given tests in the given order, and reports each start."""

    def __init__(self, order: Iterable[str], out: TextIO) -> None:
        self.order, self.out = {name: k for k, name in enumerate(order)}, out

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Chooses and sorts."""
        items[:] = [item for item in items if item.nodeid in self.order]
        items.sort(key=lambda item: self.order[item.nodeid])

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Reports the start of a test."""
        self.out.write(f"{nodeid}\n")


class Recorder:
    """Pytest plugin: which lines each test runs, and how long it takes."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.sharing: dict[str, list[str]] = {}

    def pytest_collection_finish(self, session: Any) -> None:
        """Tests by file that use a shared fixture."""
        # The lines of a shared fixture belong to every test of the file that uses one.
        for item in session.items:
            fixtures = item._fixtureinfo.name2fixturedefs.values()
            if any(found[-1].scope != "function" for found in fixtures if found):
                self.sharing.setdefault(item.nodeid.split("::")[0], []).append(item.nodeid)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: Any) -> None:
        """Lines of fixtures."""
        self.coverage.switch_context(f"{item.nodeid}|setup")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        """Lines of the test itself, and its CPU time."""
        self.coverage.switch_context(f"{item.nodeid}|call")
        begun = time.process_time()
        try:
            yield
        finally:
            self.seconds[item.nodeid] = time.process_time() - begun

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Tests that do not pass."""
        if report.failed:
            self.failed.add(report.nodeid)

    def owners(self, context: str) -> list[str]:
        """Tests that a context's lines belong to."""
        name, _, phase = context.rpartition("|")
        shared = self.sharing.get(name.split("::")[0], []) if phase == "setup" else []
        return [test for test in {name, *shared} if test in self.seconds.keys() - self.failed]


def record(test_file: str, sources: Sequence[str]) -> dict[str, Any]:
    """Times and lines of the tests of a file: {"seconds": ..., "lines": {file: {line: tests}}}."""

    def work(out: TextIO) -> None:
        watched = [str(ROOT / source) for source in sources]
        measured = coverage.Coverage(data_file=None, config_file=False, include=watched)
        recorder = Recorder(measured)
        measured.start()
        run_pytest([test_file], recorder)
        measured.stop()
        lines: dict[str, dict[int, list[str]]] = {}
        for path in measured.get_data().measured_files():
            by_line = measured.get_data().contexts_by_lineno(path)
            lines[str(Path(path).relative_to(ROOT))] = {
                line: sorted({name for c in contexts for name in recorder.owners(c)})
                for line, contexts in by_line.items()
            }
        good = {k: v for k, v in recorder.seconds.items() if k not in recorder.failed}
        json.dump({"seconds": good, "failed": sorted(recorder.failed), "lines": lines}, out)
        out.write("\n")

    lines = in_process(work, lambda _: 1800.0)
    if not lines or lines[-1] == "TIMEOUT":
        raise RuntimeError(f"{test_file}: the tests could not be recorded")
    return dict(json.loads(lines[-1]))


def coverage_of(area: Area, folder: Path) -> LineTests:
    """Tests by line of an area, recorded again for each test file that changed."""
    folder.mkdir(parents=True, exist_ok=True)
    sources = area.files()
    state = "".join(digest_of(ROOT / source) for source in sources)
    seconds: dict[str, float] = {}
    lines: dict[str, dict[int, set[str]]] = {}
    for test_file in area.test_files():
        digest = hashlib.sha256((state + digest_of(ROOT / test_file)).encode()).hexdigest()[:16]
        kept = folder / f"{area.name} {test_file.replace('/', '.')}.json".replace(" ", "_")
        found = json.loads(kept.read_text()) if kept.exists() else {}
        if found.get("digest") != digest:
            found = {**record(test_file, sources), "digest": digest}
            kept.write_text(json.dumps(found))
        for name in found["failed"]:
            print(f"not counted, because it fails without a mutant: {name}", file=sys.stderr)
        seconds |= found["seconds"]
        for file, by_line in found["lines"].items():
            for line, names in by_line.items():
                lines.setdefault(file, {}).setdefault(int(line), set()).update(names)
    return LineTests(seconds, lines)


def judge(mutant: Mutant, coverage: LineTests, budget: float) -> dict[str, str]:
    """Runs the tests of a mutant and returns its row."""
    tests = coverage.tests(mutant, budget)
    if not tests:
        return mutant.row("survived", "no test runs this line")
    start = time.perf_counter()

    def work(out: TextIO) -> None:
        tree = ast.parse((ROOT / mutant.file).read_text())
        list(mutations(tree))[mutant.number].apply()
        sys.meta_path.insert(0, MutantFinder(mutant.file, tree))
        files = sorted({name.split("::")[0] for name in tests})
        out.write(f"EXIT {run_pytest(['-x', *files], Chosen(tests, out))}\n")

    # A limit for the import of the modules, then for each test.
    lines = in_process(work, lambda line: 3.0 * tests.get(line, 0.0) + (5.0 if line else 40.0))
    spent = time.perf_counter() - start
    last = lines[-1] if lines else ""
    begun = [line for line in lines or () if line in tests]
    killer = begun[-1] if begun else "import"
    if last == "EXIT 0":
        return mutant.row("survived", f"{len(tests)} tests", spent)
    return mutant.row("timeout" if last == "TIMEOUT" else "killed", killer, spent)


def digest_of(path: Path) -> str:
    """Short digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def python_files(path: Path) -> list[Path]:
    """The file itself, or the Python files below a folder."""
    return [path] if path.is_file() else sorted(path.rglob("*.py"))


def _one_line(node: ast.AST) -> str:
    return " ".join(ast.unparse(node).split())[:200]
