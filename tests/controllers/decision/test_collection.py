"""Trips for the learner: greedy, random and guided decisions."""

import dataclasses
import itertools

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.learning.collection import Drive, drive_trip
from controllers.decision.policy import ACTIONS, LAYERS, QNetwork
from controllers.decision.trip import TripConfig, cell_trip

TRIP = cell_trip("dense", 12.5, TripConfig(duration=60.0))


def always(action):
    """Returns a network that prefers one action."""
    weights = [np.zeros((m, n), np.float32) for n, m in itertools.pairwise(LAYERS)]
    biases = [np.zeros(n, np.float32) for n in LAYERS[1:]]
    biases[-1][action] = 1.0
    return QNetwork(tuple(weights), tuple(biases))


def drive(network, seed=0, **settings):
    job = Drive("a trip", 0, TRIP, np.random.default_rng(seed), **settings)
    return drive_trip(HighwayEnv(), job, network)


@pytest.mark.parametrize("action", [0, 1, 2])
def test_without_random_decisions_the_network_makes_all(action):
    driven = drive(always(action), learns=True)
    assert set(driven.transitions.action.tolist()) == {action}
    assert len(driven.transitions) == driven.summary.decisions


def test_rewards_and_discounts_are_those_of_the_world():
    driven = drive(always(1), learns=True)
    assert driven.transitions.reward.sum() == pytest.approx(driven.summary.reward.total, rel=1e-5)
    assert driven.transitions.discount == pytest.approx(0.99)


@pytest.mark.parametrize("keeps_right", [False, True])
def test_transitions_are_symmetric_unless_traffic_keeps_right(keeps_right):
    trip = dataclasses.replace(TRIP, keeps_right=keeps_right)
    job = Drive("a trip", 0, trip, np.random.default_rng(0), learns=True)
    transitions = drive_trip(HighwayEnv(), job, always(1)).transitions
    assert set(transitions.symmetric.tolist()) == {not keeps_right}


def test_a_drive_that_learns_nothing_gives_no_transitions():
    assert drive(always(1)).transitions is None


def test_share_of_random_decisions_is_epsilon():
    actions = np.concatenate(
        [drive(always(1), seed, epsilon=0.6, learns=True).transitions.action for seed in range(8)]
    )
    # Two random decisions of three are changes, which take some seconds.
    assert np.mean(actions != 1) == pytest.approx(0.4, abs=0.1)


def test_a_fully_guided_trip_takes_the_decisions_of_mobil():
    env, maker, actions, over = HighwayEnv(), make("mobil"), [], False
    env.reset(np.random.default_rng(7), TRIP)
    while not over:
        decision = maker.decide(env.context())
        actions.append(ACTIONS.index(decision))
        step = env.step(decision)
        over = step.terminated or step.truncated
    driven = drive(always(1), 7, epsilon=1.0, guided=1.0, learns=True)
    assert driven.transitions.action.tolist() == actions
    assert {0, 1} <= set(actions)
