"""Replay memory of transitions between decisions, with n-step returns over unequal durations."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.decision.base import Observation
from iits_mj.errors import InputError


class Transition(NamedTuple):
    """From one decision to a later one.

    Attributes:
      observation, action (0 left, 1 keep, 2 right), reward: discounted sum up to `following`.
      discount: of the value at `following`; 0 after a termination, never after a truncation.
      following: observation at the later decision.
    """

    observation: Observation
    action: int
    reward: float
    discount: float
    following: Observation


@dataclass(frozen=True)
class Batch:
    """Arrays of a draw: observations (n, 216) float32, the rest (n,)."""

    observation: NDArray[np.float32]
    action: NDArray[np.int64]
    reward: NDArray[np.float32]
    discount: NDArray[np.float32]
    following: NDArray[np.float32]


class Replay:
    """A ring of transitions; observations are kept as float16, whose error of 5e-4 is harmless."""

    def __init__(self, capacity: int, size: int) -> None:
        if capacity < 1:
            raise InputError(f"replay capacity {capacity!r}: use 1 or more")
        self.capacity = capacity
        self._observation = np.zeros((capacity, size), np.float16)
        self._following = np.zeros((capacity, size), np.float16)
        self._action = np.zeros(capacity, np.int64)
        self._reward = np.zeros(capacity, np.float32)
        self._discount = np.zeros(capacity, np.float32)
        self._next = 0
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, transition: Transition) -> None:
        """Stores a transition in place of the oldest one."""
        i = self._next
        self._observation[i] = transition.observation
        self._following[i] = transition.following
        self._action[i] = transition.action
        self._reward[i] = transition.reward
        self._discount[i] = transition.discount
        self._next = (i + 1) % self.capacity
        self._count = min(self._count + 1, self.capacity)

    def sample(self, count: int, generator: np.random.Generator) -> Batch:
        """Draws `count` transitions with replacement.

        Raises:
          InputError: the memory is empty.
        """
        if self._count == 0:
            raise InputError("replay memory is empty: add transitions before sampling")
        index = generator.integers(0, self._count, count)
        return Batch(
            self._observation[index].astype(np.float32),
            self._action[index],
            self._reward[index],
            self._discount[index],
            self._following[index].astype(np.float32),
        )


class Returns:
    """Joins single transitions to n-step ones: `R = r0 + d0 r1 + d0 d1 r2 ...`.

    Sutton and Barto (2018) eq. 7.1, with the discount of each step its own, for its duration.
    """

    def __init__(self, steps: int) -> None:
        if steps < 1:
            raise InputError(f"n-step returns of {steps!r} steps: use 1 or more")
        self._steps = steps
        self._recent: deque[Transition] = deque()

    def add(self, transition: Transition, over: bool) -> list[Transition]:
        """The transitions that are complete now; all of them when the episode is over."""
        self._recent.append(transition)
        complete = []
        while self._recent and (over or len(self._recent) >= self._steps):
            complete.append(self._joined())
            self._recent.popleft()
        return complete

    def _joined(self) -> Transition:
        reward, discount = 0.0, 1.0
        for step in self._recent:
            reward += discount * step.reward
            discount *= step.discount
        first, last = self._recent[0], self._recent[-1]
        return Transition(first.observation, first.action, reward, discount, last.following)
