"""What networks see: depth as three channels, pictures as numbers from -1 to 1, and back.

The channels of depth are row, column and depth, as in `tactile-mnist` 0.13.0; the paper says (x, y), the
other way round. Where the gel meets a level surface all over, which is what a bare plate gives, the depth
image is 0 everywhere, and counts as no contact, 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tactile_sim.noise import SensorNoise, draw_noise


def depth_channels(images: NDArray[np.float32]) -> Any:
    """Return the input of a generator, (n, 3, H, W) float32, -1 to 1, of depth images (n, H, W), 0 to 1."""
    depth = torch.from_numpy(np.ascontiguousarray(images, np.float32))
    depth = torch.where((depth == 0).all(dim=(-2, -1))[:, None, None], 1.0, depth)
    count, height, width = depth.shape
    row = torch.linspace(0, 1, height)[None, :, None].expand(count, height, width)
    column = torch.linspace(0, 1, width)[None, None, :].expand(count, height, width)
    return (torch.stack([row, column, depth], dim=1) - 0.5) / 0.5


def picture_channels(pictures: NDArray[np.uint8]) -> Any:
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
        shades = torch.nn.functional.interpolate(
            shades, size=(height, width), mode="bicubic", antialias=True, align_corners=False
        )
    return shades.clip(0, 1)
