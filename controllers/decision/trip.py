"""A trip of the truck through highway traffic, one decision a step: what all worlds share.

A world asks for a decision once a second while the truck keeps its lane, and not while a change
runs: a step lasts 1 s, or as long as the change. Rewards are discounted by the second inside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Protocol

import numpy as np

from controllers.decision.base import DecisionContext, Observation
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision

# --- Where the seeds of training, validation and test trips begin; no two of the three meet ---
# Training draws from the first, the choice of a policy from the second. Only figures that are to be
# believed come from the third: no decision may rest on them.

TRAINING_SEEDS, VALIDATION_SEEDS, TEST_SEEDS = 1_000_000, 2_000_000, 3_000_000
# Each of the three has as many seeds as lie between two beginnings.
SEEDS_EACH = 1_000_000


# --- The paper's reward with its signs repaired, term by term ---
# `r = r_ch + r_v + r_sa`: -10 for a decision to change lanes (also one that is refused), minus the
# distance of the speed from the reference for each second (the paper prints it with the wrong
# sign), -20 for a decision to change at a dangerous moment. A collision, which the paper does not
# charge, ends the trip, and an end would otherwise be worth more than any future of charges.


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the terms.

    Attributes:
      change: charge of a decision to change lanes; danger: further charge when it is dangerous.
      speed: charge for each second and m/s of distance from the reference speed.
      collision: charge of a collision.
      discount: of a reward one second later.
    """

    change: float = 10.0
    danger: float = 20.0
    speed: float = 1.0
    collision: float = 300.0
    discount: float = 0.99


@dataclass(frozen=True)
class RewardTerms:
    """The terms of one decision, discounted to its instant; all zero or negative."""

    change: float = 0.0
    speed: float = 0.0
    danger: float = 0.0
    collision: float = 0.0

    @property
    def total(self) -> float:
        """Their sum."""
        return self.change + self.speed + self.danger + self.collision

    def __add__(self, other: RewardTerms) -> RewardTerms:
        """Adds term by term."""
        names = [field.name for field in fields(self)]
        return RewardTerms(**{n: getattr(self, n) + getattr(other, n) for n in names})


def decision_charge(changes: bool, dangerous: bool, config: RewardConfig) -> RewardTerms:
    """Charge of the decision itself, at its instant."""
    return RewardTerms(
        change=-config.change if changes else 0.0,
        danger=-config.danger if changes and dangerous else 0.0,
    )


def speed_charge(speed: float, reference: float, elapsed: float, config: RewardConfig) -> float:
    """Charge of one second at a speed [m/s], `elapsed` seconds after the decision."""
    return -config.speed * abs(speed - reference) * config.discount**elapsed


# --- A trip of the truck through highway traffic, one decision a step: what all worlds share ---

# The paper's spawn probabilities, of a vehicle per second and lane, and its two traffic limits.
SPAWN_PROBABILITY = {"dense": 0.05, "medium": 0.02, "sparse": 0.005}
TRAFFIC_SPEEDS = (12.5, 15.0)
CELLS = tuple((density, speed) for density in SPAWN_PROBABILITY for speed in TRAFFIC_SPEEDS)


@dataclass(frozen=True)
class TripConfig:
    """One trip of the truck.

    Attributes:
      spawn_probability: of a vehicle appearing, per second and lane.
      traffic_speed: speed limit of the traffic [m/s].
      keeps_right: whether the traffic keeps to the right lane; the paper's table can only come from
        traffic that fills both.
      length: of the trip [m]; duration: it is cut off (truncated) after this time [s].
      start_station: where it begins on the route [m].
      payload: of the truck [kg]. With 12 t, 31 t in all, the built-in road's hills alone cost no
        more speed than the paper's free road; with 36 t a tenth of it.
      reference_speed: [m/s], the paper's 60 km/h.
      reward: weights.

    Raises:
      InputError: a value is not finite or makes no trip; the message names it.
    """

    spawn_probability: float = 0.05
    traffic_speed: float = 12.5
    keeps_right: bool = False
    length: float = 15_000.0
    duration: float = 3_000.0
    start_station: float = 60.0
    payload: float = 12_000.0
    reference_speed: float = 60.0 / 3.6
    reward: RewardConfig = field(default_factory=RewardConfig)

    def __post_init__(self) -> None:
        """Refuses values that are not finite or make no trip."""
        for name in ("traffic_speed", "length", "duration", "reference_speed"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{name} = {value!r} is not allowed: use a number above 0")
        for name in ("start_station", "payload"):
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0.0:
                raise InputError(f"{name} = {value!r} is not allowed: use 0 or more")
        if not 0.0 <= self.spawn_probability <= 0.5:
            raise InputError(f"spawn_probability = {self.spawn_probability!r}: use 0 to 0.5")


@dataclass
class TripSummary:
    """What a trip came to.

    Attributes:
      distance: [m]; time: [s].
      decisions: taken; changes: carried out; refused: decisions to change that were refused.
      dangerous: of those, refused because of a vehicle: the unsafe decisions.
      collisions: with a vehicle, or a roll-over.
      time_gap_min: least time gap to the leader in the truck's lane [s], inf without one.
      loss_integral: of (v_ref - v) / v_ref over time [s].
      reward: its terms, each the plain sum over the steps.
    """

    distance: float = 0.0
    time: float = 0.0
    decisions: int = 0
    changes: int = 0
    refused: int = 0
    dangerous: int = 0
    collisions: int = 0
    time_gap_min: float = math.inf
    loss_integral: float = 0.0
    reward: RewardTerms = field(default_factory=RewardTerms)

    @property
    def speed_loss(self) -> float:
        """The paper's figure: mean over time of (v_ref - v) / v_ref."""
        return self.loss_integral / self.time if self.time > 0.0 else 0.0


@dataclass(frozen=True)
class TripStep:
    """Outcome of a decision.

    Attributes:
      observation: after it; reward: its terms; seconds: how long it took.
      terminated: the trip ended in a collision; truncated: it was over without one.
    """

    observation: Observation
    reward: RewardTerms
    seconds: float
    terminated: bool
    truncated: bool


class World(Protocol):
    """Where trips are driven: traffic, road and truck, however they are made.

    Attributes:
      summary: of the trip so far.
    """

    summary: TripSummary

    def reset(self, generator: np.random.Generator, trip: TripConfig) -> Observation:
        """Starts a trip; everything random comes from the generator. (216,) float32."""

    def context(self) -> DecisionContext:
        """What a decision maker is given now, for rules to drive in the world."""

    def step(self, decision: Decision) -> TripStep:
        """Carries out a decision, or refuses it, until the next one is due."""

    def close(self) -> None:
        """Frees what the world holds; it may be reset again."""


def cell_trip(density: str, traffic_speed: float, base: TripConfig | None = None) -> TripConfig:
    """The trip of one of the paper's six cells.

    Raises:
      InputError: a density that the paper does not have.
    """
    if density not in SPAWN_PROBABILITY:
        allowed = ", ".join(SPAWN_PROBABILITY)
        raise InputError(f"density {density!r} is unknown; allowed are: {allowed}")
    return replace(
        base or TripConfig(),
        spawn_probability=SPAWN_PROBABILITY[density],
        traffic_speed=traffic_speed,
    )
