"""Replay memory: the ring and its draws."""

import numpy as np
import pytest

from controllers.decision.learning.replay import Batch, ReplayMemory, Transition
from controllers.decision.observation import OBSERVATION_SIZE
from iits_mj.core.errors import InputError


def transition(reward=0.0, discount=0.5, action=1, mark=0.0):
    first = np.full(OBSERVATION_SIZE, mark, np.float32)
    return Transition(first, action, reward, discount, first + 0.5)


def batch(*rewards):
    return Batch.of([transition(reward) for reward in rewards])


def random(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("parts", [(4,), (1, 3), (3, 1), (2, 2)])
def test_replay_overwrites_the_oldest_and_draws_by_the_generator(parts):
    replay, rewards = ReplayMemory(3, OBSERVATION_SIZE), iter((1.0, 2.0, 3.0, 4.0))
    for part in parts:
        replay.add(batch(*[next(rewards) for _ in range(part)]))
    assert len(replay) == 3
    drawn = replay.sample(200, random())
    assert set(drawn.reward.tolist()) == {2.0, 3.0, 4.0}
    assert np.array_equal(drawn.reward, replay.sample(200, random()).reward)


def test_sampling_an_empty_replay_is_refused():
    with pytest.raises(InputError, match="empty"):
        ReplayMemory(3, OBSERVATION_SIZE).sample(1, random())


def test_replay_is_restored_to_the_bit():
    replay, other = (ReplayMemory(5, OBSERVATION_SIZE) for _ in range(2))
    replay.add(batch(*range(7)))
    other.restore(replay.state())
    for memory in (replay, other):
        memory.add(batch(8.0))
    mine, theirs = replay.sample(64, random()), other.sample(64, random())
    assert np.array_equal(mine.reward, theirs.reward)
    assert np.array_equal(mine.observation, theirs.observation)
