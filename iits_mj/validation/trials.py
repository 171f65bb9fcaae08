"""Trials of decision makers: one row of figures each, kept in a CSV file that can be resumed."""

from __future__ import annotations

import csv
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from controllers import decision as decisions
from controllers.decision.highway_env import HighwayEnv
from controllers.decision.training import TEST_SEEDS
from controllers.decision.trip import CELLS, TripConfig, cell_trip
from iits_mj.validation import row_files

REFERENCE_SPEED = 60.0 / 3.6


@dataclass(frozen=True)
class Trial:
    """One trip of one decision maker.

    Attributes:
      world, density, traffic_speed, method, seed: what was driven.
      speed_loss: mean of (v_ref - v) / v_ref; changes: carried out; refused: decisions refused.
      collisions: with a vehicle, or a roll-over; time: [s]; distance: [m].
      closest: least gap to the leader, in s (fast world) or m (full chain).
      fuel: [kg], nan in the fast world.
    """

    world: str
    density: str
    traffic_speed: float
    method: str
    seed: int
    speed_loss: float
    changes: int
    refused: int
    collisions: int
    time: float
    distance: float
    closest: float
    fuel: float

    @property
    def key(self) -> tuple[str, str, float, str, int]:
        """What makes a trial unique."""
        return (self.world, self.density, self.traffic_speed, self.method, self.seed)


def trial_seed(cell: int, trial: int, seed: int) -> int:
    """The seed that all methods share in a trial: outside those of training and validation."""
    return TEST_SEEDS + 100_000 * seed + 1000 * cell + trial


def run_fast(density: str, traffic_speed: float, method: str, seed: int, length: float) -> Trial:
    """A trip of `length` m in the fast world."""
    env = HighwayEnv()
    maker = decisions.make(method)
    maker.reset()
    env.reset(
        np.random.default_rng(seed), cell_trip(density, traffic_speed, TripConfig(length=length))
    )
    over = False
    while not over:
        step = env.step(maker.decide(env.context()))
        over = step.terminated or step.truncated
    result = env.summary
    return Trial(
        "fast",
        density,
        traffic_speed,
        method,
        seed,
        result.speed_loss,
        result.changes,
        result.refused,
        result.collisions,
        result.time,
        result.distance,
        result.time_gap_min,
        math.nan,
    )


def run_full(density: str, traffic_speed: float, method: str, seed: int, duration: float) -> Trial:
    """A drive of the full chain (MuJoCo truck, SUMO traffic) for at most `duration` s."""
    from iits_mj.simulation import DriveConfig, Simulation

    config = DriveConfig(
        density=density,
        traffic_speed=traffic_speed,
        decision=method,
        duration=duration,
        seed=seed,
        speed=REFERENCE_SPEED,
        start_speed=traffic_speed,
        speed_planner="cruise",
    )
    with Simulation(config) as simulation:
        result = simulation.run()
    return Trial(
        "full",
        density,
        traffic_speed,
        method,
        seed,
        (REFERENCE_SPEED - result.mean_speed) / REFERENCE_SPEED,
        result.lane_changes,
        result.refused,
        int(result.failed),
        result.duration,
        result.distance,
        result.closest_gap,
        result.fuel,
    )


def read_trials(path: Path) -> list[Trial]:
    """The trials of a CSV file; none when it does not exist.

    Raises:
      InputError: the file is not one of ours.
    """
    return row_files.read_rows(path, Trial, "trials")


def rewrite_trials(path: Path, trials: list[Trial]) -> None:
    """Writes the file anew, with its header; InputError when it cannot be written."""
    row_files.write_rows(path, Trial, trials, "trials")


def append_trial(path: Path, trial: Trial) -> None:
    """Adds one row."""
    with path.open("a", newline="", encoding="utf-8") as stream:
        csv.DictWriter(stream, [field.name for field in fields(Trial)]).writerow(asdict(trial))


__all__ = [
    "CELLS",
    "Trial",
    "append_trial",
    "read_trials",
    "rewrite_trials",
    "run_fast",
    "run_full",
    "trial_seed",
]
