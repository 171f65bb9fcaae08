"""Clocks of measurements of computing time."""

from __future__ import annotations

import contextlib
import gc
import math
import resource
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import TypeVar

MICROSECONDS, MILLISECONDS = 1e6, 1e3

Play = Callable[[], object]
Name = TypeVar("Name", bound=Hashable)


def best(function: Play, rounds: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Returns the least time of a call [s], by default wall time."""
    return in_turns({"": function}, rounds, clock)[""]


def in_turns(
    functions: Mapping[Name, Play],
    rounds: int,
    clock: Callable[[], float] = time.thread_time,
) -> dict[Name, float]:
    """Returns the least time of a call of each function [s], by default processor time."""
    least = dict.fromkeys(functions, math.inf)
    with no_collection():
        for _ in range(rounds):
            for name, function in functions.items():
                start = clock()
                function()
                least[name] = min(least[name], clock() - start)
    return least


def children_time() -> float:
    """Returns the processor time of the child processes that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """Switches Python's garbage collector off during a measurement, as `timeit` does."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
