"""Settings of training: each field, with help and bounds, is a flag of `iits-mj train`.

This module does not import torch: the command line and the worker processes read it, too.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from controllers.decision.priced import EASED
from controllers.decision.trip import RewardConfig
from iits_mj.core import options as option_fields
from iits_mj.core.errors import InputError
from iits_mj.core.options import jobs_option, option
from iits_mj.parameters import AnyTruck, label_of, truck_option

# Settings that may differ when a training is resumed.
CHANGEABLE = frozenset(
    {"decisions", "jobs", "evaluate_interval", "checkpoint_interval", "checkpoint_seconds"}
)


def _option(default: Any, **settings: Any) -> Any:
    return option(default, group="learning", **settings)


def _share(default: float, help: str) -> Any:
    return _option(default, help=help, low=0.0, high=1.0)


def _decisions(default: int, help: str) -> Any:
    return _option(default, help=help, low=1, high=10**9)


@dataclass(frozen=True, kw_only=True)
class LearnerConfig:
    """Settings of the learner; learning rate and batch size are the paper's.

    Raises:
      InputError: a value is out of bounds; the message names it.
    """

    learning_rate: float = _option(5e-4, help="of Adam", low=1e-8, high=1.0, metavar="RATE")
    batch_size: int = _option(64, help="transitions per update", low=1, high=65536)
    target_interval: int = _option(
        250, help="updates between two copies to the target network", low=1, high=10**7
    )
    average_rate: float = _option(
        1e-4,
        help="share by which the policy to validate follows the online network at every update: a "
        "running average over 1 / RATE updates; 0 for the online network itself",
        low=0.0,
        high=1.0,
        metavar="RATE",
    )
    gradient_norm: float = _option(
        10.0, help="longer gradients are shortened to this length", low=1e-6, high=1e9
    )
    reward_scale: float = _option(
        0.05, help="factor on the rewards; changes no optimal policy", low=1e-6, high=1e6
    )
    margin: float = _option(
        0.0,
        help="by how much the value of a change must exceed that of keeping the lane, in units of "
        "the reward, for the policy to decide on it",
        low=0.0,
        high=1e4,
    )
    standardized: bool = _option(
        True, help="inputs in units of their typical spread (LeCun et al. 1998)"
    )
    gap: float = _option(
        0.8,
        help="share of an action's shortfall from the best one that is charged again: the other "
        "values lie 1 / (1 - gap) times as far below (advantage learning, Bellemare et al. 2016)",
        low=0.0,
        high=0.99,
    )
    dueling: bool = _option(True, help="heads for value and advantage (Wang et al. 2016)")

    def __post_init__(self) -> None:
        option_fields.check(self)


@dataclass(frozen=True, kw_only=True)
class TrainConfig(LearnerConfig):
    """Settings of `train`. Intervals are in decisions of the truck.

    Raises:
      InputError: a value is out of bounds, or two do not fit; the message names it.
    """

    truck: AnyTruck | None = truck_option("truck of all trips")
    decisions: int = _decisions(1_200_000, "decisions of the truck, one per second")
    fast_decisions: int = _option(
        150_000, help="decisions in the fast world, before the other one", low=0, high=10**9
    )
    seed: int = option(0, help="seed of all randomness", low=0, high=2**31 - 1, group="run")
    jobs: int = jobs_option(2, "processes that drive; the result does not depend on it")
    trips_per_round: int = _option(
        2, help="trips driven on one state of the network", low=1, high=1024
    )
    trip_duration: float = _option(
        1_000.0,
        help="duration of a trip: platoons take time to form",
        unit="s",
        low=10.0,
        high=1e5,
    )
    discount: float = _option(0.995, help="of a reward one second later", low=0.0, high=0.9999)
    change_charge: float = _option(
        150.0,
        help="of a decision to change lanes, in m/s off the reference speed times seconds",
        low=0.0,
        high=1e4,
    )
    random_share: float = _share(0.4, "share of trips with randomized traffic and load")
    updates_per_decision: float = _option(
        0.25, help="gradient steps per decision", low=0.0, high=64.0
    )
    learning_rate_end: float = _option(
        2e-5, help="of Adam at the end", low=1e-8, high=1.0, metavar="RATE"
    )
    learning_rate_decisions: int = _decisions(1_200_000, "decisions over which the rate changes")
    replay_capacity: int = _option(
        300_000, help="greatest number of stored transitions", low=1, high=10**8
    )
    warm_up: int = _option(4_000, help="transitions before the first update", low=1, high=10**8)
    mirror: bool = _option(
        True, help="learn also from mirror images of transitions, where traffic does not keep right"
    )
    epsilon_start: float = _share(1.0, "share of random decisions at the start")
    epsilon_stage: float = _share(0.2, "share of random decisions at the start of the second world")
    epsilon_end: float = _share(0.05, "share of random decisions at the end")
    epsilon_decisions: int = _decisions(120_000, "decisions over which the share falls")
    guided_share: float = _share(0.5, "share of the random decisions that the rule MOBIL makes")
    evaluate_interval: int = _decisions(100_000, "decisions between two validations")
    validation_trips: int = _option(
        5, help="trips in each of the six cells, in the fast world", low=1, high=1000
    )
    truck_validation_trips: int = _option(
        2, help="trips in each cell, in the other world, which takes longer", low=1, high=1000
    )
    validation_duration: float = _option(
        1_000.0, help="duration of a validation trip", unit="s", low=10.0, high=1e5
    )
    checkpoint_interval: int = _decisions(10_000, "decisions between two checkpoints")
    checkpoint_seconds: float = _option(
        120.0, help="greatest time between two checkpoints", unit="s", low=0.0, high=1e6
    )
    resume: bool = option(False, help="continue from the checkpoint in --out", group="run")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.warm_up > self.replay_capacity:
            raise InputError(
                f"warm-up {self.warm_up} is not allowed; use {self.replay_capacity} "
                "(replay-capacity) or less"
            )

    @property
    def reward(self) -> RewardConfig:
        """Reward of all trips of the training, validations included."""
        return RewardConfig(change=self.change_charge, discount=self.discount)

    def identity(self) -> dict[str, Any]:
        """Returns all settings but `resume`, for weights files and checkpoints."""
        names = (field.name for field in dataclasses.fields(TrainConfig))
        found = {name: getattr(self, name) for name in names if name != "resume"}
        return {**found, "truck": label_of(self.truck)}


@dataclass(frozen=True, kw_only=True)
class RolloutConfig:
    """Settings of the training of the priced policy by roll-outs.

    Raises:
      InputError: a value is out of bounds; the message names it.
    """

    rounds: int = _option(3, help="rounds of roll-outs, each followed by a fit", low=1, high=100)
    chunks: int = _option(
        60, help="chunks of labels in a round; less in the first two", low=1, high=10_000
    )
    chunk_trips: int = _option(64, help="trips that a chunk drives in parallel", low=1, high=10_000)
    chunk_windows: int = _option(
        30, help="states that a chunk takes from each trip, one of 30 decisions", low=1, high=1_000
    )
    horizon: float = _option(100.0, help="time of a roll-out", unit="s", low=10.0, high=1_000.0)
    epochs: int = _option(14, help="passes of a fit over the labels", low=1, high=10_000)
    members: int = _option(2, help="networks of the last fit, whose mean decides", low=1, high=20)
    speed_action: bool = _option(
        False, help=f"also learn when to ease off, to drive slower by {EASED:g} m/s for some time"
    )

    def __post_init__(self) -> None:
        option_fields.check(self)
