"""Two small networks on maps of touches: one reads the answer, one chooses where to go."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import torch
from torch import nn


def trunk(channels: int) -> nn.Sequential:
    """Return three convolutions of stride 2 and a linear layer: (n, channels, 32, 32) to (n, 128)."""
    layers = nn.Sequential(
        nn.Conv2d(channels, 16, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Conv2d(16, 32, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Conv2d(32, 64, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(1024, 128),
        nn.ReLU(),
    )
    stored: nn.Sequential = layers.to(memory_format=torch.channels_last)
    return stored


def normalised(widths: Sequence[int], *layers: nn.Module) -> nn.Sequential:
    """Return convolutions of stride 2 between layers of some widths, batch-normalised, and further layers."""
    parts: list[nn.Module] = []
    for width, next_width in itertools.pairwise(widths):
        convolution = nn.Conv2d(width, next_width, 3, stride=2, padding=1, bias=False)
        parts += [convolution, nn.BatchNorm2d(next_width), nn.ReLU()]
    stored: nn.Sequential = nn.Sequential(*parts, *layers).to(memory_format=torch.channels_last)
    return stored


class Reader(nn.Module):
    """Predicts the answer from a map, and from where the map lies in the cell.

    ``side`` is the width of the map, pixels, 32 or 64. ``counts`` states that the answer is a number of
    shapes, which is the same however the map is moved, turned or mirrored; ``locates``, that the outputs are
    a position in the cell and a direction: they count from the frame of the map.
    """

    def __init__(self, outputs: int, side: int, *, counts: bool, locates: bool) -> None:
        super().__init__()
        if counts:
            self.body = normalised([2, 16, 32, 128], nn.AdaptiveAvgPool2d(1), nn.Flatten())
        elif side == 64:
            self.body = normalised([2, 16, 32, 64, 64], nn.Flatten(), nn.Linear(1024, 128), nn.ReLU())
        else:
            self.body = trunk(2)
        self.head, self.counts, self.locates = nn.Linear(128 + 4, outputs), counts, locates

    def forward(self, maps: torch.Tensor, frames: torch.Tensor) -> torch.Tensor:
        """Return predictions for maps (n, 2, h, w) in frames (n, 4): x, y in half cells, cosine, sine."""
        if self.counts and self.training:
            quarters, is_mirrored = torch.randint(4, ()), torch.randint(2, ())
            maps = torch.rot90(maps, int(quarters), (2, 3))
            maps = maps.flip(3) if is_mirrored else maps
        predictions: torch.Tensor = self.head(torch.cat([self.body(maps), frames], 1))
        if not self.locates:
            return predictions
        cosine, sine = frames[:, 2:3], frames[:, 3:]
        x, y = predictions[:, ::2], predictions[:, 1::2]
        turned = torch.stack([cosine * x - sine * y, sine * x + cosine * y], 2).flatten(1)
        return turned + nn.functional.pad(frames[:, :2], (0, 2))


def _ways() -> torch.Tensor:
    turns = torch.arange(24) * (2 * math.pi / 24)
    ring = torch.stack([turns.cos(), turns.sin()], 1)
    return torch.cat([ring, 0.6 * ring[::2], 0.3 * ring[::3]])


WAYS = _ways()
"""What a policy chooses from: ways in the plane, (44, 2), in parts of the longest."""


def nearest_ways(ways: torch.Tensor) -> torch.Tensor:
    """Return the number of the nearest of :data:`WAYS` for each way (n, 2)."""
    return torch.cdist(ways, WAYS).argmin(1)


class Explorer(nn.Module):
    """Where to go next, from the map around the sensor: a choice of ways, and a value."""

    def __init__(self) -> None:
        super().__init__()
        self.actor = nn.Sequential(trunk(3), nn.Linear(128, len(WAYS)))
        self.critic = nn.Sequential(trunk(3), nn.Linear(128, 1))

    def forward(self, maps: torch.Tensor) -> torch.distributions.Categorical:
        """Return how likely each of the ways is."""
        return torch.distributions.Categorical(logits=self.actor(maps))

    def value(self, maps: torch.Tensor) -> torch.Tensor:
        """Return the sum of rewards that is expected until the end of the episode, (n,)."""
        values: torch.Tensor = self.critic(maps)[:, 0]
        return values
