"""The decision task: its trips, actions, reward and end, for every world that it is driven in.

A world drives the truck through highway traffic: the fast world, or the MuJoCo truck among SUMO's
vehicles. It asks for a decision once a second while the truck keeps its lane, and not during a
change: a step lasts 1 s, or as long as the change. The observation is that of
`controllers.decision.observation`. Rewards are discounted by the second inside a step. Training,
the Gymnasium environments and the suite's highway task use these worlds.

The reward is the paper's with corrected signs, `r = r_ch + r_v + r_sa`: -10 for a decision to
change lanes (also a refused one), minus the difference of speed and reference speed for each second
(the paper prints it with the wrong sign), -20 for a decision to change at a dangerous moment. A
collision, which the paper does not charge, ends the trip; without a charge the end would be worth
more than any further driving.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Protocol

import numpy as np

from controllers.decision.base import DecisionContext, Observation
from controllers.decision.quality import Quality, QualityLog
from iits_mj.core.checks import in_range, require_positive, whole
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.parameters import AnyTruck, TruckParameters

ACTIONS = (Decision.LEFT, Decision.KEEP, Decision.RIGHT)
# First seeds of training, validation (choice of a policy) and test trips, with SEEDS_EACH of each.
# Published figures come from test trips, so no choice may use them.
TRAINING_SEEDS, VALIDATION_SEEDS, TEST_SEEDS = 1_000_000, 2_000_000, 3_000_000
SEEDS_EACH = 1_000_000
# The paper's spawn probabilities per second and lane, and its two speeds of the traffic [m/s].
SPAWN_PROBABILITY = {"dense": 0.05, "medium": 0.02, "sparse": 0.005}
TRAFFIC_SPEEDS = (12.5, 15.0)
CELLS = tuple((density, speed) for density in SPAWN_PROBABILITY for speed in TRAFFIC_SPEEDS)


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward's terms.

    Attributes:
      change: charge of a decision to change lanes; danger: further charge when it is dangerous.
      speed: charge for each second and each m/s of difference from the reference speed.
      collision: charge of a collision.
      discount: of a reward one second later.
    """

    change: float = 10.0
    danger: float = 20.0
    speed: float = 1.0
    collision: float = 300.0
    discount: float = 0.99


_MARGIN = 200.0  # [m] beyond the distance at reference speed, so that time ends a trip


@dataclass(frozen=True)
class RewardTerms:
    """The terms of one decision, discounted to its instant; all zero or negative."""

    change: float = 0.0
    speed: float = 0.0
    danger: float = 0.0
    collision: float = 0.0

    @property
    def total(self) -> float:
        """Sum of the terms."""
        return self.change + self.speed + self.danger + self.collision

    def __add__(self, other: RewardTerms) -> RewardTerms:
        """Returns the sum term by term."""
        names = [field.name for field in fields(self)]
        return RewardTerms(**{n: getattr(self, n) + getattr(other, n) for n in names})


@dataclass(frozen=True)
class TrafficDemand:
    """The traffic around the truck.

    Attributes:
      spawn_probability: of a vehicle appearing, per second and lane, 0 to 1.
      traffic_speed: speed limit of the traffic [m/s].
      keeps_right: whether the traffic keeps to the right lane; the paper's table can only come from
        traffic that fills both.
      lanes: of the highway, 2 or 3.
      truck_speed_limit: of rigid and articulated trucks [m/s]; None: the traffic's.
      ramp_probability: of a vehicle per second on each on-ramp, 0 to 1; 0 without ramps.
      ramp_interval: distance between on-ramps [m], 500 or more.

    Raises:
      InputError: a value is out of its range; the message names it.
    """

    spawn_probability: float = 0.05
    traffic_speed: float = 12.5
    keeps_right: bool = False
    lanes: int = 2
    truck_speed_limit: float | None = None
    ramp_probability: float = 0.0
    ramp_interval: float = 2_000.0

    def __post_init__(self) -> None:
        require_positive(self, "traffic_speed")
        in_range("spawn_probability", self.spawn_probability, 0.0, 1.0)
        in_range("lanes", whole("lanes", self.lanes), 2, 3)
        if self.truck_speed_limit is not None:
            require_positive(self, "truck_speed_limit")
        in_range("ramp_probability", self.ramp_probability, 0.0, 1.0)
        in_range("ramp_interval", self.ramp_interval, 500.0, 1e6, "m")

    @property
    def symmetric(self) -> bool:
        """Whether the mirror image of the traffic on the two lanes is as probable."""
        return self.lanes == 2 and not self.keeps_right and self.ramp_probability == 0.0


@dataclass(frozen=True)
class TripConfig(TrafficDemand):
    """One trip of the truck, with a spawn probability of 0 to 0.5.

    Attributes:
      length: of the trip [m]; duration: it is cut off (truncated) after this time [s].
      start_station: where it begins on the route [m].
      truck: that drives; see `TruckParameters.load`.
      payload: of the truck [kg], None for its greatest. With 12 t, 31 t in all, the built-in road's
        hills alone cost the shipped truck no more speed than the paper's free road; with 36 t a
        tenth of it.
      reference_speed: [m/s], the paper's 60 km/h.
      truck_keeps_right: whether the truck keeps right, see `controllers.planning.keep_right`;
        `keeps_right` is of the traffic.
      reward: weights.

    Raises:
      InputError: a value is out of its range; the message names it.
    """

    length: float = 15_000.0
    duration: float = 3_000.0
    start_station: float = 60.0
    truck: AnyTruck | None = None
    payload: float | None = 12_000.0
    reference_speed: float = 60.0 / 3.6
    truck_keeps_right: bool = False
    reward: RewardConfig = field(default_factory=RewardConfig)

    def __post_init__(self) -> None:
        in_range("spawn_probability", self.spawn_probability, 0.0, 0.5)
        super().__post_init__()
        require_positive(self, "length", "duration", "reference_speed")
        require_positive(self, "start_station", zero=True)
        if self.payload is not None:
            require_positive(self, "payload", zero=True)


def start_anywhere(trip: TripConfig, generator: np.random.Generator) -> TripConfig:
    """Returns the trip with a random start from which its duration fits the 15 km road."""
    start, room = trip.start_station, TripConfig.length - trip.start_station
    length = min(room, trip.reference_speed * trip.duration + _MARGIN)
    shift = float(generator.uniform(0.0, room - length))
    return replace(trip, start_station=start + shift, length=length)


def usual_payload(parameters: TruckParameters) -> float:
    """Returns the payload of a trip [kg], or a truck's greatest where that is less."""
    return min(TripConfig.payload or 0.0, parameters.payload_max)


def cell_trip(density: str, traffic_speed: float, base: TripConfig | None = None) -> TripConfig:
    """Returns the trip of one of the paper's six cells.

    Raises:
      InputError: the paper does not have this density.
    """
    if density not in SPAWN_PROBABILITY:
        allowed = ", ".join(SPAWN_PROBABILITY)
        raise InputError(f"density {density!r} is unknown; allowed are: {allowed}")
    probability = SPAWN_PROBABILITY[density]
    base = base or TripConfig()
    return replace(base, spawn_probability=probability, traffic_speed=traffic_speed)


@dataclass
class TripSummary:
    """Totals of a trip.

    Attributes:
      distance: [m]; time: [s].
      decisions: taken; changes: carried out; refused: decisions to change that were refused.
      dangerous: of those, refused because of a vehicle: the unsafe decisions.
      collisions: with a vehicle, or a rollover.
      time_gap_min: least time gap to the leader in the truck's lane [s], inf without a leader.
      loss_integral: of (v_ref - v) / v_ref over time [s].
      reward: its terms, each the plain sum over the steps.
      quality: what lane changes impose on others, and the use of lanes.
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
    quality: Quality = field(default_factory=Quality)

    @property
    def speed_loss(self) -> float:
        """The paper's figure: mean over time of (v_ref - v) / v_ref."""
        return self.loss_integral / self.time if self.time > 0.0 else 0.0


@dataclass(frozen=True)
class TripStep:
    """Outcome of a decision.

    Attributes:
      observation: after the step; reward: its terms; seconds: its duration.
      terminated: the trip ended in a collision; truncated: it ended without one.
    """

    observation: Observation
    reward: RewardTerms
    seconds: float
    terminated: bool
    truncated: bool


class TripLog:
    """Reward and totals of one trip, the same for every world.

    A step is `begin`, then `drive` and `charge_speed` while the truck drives, then `end`.

    Attributes:
      summary: of the trip so far; elapsed: since the last decision [s].
      quality: measures that part of the summary.
    """

    def __init__(self, trip: TripConfig) -> None:
        self.trip = trip
        self.quality = QualityLog()
        self.summary = TripSummary(quality=self.quality.quality)
        self.begin()

    def begin(self) -> None:
        """Starts a step."""
        self._terms = RewardTerms()
        self.elapsed = 0.0

    def drive(self, speed: float, seconds: float) -> None:
        """Adds some seconds at a speed [m/s] to the totals of time and speed loss."""
        reference = self.trip.reference_speed
        self.summary.time += seconds
        self.summary.loss_integral += (reference - speed) / reference * seconds

    def charge_speed(self, speed: float, seconds: float) -> None:
        """Charges some seconds at a speed [m/s] by its difference from the reference."""
        reward = self.trip.reward
        charge = -reward.speed * abs(speed - self.trip.reference_speed)
        self._terms += RewardTerms(speed=charge * reward.discount**self.elapsed * seconds)
        self.elapsed += seconds

    def end(
        self,
        decision: Decision,
        observation: Observation,
        *,
        changes: int,
        refused: int,
        dangerous: int,
        collision_at: float | None,
        over: bool,
    ) -> TripStep:
        """Ends a step; returns its outcome.

        Args:
          decision: of the step.
          observation: after the step.
          changes: carried out in the step.
          refused: decisions refused in the step.
          dangerous: of those, refused because of a vehicle.
          collision_at: time of a collision or rollover since the decision [s], None without one.
          over: whether the trip's road or time has ended.
        """
        reward, terms = self.trip.reward, self._terms
        if decision is not Decision.KEEP:
            danger = -reward.danger if dangerous else 0.0
            terms += RewardTerms(change=-reward.change, danger=danger)
        failed = collision_at is not None
        if collision_at is not None:
            terms += RewardTerms(collision=-reward.collision * reward.discount**collision_at)
        summary = self.summary
        summary.decisions += 1
        summary.changes += changes
        summary.refused += refused
        summary.dangerous += dangerous
        summary.collisions += int(failed)
        summary.reward += terms
        return TripStep(observation, terms, self.elapsed, failed, over and not failed)


class World(Protocol):
    """Drives trips: traffic, road and truck of any model."""

    @property
    def summary(self) -> TripSummary:
        """Totals of the trip so far."""

    def reset(self, generator: np.random.Generator, trip: TripConfig) -> Observation:
        """Starts a trip; returns the observation. All randomness comes from the generator."""

    def context(self) -> DecisionContext:
        """Returns the context of a decision now."""

    def step(self, decision: Decision) -> TripStep:
        """Carries out a decision, or refuses it, and drives until the next one is due."""

    def close(self) -> None:
        """Frees resources; `reset` may follow."""
