"""Score of a policy on the validation trips, driven by the workers of a training."""

from __future__ import annotations

from controllers.decision.learning.collection import Drive, TripDrivers
from controllers.decision.learning.interruption import Interruption
from controllers.decision.learning.train_config import TrainConfig
from controllers.decision.learning.train_log import trip_figures
from controllers.decision.learning.training_trips import validation_trips
from controllers.decision.network import QNetwork


def validate(
    network: QNetwork,
    config: TrainConfig,
    workers: TripDrivers,
    world: int,
    interruption: Interruption,
) -> dict[str, float]:
    """Drives the greedy policy over the six cells; means over all trips, see `trip_figures`.

    Args:
      network: of the policy.
      config: says how many trips, and how long.
      workers: who drive.
      world: which of theirs; the first is the fast one.
      interruption: of the wait for them.
    """
    count = config.truck_validation_trips if world else config.validation_trips
    trips = validation_trips(config, count)
    drives = [Drive(name, world, trip, seed) for name, trip, seed in trips]
    outcomes = workers.submit(drives, network)
    return trip_figures([interruption.wait(outcome).summary for outcome in outcomes])
