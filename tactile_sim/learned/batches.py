"""Batches of a training: pictures and crops of a step follow from seed, step and process alone."""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch

from tactile_sim.learned.channels import depth_channels, picture_channels
from tactile_sim.learned.config import TrainConfig
from tactile_sim.pairs.reading import Domain, Pairs

__all__ = ["Batches", "step_rng"]


def step_rng(config: TrainConfig, step: int, rank: int, what: str) -> np.random.Generator:
    """Return the random numbers of one step."""
    words = hashlib.sha256(f"{config.seed}/{step}/{rank}/{what}".encode()).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(words[:16], "little")))


class Batches:
    """Makes the batch of the next step while this one is computed."""

    def __init__(self, pairs: Pairs, config: TrainConfig, rank: int) -> None:
        self._pairs = pairs
        self._config = config
        self._rank = rank
        self._crop = config.crop_px(pairs.size_px)
        self._pool = ThreadPoolExecutor(1)
        self._ahead: tuple[int, Any] | None = None

    def __enter__(self) -> Batches:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def of(self, step: int) -> tuple[Any, Any, Any]:
        """Return depth and touches of a step, (n, 3, h, w), and row and column of the touches, -1 to 1."""
        ahead = self._ahead
        found: tuple[Any, Any, Any] = (
            ahead[1].result() if ahead is not None and ahead[0] == step else self._make(step)
        )
        if step + 1 < self._config.steps:
            self._ahead = (step + 1, self._pool.submit(self._make, step + 1))
        return found

    def _make(self, step: int) -> tuple[Any, Any, Any]:
        rng = step_rng(self._config, step, self._rank, "batch")
        depth = self._cropped(depth_channels(self._drawn(self._pairs.depth, rng)), rng)
        pictures = picture_channels(self._drawn(self._pairs.real, rng))
        width, height = self._pairs.size_px
        where = depth_channels(np.ones((1, height, width), np.float32))[:, :2]
        touch = self._cropped(torch.cat([pictures, where.expand(len(pictures), -1, -1, -1)], dim=1), rng)
        return depth, touch[:, :3], touch[:, 3:]

    def _drawn(self, domain: Domain, rng: np.random.Generator) -> Any:
        return domain.images(rng.integers(len(domain), size=self._config.batch))

    def _cropped(self, channels: Any, rng: np.random.Generator) -> Any:
        width, height = self._crop
        crops = []
        for whole in channels:
            top = int(rng.integers(whole.shape[1] - height + 1))
            left = int(rng.integers(whole.shape[2] - width + 1))
            crops.append(whole[:, top : top + height, left : left + width])
        return torch.stack(crops)
