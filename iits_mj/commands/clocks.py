"""Clocks of measurements of computing time."""

from __future__ import annotations

import contextlib
import gc
import time
from collections.abc import Callable, Iterator


def best(
    function: Callable[[], object],
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Returns the least time of a call [s], by default wall time."""
    times = []
    with no_collection():
        for _ in range(rounds):
            start = clock()
            function()
            times.append(clock() - start)
    return min(times)


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
