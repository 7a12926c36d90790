"""The networks, what they see, and their weights as files.

Generator (Zhu et al. 2017, Johnson et al. 2016; the layers follow from the shapes of the published weights):
a 7x7 convolution, two that halve, residual blocks, two that double, a 7x7 convolution; instance norm without
parameters, reflected borders. Discriminator: 4x4 convolutions (Isola et al. 2017).

Pictures are numbers from -1 to 1. The channels of depth are row, column and depth, as in `tactile-mnist`
0.13.0; the paper says (x, y), the other way round. Where the gel meets a level surface all over, which is
what a bare plate gives, the depth image is 0 everywhere, and counts as no contact, 1.

A file of weights has the published format, an ``.npz`` of float32 arrays by layer. What that has no room for,
the size that the network was trained at, stands in the comment of the archive, which readers of the published
format do not look at.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import nn

from tactile_sim.noise import SensorNoise, draw_noise
from tactile_sim.optics import Optics
from tactile_sim.pressing import Sensor, depth_image
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Float32, Float64, UInt8
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError, MissingExtraError

Direction = Literal["touch", "depth"]
"""What a generator makes: touches of depth, or depth of touches."""

PUBLISHED_SIZE_PX = (256, 256)
"""What the published weights were trained at (`tactile-mnist` 0.13.0)."""

_PUBLISHED = {
    "touch": "cycle_gan_tactile_mnist_v0.npz",
    "depth": "cycle_gan_inverse_tactile_mnist_v0.npz",
}
# What a file states must not decide how much is built before it was compared.
_MOST_BLOCKS, _MOST_FILTERS = 64, 1024
# Half a million pixels take about half a gigabyte in a generator of 64 filters.
_PIXELS_TOGETHER = 1 << 19
_SIDES_PX = range(16, 2049, 4)


def depth_channels(images: Float32) -> Any:
    """Return the input of a generator, (n, 3, H, W) float32, -1 to 1, of depth images (n, H, W), 0 to 1."""
    depth = torch.from_numpy(np.ascontiguousarray(images, np.float32))
    depth = torch.where((depth == 0).all(dim=(-2, -1))[:, None, None], 1.0, depth)
    count, height, width = depth.shape
    row = torch.linspace(0, 1, height)[None, :, None].expand(count, height, width)
    column = torch.linspace(0, 1, width)[None, None, :].expand(count, height, width)
    return (torch.stack([row, column, depth], dim=1) - 0.5) / 0.5


def picture_channels(pictures: UInt8) -> Any:
    """Return pictures (n, H, W, 3), uint8, as (n, 3, H, W) float32, -1 to 1."""
    levels = torch.from_numpy(np.array(pictures)).permute(0, 3, 1, 2).to(torch.float32)
    return (levels / 255 - 0.5) / 0.5


def noisy_channels(channels: Any, noise: SensorNoise, rng: np.random.Generator) -> Any:
    """Return pictures (n, 3, H, W), -1 to 1, under noise of a sensor, each of a round of its own."""
    count, colours, height, width = channels.shape
    drawn = draw_noise(noise, rng, (count, height, width, colours))
    gain, added = (torch.from_numpy(each).to(channels) for each in drawn)
    mean = channels.mean(dim=(1, 2, 3), keepdim=True)
    # Twice the noise: values run from -1 to 1, where a picture has a range of 1.
    shown = mean + (channels - mean) * gain[:, None, None, None] + 2 * added.permute(0, 3, 1, 2)
    return shown.clip(-1, 1)


def shades_of(channels: Any, size_px: tuple[int, int]) -> Any:
    """Return channels (n, C, H, W), -1 to 1, as shades from 0 to 1 in another size, bicubic."""
    shades = (channels + 1) / 2
    width, height = size_px
    if shades.shape[-2:] != (height, width):
        shades = nn.functional.interpolate(
            shades, size=(height, width), mode="bicubic", antialias=True, align_corners=False
        )
    return shades.clip(0, 1)


def pictures_of(channels: Any, size_px: tuple[int, int]) -> UInt8:
    """Return channels of touches (n, 3, h, w), -1 to 1, as pictures (n, H, W, 3), uint8."""
    shades = shades_of(channels, size_px).permute(0, 2, 3, 1)
    return np.asarray(np.rint(shades.numpy() * np.float32(255)), np.uint8)


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
    """Return a network that gives for each patch of 70 x 70 pixels how real it is: 1 real, 0 made."""

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
        drawn = 0.0 if name.endswith("bias") else torch.randn(parameter.shape, generator=rng) * 0.02
        parameter.data[...] = drawn
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


def published_weights(direction: Direction) -> Path:
    """Return the file of published weights, which `tactile-mnist` ships; nothing of it is imported."""
    found = find_spec("tactile_mnist")
    places = list(found.submodule_search_locations or ()) if found is not None else []
    file = Path(places[0]) / "resources" / _PUBLISHED[direction] if places else None
    if file is None or not file.is_file():
        feature = "the optics 'cyclegan' without weights of your own"
        raise MissingExtraError(feature, "tactile-mnist", "env")
    return file


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
        The file is not there, is damaged, or holds something else than a generator.
    """
    path = store.expanded(file)
    try:
        with store.open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
            require_unpackable(sum(entry.file_size for entry in archive.infolist()), repr(str(path)))
            comment = archive.comment
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as stored:
                arrays = dict(stored)
        _require_generator(arrays)
        width, height = json.loads(comment)["size_px"] if comment else PUBLISHED_SIZE_PX
        if not (width in _SIDES_PX and height in _SIDES_PX):
            problem = f"of {width!r} x {height!r} pixels; expected multiples of 4, 16 to 2048"
            raise ValueError(problem)
    except Exception as error:  # zipfile, zlib, json and numpy raise many kinds on damaged files
        raise InputError(
            f"{str(path)!r} cannot be read as weights of a generator ({error}); expected an .npz such as "
            "`tactile-sim train` writes",
            next="fetch or make it again",
        ) from error
    return GeneratorWeights(arrays, (width, height))


def _require_generator(arrays: Mapping[str, AnyArray]) -> None:
    """Refuse what is not a generator (ValueError), naming the first layer that differs."""
    blocks, expected = GeneratorWeights(arrays).blocks, {}
    first = arrays.get("model.1.weight")
    if first is not None and first.ndim and 0 < len(first) <= _MOST_FILTERS and blocks <= _MOST_BLOCKS:
        with torch.device("meta"):  # shapes alone
            state = Generator(len(first), blocks).state_dict()
        expected = {name: tuple(each.shape) for name, each in state.items()}
    for name in [*expected, *arrays] or ["model.1.weight"]:
        array = arrays.get(name)
        shape = None if array is None else array.shape
        if shape is None or shape != expected.get(name):
            problem = f"{name} has the shape {shape}, expected {expected.get(name)}"
            raise ValueError(problem)
        if array is not None and not (array.dtype == np.float32 and np.isfinite(array).all()):
            problem = f"{name} holds values that are not finite numbers in single precision"
            raise ValueError(problem)


def weights_bytes(weights: GeneratorWeights) -> bytes:
    """Return the content of a file of weights; equal weights give equal bytes."""
    buffer = io.BytesIO()
    # Stored, not deflated: floats of a network do not compress, and zlib differs between machines.
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in weights.arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))  # no time of day in it
            with archive.open(entry, "w") as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
        if weights.size_px != PUBLISHED_SIZE_PX:
            archive.comment = json.dumps({"size_px": list(weights.size_px)}).encode()
    return buffer.getvalue()


def write_weights(folder: store.DataFolder, name: str, weights: GeneratorWeights) -> None:
    """Write a file of weights, complete or not at all; StorageError where it cannot be written."""
    folder.write_bytes(name, weights_bytes(weights))


class CycleganOptics(Optics):
    """Pictures of touches, by a generator that was trained on real ones.

    Each picture is computed alone, so that it does not depend on its batch. Equal depth gives equal bytes on
    one machine with one version of PyTorch; another may round a level otherwise.

    Parameters
    ----------
    weights : str or path, optional
        File of weights; by default the published ones, of the installed `tactile-mnist`.
    """

    least_px = 16

    def __init__(self, weights: str | Path | None = None) -> None:
        read = read_weights(published_weights("touch") if weights is None else weights)
        self.size_px = read.size_px
        self._network = generator_of(read).eval()

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size that the network was trained at, whatever the size of the pictures."""
        super().depth_size(width, height)
        return self.size_px

    def shades(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> Float32:
        """Return shades of red, green and blue in the size asked for; equal depth is computed only once."""
        channels, made = depth_channels(depth_image(depth_m, sensor)), {}
        # Most touches may meet nothing (of the real ones four of five), and a network takes far longer than a
        # digest.
        keys = [hashlib.sha256(each.contiguous().numpy()).digest() for each in channels]
        with torch.inference_mode():
            for number, key in enumerate(keys):
                if key not in made:
                    made[key] = self._network(channels[[number]])
            shown = shades_of(torch.cat([made[key] for key in keys]), size_px)
        return np.ascontiguousarray(shown.permute(0, 2, 3, 1).numpy())


def depth_of(
    network: Generator, pictures: UInt8, advance: Callable[[int], None] = lambda _count: None
) -> Float32:
    """Return the depth images (n, H, W), 0 deepest to 1 no contact, that a generator reads from pictures.

    Pictures (n, H, W, 3) are of the size that it was trained in; ``advance`` as of :func:`generated`.
    """
    made = generated(network, picture_channels, pictures, advance)[:, 2]
    return np.asarray(((made + 1) / 2).clip(0, 1).numpy(), np.float32)


def generated(
    network: Generator,
    channels: Callable[[AnyArray], Any],
    images: AnyArray,
    advance: Callable[[int], None] = lambda _count: None,
) -> Any:
    """Return what a generator makes of images, (n, 3, H, W), where it lies, some images at a time.

    ``channels`` makes its input; ``advance`` gets the number of images since it was called last.
    """
    device = next(network.parameters()).device
    together = max(1, _PIXELS_TOGETHER // (images.shape[1] * images.shape[2]))
    made = []
    with torch.inference_mode():
        for start in range(0, len(images), together):
            part = images[start : start + together]
            made.append(network(channels(part).to(device)).cpu())
            advance(len(part))
    return torch.cat(made)
