"""Replay memory of transitions, with prioritized draws, n-step returns and mirror images."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.decision.base import Observation
from controllers.decision.fast_world.config import LANE_WIDTH
from controllers.decision.observation import mirrored
from controllers.decision.policy import ACTIONS
from controllers.decision.trip import TripConfig
from iits_mj.core.arrays import IndexArray
from iits_mj.core.errors import InputError

# Width between the middles of the outermost lanes [m]; the built-in road's lanes have the same.
_WIDTH = (TripConfig.lanes - 1) * LANE_WIDTH
_FLOOR = 1e-3  # of a priority


class Transition(NamedTuple):
    """From one decision to a later one.

    Attributes:
      observation, action (0 left, 1 keep, 2 right), reward: discounted sum up to `following`.
      discount: of the value at `following`; 0 after a termination, never after a truncation.
      following: observation at the later decision.
      symmetric: whether left and right are equivalent in its traffic.
    """

    observation: Observation
    action: int
    reward: float
    discount: float
    following: Observation
    symmetric: bool = False


@dataclass(frozen=True)
class Batch:
    """Transitions as arrays: observations (n, 216) float32, the others (n,)."""

    observation: NDArray[np.float32]
    action: IndexArray
    reward: NDArray[np.float32]
    discount: NDArray[np.float32]
    following: NDArray[np.float32]
    symmetric: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.action)

    @classmethod
    def of(cls, transitions: Sequence[Transition]) -> Batch:
        """Stacks one or more transitions."""
        columns = list(zip(*transitions, strict=True))
        return cls(
            np.stack(columns[0]).astype(np.float32),
            np.array(columns[1], np.int64),
            np.array(columns[2], np.float32),
            np.array(columns[3], np.float32),
            np.stack(columns[4]).astype(np.float32),
            np.array(columns[5], np.bool_),
        )


class Draw(NamedTuple):
    """A batch from the memory with its indices (n,) and importance weights (n,)."""

    batch: Batch
    indices: IndexArray
    weight: NDArray[np.float32]


def mirror_half(batch: Batch, generator: np.random.Generator) -> Batch:
    """Returns a batch with a random half of its symmetric transitions mirrored.

    On a road where left and right are equivalent, the mirror image is a transition, too.
    """
    chosen = batch.symmetric & (generator.random(len(batch)) < 0.5)
    observation, following = batch.observation.copy(), batch.following.copy()
    for array in (observation, following):
        array[chosen] = mirrored(array[chosen], _WIDTH)
    action = np.where(chosen, len(ACTIONS) - 1 - batch.action, batch.action)
    return dataclasses.replace(batch, observation=observation, following=following, action=action)


class Priorities:
    """Proportional prioritization of transitions (Schaul et al. 2016).

    `P(i) = p_i^alpha / sum_k p_k^alpha` with `p_i = |TD error| + floor` (eq. 1) and importance
    weights `w_i = (N P(i))^-beta / max_j w_j` (section 3.4). A new transition gets the greatest
    priority so far.
    """

    def __init__(self, capacity: int, exponent: float) -> None:
        self._exponent, self._greatest = exponent, 1.0
        self._mass = np.zeros(capacity)

    def add(self, index: IndexArray) -> None:
        """Gives new transitions the greatest priority so far."""
        self._mass[index] = self._greatest**self._exponent

    def draw(
        self, count: int, stored: int, beta: float, generator: np.random.Generator
    ) -> tuple[IndexArray, NDArray[np.float32]]:
        """Draws indices and weights, one index from each of `count` equal parts of the sum.

        `stored` is the number of transitions in the memory, `beta` the exponent of the weights.
        """
        sums = np.cumsum(self._mass[:stored])
        part = (np.arange(count) + generator.random(count)) / count * sums[-1]
        # Rounding may make the last part equal to the whole sum.
        index = np.minimum(np.searchsorted(sums, part, side="right"), stored - 1)
        weight = (stored * self._mass[index] / sums[-1]) ** -beta
        return index, (weight / weight.max()).astype(np.float32)

    def renew(self, index: IndexArray, error: NDArray[np.floating[Any]]) -> None:
        """Sets the priorities of drawn transitions from their absolute TD errors."""
        priority = np.asarray(error, dtype=float) + _FLOOR
        self._greatest = max(self._greatest, float(priority.max()))
        # A transition drawn twice has the same error both times.
        self._mass[index] = priority**self._exponent

    def state(self, stored: int) -> dict[str, Any]:
        """Returns the state for a checkpoint; a copy."""
        return {"mass": self._mass[:stored].copy(), "greatest": self._greatest}

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a state."""
        self._mass[: len(state["mass"])] = state["mass"]
        self._greatest = float(state["greatest"])


class ReplayMemory:
    """A ring of transitions, with observations as float16, whose error of 5e-4 is harmless.

    Args:
      capacity: greatest number of transitions; size: of an observation.
      priority_exponent: alpha of prioritized draws; None draws uniformly.
    """

    def __init__(self, capacity: int, size: int, priority_exponent: float | None = None) -> None:
        if capacity < 1:
            raise InputError(f"replay capacity {capacity!r}: use 1 or more")
        self.capacity = capacity
        self._columns: dict[str, NDArray[Any]] = {
            "observation": np.zeros((capacity, size), np.float16),
            "action": np.zeros(capacity, np.int64),
            "reward": np.zeros(capacity, np.float32),
            "discount": np.zeros(capacity, np.float32),
            "following": np.zeros((capacity, size), np.float16),
            "symmetric": np.zeros(capacity, np.bool_),
        }
        self._priorities = (
            None if priority_exponent is None else Priorities(capacity, priority_exponent)
        )
        self._next = 0
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, batch: Batch) -> None:
        """Stores transitions in place of the oldest ones; of more than fit, the last ones."""
        index = (self._next + np.arange(len(batch))) % self.capacity
        kept = slice(max(0, len(batch) - self.capacity), None)
        for name, column in self._columns.items():
            column[index[kept]] = getattr(batch, name)[kept]
        if self._priorities is not None:
            self._priorities.add(index[kept])
        self._next = (self._next + len(batch)) % self.capacity
        self._count = min(self._count + len(batch), self.capacity)

    def sample(self, count: int, generator: np.random.Generator, beta: float = 1.0) -> Draw:
        """Draws `count` transitions with replacement; `beta` is the importance exponent.

        Raises:
          InputError: the memory is empty.
        """
        if self._count == 0:
            raise InputError("replay memory is empty: add transitions before sampling")
        if self._priorities is None:
            index = generator.integers(0, self._count, count)
            weight = np.ones(count, np.float32)
        else:
            index, weight = self._priorities.draw(count, self._count, beta, generator)
        columns = {name: column[index] for name, column in self._columns.items()}
        for name in ("observation", "following"):
            columns[name] = columns[name].astype(np.float32)
        return Draw(Batch(**columns), index, weight)

    def renew(self, index: IndexArray, error: NDArray[np.floating[Any]]) -> None:
        """Updates priorities, if used, from the absolute TD errors of drawn transitions."""
        if self._priorities is not None:
            self._priorities.renew(index, error)

    def state(self) -> dict[str, Any]:
        """Returns the stored transitions for a checkpoint."""
        state: dict[str, Any] = {n: c[: self._count] for n, c in self._columns.items()}
        if self._priorities is not None:
            state["priorities"] = self._priorities.state(self._count)
        return {**state, "next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a state."""
        self._count = len(state["action"])
        for field in fields(Batch):
            self._columns[field.name][: self._count] = state[field.name]
        self._next = int(state["next"])
        if self._priorities is not None:
            self._priorities.restore(state["priorities"])


class Returns:
    """Joins single transitions to n-step ones: `R = r0 + d0 r1 + d0 d1 r2 ...`.

    Sutton and Barto (2018) eq. 7.1; the discount of each step depends on its duration.
    """

    def __init__(self, steps: int) -> None:
        if steps < 1:
            raise InputError(f"n-step returns of {steps!r} steps: use 1 or more")
        self._steps = steps
        self._recent: deque[Transition] = deque()

    def add(self, transition: Transition, over: bool) -> list[Transition]:
        """Adds a transition; returns the complete ones, at the end of the episode all of them."""
        self._recent.append(transition)
        return self._released(0 if over else self._steps - 1)

    def cut(self) -> list[Transition]:
        """Returns the transitions so far, each ending here.

        A return beyond a random decision is not that of the greedy policy (Watkins 1989).
        """
        return self._released(0)

    def _released(self, kept: int) -> list[Transition]:
        complete = []
        while len(self._recent) > kept:
            complete.append(self._joined())
            self._recent.popleft()
        return complete

    def _joined(self) -> Transition:
        reward, discount = 0.0, 1.0
        for step in self._recent:
            reward += discount * step.reward
            discount *= step.discount
        first, last = self._recent[0], self._recent[-1]
        return first._replace(reward=reward, discount=discount, following=last.following)
