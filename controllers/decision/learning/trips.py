"""Trips of training and validation: traffic, load, start, generators; score of a policy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from controllers.decision.learning.collection import Drive, Interruption, TripDrivers
from controllers.decision.learning.config import TrainConfig
from controllers.decision.learning.log import trip_figures
from controllers.decision.policy import QNetwork
from controllers.decision.trip import (
    CELLS,
    TRAINING_SEEDS,
    VALIDATION_SEEDS,
    TripConfig,
    cell_trip,
    start_anywhere,
    usual_payload,
)
from iits_mj.parameters import TruckParameters

# Reference speeds of the randomized trips [m/s], those of predictive cruise control.
_REFERENCES = (50.0 / 3.6, 80.0 / 3.6)
# Share of the randomized trips in traffic that keeps right.
_KEEPS_RIGHT = 0.3


def sample_trip(config: TrainConfig, generator: np.random.Generator) -> TripConfig:
    """Draws a training trip: one of the six cells, or one with randomized traffic and load."""
    density, speed = CELLS[int(generator.integers(len(CELLS)))]
    parameters = TruckParameters.load(config.truck)
    trip = cell_trip(density, speed, _base(config, parameters, config.trip_duration))
    if generator.random() < config.random_share:
        trip = replace(
            trip,
            spawn_probability=math.exp(generator.uniform(math.log(0.005), math.log(0.12))),
            traffic_speed=float(generator.uniform(11.0, 16.0)),
            payload=float(generator.uniform(0.0, parameters.payload_max)),
            reference_speed=float(generator.uniform(*_REFERENCES)),
            keeps_right=bool(generator.random() < _KEEPS_RIGHT),
        )
    return start_anywhere(trip, generator)


def _base(config: TrainConfig, parameters: TruckParameters, duration: float) -> TripConfig:
    """Returns a trip of the truck, with its usual load, for a time [s]."""
    payload = usual_payload(parameters)
    return TripConfig(truck=config.truck, payload=payload, duration=duration, reward=config.reward)


def training_generator(config: TrainConfig, round_index: int, trip: int) -> np.random.Generator:
    """Returns the generator of one trip of one round."""
    return np.random.default_rng([config.seed, TRAINING_SEEDS, round_index, trip])


def validation_trips(
    config: TrainConfig, count: int
) -> Iterator[tuple[str, TripConfig, np.random.Generator]]:
    """Yields name, trip and generator of `count` trips per cell, the same in each validation."""
    base = _base(config, TruckParameters.load(config.truck), config.validation_duration)
    for cell, (density, speed) in enumerate(CELLS):
        for trip in range(count):
            generator = np.random.default_rng(VALIDATION_SEEDS + 1000 * cell + trip)
            name = f"validation trip {trip} in {density} traffic at {speed:g} m/s"
            yield name, start_anywhere(cell_trip(density, speed, base), generator), generator


def validate(
    network: QNetwork,
    config: TrainConfig,
    workers: TripDrivers,
    world: int,
    interruption: Interruption,
) -> dict[str, float]:
    """Drives the greedy policy over the six cells; returns means, see `trip_figures`.

    Args:
      network: of the policy.
      config: number and duration of the trips.
      workers: drive the trips.
      world: index of the world; 0 is the fast one.
      interruption: ends the wait for the trips.
    """
    count = config.truck_validation_trips if world else config.validation_trips
    trips = validation_trips(config, count)
    drives = [Drive(name, world, trip, seed) for name, trip, seed in trips]
    outcomes = workers.submit(drives, network)
    return trip_figures([interruption.wait(outcome).summary for outcome in outcomes])
