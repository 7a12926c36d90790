"""Maps of the surface that sensors felt, and a rule that chooses the next touch, for many environments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from tactile_envs.config import MOVE
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float32, Float64, Int64

if TYPE_CHECKING:
    from tactile_envs.config import Observation
    from tactile_envs.environment import TactileVectorEnv

OBJECT_RELIEF = 0.1
"""Pixels of more relief belong to an object: 1 mm above the plate, or a tenth of the range of colours."""

_LARGE_CELL_M = 0.2
_PIXEL_M, _LARGE_PIXEL_M = 0.003, 0.006
_SAMPLES_PER_PIXEL = 6
_LEAST_SHOWN = 0.25
_FADING = 0.9
_ELSEWHERE = 0.3
_COST_PER_M = 10.0
_SEARCH_M = 0.07
_SPACING = 2.0


class TouchMaps:
    """What the sensors of n environments felt, on maps of their cells.

    Pixels are 3 mm wide, or 6 mm in cells of more than 20 cm; rows go along y, columns along x. A map covers
    everything that a sensor can reach. Sensors are taken to be upright.

    Parameters
    ----------
    env : TactileVectorEnv
        Environments with simulated touches.
    pixel_m : float, optional
        Width of a pixel, if other than that.

    Attributes
    ----------
    relief : ndarray of float32, shape (n, h, w)
        Felt surface: height above the plate in centimetres from images of depth; from images in colour, how
        much they differ from the image of the bare plate, 0 to 1.
    freshness : ndarray of float32, shape (n, h, w)
        1 where the last touch showed a pixel, 0.9 where the touch before it did, and so on; 0 for never.
    positions_m : ndarray of float64, shape (n, 2)
        Positions of the sensors, cell frame.
    x_m, y_m : ndarray of float64, shapes (w,) and (h,)
        Centres of the pixels, cell frame.
    pixel_m : float
        Width of a pixel.
    is_reached : ndarray of bool, shape (h, w)
        Whether a sensor can go there.

    Raises
    ------
    InputError
        The touches of the environments are recorded, not simulated.
    """

    part = MOVE

    def __init__(self, env: TactileVectorEnv, pixel_m: float | None = None) -> None:
        if env.camera is None:
            raise InputError(
                "maps of touches need simulated touches; those of this environment are recorded",
                next="choose an id without RealSnap",
            )
        config, sensor = env.config, env.camera.sensor
        self._is_large = max(config.cell_size) > _LARGE_CELL_M
        self.pixel_m = pixel_m or (_LARGE_PIXEL_M if self._is_large else _PIXEL_M)
        self._low_m, self._high_m = env.sensor_pos_limits
        self._press_m, self._gel_m = sensor.press_m, sensor.gel_m
        self._longest_m = config.max_distance(config.linear_velocity, config.linear_acceleration)
        self._bare = env.camera.bare_picture() if env.camera.sees_depth else None
        window_m = np.array(sensor.window_m)
        half_px = np.ceil((self._high_m[:2] + window_m / 2) / self.pixel_m).astype(np.int64)
        self.x_m, self.y_m = ((np.arange(-half, half) + 0.5) * self.pixel_m for half in half_px)
        far_x_m, far_y_m = self._high_m[:2] + self.pixel_m / 2
        self.is_reached = (np.abs(self.y_m) < far_y_m)[:, None] & (np.abs(self.x_m) < far_x_m)
        squares = (self.y_m[:, None] / self.y_m[-1]) ** 2 + (self.x_m / self.x_m[-1]) ** 2
        self._elsewhere = (_ELSEWHERE * np.exp(-squares)).astype(np.float32)
        self._view_px = 2 * int(min(window_m) / 2 / self.pixel_m) + 1
        size_px = np.array(config.sensor_output_size)
        pitch_m = window_m / size_px
        self._strides = np.maximum(1, np.rint(self.pixel_m / _SAMPLES_PER_PIXEL / pitch_m).astype(np.int64))
        self._least_samples = _LEAST_SHOWN * self.pixel_m**2 / (pitch_m * self._strides).prod()
        columns, rows = (np.arange(0, *ends) for ends in zip(size_px, self._strides, strict=True))
        self._right_m = (columns + 0.5) * pitch_m[0] - window_m[0] / 2
        self._up_m = window_m[1] / 2 - (rows + 0.5) * pitch_m[1]  # rows of images go down
        shape = env.num_envs, len(self.y_m), len(self.x_m)
        self.relief, self.freshness = np.zeros((2, *shape), np.float32)
        self.positions_m = np.zeros((env.num_envs, 2))

    def add(self, observation: Observation) -> None:
        """Draw a touch of every environment; a pixel shows what was felt last."""
        share = (observation["sensor_pos"].astype(np.float64) + 1) / 2
        positions_m = self._low_m + share * (self._high_m - self._low_m)
        self.positions_m = positions_m[:, :2]
        samples = self._samples(observation["sensor_img"], positions_m[:, 2])
        columns = self._pixels(positions_m[:, :1] + self._right_m, self.x_m)
        rows = self._pixels(positions_m[:, 1:2] + self._up_m, self.y_m)
        count, height, width = self.relief.shape
        numbers = (np.arange(count)[:, None, None] * height + rows[:, :, None]) * width + columns[:, None, :]
        counts = np.bincount(numbers.ravel(), minlength=self.relief.size)
        sums = np.bincount(numbers.ravel(), samples.ravel(), self.relief.size)
        is_shown = counts > self._least_samples
        self.freshness *= _FADING
        self.freshness.reshape(-1)[is_shown] = 1
        self.relief.reshape(-1)[is_shown] = sums[is_shown] / counts[is_shown]

    def _pixels(self, values_m: Float64, centres_m: Float64) -> Int64:
        """Return the numbers of the pixels at some positions along an axis with these centres."""
        numbers: Int64 = np.floor((values_m - centres_m[0]) / self.pixel_m + 0.5).astype(np.int64)
        return numbers

    def _samples(self, images: Float32, heights_m: Float64) -> Float32:
        """Return the relief at the samples of images (n, H, W, C) of sensors at some heights, (n,)."""
        thinned = (slice(None, None, self._strides[1]), slice(None, None, self._strides[0]))
        sampled = images[:, *thinned]
        if self._bare is not None:
            relief: Float32 = np.abs(sampled - self._bare[thinned]).max(axis=3)
            return relief
        depth = sampled[..., 0]
        below_m = self._press_m + depth * (self._gel_m - self._press_m)
        height_cm = 100 * (heights_m[:, None, None].astype(np.float32) - below_m)
        # Where nothing touches the gel, the surface is lower than it can measure.
        return np.where(depth < 1, np.maximum(height_cm, 0), np.float32(0))

    def next_steps(self) -> Float32:
        """Return the next move of sensors, (n, 3), to unknown surface next to an object; z stays 0.

        Elsewhere, unknown surface is worth less, and least at the edge of the cell. In large cells, surface
        is worth nothing if half of the 7 cm around is known: touches that lie apart meet an object sooner.
        """
        is_object = self.relief > OBJECT_RELIEF
        view = (1, self._view_px, self._view_px)
        is_near, is_next = (ndimage.maximum_filter(is_object, size) for size in (view, (1, 3, 3)))
        elsewhere = self._elsewhere
        if self._is_large:
            search_px = 2 * int(_SEARCH_M / 2 / self.pixel_m) + 1
            known = ndimage.uniform_filter((self.freshness > 0).astype(np.float32), (1, search_px, search_px))
            elsewhere = elsewhere * np.maximum(0, 1 - _SPACING * known)
        worth = np.maximum((is_near + np.float32(1) * is_next) / 2, elsewhere)
        worth[self.freshness > 0] = 0
        x_m, y_m = self.x_m - self.positions_m[:, :1], self.y_m - self.positions_m[:, 1:]
        too_far_m = np.maximum(0, np.hypot(x_m[:, None, :], y_m[:, :, None]) - self._longest_m)
        values = ndimage.uniform_filter(worth, view, mode="constant") - _COST_PER_M * too_far_m
        values[:, ~self.is_reached] = -np.inf
        index = np.arange(len(values))
        rows, columns = np.divmod(values.reshape(len(values), -1).argmax(axis=1), len(self.x_m))
        ways_m = np.stack([x_m[index, columns], y_m[index, rows], np.zeros(len(index))], axis=1)
        lengths_m = np.maximum(self._longest_m, np.linalg.norm(ways_m, axis=1))
        moves: Float32 = (ways_m / lengths_m[:, None]).astype(np.float32)
        return moves
