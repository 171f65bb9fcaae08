"""Flags of the commands whose work can be spread over machines."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass

from tqdm import tqdm

from iits_mj.options import option
from iits_mj.scale.ray_executor import RayExecutor


@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Where the work is done; to be inherited from."""

    ray: str | None = option(
        None,
        help="work on a Ray cluster instead of this machine: its head's HOST:PORT, auto, or local",
        metavar="ADDRESS",
    )
    shard: int = option(
        5, help="how many a worker does before it brings them home", low=1, high=10_000
    )


def pool_of(options: ClusterOptions, digest: Callable[[], str]) -> Callable[[int], Executor] | None:
    """What makes the pool of workers for `run_sharded`; None for processes of this machine.

    Args:
      options: of the command.
      digest: of the code that does the work, for the workers of a cluster to compare.
    """
    address = options.ray
    return None if address is None else lambda _: RayExecutor(address, digest)


@contextmanager
def progress_of(total: int, unit: str) -> Iterator[Callable[[int], None]]:
    """A bar on stderr; silent when that is not a terminal."""
    with tqdm(total=total, unit=f" {unit}", disable=None, smoothing=0.05, file=sys.stderr) as bar:
        yield lambda count: bar.update(count) and None
