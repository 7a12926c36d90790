"""The networks: generators of the published architecture, and discriminators that look at patches.

Generator (Zhu et al. 2017, Johnson et al. 2016; the layers follow from the shapes of the published weights):
a 7x7 convolution, two that halve, residual blocks, two that double, a 7x7 convolution; instance norm without
parameters, reflected borders. Discriminator: 4x4 convolutions (Isola et al. 2017).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn

from tactile_sim.learned.weights import GeneratorWeights


class _Residual(nn.Module):  # type: ignore[misc]
    """Two convolutions whose result is added to what went in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # Called so in the published weights.
        self.conv_block = nn.Sequential(
            nn.ReflectionPad2d(1),
            nn.Conv2d(channels, channels, 3),
            nn.InstanceNorm2d(channels),
            nn.ReLU(inplace=True),
            nn.ReflectionPad2d(1),
            nn.Conv2d(channels, channels, 3),
            nn.InstanceNorm2d(channels),
        )

    def forward(self, pictures: Any) -> Any:
        return pictures + self.conv_block(pictures)


class Generator(nn.Module):  # type: ignore[misc]
    """Three channels to three, each from -1 to 1; sides that are multiples of 4 keep their size."""

    def __init__(self, filters: int = 64, blocks: int = 9) -> None:
        super().__init__()

        def after(channels: int) -> list[Any]:
            return [nn.InstanceNorm2d(channels), nn.ReLU(inplace=True)]

        # Reflected, not zeros: a grey border would be something to see.
        layers: list[Any] = [nn.ReflectionPad2d(3), nn.Conv2d(3, filters, 7), *after(filters)]
        for channels in (filters, 2 * filters):
            layers += [nn.Conv2d(channels, 2 * channels, 3, stride=2, padding=1), *after(2 * channels)]
        layers += [_Residual(4 * filters) for _ in range(blocks)]
        for channels in (4 * filters, 2 * filters):
            doubling = nn.ConvTranspose2d(channels, channels // 2, 3, stride=2, padding=1, output_padding=1)
            layers += [doubling, *after(channels // 2)]
        self.model = nn.Sequential(*layers, nn.ReflectionPad2d(3), nn.Conv2d(filters, 3, 7), nn.Tanh())

    def forward(self, pictures: Any) -> Any:
        """Run it on (n, 3, H, W)."""
        return self.model(pictures)


def discriminator(filters: int = 64) -> Any:
    """Return a network that tells of each patch of 70 x 70 pixels how real it is: 1 real, 0 made."""

    def step(inside: int, outside: int, stride: int) -> list[Any]:
        convolution = nn.Conv2d(inside, outside, 4, stride=stride, padding=1)
        return [convolution, nn.InstanceNorm2d(outside), nn.LeakyReLU(0.2, inplace=True)]

    return nn.Sequential(
        nn.Conv2d(3, filters, 4, stride=2, padding=1),
        nn.LeakyReLU(0.2, inplace=True),
        *step(filters, 2 * filters, 2),
        *step(2 * filters, 4 * filters, 2),
        *step(4 * filters, 8 * filters, 1),
        nn.Conv2d(8 * filters, 1, 4, padding=1),
    )


def initialise(network: Any, seed: int) -> None:
    """Draw all weights again: normal, deviation 0.02 (Zhu et al. 2017); biases are 0.

    What doubles the size begins as linear interpolation: drawn freely, it draws a chequered grain.
    """
    rng = torch.Generator().manual_seed(seed)
    # By name: the order of modules does not decide which numbers a layer gets.
    for name, parameter in sorted(network.named_parameters()):
        with torch.no_grad():
            if name.endswith("bias"):
                parameter.zero_()
            else:
                parameter.copy_(torch.randn(parameter.shape, generator=rng) * 0.02)
    tent = torch.tensor([0.5, 1.0, 0.5])
    for module in network.modules():
        if isinstance(module, nn.ConvTranspose2d):
            with torch.no_grad():
                module.weight.copy_(module.weight[:, :, 1:2, 1:2] * tent[:, None] * tent)


def generator_of(weights: GeneratorWeights) -> Generator:
    """Return the generator with these weights."""
    network = Generator(weights.filters, weights.blocks)
    network.load_state_dict({name: torch.from_numpy(array) for name, array in weights.arrays.items()})
    return network


def weights_of(network: Generator, size_px: tuple[int, int]) -> GeneratorWeights:
    """Return the weights of a generator."""
    state = network.state_dict()
    arrays = {name: np.asarray(value.detach().float().cpu().numpy()) for name, value in state.items()}
    return GeneratorWeights(arrays, size_px)
