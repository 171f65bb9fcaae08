"""Fits the priced network to labels of roll-outs; needs torch.

The loss is the Huber loss of what a change is worth at the label's prices, and of its parts, each
in units of its usual size. Mirror images of the labels count where the mirror image of the traffic
is as probable and the right lane has no price. The inputs are standardized as those of
`ddqn.ValueNetwork`; the scaling folds into the first layer and that of the parts into the last one.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from controllers.decision.fast_world.config import LANE_WIDTH
from controllers.decision.learning.rollouts import Labels
from controllers.decision.observation import mirrored, usual_and_spread
from controllers.decision.priced import (
    COMPONENTS,
    PricedNetwork,
    disagreement,
    price_inputs,
    priced_layers,
    usual_worth,
)
from iits_mj.core.errors import Error

# Usual sizes of the parts, in their order and units.
_SCALES = np.array([40.0, 1.0, 0.5, 30.0], np.float32)
_PARTS = 0.2  # weight of the loss of the parts
# Errors beyond this many usual sizes count linearly. It is wide: the network is to tell the mean of
# what a change adds, and few states add much.
_DELTA = 4.0
_BATCH = 512
# Share of the labels that the members agree on well enough to decide.
_SURE = 0.998
_RATE, _RATE_END, _DECAY = 1e-3, 1e-5, 1e-3


def mirror_images(labels: Labels) -> Labels:
    """Returns the mirror images of the labels for which they are as probable."""
    rows = np.flatnonzero(labels.symmetric & (labels.prices[:, 2] == 0.0))
    sides = [1, 0, *range(2, labels.possible.shape[1])]
    components = labels.components[rows][:, sides]
    # The time in the one lane is the time outside the other one.
    components[..., 3] *= -1.0
    return Labels(
        mirrored(labels.observation[rows], LANE_WIDTH),
        labels.prices[rows],
        components,
        labels.possible[rows][:, sides],
        labels.symmetric[rows],
    )


def joined(labels: Sequence[Labels]) -> Labels:
    """Returns the labels of all chunks."""
    columns = zip(*(vars(chunk).values() for chunk in labels), strict=True)
    return Labels(*(np.concatenate(column) for column in columns))


def fit(labels: Labels, seed: int, epochs: int) -> PricedNetwork:
    """Returns a network of one member, fitted to labels.

    Args:
      labels: of roll-outs.
      seed: of the initial weights and the order of the labels.
      epochs: passes over the labels.

    Raises:
      Error: the loss is not finite.
    """
    torch.set_num_threads(1)
    labels = joined([labels, mirror_images(labels)])
    usual, spread = usual_and_spread()
    inputs = np.concatenate(
        [(labels.observation - usual) / spread, price_inputs(labels.prices)], axis=1
    )
    x, wanted = torch.from_numpy(inputs), torch.from_numpy(labels.components)
    prices = torch.from_numpy(labels.prices)
    weight = torch.from_numpy(labels.possible.astype(np.float32))
    size = torch.from_numpy(usual_worth(labels.prices[:, :1]).astype(np.float32))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = _network(priced_layers(labels.possible.shape[1]))
        optimizer = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
        batches = math.ceil(len(x) / _BATCH)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
            optimizer, epochs * batches, eta_min=_RATE_END
        )
        for _ in range(epochs):
            for rows in torch.randperm(len(x)).split(_BATCH):
                found = network(x[rows]).unflatten(1, (-1, len(COMPONENTS)))
                loss = _loss(found, wanted[rows], prices[rows], size[rows], weight[rows])
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimizer.step()
                schedule.step()
            if not math.isfinite(loss.item()):
                raise Error(f"training diverged: the loss of the fit is {loss.item()}")
    return PricedNetwork(*_layers(network, usual, spread))


def with_limit(network: PricedNetwork, labels: Labels) -> PricedNetwork:
    """Returns a network with the disagreement of its members that labels hardly exceed."""
    if len(network) == 1:
        return network
    gains = network.gains(labels.observation, labels.prices)
    found = disagreement(gains, labels.prices)[labels.possible]
    return dataclasses.replace(network, disagreement_max=float(np.quantile(found, _SURE)))


def _network(sizes: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def _loss(found: Tensor, wanted: Tensor, prices: Tensor, size: Tensor, weight: Tensor) -> Tensor:
    """Returns the loss of outputs (n, actions, 4), in units of `_SCALES`, against components.

    Args:
      found: outputs.
      wanted: components, shape (n, actions, 4).
      prices: shape (n, 3).
      size: of what a change is worth, shape (n, 1).
      weight: of the actions, shape (n, actions).
    """
    scales = torch.from_numpy(_SCALES)
    charges = torch.cat([-torch.ones(len(prices), 1), prices], dim=1)[:, None]
    error = ((found * scales - wanted) * charges).sum(2) / size
    huber = functools.partial(nn.functional.huber_loss, reduction="none", delta=_DELTA)
    whole = huber(error, torch.zeros_like(error))
    parts = huber(found, wanted / scales).mean(2)
    return ((whole + _PARTS * parts) * weight).sum() / weight.sum()


def _layers(
    network: nn.Sequential, usual: NDArray[np.float32], spread: NDArray[np.float32]
) -> tuple[tuple[NDArray[np.float32], ...], tuple[NDArray[np.float32], ...]]:
    """Returns weights and biases with the scaling of inputs and outputs folded in."""
    linear = [layer for layer in network if isinstance(layer, nn.Linear)]
    weights = [layer.weight.detach().numpy().astype(np.float64) for layer in linear]
    biases = [layer.bias.detach().numpy().astype(np.float64) for layer in linear]
    size = len(usual)
    first = weights[0]
    first[:, :size] /= spread
    biases[0] = biases[0] - first[:, :size] @ usual
    scales = np.tile(_SCALES, len(biases[-1]) // len(_SCALES))
    weights[-1], biases[-1] = weights[-1] * scales[:, None], biases[-1] * scales
    return (
        tuple(weight.astype(np.float32)[None] for weight in weights),
        tuple(bias.astype(np.float32)[None] for bias in biases),
    )
