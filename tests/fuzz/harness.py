"""Fuzzes the project: `python -m tests.fuzz.harness --inputs 1000000 --jobs 2` (`make fuzz`).

Each input must be taken, or refused with an error of ours, within 5 s and 1 GB. A finding is
printed with its seed, and its input is stored: the same seed finds it again.
"""

from __future__ import annotations

import argparse
import collections
import multiprocessing
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import numpy as np

from iits_mj.core.errors import Error
from tests.fuzz.targets import Target, attack, make_targets

TIME_MAX = 5.0  # [s] an input
MEMORY_MAX = 2**30  # bytes above what the targets need themselves
CHUNK = 250


class HangError(Exception):
    """An input took longer than `TIME_MAX`."""


def _hang(number: int, frame: FrameType | None) -> None:
    del number, frame
    raise HangError


def trial(target: Target, seed: tuple[int, ...]) -> tuple[str, bytes] | None:
    """Takes one mutant; returns what went wrong, with the mutant, or None."""
    mutant = attack(target, np.random.default_rng(seed))
    before = signal.signal(signal.SIGALRM, _hang)
    signal.setitimer(signal.ITIMER_REAL, TIME_MAX)
    try:
        target.take(mutant)
    except Error:
        return None
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [f for f in frames if "site-packages" not in f.filename] or frames
        place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return f"{type(error).__name__} at {place}: {str(error)[:100]}", mutant
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    return None


def memory() -> int:
    """The greatest memory of this process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


_targets: dict[str, Target] = {}


def _begin() -> None:
    folder = tempfile.mkdtemp(prefix="iits_mj_fuzz_")
    _targets.update(make_targets(Path(folder)))
    for target in _targets.values():
        for sample in target.samples:
            target.take(sample)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_MAX
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _chunk(task: tuple[str, int, int]) -> tuple[str, int, list[tuple[str, int, bytes]]]:
    name, seed, number = task
    found = []
    for index in range(number * CHUNK, (number + 1) * CHUNK):
        result = trial(_targets[name], (seed, index))
        if result is not None:
            found.append((result[0], index, result[1]))
    return name, number, found


def main() -> int:
    """Runs all targets; 0 when nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="stored inputs")
    parser.add_argument("--only", nargs="*", help="targets")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        names = options.only or list(make_targets(Path(folder)))
    counts: collections.Counter[str] = collections.Counter()
    findings: collections.Counter[str] = collections.Counter()
    begin = time.monotonic()
    context = multiprocessing.get_context("spawn")
    with context.Pool(options.jobs, _begin) as pool:
        for name, number, found in pool.imap_unordered(
            _chunk, _tasks(names, options.seed, options.inputs)
        ):
            counts[name] += CHUNK
            for text, index, mutant in found:
                findings[f"{name}: {text}"] += 1
                if findings[f"{name}: {text}"] == 1:
                    (options.out / f"{name.replace(' ', '_')}-{options.seed}-{index}").write_bytes(
                        mutant
                    )
                    print(f"{name}, seed {options.seed}, input {index}: {text}", flush=True)
            if number % 40 == 0:
                rate = counts.total() / (time.monotonic() - begin)
                print(f"{counts.total()} inputs, {rate:.0f} a second", file=sys.stderr, flush=True)
    print(f"{'target':14} {'inputs':>9} findings")
    for name in names:
        own = [key for key in findings if key.startswith(f"{name}: ")]
        print(f"{name:14} {counts[name]:9} {len(own)}")
    return 1 if findings else 0


def _tasks(names: list[str], seed: int, inputs: int) -> Iterator[tuple[str, int, int]]:
    for number in range(-(-inputs // (CHUNK * len(names)))):
        for name in names:
            yield name, seed, number


if __name__ == "__main__":
    sys.exit(main())
