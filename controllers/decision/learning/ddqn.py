"""Double DQN, with dueling heads as an option.

The online network chooses the next action, the target network gives its value (van Hasselt, Guez
and Silver 2016, eq. 4): `Y = R + discount * Q_target(s', argmax_a Q_online(s', a))`. The target
network is a separate copy that is updated every `target_interval` updates. A
decision lasts 1 s, or a whole lane change, so each transition has its own discount, which is 0
after a termination only.

Dueling heads (Wang et al. 2016, eq. 9) are two linear heads on one trunk: `Q = V + A - mean_a A`.

The shipped policy may be a running average of the online network, which smooths its gradient steps.
The online network itself drives the training trips, because only that corrects its errors.

Heads are linear, so they fold exactly into the last layer of the shipped network, and the scaling
of the inputs into its first layer.

Inputs may be standardized: in the observation's units a typical difference of speed is 0.05, a
typical lateral speed in a lane change 0.01, and a typical distance 0.3. Adam's steps are about
equally long for all weights, so the network learns slowly from small inputs; in units of their
spread all inputs have the same size (LeCun et al. 1998, "Efficient BackProp", section 4.3).
"""

from __future__ import annotations

import copy
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from controllers.decision.learning.config import LearnerConfig
from controllers.decision.learning.replay import Batch
from controllers.decision.observation import usual_and_spread
from controllers.decision.policy import LAYERS, QNetwork
from iits_mj.core.errors import Error

ACTION_COUNT = LAYERS[-1]


class Update(NamedTuple):
    """One gradient step: loss, mean value of the actions taken, mean absolute TD error.

    Value and error are in units of the scaled reward.
    """

    loss: float
    value: float
    error: float


class ValueNetwork(nn.Module):
    """The paper's 216-256-512-256-3 network with ReLU; its last layer may be two heads.

    Args:
      dueling: heads for value and advantage.
      standardized: inputs are relative to their usual values, in units of their spread.
    """

    def __init__(self, dueling: bool, standardized: bool = False) -> None:
        super().__init__()
        self._inputs = usual_and_spread() if standardized else None
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(LAYERS[:-1]):
            layers += [nn.Linear(inputs, outputs), nn.ReLU()]
        self.trunk = nn.Sequential(*layers)
        self.advantage = nn.Linear(LAYERS[-2], ACTION_COUNT)
        self.value = nn.Linear(LAYERS[-2], 1) if dueling else None

    def forward(self, observation: Tensor) -> Tensor:
        """Returns values of the actions, (n, 3), for observations (n, 216)."""
        if self._inputs is not None:
            usual, spread = map(torch.from_numpy, self._inputs)
            observation = (observation - usual) / spread
        hidden = self.trunk(observation)
        advantage: Tensor = self.advantage(hidden)
        if self.value is None:
            return advantage
        found: Tensor = self.value(hidden) + advantage - advantage.mean(dim=1, keepdim=True)
        return found

    def layers(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Returns copies of weights and biases of the four layers, all linear parts folded in."""
        pairs = [_arrays(layer) for layer in self.trunk if isinstance(layer, nn.Linear)]
        if self._inputs is not None:
            usual, spread = self._inputs
            weight = pairs[0][0] / spread
            pairs[0] = weight, pairs[0][1] - weight @ usual
        # V + A - mean A is linear: one matrix suffices.
        weight, bias = _arrays(self.advantage)
        if self.value is not None:
            shared, common = _arrays(self.value)
            weight, bias = shared + weight - weight.mean(0), common + bias - bias.mean(0)
        pairs.append((weight, bias))
        return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in pairs]


def _arrays(layer: nn.Linear) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
    return weight.astype(np.float64), bias.astype(np.float64)


def double_q_target(
    reward: Tensor, discount: Tensor, online_next: Tensor, target_next: Tensor
) -> Tensor:
    """Returns targets (n,) from rewards and discounts (n,), next values (n, 3)."""
    return reward + discount * _of_action(target_next, online_next.argmax(dim=1))


def shortfall(values: Tensor, action: Tensor) -> Tensor:
    """Returns the best action's value less that of an action, (n,), from values (n, 3).

    Charging a part of it widens the gap between the best action and the others and leaves the best
    value unchanged (Bellemare et al. 2016, eq. 7). With frequent decisions the gap is small, as the
    next decision can correct this one, and errors of the values choose the action.
    """
    return values.max(dim=1).values - _of_action(values, action)


def _of_action(values: Tensor, action: Tensor) -> Tensor:
    """Returns the values of an action, (n,), from values (n, 3)."""
    return values[torch.arange(len(action)), action]


def _follow(mine: ValueNetwork, theirs: ValueNetwork, rate: float) -> None:
    """Moves all parameters by a share of the way to those of another network."""
    for parameter, other in zip(mine.parameters(), theirs.parameters(), strict=True):
        parameter.lerp_(other.detach(), rate)


class DoubleDqn:
    """The learner: online and target network, optimizer, number of updates."""

    def __init__(self, config: LearnerConfig, seed: int) -> None:
        self.config = config
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.online = ValueNetwork(config.dueling, config.standardized)
        self.target = copy.deepcopy(self.online).requires_grad_(False)
        self.average = copy.deepcopy(self.target) if config.average_rate else None
        self.optimizer = torch.optim.Adam(
            self.online.parameters(), lr=config.learning_rate, fused=True
        )
        self.updates = 0

    def update(self, batch: Batch) -> Update:
        """Takes one gradient step on a batch.

        Raises:
          Error: the loss is not finite.
        """
        reward = torch.from_numpy(batch.reward) * self.config.reward_scale
        observation, following = map(torch.from_numpy, (batch.observation, batch.following))
        action = torch.from_numpy(batch.action)
        with torch.no_grad():
            wanted = double_q_target(
                reward,
                torch.from_numpy(batch.discount),
                self.online(following),
                self.target(following),
            )
            if self.config.gap:
                wanted -= self.config.gap * shortfall(self.target(observation), action)
        taken = _of_action(self.online(observation), action)
        loss = nn.functional.smooth_l1_loss(taken, wanted)
        if not math.isfinite(loss.item()):
            raise Error(
                f"training diverged: the loss of update {self.updates + 1} is {loss.item()}; "
                "use a smaller learning-rate"
            )
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.online.parameters(), self.config.gradient_norm)
        self.optimizer.step()
        self.updates += 1
        if self.updates % self.config.target_interval == 0:
            self.target.load_state_dict(self.online.state_dict())
        if self.average is not None:
            # At first the mean of all networks since the initial one.
            rate = max(self.config.average_rate, 1.0 / self.updates)
            _follow(self.average, self.online, rate)
        value = taken.detach()
        error = (wanted - value).abs().mean().item()
        return Update(float(loss.item()), float(value.mean().item()), float(error))

    def set_rate(self, learning_rate: float) -> None:
        """Sets the learning rate."""
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate

    def network(self) -> QNetwork:
        """Returns a copy of the online network, which drives the training trips, in numpy."""
        return self._in_numpy(self.online)

    def policy(self) -> QNetwork:
        """Returns a copy of the policy to validate: the running average or the online network."""
        return self._in_numpy(self.online if self.average is None else self.average)

    def _in_numpy(self, values: ValueNetwork) -> QNetwork:
        weights, biases = zip(*values.layers(), strict=True)
        margin = self.config.margin * self.config.reward_scale
        return QNetwork(tuple(weights), tuple(biases), margin=margin)

    def state(self) -> dict[str, Any]:
        """Returns the state for a checkpoint; a copy."""
        state = {
            "online": self.online.state_dict(),
            "target": self.target.state_dict(),
            "average": None if self.average is None else self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "updates": self.updates,
        }
        return copy.deepcopy(state)

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a state."""
        self.online.load_state_dict(state["online"])
        self.target.load_state_dict(state["target"])
        if self.average is not None:
            self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.updates = int(state["updates"])
