"""Replay memory: the ring, uniform and prioritized draws, n-step returns."""

import numpy as np
import pytest

from controllers.decision.learning.replay import (
    Batch,
    Priorities,
    ReplayMemory,
    Returns,
    Transition,
)
from controllers.decision.observation import OBSERVATION_SIZE
from iits_mj.core.errors import InputError


def transition(reward=0.0, discount=0.5, action=1, mark=0.0):
    first = np.full(OBSERVATION_SIZE, mark, np.float32)
    return Transition(first, action, reward, discount, first + 0.5)


def batch(*rewards):
    return Batch.of([transition(reward) for reward in rewards])


def random(seed=0):
    return np.random.default_rng(seed)


def test_n_step_return_equals_a_hand_calculation():
    returns = Returns(3)
    assert returns.add(transition(1.0, 0.5, mark=0.1), over=False) == []
    assert returns.add(transition(2.0, 0.25, mark=0.2), over=False) == []
    (joined,) = returns.add(transition(4.0, 0.5, mark=0.3), over=False)
    assert joined.reward == 1.0 + 0.5 * 2.0 + 0.125 * 4.0
    assert joined.discount == 0.5 * 0.25 * 0.5
    assert joined.observation[0] == np.float32(0.1)
    assert joined.following[0] == np.float32(0.8)


def test_end_of_an_episode_completes_all_returns():
    returns = Returns(3)
    returns.add(transition(1.0), over=False)
    joined = returns.add(transition(2.0, discount=0.0), over=True)
    assert [t.reward for t in joined] == [1.0 + 0.5 * 2.0, 2.0]
    assert [t.discount for t in joined] == [0.0, 0.0]


def test_a_cut_completes_all_returns():
    returns = Returns(3)
    returns.add(transition(1.0, mark=0.1), over=False)
    returns.add(transition(2.0, mark=0.2), over=False)
    joined = returns.cut()
    assert [t.reward for t in joined] == [1.0 + 0.5 * 2.0, 2.0]
    assert [t.discount for t in joined] == [0.25, 0.5]
    assert [t.following[0] for t in joined] == [np.float32(0.7)] * 2
    assert returns.cut() == []
    assert returns.add(transition(4.0), over=False) == []


def test_truncation_keeps_the_discount_of_the_next_value():
    returns = Returns(3)
    (joined,) = returns.add(transition(1.0, discount=0.99), over=True)
    assert joined.discount == 0.99


@pytest.mark.parametrize("parts", [(4,), (1, 3), (3, 1), (2, 2)])
def test_replay_overwrites_the_oldest_and_draws_by_the_generator(parts):
    replay, rewards = ReplayMemory(3, OBSERVATION_SIZE), iter((1.0, 2.0, 3.0, 4.0))
    for part in parts:
        replay.add(batch(*[next(rewards) for _ in range(part)]))
    assert len(replay) == 3
    drawn = replay.sample(200, random()).batch
    assert set(drawn.reward.tolist()) == {2.0, 3.0, 4.0}
    assert np.array_equal(drawn.reward, replay.sample(200, random()).batch.reward)


def test_uniform_draws_have_weight_one_and_ignore_errors():
    replay = ReplayMemory(3, OBSERVATION_SIZE)
    replay.add(batch(1.0, 2.0))
    replay.renew(np.array([0]), np.array([100.0]))
    drawn = replay.sample(1000, random())
    assert (drawn.weight == 1.0).all()
    assert 400 < (drawn.indices == 0).sum() < 600


def test_sampling_an_empty_replay_is_refused():
    with pytest.raises(InputError, match="empty"):
        ReplayMemory(3, OBSERVATION_SIZE).sample(1, random())


def priorities(*p, exponent=1.0):
    """Returns priorities of the given values; the errors are less by the floor of 1e-3."""
    made = Priorities(len(p), exponent)
    made.add(np.arange(len(p)))
    made.renew(np.arange(len(p)), np.array(p) - 1e-3)
    return made


@pytest.mark.parametrize("size", [1, 2, 5, 64, 100])
def test_draws_follow_the_cumulative_sum_of_the_priorities(size):
    p = random().uniform(0.01, 2.0, size)
    index, _ = priorities(*p).draw(500, size, 1.0, random(1))
    wanted = (np.arange(500) + random(1).random(500)) / 500 * p.sum()
    assert np.array_equal(index, np.searchsorted(np.cumsum(p), wanted, side="right"))


def test_renewed_priorities_are_those_of_the_last_errors():
    made, p = priorities(*np.ones(37)), np.ones(37)
    for seed in range(200):
        index = random(seed).integers(0, 37, 5)
        p[index] = seed + 1.0
        made.renew(index, np.full(5, seed + 1.0 - 1e-3))
    assert made.state(37)["mass"] == pytest.approx(p)


def test_draws_never_go_beyond_the_stored_transitions():
    made = Priorities(8, 1.0)
    made.add(np.arange(3))
    index, _ = made.draw(1000, 3, 1.0, random())
    assert np.bincount(index).tolist() == [334, 333, 333]


def test_draws_are_proportional_to_the_priorities():
    # One draw in each of 400 equal parts of the sum: shares are exact where parts do not mix.
    index, _ = priorities(1.0, 2.0, 5.0).draw(400, 3, 1.0, random())
    assert np.bincount(index).tolist() == [50, 100, 250]


@pytest.mark.parametrize(("exponent", "shares"), [(0.0, [100, 100]), (0.5, [50, 150])])
def test_exponent_below_one_equalizes_the_priorities(exponent, shares):
    index, _ = priorities(1.0, 9.0, exponent=exponent).draw(200, 2, 1.0, random())
    assert np.bincount(index).tolist() == shares


def test_importance_weights_equal_a_hand_calculation():
    # P = 1/4 and 3/4 of N = 2: (N P)^-1/2 = sqrt 2 and sqrt 2/3, their ratio sqrt 1/3.
    index, weight = priorities(1.0, 3.0).draw(4, 2, 0.5, random())
    assert index.tolist() == [0, 1, 1, 1]
    assert weight == pytest.approx([1.0, *[np.sqrt(1.0 / 3.0)] * 3], abs=1e-6)


def test_full_importance_weights_make_draws_unbiased():
    index, weight = priorities(1.0, 3.0, 4.0).draw(800, 3, 1.0, random())
    sums = np.bincount(index, weights=weight)
    assert sums == pytest.approx([sums.mean()] * 3, rel=1e-6)


def test_new_transitions_have_the_greatest_priority_so_far():
    replay = ReplayMemory(8, OBSERVATION_SIZE, priority_exponent=1.0)
    replay.add(batch(0.0, 1.0))
    replay.renew(np.array([0, 1]), np.array([0.5, 5.0]) - 1e-3)
    replay.add(batch(2.0))
    drawn = replay.sample(1050, random())
    assert np.bincount(drawn.indices).tolist() == [50, 500, 500]


def test_an_overwritten_transition_loses_its_priority():
    replay = ReplayMemory(2, OBSERVATION_SIZE, priority_exponent=1.0)
    replay.add(batch(0.0, 1.0))
    replay.renew(np.array([0, 1]), np.array([4.0, 2.0]) - 1e-3)
    replay.add(batch(2.0, 3.0))
    assert np.bincount(replay.sample(100, random()).indices).tolist() == [50, 50]


@pytest.mark.parametrize("exponent", [None, 0.6])
def test_replay_is_restored_to_the_bit(exponent):
    replay, other = (ReplayMemory(5, OBSERVATION_SIZE, exponent) for _ in range(2))
    replay.add(batch(*range(7)))
    replay.renew(np.array([1, 3]), np.array([0.2, 9.0]))
    other.restore(replay.state())
    for memory in (replay, other):
        memory.add(batch(8.0))
    mine, theirs = replay.sample(64, random(), 0.4), other.sample(64, random(), 0.4)
    assert np.array_equal(mine.indices, theirs.indices)
    assert np.array_equal(mine.weight, theirs.weight)
    assert np.array_equal(mine.batch.reward, theirs.batch.reward)
