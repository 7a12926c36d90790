"""CycleGAN: pictures that a network makes of depth, by the published weights or others.

Each picture is computed alone, so that it does not depend on its batch. Equal depth gives equal bytes on one
machine with one version of PyTorch, with any number of threads; another processor or version may round a
level otherwise, as its convolutions add in another order.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tactile_sim.learned.networks import (
    Direction,
    depth_channels,
    generator_of,
    picture_channels,
    published_weights,
    read_weights,
    shades_of,
)
from tactile_sim.pressing import depth_image
from tactile_sim.sensor import Sensor
from tactile_toolkit.errors import InputError

_LEAST_PX = 16


class _Learned:
    """A generator that was read from a file; the published one by default."""

    direction: Direction

    def __init__(self, weights: str | Path | None = None) -> None:
        read = read_weights(published_weights(self.direction) if weights is None else weights)
        self.size_px = read.size_px
        self._network = generator_of(read).eval()

    def _made(self, channels: Any) -> Any:
        """Run the network on one picture after another; equal ones, such as no contact, only once."""
        made: dict[bytes, Any] = {}
        # Most touches may meet nothing (of the real ones four of five), and a network takes far longer than a
        # digest.
        keys = [hashlib.sha256(each.contiguous().numpy()).digest() for each in channels]
        with torch.inference_mode():
            for number, key in enumerate(keys):
                if key not in made:
                    made[key] = self._network(channels[[number]])
            return torch.cat([made[key] for key in keys])


class CycleganOptics(_Learned):
    """Pictures of touches, by a generator that was trained on real ones.

    Parameters
    ----------
    weights : str or path, optional
        File of weights; by default the published ones, of the installed `tactile-mnist`.
    """

    direction = "touch"

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size that the network was trained at, whatever the size of the pictures."""
        if min(width, height) < _LEAST_PX:
            raise InputError(
                f"a picture of {width} x {height} pixels is too small; expected at least 16 x 16"
            )
        return self.size_px

    def render(
        self, depth_m: NDArray[np.float64], sensor: Sensor, size_px: tuple[int, int]
    ) -> NDArray[np.uint8]:
        """Return pictures (n, H, W, 3), uint8, in the size asked for, of depth maps (n, h, w), metres."""
        return np.asarray(np.rint(self.shades(depth_m, sensor, size_px) * np.float32(255)), np.uint8)

    def shades(
        self, depth_m: NDArray[np.float64], sensor: Sensor, size_px: tuple[int, int]
    ) -> NDArray[np.float32]:
        """Return the same as shades of red, green and blue from 0 to 1, float32."""
        made = shades_of(self._made(depth_channels(depth_image(depth_m, sensor))), size_px)
        return np.ascontiguousarray(made.permute(0, 2, 3, 1).numpy())


class CycleganDepth(_Learned):
    """Depth of pictures: the other direction, with parameters as of :class:`CycleganOptics`."""

    direction = "depth"

    def images(self, pictures: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.float32]:
        """Return depth images (n, H, W), float32, 0 deepest to 1 no contact, of pictures (n, h, w, 3)."""
        shown = (shades_of(picture_channels(pictures), self.size_px) - 0.5) / 0.5
        made = shades_of(self._made(shown)[:, 2:], size_px)
        return np.ascontiguousarray(made[:, 0].numpy())

    def depth_m(
        self, pictures: NDArray[np.uint8], sensor: Sensor, size_px: tuple[int, int]
    ) -> NDArray[np.float32]:
        """Return depth maps (n, H, W), float32, metres, as the published estimator does."""
        span_m = np.float32(sensor.gel_m - sensor.press_m)
        return self.images(pictures, size_px) * span_m + np.float32(sensor.press_m)
