"""Convolutions of 3 x 3 pixels by Winograd's algorithm F(4x4, 3x3) (Lavin and Gray 2015), and instance norm.

An image is cut into tiles of 4 x 4 pixels. Each is computed from 6 x 6 pixels with 36 multiplications for a
pair of channels, not 144. Images have the shape (height, width, channels). All kernels compute the rows, of
pixels or tiles, from ``first`` to ``last``. No sum crosses rows: values do not depend on their division.
"""

from __future__ import annotations

import numpy as np

from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.compiled import compiled

TILE = 4
"""Side of a tile of output, pixels."""

POINTS = 36
"""Products of a tile for a pair of channels."""

_REACH = 6  # side of the input of a tile
# Channels that are transformed together, few enough for the fastest memory. Where the compiler knows that
# their number is at most this constant, so that rows do not overlap, it uses vector instructions.
_TOGETHER = 64

# These keep values in single precision; plain literals would be double.
_TWO, _FOUR, _FIVE, _EIGHT = (np.float32(value) for value in (2, 4, 5, 8))

_WEIGHT_TRANSFORM = np.array([[6, 0, 0], [-4, -4, -4], [-4, 4, -4], [1, 2, 4], [1, -2, 4], [0, 0, 24]]) / 24


def transformed_weights(weights: Float32) -> Float32:
    """Return weights (out, in, 3, 3) as 36 matrices (36, out, in)."""
    both = np.kron(_WEIGHT_TRANSFORM, _WEIGHT_TRANSFORM)
    flat = weights.reshape(-1, 9).T.astype(np.float64)
    return np.asarray(both @ flat, np.float32).reshape(POINTS, *weights.shape[:2])


def tiles_across(pixels: int) -> int:
    """Return the number of tiles that cover a side."""
    return -(-pixels // TILE)


@compiled
def _mirrored(place: int, count: int) -> int:
    if place < 0:
        return -place
    # Tiles may extend beyond the border; their values there are discarded.
    return place if place < count else max(2 * count - 2 - place, 0)


@compiled
def _transform_input(taken: Float32, made: Float32, start: int, step: int, count: int) -> None:
    """Transform six rows of ``count`` channels, which begin at ``start`` and are ``step`` apart."""
    for k in range(count):
        a, b, c = taken[start + k], taken[start + step + k], taken[start + 2 * step + k]
        d, e, f = (
            taken[start + 3 * step + k],
            taken[start + 4 * step + k],
            taken[start + 5 * step + k],
        )
        even, odd = e - _FOUR * c, d - _FOUR * b
        near, far = e - c, _TWO * (d - b)
        made[start + k] = _FOUR * a - _FIVE * c + e
        made[start + step + k] = even + odd
        made[start + 2 * step + k] = even - odd
        made[start + 3 * step + k] = near + far
        made[start + 4 * step + k] = near - far
        made[start + 5 * step + k] = _FOUR * b - _FIVE * d + f


@compiled
def _transform_output(
    taken: Float32, start: int, step: int, made: Float32, to: int, to_step: int, count: int
) -> None:
    """Transform six rows of ``count`` channels to four."""
    for k in range(count):
        a, b, c = taken[start + k], taken[start + step + k], taken[start + 2 * step + k]
        d, e, f = (
            taken[start + 3 * step + k],
            taken[start + 4 * step + k],
            taken[start + 5 * step + k],
        )
        near, near_off, far, far_off = b + c, b - c, d + e, d - e
        made[to + k] = a + near + far
        made[to + to_step + k] = near_off + _TWO * far_off
        made[to + 2 * to_step + k] = near + _FOUR * far
        made[to + 3 * to_step + k] = near_off + _EIGHT * far_off + f


@compiled
def split_tiles(
    image: Float32, scale: Float32, shift: Float32, floor: np.float32, tiles: Float32, first: int, last: int
) -> None:
    """Transform ``max(image * scale + shift, floor)``, mirrored at borders, to tiles (36, n, channels)."""
    height, width, channels = image.shape
    across = (width + 3) // 4
    taken, made = np.empty(POINTS * _TOGETHER, np.float32), np.empty(POINTS * _TOGETHER, np.float32)
    for down in range(first, last):
        for right in range(across):
            for begin in range(0, channels, _TOGETHER):
                count = min(_TOGETHER, channels - begin)
                end = begin + count
                by, plus = scale[begin:end], shift[begin:end]
                for i in range(_REACH):
                    row = _mirrored(4 * down + i - 1, height)
                    for j in range(_REACH):
                        pixel = image[row, _mirrored(4 * right + j - 1, width), begin:end]
                        at = (_REACH * i + j) * _TOGETHER
                        for k in range(count):
                            value = pixel[k] * by[k] + plus[k]
                            taken[at + k] = value if value > floor else floor
                for i in range(_REACH):
                    _transform_input(taken, made, _REACH * i * _TOGETHER, _TOGETHER, count)
                for j in range(_REACH):
                    _transform_input(made, taken, j * _TOGETHER, _REACH * _TOGETHER, count)
                for point in range(POINTS):
                    tile = tiles[point, down * across + right, begin:end]
                    at = point * _TOGETHER
                    for k in range(count):
                        tile[k] = taken[at + k]


@compiled
def join_tiles(tiles: Float32, image: Float32, sums: Float64, first: int, last: int) -> None:
    """Transform tiles (36, n, channels) to an image; sums by row of tiles, as :func:`add_image_sums`."""
    height, width, channels = image.shape
    across = (width + 3) // 4
    taken, between = np.empty(POINTS * _TOGETHER, np.float32), np.empty(24 * _TOGETHER, np.float32)
    made = np.empty(16 * _TOGETHER, np.float32)
    for down in range(first, last):
        sums[down] = 0
        for right in range(across):
            for begin in range(0, channels, _TOGETHER):
                count = min(_TOGETHER, channels - begin)
                end = begin + count
                for point in range(POINTS):
                    tile = tiles[point, down * across + right, begin:end]
                    at = point * _TOGETHER
                    for k in range(count):
                        taken[at + k] = tile[k]
                for i in range(_REACH):
                    start = i * _TOGETHER
                    _transform_output(taken, _REACH * start, _TOGETHER, between, 4 * start, _TOGETHER, count)
                for j in range(4):
                    start = j * _TOGETHER
                    _transform_output(between, start, 4 * _TOGETHER, made, start, 4 * _TOGETHER, count)
                total, squares = sums[down, 0, begin:end], sums[down, 1, begin:end]
                for i in range(min(4, height - 4 * down)):
                    for j in range(min(4, width - 4 * right)):
                        pixel = image[4 * down + i, 4 * right + j, begin:end]
                        at = (4 * i + j) * _TOGETHER
                        for k in range(count):
                            value = made[at + k]
                            pixel[k] = value
                            wide = np.float64(value)
                            total[k] += wide
                            squares[k] += wide * wide


@compiled
def add_image_sums(image: Float32, sums: Float64, first: int, last: int) -> None:
    """Write the sum of each row of an image, and of its squares, to ``sums`` (rows, 2, channels)."""
    _, width, channels = image.shape
    for row in range(first, last):
        total, squares = sums[row, 0], sums[row, 1]
        total[:], squares[:] = 0, 0
        for column in range(width):
            pixel = image[row, column]
            for k in range(channels):
                wide = np.float64(pixel[k])
                total[k] += wide
                squares[k] += wide * wide


@compiled
def rectify(
    image: Float32, scale: Float32, shift: Float32, margin: int, out: Float32, first: int, last: int
) -> None:
    """Write ``max(image * scale + shift, 0)``, mirrored into a margin; ``out`` may be the image itself."""
    height, width, channels = image.shape
    zero = np.float32(0)
    for row in range(first, last):
        for column in range(width + 2 * margin):
            pixel = image[_mirrored(row - margin, height), _mirrored(column - margin, width)]
            written = out[row, column]
            for k in range(channels):
                value = pixel[k] * scale[k] + shift[k]
                written[k] = value if value > zero else zero


@compiled
def add_scaled(image: Float32, scale: Float32, shift: Float32, out: Float32, first: int, last: int) -> None:
    """Add ``image * scale + shift`` to another image."""
    _, width, channels = image.shape
    for row in range(first, last):
        for column in range(width):
            pixel, written = image[row, column], out[row, column]
            for k in range(channels):
                written[k] += pixel[k] * scale[k] + shift[k]
