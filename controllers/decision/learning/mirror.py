"""Transitions seen in a mirror: on a road where left and right are alike, each teaches twice."""

from __future__ import annotations

import dataclasses

import numpy as np

from controllers.decision.fast_world.road import LANE_WIDTH, LANES
from controllers.decision.learning.replay import Batch
from controllers.decision.network import ACTIONS
from controllers.decision.observation import mirrored

# Between the middles of the outermost lanes [m]; the built-in road's lanes are as wide.
_WIDTH = (LANES - 1) * LANE_WIDTH


def mirror_half(batch: Batch, generator: np.random.Generator) -> Batch:
    """A batch of which every second transition, by chance, is seen in a mirror.

    Those from traffic that keeps right stay as they are.
    """
    chosen = batch.symmetric & (generator.random(len(batch)) < 0.5)
    observation, following = batch.observation.copy(), batch.following.copy()
    for array in (observation, following):
        array[chosen] = mirrored(array[chosen], _WIDTH)
    action = np.where(chosen, len(ACTIONS) - 1 - batch.action, batch.action)
    return dataclasses.replace(batch, observation=observation, following=following, action=action)
