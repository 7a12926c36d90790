"""Policies that explore by the rule, at random or by a network, and read their maps by a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from networks import WAYS, Explorer, Reader
from numpy.typing import NDArray

from tactile_envs.config import MOVE
from tactile_envs.episodes.touch_maps import OBJECT_RELIEF, TouchMaps

EXPLORER_SIDE = 32
"""Width of the maps that explorers see, pixels."""

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class View:
    """What a reader sees of the map of touches.

    Attributes
    ----------
    follows : bool
        Whether the known part of the object is in the middle, not the cell.
    turns : bool
        Whether the longest direction of that part lies along the rows.
    side : int
        Width, pixels.
    pixel_m : float, optional
        Width of a pixel; that of the maps of the rule by default.
    """

    follows: bool = True
    turns: bool = False
    side: int = 32
    pixel_m: float | None = None


class Agent:
    """Explores by the rule of ``tactile-envs evaluate --policy rule``, and predicts what its reader reads.

    Parameters
    ----------
    sight : View
        What the reader sees.
    reader : Reader, optional
        Predicts the answers; without one, predictions are 0.

    Attributes
    ----------
    maps, shown : TouchMaps
        What was felt in the episode: for the rule, and for the reader.
    view, frames : ndarray of float32, shapes (n, 2, side, side) and (n, 4)
        What the reader sees: relief and freshness; the frame of this map: x, y in half cells, cosine, sine.
    """

    def __init__(self, sight: View, reader: Reader | None = None) -> None:
        self.sight, self.reader = sight, reader

    def begin(self, env: Any, seed: int) -> None:
        """Forget what was felt."""
        self.maps, self.rng = TouchMaps(env), np.random.default_rng(seed)
        self.shown = self.maps
        if self.sight.pixel_m is not None:
            self.shown = TouchMaps(env, self.sight.pixel_m)
        self.half_cell_m = np.array(env.config.cell_size) / 2
        self._nothing = np.zeros(env.prediction_space.shape, np.float32)

    def __call__(self, observation: dict[str, NDArray[Any]]) -> dict[str, Any]:
        """Return the next touches, and predictions."""
        self.maps.add(observation)
        if self.shown is not self.maps:
            self.shown.add(observation)
        self.view, self.frames = self._look()
        prediction = self._nothing
        if self.reader is not None:
            with torch.inference_mode():
                prediction = self.reader(tensor(self.view), torch.from_numpy(self.frames)).numpy()
        return {"action": {MOVE: self.choose()}, "prediction": prediction}

    def choose(self) -> Floats:
        """Return the next move, (n, 3)."""
        return self.maps.next_steps()

    def _look(self) -> tuple[Floats, Floats]:
        maps = self.shown
        middles_m, angles_rad = np.zeros((len(maps.relief), 2)), np.zeros(len(maps.relief))
        if self.sight.follows:
            is_object = (maps.relief > OBJECT_RELIEF).astype(np.float64)
            shares = is_object / np.maximum(is_object.sum(axis=(1, 2), keepdims=True), 1)
            along_x, along_y = shares.sum(axis=1), shares.sum(axis=2)
            middles_m = np.stack([along_x @ maps.x_m, along_y @ maps.y_m], axis=1)
            if self.sight.turns:
                x, y = middles_m.T
                cross = np.einsum("nij,i,j->n", shares, maps.y_m, maps.x_m) - x * y
                angles_rad = (
                    np.arctan2(2 * cross, along_x @ maps.x_m**2 - x * x - along_y @ maps.y_m**2 + y * y) / 2
                )
        layers = np.stack([maps.relief, maps.freshness], axis=1)
        view = around(maps, layers, middles_m, angles_rad, self.sight.side)
        frames = np.column_stack([middles_m / self.half_cell_m, np.cos(angles_rad), np.sin(angles_rad)])
        return view, frames.astype(np.float32)


class RandomAgent(Agent):
    """Explores by random actions, drawn from the action space."""

    def choose(self) -> Floats:
        """Return the next move, (n, 3)."""
        return self.rng.uniform(-1, 1, (len(self._nothing), 3)).astype(np.float32)


class LearnedAgent(Agent):
    """Explores by a network: the most likely way, or a random one of its distribution (``samples``)."""

    def __init__(self, sight: View, explorer: Explorer, reader: Reader | None = None) -> None:
        super().__init__(sight, reader)
        self.explorer, self.samples = explorer, False

    def choose(self) -> Floats:
        """Return the next move, (n, 3); keep the maps around the sensors and the numbers of the ways."""
        maps = self.maps
        reached = np.broadcast_to(maps.is_reached, maps.relief.shape)
        layers = np.stack([maps.relief, maps.freshness > 0, reached], axis=1).astype(np.float32)
        self.around_sensor = around(maps, layers, maps.positions_m, np.zeros(len(layers)), EXPLORER_SIDE)
        with torch.inference_mode():
            likely = self.explorer(tensor(self.around_sensor))
            self.ways = likely.sample() if self.samples else likely.probs.argmax(1)
        return np.pad(WAYS[self.ways].numpy(), ((0, 0), (0, 1)))


def around(
    maps: TouchMaps, layers: Floats, middles_m: NDArray[Any], angles_rad: NDArray[Any], side: int
) -> Floats:
    """Cut (n, c, side, side) out of layers (n, c, h, w) around points (n, 2), turned by angles (n,).

    Each pixel is the nearest one of the map; pixels outside of it are 0.
    """
    count, _, height, width = layers.shape
    steps_m = (np.arange(side) - (side - 1) / 2) * maps.pixel_m
    cosines, sines = np.cos(angles_rad)[:, None, None], np.sin(angles_rad)[:, None, None]
    x_m = middles_m[:, 0, None, None] + cosines * steps_m - sines * steps_m[:, None]
    y_m = middles_m[:, 1, None, None] + sines * steps_m + cosines * steps_m[:, None]
    columns = np.floor(x_m / maps.pixel_m).astype(np.int64) + width // 2
    rows = np.floor(y_m / maps.pixel_m).astype(np.int64) + height // 2
    is_inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    numbers = np.where(is_inside, rows * width + columns, 0).reshape(count, 1, -1)
    cut = np.take_along_axis(layers.reshape(count, -1, height * width), numbers, axis=2)
    return (cut * is_inside.reshape(count, 1, -1)).reshape(count, -1, side, side)


def tensor(maps: Floats) -> torch.Tensor:
    """Return maps (..., c, side, side) as one batch."""
    batch = torch.from_numpy(maps.reshape(-1, *maps.shape[-3:]))
    return batch.contiguous(memory_format=torch.channels_last)
