"""Batches of a training; images and crops depend only on seed, step and process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from tactile_sim.learned.inference import depth_channels, picture_channels
from tactile_sim.optics.rendering import make_optics
from tactile_sim.sets.learning_specs import TrainConfig
from tactile_sim.sets.pairs import Pairs
from tactile_sim.sets.round_plan import keyed_rng
from tactile_toolkit.array_types import Float32, UInt8

# Enough for a median without noise, and 100 MB at 256 x 256 pixels.
_LEVEL_TOUCHES = 512

Renderer: TypeAlias = Callable[[Float32], UInt8]
"""Renders images (n, H, W, 3) from depth images (n, H, W)."""


class Batch(NamedTuple):
    """Input of a step: ``n`` unpaired images of each kind, values from -1 to 1."""

    depth: Tensor
    """Row, column and depth, (n, 3, h, w)."""

    touch: Tensor
    """Colours of touches, (n, 3, h, w)."""

    where: Tensor
    """Row and column of the touches, (n, 2, h, w)."""

    level: Tensor | None
    """Background of the sensor in the crop of each depth image, (n, 3, h, w); None if not known."""

    contact: Tensor
    """Whether each touch has contact, (n, 1, 1, 1)."""

    simulated: Tensor | None
    """Touches that Taxim renders from the depth, (n, 3, h, w); None after the first steps."""


def by_taxim(pairs: Pairs) -> Renderer:
    """Return a function that renders depth images of a training set with Taxim, the extra ``sim``."""
    sensor = pairs.sensor
    taxim = make_optics("taxim")

    def render(depth: Float32) -> UInt8:
        depth_m = sensor.press_m + depth.astype(np.float64) * (sensor.gel_m - sensor.press_m)
        return taxim.render(depth_m, sensor, pairs.size_px)

    return render


class Batches:
    """Makes the batch of the next step while the current step is computed."""

    def __init__(self, pairs: Pairs, config: TrainConfig, rank: int) -> None:
        self._pairs = pairs
        self._config = config
        self._rank = rank
        self._crop = config.crop_px(pairs.size_px)
        self._taxim = None
        if config.pretrain_steps:
            self._taxim = by_taxim(pairs)

    def since(self, first: int) -> Iterator[Batch]:
        """Yield the batches of the steps from ``first`` on."""
        # One batch ahead is enough, as decoding is much faster than a step. A thread is enough, as decoders
        # and torch release the interpreter's lock.
        with ThreadPoolExecutor(1) as pool:
            made = (pool.submit(self._make, step) for step in range(first, self._config.steps))
            ahead = next(made, None)
            while ahead is not None:
                batch = ahead.result()
                ahead = next(made, None)
                yield batch

    @cached_property
    def _level(self) -> Tensor | None:
        """Background: the median of touches without contact, (3, H, W), which leaves out the noise."""
        real = self._pairs.real
        numbers = np.flatnonzero(~real.contact)
        if not len(numbers):
            return None
        chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, _LEVEL_TOUCHES).astype(np.int64))]
        return picture_channels(np.median(real.images(chosen), axis=0)[None])[0]

    def _make(self, step: int) -> Batch:
        rng = keyed_rng(self._config.seed, step, self._rank, "batch")
        depth = self._pairs.depth
        real = self._pairs.real
        images = depth.images(rng.integers(len(depth), size=self._config.batch))
        height, width = images.shape[1:]
        parts = {"depth": depth_channels(images)}
        if self._level is not None:
            parts["level"] = self._level.expand(len(images), -1, -1, -1)
        if self._taxim is not None and step < self._config.pretrain_steps:
            parts["simulated"] = self._simulated(images, self._taxim)
        # Cropped together, so that they show the same place.
        cropped = self._cropped(torch.cat(list(parts.values()), dim=1), rng)
        known = dict(zip(parts, cropped.split(3, dim=1), strict=True))
        numbers = rng.integers(len(real), size=self._config.batch)
        pictures = picture_channels(real.images(numbers))
        # A touch has no depth: only the channels of row and column are kept.
        where = depth_channels(np.ones((1, height, width), np.float32))[:, :2]
        touch = self._cropped(torch.cat([pictures, where.expand(len(pictures), -1, -1, -1)], dim=1), rng)
        contact = torch.from_numpy(real.contact[numbers])[:, None, None, None]
        return Batch(
            known["depth"], touch[:, :3], touch[:, 3:], known.get("level"), contact, known.get("simulated")
        )

    def _simulated(self, images: Float32, taxim: Renderer) -> Tensor:
        """Return the shading that Taxim renders from depth, on the background of the real touches."""
        shown = picture_channels(taxim(np.concatenate([images, np.ones_like(images[:1])])))
        level = self._level
        if level is None:
            level = shown[-1]
        # The background of Taxim's own gel is replaced by that of the real one.
        return (level + shown[:-1] - shown[-1]).clip(-1, 1)

    def _cropped(self, channels: Tensor, rng: np.random.Generator) -> Tensor:
        width, height = self._crop
        crops = []
        for whole in channels:
            top = int(rng.integers(whole.shape[1] - height + 1))
            left = int(rng.integers(whole.shape[2] - width + 1))
            crops.append(whole[:, top : top + height, left : left + width])
        return torch.stack(crops)
