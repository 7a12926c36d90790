"""The networks of CycleGAN, their weights as files, and images and depth by trained generators.

Generator (Zhu et al. 2017, Johnson et al. 2016; the layers follow from the shapes of the published weights):
a 7x7 convolution, two that halve, residual blocks, two that double, a 7x7 convolution; instance norm without
parameters, reflected borders. Discriminator: 4x4 convolutions (Isola et al. 2017).

A file has the published format: an ``.npz`` of float32 arrays by layer. The size that the network was trained
at, for which that format has no room, is stored in the comment of the archive, which readers of the published
format ignore.

Networks see images as channels with values from -1 to 1. The channels of depth are row, column and depth, as
in `tactile-mnist` 0.13.0; the paper states (x, y), the other way round. Where the gel touches a level surface
all over, such as a bare plate, the depth image is 0 everywhere, and counts as no contact, 1.

On one core of a Zen 5 processor, the published generator (64 filters, 9 blocks, 256 x 256 pixels) takes
0.49 s for an image, and 0.27 s in bfloat16.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim import user_values
from tactile_sim.optics.rendering import Optics, require_images
from tactile_sim.optics.sensor_noise import SensorNoise, draw_noise
from tactile_sim.press.sensors import Sensor, center_view, checked_size_px
from tactile_toolkit import store
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, JsonDict, UInt8

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
# Images whose channels are in memory at a time.
_TOGETHER = 64
# Half a million pixels take about half a gigabyte in a generator of 64 filters on a GPU.
_PIXELS_TOGETHER = 1 << 19

Generator: TypeAlias = Callable[[Tensor], Tensor]
"""Computes images (n, 3, H, W) from images (n, 3, H, W), -1 to 1, both on the CPU."""


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
        arrays, comment = user_values.read_npz(path)
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
    return user_values.npz_bytes(weights.arrays, comment)


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


def depth_channels(images: Float32) -> Tensor:
    """Return the input of a generator, (n, 3, H, W) float32, -1 to 1, of depth images (n, H, W), 0 to 1."""
    depth = torch.from_numpy(np.ascontiguousarray(images, np.float32))
    depth = torch.where((depth == 0).all(dim=(-2, -1))[:, None, None], 1.0, depth)
    count, height, width = depth.shape
    row = torch.linspace(0, 1, height)[None, :, None].expand(count, height, width)
    column = torch.linspace(0, 1, width)[None, None, :].expand(count, height, width)
    return (torch.stack([row, column, depth], dim=1) - 0.5) / 0.5


def picture_channels(pictures: UInt8) -> Tensor:
    """Return pictures (n, H, W, 3), uint8, as (n, 3, H, W) float32, -1 to 1."""
    levels = torch.from_numpy(np.array(pictures)).permute(0, 3, 1, 2).to(torch.float32)
    return (levels / 255 - 0.5) / 0.5


def noisy_channels(channels: Tensor, noise: SensorNoise, rng: np.random.Generator) -> Tensor:
    """Return images (n, 3, H, W), -1 to 1, with the noise of a sensor, each of a round of its own."""
    count, colours, height, width = channels.shape
    drawn = draw_noise(noise, rng, (count, height, width, colours))
    gain, added = (torch.from_numpy(array).to(channels) for array in drawn)
    mean = channels.mean(dim=(1, 2, 3), keepdim=True)
    # Twice the noise: values run from -1 to 1, and noise is a fraction of the range of an image.
    shown = mean + (channels - mean) * gain[:, None, None, None] + 2 * added.permute(0, 3, 1, 2)
    return shown.clip(-1, 1)


def shades_of(channels: Tensor, size_px: tuple[int, int]) -> Tensor:
    """Return channels (n, C, H, W), -1 to 1, as shades from 0 to 1 in another size, bicubic."""
    shades = (channels + 1) / 2
    width, height = size_px
    if shades.shape[-2:] != (height, width):
        shades = nn.functional.interpolate(
            shades, size=(height, width), mode="bicubic", antialias=True, align_corners=False
        )
    return shades.clip(0, 1)


def pictures_from(channels: Tensor, size_px: tuple[int, int]) -> UInt8:
    """Return channels of touches (n, 3, h, w), -1 to 1, as pictures (n, H, W, 3), uint8."""
    shades = shades_of(channels, size_px).permute(0, 2, 3, 1)
    return np.asarray(np.rint(shades.numpy() * np.float32(255)), np.uint8)


def generated(generator: Generator, channels: Callable[[AnyArray], Tensor], images: AnyArray) -> Tensor:
    """Return the output (n, 3, H, W) of a generator for images, a few at a time.

    ``channels`` makes its input from images.
    """
    parts = range(0, len(images), _TOGETHER)
    return torch.cat([generator(channels(images[start : start + _TOGETHER])) for start in parts])


def chosen_device(name: str) -> str:
    """Return ``"cpu"`` or ``"cuda"``; InputError for another name, and for CUDA without a GPU."""
    available = torch.cuda.is_available()
    if name not in ("auto", "cpu", "cuda"):
        raise InputError(f"is {name!r}; expected auto, cpu or cuda", field="device")
    if name == "cuda" and not available:
        raise InputError("is 'cuda', but PyTorch finds no GPU here", next="use --device cpu", field="device")
    if name == "cpu" or not available:
        return "cpu"
    return "cuda"


def make_generator(weights: GeneratorWeights, device: str = "cpu", *, bfloat16: bool = False) -> Generator:
    """Return a generator with these weights.

    Parameters
    ----------
    weights : GeneratorWeights
        Weights.
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one. On the CPU, an image does not depend
        on its batch.
    bfloat16 : bool
        Multiply numbers of 8 bits of precision, for speed.

    Returns
    -------
    callable
        Computes images (n, 3, H, W) from images, both on the CPU.

    Raises
    ------
    InputError
        There is no such device, or the processor has no bfloat16.
    """
    chosen = chosen_device(device)
    together = 1
    if chosen != "cpu":
        width, height = weights.size_px
        together = max(1, _PIXELS_TOGETHER // (width * height))
    elif bfloat16 and not torch.cpu._is_avx512_bf16_supported():
        raise InputError(
            "bfloat16 was asked for, but this processor does not compute with it (AVX-512 BF16)",
            next="leave it out",
        )
    network = generator_of(weights).eval().to(chosen, memory_format=torch.channels_last)
    return partial(_generate, network, together, bfloat16)


def _generate(network: GeneratorNetwork, together: int, bfloat16: bool, images: Tensor) -> Tensor:
    """Run a network on its device, on some images at a time."""
    device = next(network.parameters()).device
    with torch.inference_mode(), torch.autocast(device.type, torch.bfloat16, enabled=bfloat16):
        parts = (part.to(device, memory_format=torch.channels_last) for part in images.split(together))
        return torch.cat([network(part).float().cpu() for part in parts]).contiguous()


class CycleganOptics(Optics):
    """Renders touches with a generator that was trained on real ones.

    On the CPU, each image is computed by itself, so that it does not depend on its batch. Equal depth gives
    equal bytes on one machine with one version of PyTorch; another may differ by a level. On a GPU, levels
    may also differ with the batch.

    Parameters
    ----------
    weights : str or path, optional
        File of weights; by default the published ones, of the installed `tactile-mnist`.
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one.
    bfloat16 : bool
        Multiply in bfloat16: almost twice as fast on a CPU that has it. Images of the published weights
        differ by 0.04 of 255 levels on average, and by 1.4 at most in three touches.

    Raises
    ------
    InputError
        The weights cannot be read; there is no such device; the processor has no bfloat16.
    """

    min_side_px = 16

    def __init__(
        self, weights: str | Path | None = None, *, device: str = "cpu", bfloat16: bool = False
    ) -> None:
        read = read_weights(weights or published_weights("touch"))
        self.size_px = read.size_px
        self._generator = make_generator(read, device, bfloat16=bfloat16)

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size that the network was trained at, whatever the size of the images."""
        super().depth_size(width, height)
        return self.size_px

    def _shades(
        self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int], *, is_surface: bool
    ) -> Float32:
        """Return shades of red, green and blue in the requested size; equal depth is computed only once."""
        if not len(depth_m):
            return np.zeros((0, *size_px[::-1], 3), np.float32)
        images = sensor.depth_image(depth_m)
        # Many depth maps are equal: four of five real touches have no contact. A digest takes far less time
        # than a network.
        first: dict[bytes, int] = {}
        keys = [hashlib.sha256(image.tobytes()).digest() for image in images]
        numbers = [first.setdefault(key, len(first)) for key in keys]
        _, chosen = np.unique(numbers, return_index=True)
        made = generated(self._generator, depth_channels, images[chosen])
        shown = shades_of(made, size_px).permute(0, 2, 3, 1).numpy()
        return np.ascontiguousarray(shown[numbers])


class DepthEstimator:
    """Estimates depth from images of touches with a generator that was trained on real ones.

    On the CPU, an estimate does not depend on its batch. Images of a GelSight Mini are expected.

    Parameters
    ----------
    weights : str or path, optional
        File of weights, ``touch_to_depth.npz`` of ``tactile-sim train``; by default the published ones, of
        the installed `tactile-mnist`.
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one.
    bfloat16 : bool
        Multiply in bfloat16: almost twice as fast on a CPU that has it, and less precise.

    Attributes
    ----------
    input_size_px : tuple of int
        Width and height that images are scaled to, pixels: those that the network was trained at.

    Raises
    ------
    InputError
        The weights cannot be read; there is no such device; the processor has no bfloat16.
    MissingExtraError
        The published weights are not installed.
    """

    def __init__(
        self, weights: str | Path | None = None, *, device: str = "cpu", bfloat16: bool = False
    ) -> None:
        read = read_weights(weights or published_weights("depth"))
        self.input_size_px = read.size_px
        self._generator = make_generator(read, device, bfloat16=bfloat16)
        self._sensor = center_view(*read.size_px)

    def estimate_m(self, images: UInt8, size_px: tuple[int, int]) -> Float32:
        """Estimate depth.

        Parameters
        ----------
        images : ndarray of uint8
            Touches, shape (n, H, W, 3).
        size_px : tuple of int
            Width and height of the depth maps, pixels.

        Returns
        -------
        ndarray of float32
            Depth below the camera's side of the gel, metres, shape (n, h, w): 0.002125 where the gel is
            pressed in deepest, 0.00425, its thickness, where nothing touches it.

        Raises
        ------
        InputError
            The images have another shape or type, or the size is not valid.
        """
        width, height = checked_size_px(size_px)
        require_images(images, "images")
        made = generated(
            self._generator,
            lambda pictures: 2 * shades_of(picture_channels(pictures), self.input_size_px) - 1,
            images,
        )
        share = shades_of(made[:, 2:], (width, height))[:, 0].numpy()
        gel_m = self._sensor.gel_m
        press_m = self._sensor.press_m
        return np.asarray(share * (gel_m - press_m) + press_m, np.float32)
