"""Kernels of a gel in a moving world, in numba: heights of shapes, blocks of pixels, motion of bodies."""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float64, Int32

ELLIPSOID, CYLINDER, CAPSULE, BOX, PLANE = range(5)
"""Shapes of which the highest point on a line is known in closed form."""

_PARALLEL = 1e-300  # in place of 0, where a line is parallel to the axis of a cylinder


@part
def _slab(start: float, slope: float, half: float) -> tuple[float, float]:
    """Return where a line is within ``half`` of a plane; both ends are the same infinity if it is nowhere."""
    first = (-half - start) / slope
    second = (half - start) / slope
    return min(first, second), max(first, second)


@part
def _ball(
    x: float, y: float, z: float, slope_x: float, slope_y: float, slope_z: float
) -> tuple[float, float]:
    """Return where a line is in the unit ball; the first end is greater if it is nowhere."""
    square = max(slope_x * slope_x + slope_y * slope_y + slope_z * slope_z, _PARALLEL)
    middle = -(x * slope_x + y * slope_y + z * slope_z) / square
    x += middle * slope_x
    y += middle * slope_y
    z += middle * slope_z
    inside = 1.0 - (x * x + y * y + z * z)
    if inside < 0.0:
        return math.inf, -math.inf
    reach = math.sqrt(inside / square)
    return middle - reach, middle + reach


@part
def _top(
    shape: int, half: Float64, start: tuple[float, float, float], slope: tuple[float, float, float]
) -> float:
    """Return the greatest height at which a line through a body is inside of it; -inf if it misses."""
    x, y, z = start[0] / half[0], start[1] / half[1], start[2] / half[2]
    dx, dy, dz = slope[0] / half[0], slope[1] / half[1], slope[2] / half[2]
    if shape == PLANE:
        return -z / dz if dz > 0.0 else -math.inf
    if shape == ELLIPSOID:
        return _ball(x, y, z, dx, dy, dz)[1]
    low, high = _slab(z, dz, 1.0)
    if shape == BOX:
        low_x, high_x = _slab(x, dx, 1.0)
        low_y, high_y = _slab(y, dy, 1.0)
        low, high = max(low, low_x, low_y), min(high, high_x, high_y)
    else:
        low_round, high_round = _ball(x, y, 0.0, dx, dy, 0.0)
        low, high = max(low, low_round), min(high, high_round)
    top = high if low <= high else -math.inf
    if shape == CAPSULE:
        z, dz = start[2] / half[0], slope[2] / half[0]
        end = half[2] / half[0]
        top = max(top, _ball(x, y, z - end, dx, dy, dz)[1], _ball(x, y, z + end, dx, dy, dz)[1])
    return top


@compiled
def raise_shape(
    out: Float64, shape: int, half_m: Float64, pose: Float64, columns_m: Float64, rows_m: Float64
) -> None:
    """Raise each pixel of ``out`` to the highest point of a shape over it.

    ``half_m`` (3,) are its half sizes, ``pose`` (4, 4) leads from its frame to that of the gel, in which
    pixels have the positions ``columns_m`` along x and ``rows_m`` along y.
    """
    slope = (pose[2, 0], pose[2, 1], pose[2, 2])
    z = -pose[2, 3]
    for row in range(len(rows_m)):
        y = rows_m[row] - pose[1, 3]
        for column in range(len(columns_m)):
            x = columns_m[column] - pose[0, 3]
            start = (
                pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z,
                pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z,
                pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z,
            )
            out[row, column] = max(out[row, column], _top(shape, half_m, start, slope))


@compiled
def is_near(balls_m: Float64, pose: Float64, reach_m: tuple[float, float, float]) -> bool:
    """Return whether one of the balls (B, 4) around a body reaches into a box around the origin."""
    for ball in balls_m:
        is_inside = True
        for axis in range(3):
            middle = pose[axis, 3]
            for other_axis in range(3):
                middle += pose[axis, other_axis] * ball[other_axis]
            is_inside = is_inside and abs(middle) <= reach_m[axis] + ball[3]
        if is_inside:
            return True
    return False


@compiled
def to_blocks(heights: Float64, owners: Int32, block_px: int, low_m: float) -> tuple[Float64, Int32]:
    """Return mean heights of blocks of pixels, of which none counts as lower than ``low_m``.

    The owner of a block is that of its highest pixel.
    """
    shape = (heights.shape[0] // block_px, heights.shape[1] // block_px)
    means = np.zeros(shape)
    highest = np.full(shape, -1, np.int32)
    tops = np.full(shape, -np.inf)
    for y in range(heights.shape[0]):
        row = y // block_px
        for x in range(heights.shape[1]):
            column = x // block_px
            means[row, column] += max(heights[y, x], low_m)
            if heights[y, x] > tops[row, column]:
                tops[row, column] = heights[y, x]
                highest[row, column] = owners[y, x]
    return means / block_px**2, highest


@compiled
def add_motion(
    out: Float64, heights: Float64, owners: Int32, back: Float64, columns_m: Float64, rows_m: Float64
) -> None:
    """Add to ``out`` (2, R, C) how far the points of bodies under it have moved along x and y.

    ``back`` (n, 4, 4) leads from where the points of each body are to where they were.
    """
    for row in range(heights.shape[0]):
        y = rows_m[row]
        for column in range(heights.shape[1]):
            if owners[row, column] >= 0:
                x = columns_m[column]
                z = heights[row, column]
                turn = back[owners[row, column]]
                out[0, row, column] += x - (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + turn[0, 3])
                out[1, row, column] += y - (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + turn[1, 3])
