"""Double DQN (van Hasselt, Guez and Silver 2016) in one file.

The online network chooses the next action, the target network values it (the paper's eq. 4):
`Y = R + discount * Q_target(s', argmax_a Q_online(s', a))`. The target network is a separate copy
that is renewed every `target_interval` updates. Durations of decisions differ (1 s, or a whole lane
change), so each transition carries its own discount, which is 0 after a termination only.
"""

from __future__ import annotations

import copy
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from controllers.decision.network import LAYERS, QNetwork
from controllers.decision.replay import Batch


@dataclass(frozen=True)
class LearnerConfig:
    """Settings of the learner; the first two are the paper's.

    Attributes:
      learning_rate: of Adam; batch_size: transitions an update.
      target_interval: updates between two copies to the target network.
      gradient_norm: the gradient is shortened to this length.
      reward_scale: rewards are multiplied by it; it changes no policy, only the numbers' size.
    """

    learning_rate: float = 5e-4
    batch_size: int = 64
    target_interval: int = 1000
    gradient_norm: float = 10.0
    reward_scale: float = 0.05


def build_network() -> nn.Sequential:
    """The paper's 216-256-512-256-3 with ReLU."""
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(LAYERS):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def double_q_target(
    reward: Tensor, discount: Tensor, online_next: Tensor, target_next: Tensor
) -> Tensor:
    """Targets of shape (n,) from rewards and discounts (n,) and next values (n, 3) of both nets."""
    chosen = online_next.argmax(dim=1, keepdim=True)
    return reward + discount * target_next.gather(1, chosen).squeeze(1)


class DoubleDqn:
    """The learner: online and target network, optimizer, and how often they were updated."""

    def __init__(self, config: LearnerConfig, seed: int) -> None:
        torch.manual_seed(seed)
        self.config = config
        self.online = build_network()
        self.target = copy.deepcopy(self.online).requires_grad_(False)
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=config.learning_rate)
        self.updates = 0

    def update(self, batch: Batch) -> float:
        """One gradient step on a batch; returns the loss (Huber)."""
        reward = torch.from_numpy(batch.reward) * self.config.reward_scale
        following = torch.from_numpy(batch.following)
        with torch.no_grad():
            wanted = double_q_target(
                reward,
                torch.from_numpy(batch.discount),
                self.online(following),
                self.target(following),
            )
        values = self.online(torch.from_numpy(batch.observation))
        taken = values.gather(1, torch.from_numpy(batch.action)[:, None]).squeeze(1)
        loss = nn.functional.smooth_l1_loss(taken, wanted)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.online.parameters(), self.config.gradient_norm)
        self.optimizer.step()
        self.updates += 1
        if self.updates % self.config.target_interval == 0:
            self.target.load_state_dict(self.online.state_dict())
        return float(loss.item())

    def network(self, **metadata: Any) -> QNetwork:
        """The online network as numpy arrays, a copy."""
        linear = [layer for layer in self.online if isinstance(layer, nn.Linear)]
        return QNetwork(
            tuple(np.array(layer.weight.detach().numpy(), np.float32) for layer in linear),
            tuple(np.array(layer.bias.detach().numpy(), np.float32) for layer in linear),
            dict(metadata),
        )

    def state(self) -> dict[str, Any]:
        """Everything that evolves, for a checkpoint; a copy."""
        state = {
            "online": self.online.state_dict(),
            "target": self.target.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "updates": self.updates,
        }
        return copy.deepcopy(state)

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up what `state` gave."""
        self.online.load_state_dict(state["online"])
        self.target.load_state_dict(state["target"])
        self.optimizer.load_state_dict(state["optimizer"])
        # A resumed training may ask for another rate than the stored one.
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.learning_rate
        self.updates = int(state["updates"])
