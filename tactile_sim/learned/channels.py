"""Images as networks see them, channels with values from -1 to 1, and running generators on many images.

The channels of depth are row, column and depth, as in `tactile-mnist` 0.13.0; the paper states (x, y), the
other way round. Where the gel touches a level surface all over, such as a bare plate, the depth image is 0
everywhere, and counts as no contact, 1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim.learned.generators import Generator
from tactile_sim.sensor_noise import SensorNoise, draw_noise
from tactile_toolkit.array_types import AnyArray, Float32, UInt8

# Images whose channels are in memory at a time.
_TOGETHER = 64


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
    gain, added = (torch.from_numpy(each).to(channels) for each in drawn)
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
