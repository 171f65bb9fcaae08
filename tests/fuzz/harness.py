"""Fuzzes the project: `python -m tests.fuzz.harness --inputs 1000000 --jobs 2` (`make fuzz`).

Each input must be taken, or refused with an error of ours, within 5 s and 1 GB. A finding is
printed with its seed, and its input is stored: the same seed finds it again. A process that dies or
is stuck is a finding, too. Ctrl-C and SIGTERM end the run early, with its table.
"""

from __future__ import annotations

import argparse
import collections
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

import mujoco
import numpy as np

from iits_mj.core.errors import Error
from iits_mj.core.output_files import TemporaryFolder
from tests.fuzz.targets import Target, attack, make_targets
from tests.paths import ROOT

TIME_MAX = 5.0  # [s] of the processor, an input; a shared machine may take longer
MEMORY_MAX = 2**30  # bytes above what the targets need themselves
STUCK = 60.0  # [s] of the clock: code that waits, or does not return to Python
CHUNK = 250


class HangError(BaseException):  # no handler of "Exception" sees it
    """An input took longer than `TIME_MAX`."""


def _hang(number: int, frame: FrameType | None) -> None:
    del number, frame
    raise HangError


def trial(target: Target, seed: tuple[int, ...]) -> tuple[str, bytes] | None:
    """Takes one mutant; returns what went wrong, with the mutant, or None."""
    mutant = attack(target, np.random.default_rng(seed))
    before = signal.signal(signal.SIGPROF, _hang)
    signal.setitimer(signal.ITIMER_PROF, TIME_MAX)
    try:
        target.take(mutant)
    except Error:
        return None
    except (Exception, SystemExit, HangError) as error:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [f for f in frames if f.filename.startswith(str(ROOT))] or frames
        place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return f"{type(error).__name__} at {place}: {str(error)[:100]}", mutant
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return None


def memory() -> int:
    """The greatest memory of this process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _resident(key: str) -> int:
    """Memory of this process [bytes]: VmRSS is now, VmHWM the maximum."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(key))


@dataclass
class Outcome:
    """Figures of some inputs of one target.

    Attributes:
      count: number of inputs.
      seconds: of the slowest input.
      memory: greatest growth within a chunk [bytes].
      found: text, index and mutant of each finding.
    """

    count: int = 0
    seconds: float = 0.0
    memory: int = 0
    found: list[tuple[str, int, bytes]] = field(default_factory=list)

    def add(self, other: Outcome) -> None:
        """Adds the figures of more inputs."""
        self.count += other.count
        self.seconds = max(self.seconds, other.seconds)
        self.memory = max(self.memory, other.memory)


def _work(pipe: Connection, place: Any, seed: int) -> None:
    """Takes chunks; `place` has the index in hand and the time when it began."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the parent decides
    mujoco.set_mju_user_warning(lambda _text: None)  # the plugin's target makes thousands
    with TemporaryFolder("fuzz") as folder:
        os.chdir(folder)
        targets = make_targets(folder)
        for target in targets.values():
            for sample in target.samples:
                target.take(sample)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY_MAX
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        while (task := pipe.recv()) is not None:
            name, indices = task
            outcome = Outcome()
            Path("/proc/self/clear_refs").write_text("5")  # VmHWM begins again
            before = _resident("VmRSS")
            for index in indices:
                place[:] = [index, time.monotonic()]
                began = time.process_time()
                result = trial(targets[name], (seed, index))
                outcome.seconds = max(outcome.seconds, time.process_time() - began)
                outcome.count += 1
                if result is not None:
                    outcome.found.append((result[0], index, result[1]))
            place[:] = [-1, 0.0]
            outcome.memory = max(0, _resident("VmHWM") - before)
            pipe.send(outcome)


class Worker:
    """A process with all targets."""

    def __init__(self, seed: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._place = context.Array("d", [-1.0, 0.0], lock=False)
        self._process = context.Process(target=_work, args=(other, self._place, seed), daemon=True)
        self._process.start()
        other.close()

    def take(self, name: str, indices: range) -> tuple[Outcome, range]:
        """Takes inputs; returns the outcome, and the inputs left when the process died."""
        self._pipe.send((name, indices))
        try:
            while not self._pipe.poll(1.0):
                began = self._place[1]
                if began and time.monotonic() - began > STUCK:
                    self._process.kill()
            return self._pipe.recv(), range(0)
        except EOFError:
            self._process.join()
        index = int(self._place[0])
        if index < 0:
            raise RuntimeError("a process died outside of an input")
        text = f"the process ended with {self._process.exitcode}"
        done = index - indices.start + 1
        return Outcome(done, found=[(text, index, b"")]), range(index + 1, indices.stop)

    def end(self) -> None:
        """Ends the process."""
        self._pipe.send(None)
        self._process.join()


class Run:
    """Distributes chunks to the processes and collects the findings."""

    def __init__(self, names: list[str], options: argparse.Namespace) -> None:
        self._options = options
        self._lock = threading.Lock()
        self.stopped = False
        self.outcomes = {name: Outcome() for name in names}
        self.findings: collections.Counter[str] = collections.Counter()
        rounds = -(-options.inputs // (CHUNK * len(names)))
        self._chunks = ((n, name) for n in range(options.begin, rounds) for name in names)
        self.round = options.begin  # that is not complete
        self._begin = self._shown = time.monotonic()

    def serve(self) -> None:
        """Takes chunks, in a process of its own, until none is left or the run is stopped."""
        worker = Worker(self._options.seed)
        while (chunk := self._next()) is not None:
            number, name = chunk
            left = range(number * CHUNK, (number + 1) * CHUNK)
            while left:
                outcome, left = worker.take(name, left)
                if any(not mutant for _, _, mutant in outcome.found):
                    worker = Worker(self._options.seed)
                with self._lock:
                    self._add(name, outcome)
        worker.end()

    def _next(self) -> tuple[int, str] | None:
        with self._lock:
            chunk = None if self.stopped else next(self._chunks, None)
            if chunk is not None:
                self.round = chunk[0]
            return chunk

    def _add(self, name: str, outcome: Outcome) -> None:
        self.outcomes[name].add(outcome)
        for text, index, mutant in outcome.found:
            key = f"{name}: {text}"
            self.findings[key] += 1
            if self.findings[key] == 1:
                stored = f"{name.replace(' ', '_')}-{self._options.seed}-{index}"
                (self._options.out / stored).write_bytes(mutant)
                print(f"{name}, seed {self._options.seed}, input {index}: {text}", flush=True)
        now = time.monotonic()
        if now - self._shown > 60.0:
            self._shown = now
            count = sum(each.count for each in self.outcomes.values())
            print(f"{count} inputs, {count / (now - self._begin):.0f} a second", file=sys.stderr)


def main() -> int:
    """Runs all targets; 0 when nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="stored inputs")
    parser.add_argument("--only", nargs="*", help="targets")
    parser.add_argument("--begin", type=int, default=0, help="first round, to continue a run")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        names = options.only or list(make_targets(Path(folder)))
    run = Run(names, options)

    def stop(number: int, frame: FrameType | None) -> None:
        del number, frame
        run.stopped = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    threads = [threading.Thread(target=run.serve) for _ in range(options.jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(f"{'target':14} {'inputs':>9} {'findings':>8} {'slowest':>8} {'memory':>8}")
    for name, outcome in run.outcomes.items():
        own = sum(1 for key in run.findings if key.startswith(f"{name}: "))
        size = outcome.memory / 2**20
        print(f"{name:14} {outcome.count:9} {own:8} {outcome.seconds:6.2f} s {size:5.0f} MB")
    if run.stopped:
        print(f"stopped; continue with --begin {run.round}")
    return 1 if run.findings else 0


if __name__ == "__main__":
    sys.exit(main())
