"""Trips of a training on a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

from controllers.decision import fast_world
from controllers.decision.learning import collection
from controllers.decision.learning.collection import Drive, Driven, TripDrivers, WorldFactory
from controllers.decision.network import QNetwork
from controllers.decision.trip import World
from iits_mj.scale.ray_executor import RayExecutor
from iits_mj.validation.kept_runs import drive_digest


class ClusterDrivers(TripDrivers):
    """Drives trips on a Ray cluster; what they bring home is what processes here would.

    Args:
      address: of the cluster, see `RayExecutor`.
      worlds: picklable factories, chosen by `Drive.world`.

    Raises:
      InputError: Ray is not installed. ClusterError: there is no cluster at the address.
    """

    def __init__(self, address: str, worlds: Sequence[WorldFactory]) -> None:
        self._worlds = tuple(worlds)
        self._executor = RayExecutor(address, trips_code)

    def submit(self, jobs: Sequence[Drive], network: QNetwork) -> list[Future[Driven]]:
        """Asks for trips on a network, which goes to each node once."""
        shared = self._executor.share(network)
        return [
            self._executor.submit(drive_in_worker, self._worlds[job.world], job, shared)
            for job in jobs
        ]

    def close(self) -> None:
        """Leaves the cluster, also in the middle of a trip."""
        self._executor.shutdown(cancel_futures=True)


def trips_code() -> str:
    """Digest of the code that drives a training's trips."""
    return drive_digest(collection, fast_world)


def drive_in_worker(factory: WorldFactory, job: Drive, network: QNetwork) -> Driven:
    """Drives one trip in a worker, which keeps its worlds."""
    if factory not in _worlds:
        _worlds[factory] = factory()
    return collection.drive_trip(_worlds[factory], job, network)


_worlds: dict[Any, World] = {}
