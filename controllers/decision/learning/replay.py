"""Replay memory of transitions, with mirror images."""

from __future__ import annotations

import dataclasses
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


class Transition(NamedTuple):
    """From one decision to the next one.

    Attributes:
      observation, action (0 left, 1 keep, 2 right), reward: discounted to the decision.
      discount: of the value at `following`; 0 after a termination, never after a truncation.
      following: observation at the next decision.
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


class ReplayMemory:
    """A ring of transitions, with observations as float16, whose error of 5e-4 is harmless.

    Args:
      capacity: greatest number of transitions.
      size: of an observation.
    """

    def __init__(self, capacity: int, size: int) -> None:
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
        self._next = (self._next + len(batch)) % self.capacity
        self._count = min(self._count + len(batch), self.capacity)

    def sample(self, count: int, generator: np.random.Generator) -> Batch:
        """Draws transitions uniformly, with replacement.

        Raises:
          InputError: the memory is empty.
        """
        if self._count == 0:
            raise InputError("replay memory is empty: add transitions before sampling")
        index = generator.integers(0, self._count, count)
        columns = {name: column[index] for name, column in self._columns.items()}
        for name in ("observation", "following"):
            columns[name] = columns[name].astype(np.float32)
        return Batch(**columns)

    def state(self) -> dict[str, Any]:
        """Returns the stored transitions for a checkpoint."""
        state: dict[str, Any] = {n: c[: self._count] for n, c in self._columns.items()}
        return {**state, "next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a state."""
        self._count = len(state["action"])
        for field in fields(Batch):
            self._columns[field.name][: self._count] = state[field.name]
        self._next = int(state["next"])
