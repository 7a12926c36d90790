"""Maps of the surface that was touched, for many environments at once, and the direction to go next.

A map has pixels of 3 mm in the frame of the cell, row 0 at the smallest y. Its three channels: the measured
height, whether any touch has shown a pixel, and whether the last touch has shown it.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

SIDE, PIXEL_MM = 32, 3.0
REACH_MM = np.array([38.5, 40.5, 20.0])
"""Positions are observed as fractions of this: half the cell less its padding; z starts at 0."""

OBJECT_CM = 0.1
"""Surface that is higher than this above the plate belongs to the object."""

_IMAGE_MM = 14.16
_PRESS_MM = 2.125
_STEP_MM = 15.0
_HALF_VIEW = 2
"""Number of pixels of the map that a touch shows on each side of its middle."""

Floats = NDArray[np.float32]


class TouchMaps:
    """Maps of n environments.

    Attributes
    ----------
    maps : ndarray of float32, shape (n, 3, 32, 32)
        Height in centimetres, shown by any touch, shown by the last touch; in the frame of the cell.
    at_mm : ndarray of float32, shape (n, 2)
        Positions of the sensors.
    """

    def __init__(self, count: int) -> None:
        self.maps = np.zeros((count, 3, SIDE, SIDE), np.float32)
        self.at_mm = np.zeros((count, 2), np.float32)

    def begin(self) -> None:
        """Forget everything."""
        self.maps[:] = 0

    def add(self, observation: dict[str, NDArray[Any]]) -> None:
        """Draw the observations of a touch in all environments."""
        position_mm = observation["sensor_pos"] * REACH_MM.astype(np.float32)
        position_mm[:, 2] = (observation["sensor_pos"][:, 2] + 1) * REACH_MM[2] / 2
        self.at_mm[:] = position_mm[:, :2]
        _paste(position_mm, observation["sensor_img"][..., 0], self.maps)

    def centred(self) -> Floats:
        """Return the maps with the known part of each object in the middle."""
        out = np.zeros_like(self.maps)
        _centre(self.maps, out)
        return out

    def around_sensor(self) -> Floats:
        """Return height, shown, and reach of the sensor, (n, 3, 32, 32), with the sensor in the middle."""
        out = np.zeros_like(self.maps)
        _around_sensor(self.maps, self.at_mm, out)
        return out

    def frontier(self) -> Floats:
        """Return the step (n, 2), as a fraction of the longest, to unknown surface next to the object."""
        out = np.zeros((len(self.maps), 2), np.float32)
        _frontier(self.maps, self.at_mm, out)
        return out


@numba.njit(cache=True, parallel=False)
def _paste(position_mm: Floats, images: Floats, maps: Floats) -> None:
    size, step = images.shape[1], 2
    total = np.zeros((SIDE, SIDE), np.float32)
    count = np.zeros((SIDE, SIDE), np.int32)
    for n in range(len(maps)):
        total[:] = 0
        count[:] = 0
        maps[n, 2] = 0
        for row in range(0, size, step):
            y_mm = position_mm[n, 1] - (row + 0.5 - size / 2) * _IMAGE_MM / size
            i = math.floor(y_mm / PIXEL_MM) + SIDE // 2
            for column in range(0, size, step):
                x_mm = position_mm[n, 0] + (column + 0.5 - size / 2) * _IMAGE_MM / size
                j = math.floor(x_mm / PIXEL_MM) + SIDE // 2
                if 0 <= i < SIDE and 0 <= j < SIDE:
                    depth = images[n, row, column]
                    count[i, j] += 1
                    # Where the gel touches nothing, the surface is lower than it can measure.
                    if depth < 1:
                        height_mm = position_mm[n, 2] - (1 + depth) * _PRESS_MM
                        total[i, j] += max(np.float32(0), height_mm)
        for i in range(SIDE):
            for j in range(SIDE):
                if count[i, j] > 12:  # a quarter of the samples that fit
                    maps[n, 0, i, j] = max(maps[n, 0, i, j], total[i, j] / count[i, j] / 10)
                    maps[n, 1, i, j] = 1
                    maps[n, 2, i, j] = 1


@numba.njit(cache=True)
def _centre(maps: Floats, out: Floats) -> None:
    for n in range(len(maps)):
        rows, columns, weight = 0.0, 0.0, 0.0
        for i in range(SIDE):
            for j in range(SIDE):
                if maps[n, 0, i, j] > OBJECT_CM:
                    rows += i
                    columns += j
                    weight += 1
        down, right = 0, 0
        if weight:
            down = round((SIDE - 1) / 2 - rows / weight)
            right = round((SIDE - 1) / 2 - columns / weight)
        for i in range(max(0, -down), min(SIDE, SIDE - down)):
            for j in range(max(0, -right), min(SIDE, SIDE - right)):
                for channel in range(3):
                    out[n, channel, i + down, j + right] = maps[n, channel, i, j]


@numba.njit(cache=True)
def _around_sensor(maps: Floats, at_mm: Floats, out: Floats) -> None:
    for n in range(len(maps)):
        right, up = round(at_mm[n, 0] / PIXEL_MM), round(at_mm[n, 1] / PIXEL_MM)
        for i in range(SIDE):
            for j in range(SIDE):
                k, m = i + up, j + right
                y_mm, x_mm = (k - SIDE / 2 + 0.5) * PIXEL_MM, (m - SIDE / 2 + 0.5) * PIXEL_MM
                if abs(x_mm) < REACH_MM[0] and abs(y_mm) < REACH_MM[1]:
                    out[n, 2, i, j] = 1
                if 0 <= k < SIDE and 0 <= m < SIDE:
                    out[n, 0, i, j] = maps[n, 0, k, m]
                    out[n, 1, i, j] = maps[n, 1, k, m]


@numba.njit(cache=True)
def _frontier(maps: Floats, at_mm: Floats, out: Floats) -> None:
    gains = np.zeros((SIDE, SIDE), np.float32)
    for n in range(len(maps)):
        is_met = False
        gains[:] = 0
        for i in range(SIDE):
            for j in range(SIDE):
                if maps[n, 0, i, j] > OBJECT_CM:
                    is_met = True
                    for k in range(max(0, i - 2), min(SIDE, i + 3)):
                        for m in range(max(0, j - 2), min(SIDE, j + 3)):
                            if maps[n, 1, k, m] == 0:
                                near = 1.0 / (1 + abs(k - i) + abs(m - j))
                                gains[k, m] = max(gains[k, m], near)
        if not is_met:  # objects lie in the middle more often than at the edge
            for i in range(SIDE):
                for j in range(SIDE):
                    if maps[n, 1, i, j] == 0:
                        square = (i - SIDE / 2 + 0.5) ** 2 + (j - SIDE / 2 + 0.5) ** 2
                        gains[i, j] = math.exp(-square / 200)
        best, best_x, best_y = -np.inf, 0.0, 0.0
        for i in range(_HALF_VIEW, SIDE - _HALF_VIEW):
            y_mm = (i - SIDE / 2 + 0.5) * PIXEL_MM
            for j in range(_HALF_VIEW, SIDE - _HALF_VIEW):
                x_mm = (j - SIDE / 2 + 0.5) * PIXEL_MM
                if abs(x_mm) > REACH_MM[0] + 1.5 or abs(y_mm) > REACH_MM[1] + 1.5:
                    continue
                gain = 0.0
                for k in range(i - _HALF_VIEW, i + _HALF_VIEW + 1):
                    for m in range(j - _HALF_VIEW, j + _HALF_VIEW + 1):
                        gain += gains[k, m]
                if gain == 0:
                    continue
                way_mm = math.hypot(x_mm - at_mm[n, 0], y_mm - at_mm[n, 1])
                value = gain - 0.8 * max(0.0, way_mm - _STEP_MM) / PIXEL_MM
                if value > best:
                    best, best_x, best_y = value, x_mm, y_mm
        if best == -np.inf:
            continue  # everything is known: stay
        x_mm, y_mm = best_x - at_mm[n, 0], best_y - at_mm[n, 1]
        scale = max(_STEP_MM, math.hypot(x_mm, y_mm))
        out[n, 0], out[n, 1] = x_mm / scale, y_mm / scale
