"""Images and depth by trained generators, on a CPU or a GPU.

Networks see images as channels with values from -1 to 1. The channels of depth are row, column and depth, as
in `tactile-mnist` 0.13.0; the paper states (x, y), the other way round. Where the gel touches a level surface
all over, such as a bare plate, the depth image is 0 everywhere, and counts as no contact, 1.

On one core of a Zen 5 processor, the published generator (64 filters, 9 blocks, 256 x 256 pixels) takes
0.49 s for an image, and 0.27 s in bfloat16.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim.learned.networks import (
    GeneratorNetwork,
    GeneratorWeights,
    generator_of,
    published_weights,
    read_weights,
)
from tactile_sim.optics.rendering import Optics, require_images
from tactile_sim.optics.sensor_noise import SensorNoise, draw_noise
from tactile_sim.press.sensors import Sensor, center_view, checked_size_px
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, UInt8

# Images whose channels are in memory at a time.
_TOGETHER = 64
# Half a million pixels take about half a gigabyte in a generator of 64 filters on a GPU.
_PIXELS_TOGETHER = 1 << 19

Generator: TypeAlias = Callable[[Tensor], Tensor]
"""Computes images (n, 3, H, W) from images (n, 3, H, W), -1 to 1, both on the CPU."""


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
