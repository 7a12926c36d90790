"""The networks of CycleGAN.

Generator (Zhu et al. 2017, Johnson et al. 2016; the layers follow from the shapes of the published weights):
a 7x7 convolution, two that halve, residual blocks, two that double, a 7x7 convolution; instance norm without
parameters, reflected borders. Discriminator: 4x4 convolutions (Isola et al. 2017).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


class _Residual(nn.Module):  # type: ignore[misc]
    """Two convolutions whose result is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # The published weights have this name.
        self.conv_block = nn.Sequential(
            nn.ReflectionPad2d(1),
            nn.Conv2d(channels, channels, 3),
            nn.InstanceNorm2d(channels),
            nn.ReLU(inplace=True),
            nn.ReflectionPad2d(1),
            nn.Conv2d(channels, channels, 3),
            nn.InstanceNorm2d(channels),
        )

    def forward(self, pictures: Tensor) -> Tensor:
        return pictures + self.conv_block(pictures)


class GeneratorNetwork(nn.Module):  # type: ignore[misc]
    """Three channels to three, each from -1 to 1; sides that are multiples of 4 keep their size."""

    def __init__(self, filters: int = 64, blocks: int = 9) -> None:
        super().__init__()

        def after(channels: int) -> list[nn.Module]:
            return [nn.InstanceNorm2d(channels), nn.ReLU(inplace=True)]

        # Reflected, not zeros: a grey border would be visible structure.
        layers: list[nn.Module] = [nn.ReflectionPad2d(3), nn.Conv2d(3, filters, 7), *after(filters)]
        for channels in (filters, 2 * filters):
            layers += [nn.Conv2d(channels, 2 * channels, 3, stride=2, padding=1), *after(2 * channels)]
        layers += [_Residual(4 * filters) for _ in range(blocks)]
        for channels in (4 * filters, 2 * filters):
            doubling = nn.ConvTranspose2d(channels, channels // 2, 3, stride=2, padding=1, output_padding=1)
            layers += [doubling, *after(channels // 2)]
        self.model = nn.Sequential(*layers, nn.ReflectionPad2d(3), nn.Conv2d(filters, 3, 7), nn.Tanh())

    def forward(self, pictures: Tensor) -> Tensor:
        """Run it on (n, 3, H, W)."""
        return self.model(pictures)


def discriminator(filters: int = 64) -> nn.Module:
    """Return a network that rates each patch of 70 x 70 pixels: 1 real, 0 generated."""

    def step(inside: int, outside: int, stride: int) -> list[nn.Module]:
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


def initialise(network: nn.Module, seed: int) -> None:
    """Draw all weights again: normal, standard deviation 0.02 (Zhu et al. 2017); biases are 0.

    Layers that double the size begin as linear interpolation; random weights give checkerboard artefacts.
    """
    rng = torch.Generator().manual_seed(seed)
    # By name, so that the order of modules does not decide which numbers a layer gets.
    for name, parameter in sorted(network.named_parameters()):
        if name.endswith("bias"):
            parameter.data.zero_()
        else:
            parameter.data[...] = torch.randn(parameter.shape, generator=rng) * 0.02
    tent = torch.tensor([0.5, 1.0, 0.5])
    for module in network.modules():
        if isinstance(module, nn.ConvTranspose2d):
            weight = module.weight.data
            weight[...] = weight[:, :, 1:2, 1:2].clone() * tent[:, None] * tent
