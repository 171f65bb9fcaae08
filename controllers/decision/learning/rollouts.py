"""What lane changes add, measured by roll-outs in the fast world: the labels of the priced policy.

A chunk of labels is made from trips that drive in parallel. Of 30 decisions of a trip one is
drawn, nearly equal ones with a greater probability. From copies of this state the truck keeps its
lane, changes to the left, changes to the right and, with the speed action, eases off, and then
follows a policy for some time. What the truck cannot see, e.g. the other drivers' desired speeds,
is the same for the decisions that are compared; a fit to labels of many states averages over it.

This is one round of policy iteration by roll-outs (Lagoudakis and Parr 2003; Bertsekas 2019).
"""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.learning.config import TrainConfig
from controllers.decision.learning.trips import sample_trip
from controllers.decision.priced import (
    ACTIONS,
    COMPONENTS,
    EASE,
    EASES_FROM,
    IMPOSED_BRAKING_MAX,
    SIDES,
    PricedNetwork,
    chosen,
    eased_speed,
    fallback_rule,
    usual_worth,
)
from controllers.decision.rules import compiled
from controllers.decision.trip import TripConfig
from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.parameters import TruckParameters

# Decisions of each world, from worlds, prices (n, 3) and the braking that actions ask of others
# (n, actions), see `chosen`.
Policy = Callable[[FastWorlds, FloatArray, FloatArray], IntArray]

_ENDLESS = 1e6  # [m], [s]
_WARM_UP = 40.0  # [s]
_WINDOW = 30  # decisions, of which one is drawn
_REACH = 300.0  # [m] ahead: the observation's range
_COLLISION = 1_000.0  # [m] of way
# Decisions for which the truck keeps its lane where it does not change now. A wait of one second
# costs some meters, less than the error of a fit: the truck would change by chance, and too early.
WAIT = 10
# Decisions for which a truck that eases off at first does so, unless it changes lanes.
EASE_WAIT = 5
# Prices of the rule that drives the first round [m].
_RULE_PRICES = np.geomspace(14.0, 400.0, 6)
# The speed at a roll-out's end counts as way, for a time in proportion to the price [s/m]: behind a
# slow leader a truck with a high price stays for longer.
TAIL = 0.22
# Trips with three lanes, and in traffic that keeps right, where the right lane has a price.
_THREE_LANES, _KEEPS_RIGHT = 0.1, 0.15
# Share of trips with a low price of a change.
_LOW_PRICE = 0.15
# Shares of trips without a price of braking, and of the right lane, this one also where the traffic
# keeps right.
_BRAKING_FREE, _LEFT_FREE, _LEFT_FREE_KEEPS_RIGHT = 0.8, 0.85, 0.25
_RANDOM = 0.005  # share of random changes in the decisions of the trips


@dataclass(frozen=True)
class Labels:
    """What changes added.

    Attributes:
      observation: shape (n, 216), float32.
      prices: shape (n, 3).
      components: see `priced.COMPONENTS`; of the actions, shape (n, actions, 4), float32.
      possible: whether an action was possible, shape (n, actions).
      symmetric: whether the mirror image of the traffic is as probable, shape (n,).
    """

    observation: NDArray[np.float32]
    prices: NDArray[np.float32]
    components: NDArray[np.float32]
    possible: BoolArray
    symmetric: BoolArray


def rule_policy(worlds: FastWorlds, prices: FloatArray, braking: FloatArray) -> IntArray:
    """Returns decisions of look-ahead near the prices: the policy before the first."""
    nearest = np.abs(np.log(_RULE_PRICES / prices[:, :1])).argmin(axis=1)
    decisions = np.zeros(len(worlds), dtype=np.int64)
    for number in np.unique(nearest):
        rule = compiled(fallback_rule(float(_RULE_PRICES[number])))
        assert rule is not None
        rows = np.flatnonzero(nearest == number)
        decisions[rows] = worlds.copy(rows).decide(rule)
    return possible_or_keep(decisions, braking)


class NetworkPolicy:
    """Decisions of a network."""

    def __init__(self, network: PricedNetwork) -> None:
        self.network = network

    def __call__(self, worlds: FastWorlds, prices: FloatArray, braking: FloatArray) -> IntArray:
        """Returns the decisions, shape (n,)."""
        return chosen(self.gains(worlds, prices, braking), braking)

    def gains(self, worlds: FastWorlds, prices: FloatArray, braking: FloatArray) -> FloatArray:
        """Returns what actions are worth [m], (n, actions), minus infinity where none may be."""
        return self.member_gains(worlds, prices, braking).mean(axis=0)

    def member_gains(
        self, worlds: FastWorlds, prices: FloatArray, braking: FloatArray
    ) -> FloatArray:
        """Returns the same for each member, shape (members, n, actions)."""
        rows = np.flatnonzero(np.isfinite(braking).any(axis=1))
        gains = np.full((len(self.network), *braking.shape), -np.inf)
        if rows.size:
            seen = worlds.states["frames"][rows].reshape(rows.size, -1)
            gains[:, rows] = self.network.gains(seen, prices[rows])
        return gains


def draw_prices(trip: TripConfig, generator: np.random.Generator) -> FloatArray:
    """Draws the prices of a trip, shape (3,)."""
    low, high = (10.0, 30.0) if generator.random() < _LOW_PRICE else (30.0, 400.0)
    change = np.exp(generator.uniform(np.log(low), np.log(high)))
    braking = 60.0 * generator.random() ** 2 if generator.random() > _BRAKING_FREE else 0.0
    free = _LEFT_FREE_KEEPS_RIGHT if trip.keeps_right else _LEFT_FREE
    left = np.exp(generator.uniform(np.log(0.1), np.log(4.0)))
    return np.array([change, braking, left if generator.random() > free else 0.0])


@functools.cache
def _config() -> TrainConfig:
    """Settings of the drawn trips, with the parameters of the truck, which are read once."""
    return TrainConfig(truck=TruckParameters.load(None), random_share=0.25)


def draw_trip(generator: np.random.Generator) -> TripConfig:
    """Draws an endless trip as `sample_trip` does; a tenth of them have three lanes."""
    trip = sample_trip(_config(), generator)
    return replace(
        trip,
        length=_ENDLESS,
        duration=_ENDLESS,
        keeps_right=bool(trip.keeps_right or generator.random() < _KEEPS_RIGHT),
        lanes=3 if generator.random() < _THREE_LANES else 2,
    )


def braking_of_actions(worlds: FastWorlds, actions: int = len(SIDES)) -> FloatArray:
    """Returns the braking that actions ask of the new follower [m/s2], shape (n, actions).

    It is infinite where the policy makes no change, or does not ease off.
    """
    braking = worlds.imposed_braking()[:, ::2]
    eases = np.where(worlds.states["speed"] >= EASES_FROM, 0.0, np.inf)
    braking = np.column_stack([braking, eases])[:, :actions]
    return np.where(braking < IMPOSED_BRAKING_MAX, braking, np.inf)


def _asked(braking: FloatArray, decisions: IntArray) -> FloatArray:
    """Returns the braking that decisions ask, shape (n,); of those to keep, of no meaning."""
    return np.take_along_axis(braking, np.searchsorted(ACTIONS, decisions)[:, None], 1)[:, 0]


def possible_or_keep(decisions: IntArray, braking: FloatArray) -> IntArray:
    """Returns decisions, with those that are not possible replaced by keeping the lane, (n,)."""
    return np.where(_asked(braking, decisions) < np.inf, decisions, 0)


def drive_step(worlds: FastWorlds, decisions: IntArray) -> None:
    """Carries out decisions, also those to ease off."""
    state = worlds.states
    eases = decisions == EASE
    eased = np.where(eases, eased_speed(state["speed_max"], state["speed"]), np.inf)
    worlds.step(np.where(eases, 0, decisions), eased)


def advance(
    worlds: FastWorlds,
    decisions: IntArray,
    braking: FloatArray,
    totals: FloatArray,
    left: FloatArray,
    prices: FloatArray,
) -> None:
    """Carries out decisions; adds what they gather to `totals`, and takes the time from `left`.

    Args:
      worlds: n of them.
      decisions: shape (n,), possible ones.
      braking: of the actions, shape (n, actions).
      totals: shape (n, 4), see `COMPONENTS`.
      left: time of the roll-out that is left [s], shape (n,); a step that ends later counts in
        part, and the last step adds what the speed at its end is worth.
      prices: shape (n, 3).
    """
    state = worlds.states
    before = state["distance"].copy(), state["right_time"].copy(), state["driven_time"].copy()
    collided = state["terminated"].copy()
    drive_step(worlds, decisions)
    seconds = state["driven_time"] - before[2]
    share = np.clip(left / np.maximum(seconds, 1e-9), 0.0, 1.0)
    running = left > 0.0
    changes = (np.abs(decisions) == 1) & running
    totals[:, 0] += share * (state["distance"] - before[0])
    totals[:, 0] -= _COLLISION * ((state["terminated"] > collided) & running)
    totals[:, 1] += changes
    totals[changes, 2] += _asked(braking, decisions)[changes]
    totals[:, 3] += share * (seconds - (state["right_time"] - before[1]))
    left -= np.where(seconds > 0.0, seconds, np.inf)
    ends = running & (left <= 0.0)
    totals[ends, 0] += TAIL * prices[ends, 0] * state["speed"][ends]


def roll_out(
    worlds: FastWorlds,
    first: IntArray,
    prices: FloatArray,
    policy: Policy,
    seconds: float,
    actions: int = len(SIDES),
) -> FloatArray:
    """Drives worlds by a first decision and then a policy; returns what they gather, (n, 4).

    Where the first decision is to keep the lane, so are the next ones, `WAIT` in all. Where it is
    to ease off, so are those of the next ones that make no change, `EASE_WAIT` in all.
    """
    totals = np.zeros((len(worlds), len(COMPONENTS)))
    left = np.full(len(worlds), float(seconds))
    decisions = first
    braking = braking_of_actions(worlds, actions)
    for step in itertools.count(1):
        advance(worlds, decisions, braking, totals, left, prices)
        if not (left > 0.0).any():
            break
        braking = braking_of_actions(worlds, actions)
        decisions = policy(worlds, prices, braking)
        if step < WAIT:
            decisions[first == 0] = 0
        if step < EASE_WAIT:
            decisions[(first == EASE) & (decisions == 0)] = EASE
    return totals


def compare(
    worlds: FastWorlds,
    prices: FloatArray,
    policy: Policy,
    seconds: float,
    actions: int = len(SIDES),
) -> tuple[FloatArray, BoolArray]:
    """Returns what actions add to keeping the lane.

    Returns:
      components, shape (n, actions, 4), zero where an action is not possible; and where it is,
      shape (n, actions).
    """
    possible = np.isfinite(braking_of_actions(worlds, actions))
    drawn = worlds.copy(np.arange(len(worlds)))
    # The truck reaches no vehicle beyond within a roll-out.
    drawn.states["window_ahead"] = np.minimum(drawn.states["window_ahead"], _REACH + 6.0 * seconds)
    rows, columns = np.nonzero(possible)
    index = np.concatenate([np.arange(len(worlds)), rows])
    first = np.concatenate([np.zeros(len(worlds), np.int64), ACTIONS[columns]])
    totals = roll_out(drawn.copy(index), first, prices[index], policy, seconds, actions)
    kept, acted = np.split(totals, [len(worlds)])
    components = np.zeros((*possible.shape, len(COMPONENTS)))
    components[rows, columns] = acted - kept[rows]
    return components, possible


@dataclass(frozen=True)
class Chunk:
    """Size of a chunk of labels.

    Attributes:
      trips: driven in parallel; windows: states of each trip, one from each minute.
      seconds: of a roll-out.
    """

    trips: int
    windows: int
    seconds: float


def make_labels(
    chunk: Chunk,
    network: PricedNetwork | None,
    generator: np.random.Generator,
    speed_action: bool = False,
) -> Labels:
    """Makes a chunk of labels for the policy of a network, or without one of the rule."""
    actions = len(SIDES) + int(speed_action)
    learned = NetworkPolicy(network) if network is not None else None
    policy: Policy = learned or rule_policy
    worlds = FastWorlds(chunk.trips)
    trips = [draw_trip(generator) for _ in range(chunk.trips)]
    for index, trip in enumerate(trips):
        worlds.reset(index, generator, trip)
    prices = np.array([draw_prices(trip, generator) for trip in trips])
    symmetric = np.array([trip.symmetric for trip in trips])
    states = _drawn_states(chunk, worlds, prices, policy, learned, generator, actions)
    rows = np.concatenate([index for index, _ in states])
    joined = copy.copy(worlds)
    joined.states = np.concatenate([found.states for _, found in states])
    components, possible = compare(joined, prices[rows], policy, chunk.seconds, actions)
    return Labels(
        joined.observations,
        prices[rows].astype(np.float32),
        components.astype(np.float32),
        possible,
        symmetric[rows],
    )


def _drawn_states(
    chunk: Chunk,
    worlds: FastWorlds,
    prices: FloatArray,
    policy: Policy,
    learned: NetworkPolicy | None,
    generator: np.random.Generator,
    actions: int,
) -> list[tuple[IntArray, FastWorlds]]:
    """Drives the trips; returns indices of trips and copies of one state of each in each window.

    A state is drawn with a probability in proportion to its weight (Efraimidis and Spirakis 2006).
    """
    count = len(worlds)
    totals, left = np.zeros((count, len(COMPONENTS))), np.full(count, np.inf)
    found = []
    for window in range(-1, chunk.windows):
        best, drawn = np.zeros(count), worlds.copy(np.arange(count))
        for _ in range(_WINDOW if window >= 0 else int(_WARM_UP)):
            braking = braking_of_actions(worlds, actions)
            possible = np.isfinite(braking)
            if learned is None:
                weight = np.ones(count)
                decisions = policy(worlds, prices, braking)
            else:
                gains = learned.gains(worlds, prices, braking)
                decisions = chosen(gains, braking)
                closest = np.where(possible, np.abs(gains), np.inf).min(axis=1)
                weight = 0.1 + 1.0 / (1.0 + (closest / usual_worth(prices[:, 0])) ** 2)
            key = np.where(possible.any(axis=1), generator.random(count) ** (1.0 / weight), 0.0)
            better = np.flatnonzero(key > best)
            best[better] = key[better]
            drawn.states[better] = worlds.states[better]
            decisions = _explored(decisions, possible, generator)
            advance(worlds, decisions, braking, totals, left, prices)
        if window >= 0:
            rows = np.flatnonzero(best > 0.0)
            found.append((rows, drawn.copy(rows)))
    return found


def _explored(decisions: IntArray, possible: BoolArray, generator: np.random.Generator) -> IntArray:
    """Returns decisions with a share of random ones."""
    side = generator.integers(len(SIDES), size=len(decisions))
    random = generator.random(len(decisions)) < _RANDOM
    random &= possible[np.arange(len(decisions)), side]
    return np.where(random, 2 * side - 1, decisions)
