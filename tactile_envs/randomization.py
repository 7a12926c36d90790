"""Randomisation of touches and episodes: observed heights, noise, and depth maps in the background."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactile_envs.config import Config
from tactile_envs.reset_options import Rows
from tactile_sim.optics.sensor_noise import EpisodeNoise
from tactile_toolkit.array_types import Float32, Float64, Int64


class TouchDraws(NamedTuple):
    """Random numbers for a touch of n sensors.

    ``lifts_m`` (n,) is added to the observed heights, metres; ``bases`` (n,) the number of
    the depth map behind its own; ``rng`` draws the noise, None where nothing is random.
    """

    lifts_m: Float64
    bases: Int64
    rng: np.random.Generator | None


class Randomization:
    """Draws heights, noise, and maps behind those of touches for many sensors.

    As published, each episode and each touch has a generator of its own, spawned from that of the
    environment, whose other draws stay as they are.

    Parameters
    ----------
    config : Config
        Settings.
    shape : tuple of int
        Shape (n, H, W, C) of the images of all sensors.
    bases : int
        Number of depth maps, of which one lies behind that of each touch; 0 for none.
    """

    def __init__(self, config: Config, shape: tuple[int, int, int, int], bases: int) -> None:
        self._std_m, self._bases = config.penetration_depth_reduction_std, bases
        self._most_m = config.gel_thickness - config.penetration_depth
        self._noise: EpisodeNoise | None = None
        if config.sensor_noise is not None:
            self._noise = EpisodeNoise(config.sensor_noise, shape)
        # Shared by all touches: nothing writes to it.
        self._nothing = TouchDraws(np.zeros(shape[0]), np.zeros(shape[0], np.int64), None)
        self._is_random = bool(self._std_m or bases or self._noise is not None)

    def begin(self, rows: Rows, rng: np.random.Generator) -> None:
        """Draw the values that are constant during an episode of some sensors."""
        if not self._is_random:
            return
        own = rng.spawn(1)[0]
        if self._noise is not None:
            self._noise.begin(rows, own)

    def touch(self, count: int, rng: np.random.Generator) -> TouchDraws:
        """Draw the values that differ from touch to touch, for ``count`` sensors."""
        if not self._is_random and count == len(self._nothing.bases):
            return self._nothing
        draws = TouchDraws(self._nothing.lifts_m[:count], self._nothing.bases[:count], None)
        if not self._is_random:
            return draws
        own = rng.spawn(1)[0]
        if self._std_m:
            lifts_m = np.abs(own.normal(scale=self._std_m, size=count))
            draws = draws._replace(lifts_m=np.minimum(lifts_m, self._most_m))
        if self._bases:
            # From another generator, so that the noise is as published.
            draws = draws._replace(bases=own.spawn(1)[0].integers(self._bases, size=count))
        return draws._replace(rng=own)

    def add_noise(self, images: Float32, rows: Rows, draws: TouchDraws) -> Float32:
        """Return images of some sensors, (n, H, W, C), with noise; works in place."""
        if self._noise is None or draws.rng is None:
            return images
        return self._noise.add(images, rows, draws.rng)
