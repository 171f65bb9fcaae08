"""One policy for every price of a lane change: a decision maker and its network's file.

A lane change is worth the way that it gains, less a price for each later lane change, for the
braking that it asks of new followers, and for the time outside the right lane. The network has the
prices as inputs, besides the paper's 216, and the paper's hidden layers. Its outputs are the four
parts of what a change to the left and to the right adds in the next 100 s to ten seconds in the
lane. So a user chooses between a calm and a brisk truck without another training.

A network that was trained with the speed action has four more outputs: what it adds to ease off,
to drive a little slower for as long as it decides so, e.g. until a gap beside the truck is free.

The file is an npz without pickled objects: `w0..w3` of shape (members, outputs, inputs), `b0..b3`,
and `metadata`. The members are networks of several trainings; their mean decides.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.decision.base import DecisionContext
from controllers.decision.observation import OBSERVATION_SIZE, OBSERVATION_VERSION
from controllers.decision.policy import (
    LAYERS,
    SHIPPED_PRICED,
    FloatArray,
    check_observation,
    read_layers,
    write_layers,
)
from controllers.decision.prices import Prices
from controllers.decision.rules import LookAhead, imposed_braking
from iits_mj.core.checks import is_number
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision

# What a change adds: way [m]; lane changes, itself included; braking asked of new followers [m/s2];
# time outside the right lane [s].
COMPONENTS = ("way", "changes", "imposed_braking", "left_time")
SIDES = (Decision.LEFT, Decision.RIGHT)
# Besides the values of `Decision`: to keep the lane and ease off.
EASE = 2
# The actions whose worth a network tells, the last one with the speed action alone.
ACTIONS = np.array([*SIDES, EASE])
FORMAT = "iits_mj.priced_network.1"
# A change that asks more braking of the new follower is not made [m/s2]. In the fast world, none of
# look-ahead's changes below it made a follower brake harder than 2 m/s2; most from 2 up did.
IMPOSED_BRAKING_MAX = 1.85
# Most lanes of the roads of the training.
LANES_MAX = 3
# Horizon [s] of the rule where the policy is unsure, and its cost as a share of the price.
RULE_HORIZON, RULE_SHARE = 30.0, 0.35
# The truck that eases off drives this much slower than it did when it began, from a speed [m/s] on.
EASED, EASES_FROM = 2.0, 8.0
_EASED_SLACK = 1.0  # [m/s] below that speed at which it begins again


def priced_layers(actions: int = len(SIDES)) -> tuple[int, ...]:
    """Returns the sizes of the layers for a number of actions, 2 or 3."""
    inputs = OBSERVATION_SIZE + len(dataclasses.fields(Prices))
    return (inputs, *LAYERS[1:-1], actions * len(COMPONENTS))


PRICED_LAYERS = priced_layers()


def price_inputs(prices: ArrayLike) -> FloatArray:
    """Returns the network's inputs of prices, both of shape (..., 3), each of the order of 1."""
    values = np.asarray(prices, dtype=float)
    change, braking, left = np.moveaxis(values, -1, 0)
    return np.stack([np.log(change / 60.0), braking / 20.0, left], -1).astype(np.float32)


def usual_worth(lane_change_price: ArrayLike) -> NDArray[np.float64]:
    """Returns the usual size of what a change is worth at a price [m], of the price's shape."""
    return 30.0 + 0.4 * np.asarray(lane_change_price, dtype=float)


def disagreement(gains: FloatArray, prices: ArrayLike) -> NDArray[np.float64]:
    """Returns the members' standard deviation in units of `usual_worth`, shape (..., 2).

    Args:
      gains: of the members, shape (members, ..., 2).
      prices: shape (..., 3).
    """
    size = usual_worth(np.asarray(prices)[..., 0])
    return np.std(gains, axis=0, dtype=float) / size[..., None]


def fallback_rule(lane_change_price: float) -> LookAhead:
    """Returns the rule that decides where the policy is unsure.

    Its cost of a change fits the price: the rule counts what it gains in 30 s alone.
    """
    cost = RULE_SHARE * lane_change_price
    return LookAhead(horizon=RULE_HORIZON, change_cost=cost, right_gain=0.0)


def worth(components: FloatArray, prices: ArrayLike) -> FloatArray:
    """Returns way less priced parts [m], shape (...), from components (..., 4), prices (..., 3)."""
    charged = components[..., 1:] * np.asarray(prices, np.float32)
    worth: FloatArray = components[..., 0] - charged.sum(-1)
    return worth


@dataclass(frozen=True)
class PricedNetwork:
    """Networks that tell what a lane change adds, for any prices.

    Attributes:
      weights: of the layers, each of shape (members, outputs, inputs), float32.
      biases: of shape (members, outputs).
      metadata: JSON values of the file.
      disagreement_max: greatest `disagreement` of the members at which they decide.

    Raises:
      InputError: the layers do not fit each other, 219 inputs and 8 outputs, 12 with the speed
        action, or a number is not finite.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    metadata: dict[str, Any] = field(default_factory=dict)
    disagreement_max: float = math.inf

    def __post_init__(self) -> None:
        found = [w.shape for w in self.weights]
        wanted: list[tuple[int, ...]] = []
        if len(found) == len(PRICED_LAYERS) - 1 and all(len(shape) == 3 for shape in found):
            actions = min(max(self.actions, len(SIDES)), len(ACTIONS))
            sizes = (PRICED_LAYERS[0], *self.layers[1:-1], priced_layers(actions)[-1])
            wanted = [(found[0][0], m, n) for n, m in itertools.pairwise(sizes)]
        biases = [b.shape for b in self.biases]
        fit = found == wanted and biases == [shape[:2] for shape in wanted]
        if not (wanted and fit and found[0][0]):
            raise InputError(
                f"network has layers of shape {', '.join(map(str, found))}; must be members times "
                f"outputs times inputs of {'-'.join(map(str, PRICED_LAYERS))} or other hidden "
                f"sizes, with the speed action {priced_layers(len(ACTIONS))[-1]} outputs"
            )
        if not all(np.isfinite(a).all() for a in (*self.weights, *self.biases)):
            raise InputError("network contains numbers that are not finite")
        limit = self.disagreement_max
        if (not is_number(limit) and limit != math.inf) or limit < 0.0:
            raise InputError(f"network has the disagreement_max {limit!r}; use zero or more")

    @classmethod
    def joined(cls, networks: Sequence[PricedNetwork], **metadata: Any) -> PricedNetwork:
        """Returns one network with the members of several."""
        weights = zip(*(network.weights for network in networks), strict=True)
        biases = zip(*(network.biases for network in networks), strict=True)
        return cls(
            tuple(map(np.concatenate, weights)), tuple(map(np.concatenate, biases)), metadata
        )

    @property
    def layers(self) -> tuple[int, ...]:
        """Numbers of inputs, of hidden units and of outputs."""
        return (self.weights[0].shape[2], *(weight.shape[1] for weight in self.weights))

    @property
    def actions(self) -> int:
        """Number of actions whose worth it tells: changes to both sides, and to ease off."""
        return self.layers[-1] // len(COMPONENTS)

    def __len__(self) -> int:
        return len(self.weights[0])

    def components(self, observation: NDArray[np.floating[Any]], prices: ArrayLike) -> FloatArray:
        """Returns what an action adds for each member, shape (members, ..., actions, 4).

        Actions are those of `ACTIONS`, parts those of `COMPONENTS`.

        Args:
          observation: shape (..., 216).
          prices: shape (..., 3) or (3,), in the order of `Prices`.

        Raises:
          InputError: wrong shape of the observation, or a value that is not finite.
        """
        check_observation(observation)
        inputs = price_inputs(prices)
        inputs = np.broadcast_to(inputs, (*observation.shape[:-1], inputs.shape[-1]))
        first = np.concatenate([np.asarray(observation, np.float32), inputs], axis=-1)
        found = []
        for member in range(len(self)):
            x = first
            for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
                x = x @ weight[member].T + bias[member]
                if i < len(self.weights) - 1:
                    x = np.maximum(x, 0.0)
            found.append(x.reshape(*x.shape[:-1], self.actions, len(COMPONENTS)))
        return np.stack(found)

    def gains(self, observation: NDArray[np.floating[Any]], prices: ArrayLike) -> FloatArray:
        """Returns what the actions are worth [m], shape (members, ..., actions)."""
        priced = np.asarray(prices, np.float32)[..., None, :]
        return worth(self.components(observation, prices), priced)

    def save(self, path: str | Path, **metadata: Any) -> None:
        """Writes the npz file with numbers of 16 bits; keyword arguments extend its metadata."""
        limit = self.disagreement_max
        header = {
            **self.metadata,
            **metadata,
            "format": FORMAT,
            "observation_version": OBSERVATION_VERSION,
            "layers": list(self.layers),
            "disagreement_max": None if math.isinf(limit) else limit,
        }
        weights, biases = ([a.astype(np.float16) for a in k] for k in (self.weights, self.biases))
        write_layers(path, "weights file", header, weights, biases)

    @classmethod
    def load(cls, path: str | Path | None = None) -> PricedNetwork:
        """Reads a file written by `save`; default: the shipped one.

        Raises:
          InputError: the file does not exist, is not such an npz file, has other shapes or another
            version of the observation, or a number is not finite; the message gives the reason.
        """
        path = SHIPPED_PRICED if path is None else path
        weights, biases, metadata = read_layers(path, FORMAT, len(PRICED_LAYERS) - 1)
        limit = metadata.get("disagreement_max")
        try:
            return cls(weights, biases, metadata, math.inf if limit is None else limit)
        except InputError as error:
            raise InputError(f"weights file {str(path)!r}: {error}") from error


def chosen(gains: NDArray[np.floating[Any]], braking: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns decisions of shape (...): the action worth most, if it is worth a price; 0 keeps.

    Args:
      gains: of the actions [m], shape (..., actions).
      braking: that each of them asks of the new follower [m/s2], same shape; infinite where it
        is not possible.
    """
    allowed = np.where(braking < IMPOSED_BRAKING_MAX, gains, -np.inf)
    best = allowed.argmax(-1)
    gained = np.take_along_axis(allowed, best[..., None], -1)[..., 0] > 0.0
    return np.where(gained, ACTIONS[best], 0)


def eased_speed(before: ArrayLike, speed: ArrayLike) -> NDArray[np.float64]:
    """Returns the highest speed of a truck that eases off [m/s].

    Args:
      before: the one until now, infinite where it did not ease off.
      speed: of the truck, of the same shape.
    """
    held = np.asarray(before) <= np.asarray(speed) + _EASED_SLACK
    return np.where(held, before, np.asarray(speed) - EASED)


class PricedPolicy:
    """Makes the lane change that is worth most at given prices, if it is worth more than nothing.

    It makes no change for which the planner's gaps are not free, and none that asks more than
    `IMPOSED_BRAKING_MAX` of the new follower. With the speed action it eases off where that is
    worth more. Where the members of the network disagree more than in their training, or the road
    has more lanes, look-ahead decides instead.

    Args:
      network: tells what a change adds.
      prices: of the drive.

    Attributes:
      unsure: whether look-ahead made the last decision; unsure_decisions: how many since `reset`.
      speed_max: highest speed until the next decision [m/s]; infinite where it does not ease off.
    """

    name = "ddqn"

    def __init__(self, network: PricedNetwork, prices: Prices) -> None:
        self.network, self.prices = network, prices
        self.rule = fallback_rule(prices.lane_change)
        self.reset()

    def reset(self) -> None:
        """Prepares the policy for a new drive."""
        self.unsure, self.unsure_decisions = False, 0
        self.speed_max = math.inf

    def values(self, observation: NDArray[np.floating[Any]]) -> FloatArray:
        """Returns what left, keep and right are worth [m], shape (3,)."""
        left, right = self.network.gains(observation, self.prices.numbers).mean(0)[:2]
        return np.array([left, 0.0, right], np.float32)

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the decision of greatest worth; KEEP where no change is possible."""
        self.unsure, eased, self.speed_max = False, self.speed_max, math.inf
        speed = context.scene.ego.speed
        of_sides = imposed_braking(context)
        asked = [of_sides[side] for side in SIDES] + [0.0 if speed >= EASES_FROM else math.inf]
        braking = np.array(asked[: self.network.actions])
        possible = braking < IMPOSED_BRAKING_MAX
        if not possible.any():
            return Decision.KEEP
        gains = self.network.gains(context.observation, self.prices.numbers)
        spread = disagreement(gains, self.prices.numbers)[possible].max()
        if spread > self.network.disagreement_max or len(context.lanes) > LANES_MAX:
            self.unsure = True
            self.unsure_decisions += 1
            decision = self.rule.decide(context)
            may = of_sides.get(decision, math.inf) < IMPOSED_BRAKING_MAX
            return decision if may else Decision.KEEP
        action = int(chosen(gains.mean(0), braking))
        if action == EASE:
            self.speed_max = float(eased_speed(eased, speed))
            return Decision.KEEP
        return Decision(action)


def load_priced(path: str | Path | None = None, **prices: float) -> PricedPolicy:
    """Returns the policy of a weights file, by default the shipped one, at some `Prices`.

    Raises:
      InputError: the file is not usable, or a price is out of its bounds.
    """
    return PricedPolicy(PricedNetwork.load(path), Prices(**prices))
