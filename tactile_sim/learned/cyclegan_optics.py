"""Optics that render touches with a generator that was trained on real ones."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch

from tactile_sim.learned.channels import depth_channels, shades_of
from tactile_sim.learned.weights import generator_of, published_weights, read_weights
from tactile_sim.optics import Optics
from tactile_sim.pressing import depth_image
from tactile_sim.sensor import Sensor
from tactile_toolkit.array_types import Float32, Float64


class CycleganOptics(Optics):
    """Renders touches with a generator that was trained on real ones.

    Each image is computed alone, so that it does not depend on its batch. Equal depth gives equal bytes on
    one machine with one version of PyTorch; another may differ by a level.

    Parameters
    ----------
    weights : str or path, optional
        File of weights; by default the published ones, of the installed `tactile-mnist`.
    """

    least_px = 16

    def __init__(self, weights: str | Path | None = None) -> None:
        read = read_weights(weights or published_weights("touch"))
        self.size_px = read.size_px
        self._network = generator_of(read).eval()

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size that the network was trained at, whatever the size of the images."""
        super().depth_size(width, height)
        return self.size_px

    def shades(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> Float32:
        """Return shades of red, green and blue in the size asked for; equal depth is computed only once."""
        channels, made = depth_channels(depth_image(depth_m, sensor)), {}
        # Many depth maps are equal: four of five real touches have no contact. A digest takes far less time
        # than a network.
        keys = [hashlib.sha256(each.contiguous().numpy()).digest() for each in channels]
        with torch.inference_mode():
            for number, key in enumerate(keys):
                if key not in made:
                    made[key] = self._network(channels[[number]])
            shown = shades_of(torch.cat([made[key] for key in keys]), size_px)
        return np.ascontiguousarray(shown.permute(0, 2, 3, 1).numpy())
