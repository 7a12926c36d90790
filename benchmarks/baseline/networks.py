"""Two small networks on maps of 32 x 32 pixels: one reads the digit, one chooses where to go."""

from __future__ import annotations

import math

import torch
from torch import nn


def trunk(outputs: int) -> nn.Sequential:
    """Return three convolutions of stride 2 and two linear layers: (n, 3, 32, 32) to (n, outputs)."""
    return nn.Sequential(
        nn.Conv2d(3, 32, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Conv2d(32, 64, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Conv2d(64, 64, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(1024, 128),
        nn.ReLU(),
        nn.Linear(128, outputs),
    ).to(memory_format=torch.channels_last)


def _ways() -> torch.Tensor:
    turns = torch.arange(24) * (2 * math.pi / 24)
    ring = torch.stack([turns.cos(), turns.sin()], 1)
    return torch.cat([ring, 0.6 * ring[::2], 0.3 * ring[::3]])


WAYS = _ways()
"""What a policy chooses from: ways, (44, 2), in parts of the longest."""


def chosen_of(ways: torch.Tensor) -> torch.Tensor:
    """Return the number of the nearest of :data:`WAYS` for each way (n, 2)."""
    return torch.cdist(ways, WAYS).argmin(1)


class Policy(nn.Module):
    """Where to go next, from the map around the sensor: a choice of ways, and a value."""

    def __init__(self) -> None:
        super().__init__()
        self.body, self.critic = trunk(len(WAYS)), trunk(1)

    def forward(self, maps: torch.Tensor) -> torch.distributions.Categorical:
        """Return how likely each of the ways is."""
        return torch.distributions.Categorical(logits=self.body(maps))

    def value(self, maps: torch.Tensor) -> torch.Tensor:
        """Return the sum of rewards that is expected until the end of the episode, (n,)."""
        return self.critic(maps)[:, 0]
