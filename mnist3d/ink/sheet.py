"""Images of any size, fitted into a square sheet of 500 pixels."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from PIL import Image
from scipy.sparse import csr_array

from tactile_toolkit.arithmetic import exp_neg
from tactile_toolkit.array_types import AnyArray, Float32, Floating, UInt8

SIDE_PX = 500
"""Side of the square sheet that every source returns: 100 mm at the published 0.2 mm per pixel."""

# Samples per original pixel at which the ink is smoothed before it is drawn.
_MESH = 5
# Standard deviation of that blur, original pixels.
_BLUR_PX = 0.6
_PAPER = 255


def fit(pixels: UInt8, side: int = SIDE_PX) -> UInt8:
    """Fit a dark-on-light image of any size into a square sheet: aspect kept, centred on white paper.

    Larger images are shrunk with antialiasing, smaller ones go through :func:`enlarge`. An image of the size
    of the sheet, 500 x 500 px by default, is returned unchanged.
    """
    height, width = pixels.shape
    if height == width == side:
        return pixels
    scale = side / max(height, width)
    height, width = max(1, round(height * scale)), max(1, round(width * scale))
    if scale > 1:
        resized = enlarge(pixels, (height, width))
    else:
        resized = np.asarray(Image.fromarray(pixels).resize((width, height), Image.Resampling.LANCZOS))
    sheet = np.full((side, side), _PAPER, np.uint8)
    top, left = (side - height) // 2, (side - width) // 2
    sheet[top : top + height, left : left + width] = resized
    return sheet


def enlarge(pixels: UInt8, size: tuple[int, int]) -> UInt8:
    """Enlarge a small dark-on-light image so that its outlines become smooth curves, some 3 px wide.

    The outline is where the interpolating cubic spline through the pixels crosses half ink. That curve still
    winds around the pixel rows (greys of small images are often clipped), so the ink it bounds is smoothed by
    a Gaussian of 0.6 original pixels before the outline is drawn: enough to straighten a slanted edge, too
    little to close a loop or cut a stroke of one pixel.
    """
    ink = 1 - pixels.astype(np.float32) / np.float32(_PAPER)
    rows, columns = (_spline_matrix(count) for count in ink.shape)
    solid = np.clip((_both_ways(rows, columns, ink) - 0.5) * 4 + 0.5, 0, 1)
    down, across = (_blur_matrix(count, out) for count, out in zip(ink.shape, size, strict=True))
    levels = _both_ways(down, across, solid)
    # The blur has widened the edge; it is made steeper again about half ink.
    gain = max(1.0, _BLUR_PX * size[0] / ink.shape[0])
    levels -= np.float32(0.5)
    levels *= np.float32(-_PAPER * gain)
    levels += np.float32(_PAPER / 2)
    np.clip(levels, 0, _PAPER, out=levels)
    return np.rint(levels, out=levels).astype(np.uint8)


def _centres(count: int, out: int) -> Floating:
    """Return the centres of `out` pixels in the coordinates of `count` pixels over the same length."""
    return (np.arange(out) + 0.5) * (count / out) - 0.5


def _cubic_basis(count: int, at: Floating) -> Floating:
    """Return cubic B-splines of `count` knots at some positions; outer knots are repeated beyond the edge."""
    margin = 3
    t = np.abs(at[:, None] - np.arange(-margin, count + margin))
    beyond = np.clip(2 - t, 0, None)
    bumps: Floating = np.where(t < 1, 2 / 3 - t * t + t * t * t / 2, beyond * beyond * beyond / 6)
    basis: Floating = bumps[:, margin : margin + count].copy()
    basis[:, 0] += bumps[:, :margin].sum(axis=1)
    basis[:, -1] += bumps[:, margin + count :].sum(axis=1)
    return basis


def _both_ways(down: csr_array, across: csr_array, values: AnyArray) -> Float32:
    return np.ascontiguousarray((down @ (across @ values.T).T), dtype=np.float32)


# Both matrices depend on sizes only, and cost more to build than to use. Most sources have one size.
@lru_cache(maxsize=8)
def _spline_matrix(count: int) -> csr_array:
    knots = _cubic_basis(count, np.arange(count, dtype=np.float64))
    fine = _cubic_basis(count, _centres(count, count * _MESH))
    return _sparse(_solved(knots.T, fine.T).T)


def _solved(matrix: Floating, right: Floating) -> Floating:
    """Solve equations with a tridiagonal, diagonally dominant matrix."""
    # LAPACK rounds differently on other processors.
    pivots, left = matrix.diagonal().copy(), right.copy()
    for row in range(1, len(matrix)):
        share = matrix[row, row - 1] / pivots[row - 1]
        pivots[row] -= share * matrix[row - 1, row]
        left[row] -= share * left[row - 1]
    left[-1] /= pivots[-1]
    for row in range(len(matrix) - 2, -1, -1):
        left[row] = (left[row] - matrix[row, row + 1] * left[row + 1]) / pivots[row]
    return left


@lru_cache(maxsize=8)
def _blur_matrix(count: int, out: int) -> csr_array:
    fine = count * _MESH
    distance = (_centres(fine, out)[:, None] - np.arange(fine)) / (_BLUR_PX * _MESH)
    return _sparse(exp_neg(0.5 * distance * distance))


def _sparse(weights: Floating) -> csr_array:
    """Keep the weights that matter, and scale each row to a sum of 1.

    Sparse products sum in a fixed order. The order of dense products depends on the number of threads, so the
    same image would give other bytes on a busy machine.
    """
    near = np.where(np.abs(weights) > 1e-5, weights, 0)
    return csr_array((near / near.sum(axis=1, keepdims=True)).astype(np.float32))
