"""The networks of CycleGAN, and their weights as files.

Generator (Zhu et al. 2017, Johnson et al. 2016; the layers follow from the shapes of the published weights):
a 7x7 convolution, two that halve, residual blocks, two that double, a 7x7 convolution; instance norm without
parameters, reflected borders. Discriminator: 4x4 convolutions (Isola et al. 2017).

A file has the published format: an ``.npz`` of float32 arrays by layer. The size that the network was trained
at, for which that format has no room, is stored in the comment of the archive, which readers of the published
format ignore.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim import value_files
from tactile_toolkit import store
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float32, JsonDict

Direction = Literal["touch", "depth"]
"""Output of a generator: touches from depth, or depth from touches."""

PUBLISHED_SIZE_PX = (256, 256)
"""Size that the published weights were trained at (`tactile-mnist` 0.13.0)."""

_PUBLISHED = {
    "touch": "cycle_gan_tactile_mnist_v0.npz",
    "depth": "cycle_gan_inverse_tactile_mnist_v0.npz",
}

# A file must not decide how large a network is built before its shapes are compared.
_MAX_BLOCKS, _MAX_FILTERS = 64, 1024
_SIDES_PX = range(16, 2049, 4)
_MISSING: AnyArray = np.empty(0)


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


@dataclass(frozen=True, eq=False)
class GeneratorWeights:
    """Weights of one generator.

    Attributes
    ----------
    arrays : mapping of str to ndarray of float32
        By the names of the published files, such as ``model.10.conv_block.1.weight``.
    size_px : tuple of int
        Width and height of the pictures that it was trained with, pixels; multiples of 4.
    """

    arrays: Mapping[str, Float32]
    size_px: tuple[int, int] = PUBLISHED_SIZE_PX

    @property
    def filters(self) -> int:
        """Filters of the first layer."""
        return int(self.arrays["model.1.weight"].shape[0])

    @property
    def blocks(self) -> int:
        """Number of residual blocks."""
        return sum(name.endswith("conv_block.1.weight") for name in self.arrays)


def generator_of(weights: GeneratorWeights) -> GeneratorNetwork:
    """Return the generator with these weights."""
    network = GeneratorNetwork(weights.filters, weights.blocks)
    network.load_state_dict({name: torch.from_numpy(array) for name, array in weights.arrays.items()})
    return network


def weights_of(network: GeneratorNetwork, size_px: tuple[int, int]) -> GeneratorWeights:
    """Return the weights of a generator."""
    state = network.state_dict()
    arrays = {name: np.asarray(value.detach().float().cpu().numpy()) for name, value in state.items()}
    return GeneratorWeights(arrays, size_px)


def published_weights(direction: Direction) -> Path:
    """Return the file of the published weights, which `tactile-mnist` ships, without importing the package.

    Raises InputError if the package is not installed.
    """
    package = find_spec("tactile_mnist")
    if package is not None and package.origin is not None:
        file = Path(package.origin).parent / "resources" / _PUBLISHED[direction]
        if file.is_file():
            return file
    user = {"touch": "the optics 'cyclegan'", "depth": "DepthEstimator"}[direction]
    raise InputError(
        f"{user} without weights of your own needs a file of the package 'tactile-mnist', which is not "
        "installed",
        next="give `weights`, or run `pip install --no-deps tactile-mnist==0.13.0`",
    )


def read_weights(file: str | Path) -> GeneratorWeights:
    """Read and check a file of weights.

    Parameters
    ----------
    file : str or path
        An ``.npz`` as `tactile-mnist` ships it or ``tactile-sim train`` writes it; any number of filters
        and residual blocks.

    Returns
    -------
    GeneratorWeights

    Raises
    ------
    InputError
        The file does not exist, is damaged, or holds no generator.
    """
    path = store.expanded(file)
    try:
        arrays, comment = value_files.read_npz(path)
        _require_generator(arrays)
        width, height = PUBLISHED_SIZE_PX
        if comment:
            width, height = json.loads(comment)["size_px"]
        if not (width in _SIDES_PX and height in _SIDES_PX):
            problem = f"of {width!r} x {height!r} pixels; expected multiples of 4, 16 to 2048"
            raise ValueError(problem)
    except Exception as error:  # zipfile, zlib, json and numpy raise many kinds on damaged files
        raise InputError(
            f"{str(path)!r} cannot be read as weights of a generator ({error}); expected an .npz such as "
            "`tactile-sim train` writes",
            next="download or make it again",
        ) from error
    return GeneratorWeights(arrays, (width, height))


def _require_generator(arrays: Mapping[str, AnyArray]) -> None:
    """Raise ValueError, which names the first layer that differs, for arrays that no generator has."""
    blocks = GeneratorWeights(arrays).blocks
    expected = {}
    first = arrays.get("model.1.weight")
    if first is not None and first.ndim and 0 < len(first) <= _MAX_FILTERS and blocks <= _MAX_BLOCKS:
        with torch.device("meta"):  # only shapes, no memory
            state = GeneratorNetwork(len(first), blocks).state_dict()
        expected = {name: tuple(array.shape) for name, array in state.items()}
    for name in [*expected, *arrays] or ["model.1.weight"]:
        array = arrays.get(name, _MISSING)
        if array is _MISSING or array.shape != expected.get(name):
            problem = f"{name} has the shape {array.shape}, expected {expected.get(name)}"
            raise ValueError(problem)
        if not (array.dtype == np.float32 and np.isfinite(array).all()):
            problem = f"{name} holds values that are not finite numbers in single precision"
            raise ValueError(problem)


def weights_bytes(weights: GeneratorWeights) -> bytes:
    """Return the bytes of a file of weights; equal weights give equal bytes."""
    comment = b""
    if weights.size_px != PUBLISHED_SIZE_PX:
        comment = json.dumps({"size_px": list(weights.size_px)}).encode()
    return value_files.npz_bytes(weights.arrays, comment)


def write_weights(folder: store.DataFolder, name: str, weights: GeneratorWeights) -> None:
    """Write a file of weights, complete or not at all; StorageError if it cannot be written."""
    folder.write_bytes(name, weights_bytes(weights))


def weights_facts(weights: str | None) -> JsonDict:
    """Return JSON values that identify a file of weights by its content; the published one by default."""
    file = published_weights("touch") if weights is None else store.expanded(weights)
    return {
        "weights_size_px": list(read_weights(file).size_px),
        "weights_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
    }
