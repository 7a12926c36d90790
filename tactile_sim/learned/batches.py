"""Batches of a training: pictures and crops of a step follow from seed, step and process alone."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tactile_sim.learned.networks import depth_channels, picture_channels
from tactile_sim.optics import make_optics
from tactile_sim.pairs import Pairs
from tactile_sim.plan import generator
from tactile_sim.spec import TrainConfig

# Enough for a median without noise, and 100 MB at 256 x 256 pixels.
_LEVEL_TOUCHES = 512


class Batch(NamedTuple):
    """What a step is shown: ``n`` pictures of each kind, which do not belong together, from -1 to 1."""

    depth: Any
    """Row, column and depth, (n, 3, h, w)."""

    touch: Any
    """Colours of touches, (n, 3, h, w)."""

    where: Any
    """Row and column of the touches, (n, 2, h, w)."""

    level: Any
    """What the sensor shows of nothing where the depth images lie, (n, 3, h, w); None if not known."""

    contact: Any
    """Whether each touch met its object, (n, 1, 1, 1)."""

    simulated: Any
    """Touches of the depth as Taxim shows it, (n, 3, h, w); None after the first steps."""


_Maker = Callable[[NDArray[np.float32]], NDArray[np.uint8]]


def by_taxim(pairs: Pairs) -> _Maker:
    """Return what makes Taxim's pictures of depth images of a training set; MissingExtraError without."""
    sensor, taxim = pairs.sensor, make_optics("taxim")

    def made(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
        depth_m = sensor.press_m + depth.astype(np.float64) * (sensor.gel_m - sensor.press_m)
        return taxim.render(depth_m, sensor, pairs.size_px)

    return made


class Batches:
    """Makes the batch of the next step while this one is computed."""

    def __init__(self, pairs: Pairs, config: TrainConfig, rank: int) -> None:
        self._pairs = pairs
        self._config = config
        self._rank = rank
        self._crop = config.crop_px(pairs.size_px)
        self._taxim = by_taxim(pairs) if config.pretrain_steps else None
        # One batch ahead is enough, as decoding is much faster than a step; a thread, as decoders and torch
        # leave the interpreter's lock.
        self._pool = ThreadPoolExecutor(1)
        self._ahead: tuple[int, Any] | None = None

    def __enter__(self) -> Batches:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def of(self, step: int) -> Batch:
        """Return the batch of a step."""
        ahead = self._ahead
        found: Batch = ahead[1].result() if ahead is not None and ahead[0] == step else self._make(step)
        if step + 1 < self._config.steps:
            self._ahead = (step + 1, self._pool.submit(self._make, step + 1))
        return found

    @cached_property
    def _level(self) -> Any:
        """The median of touches without contact, (3, H, W): a sensor's noise is not in it."""
        real = self._pairs.real
        numbers = np.flatnonzero(~real.contact)
        if not len(numbers):
            return None
        chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, _LEVEL_TOUCHES).astype(np.int64))]
        return picture_channels(np.median(real.images(chosen), axis=0)[None])[0]

    def _make(self, step: int) -> Batch:
        rng = generator(self._config.seed, step, self._rank, "batch")
        depth, real = self._pairs.depth, self._pairs.real
        images = depth.images(rng.integers(len(depth), size=self._config.batch))
        height, width = images.shape[1:]
        parts = [depth_channels(images)]
        if self._level is not None:
            parts.append(self._level.expand(len(images), -1, -1, -1))
        taxim = self._taxim if step < self._config.pretrain_steps else None
        if taxim is not None:
            parts.append(self._simulated(images, taxim))
        cropped = self._cropped(torch.cat(parts, dim=1), rng)
        level = None if self._level is None else cropped[:, 3:6]
        simulated = None if taxim is None else cropped[:, -3:]
        numbers = rng.integers(len(real), size=self._config.batch)
        pictures = picture_channels(real.images(numbers))
        # A touch has no depth to go with its row and column: only those two are kept.
        where = depth_channels(np.ones((1, height, width), np.float32))[:, :2]
        touch = self._cropped(torch.cat([pictures, where.expand(len(pictures), -1, -1, -1)], dim=1), rng)
        contact = torch.from_numpy(real.contact[numbers])[:, None, None, None]
        return Batch(cropped[:, :3], touch[:, :3], touch[:, 3:], level, contact, simulated)

    def _simulated(self, images: NDArray[np.float32], taxim: _Maker) -> Any:
        """Return the relief that Taxim shows of depth, on what the sensor shows of nothing."""
        shown = picture_channels(taxim(np.concatenate([images, np.ones_like(images[:1])])))
        level = shown[-1] if self._level is None else self._level
        # The colours of Taxim's own gel are taken away, and those of the real one put in their place.
        return (level + shown[:-1] - shown[-1]).clip(-1, 1)

    def _cropped(self, channels: Any, rng: np.random.Generator) -> Any:
        width, height = self._crop
        crops = []
        for whole in channels:
            top = int(rng.integers(whole.shape[1] - height + 1))
            left = int(rng.integers(whole.shape[2] - width + 1))
            crops.append(whole[:, top : top + height, left : left + width])
        return torch.stack(crops)
