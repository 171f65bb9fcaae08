"""How long a call takes, on a machine that does other things as well."""

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
    """Least time of a call [s], by default on the wall; other work can only make it longer."""
    times = []
    with no_collection():
        for _ in range(rounds):
            start = clock()
            function()
            times.append(clock() - start)
    return min(times)


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """Keeps Python's garbage collector from falling into a measurement, as `timeit` does."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
