"""Pictures reduced to some 175 pixels, in which the page and the paper are looked for.

Grey levels stay integers: their means and interpolations are the same on every processor.
"""

from __future__ import annotations

import numpy as np
from PIL import Image
from scipy import ndimage

from tactile_toolkit.array_types import Bool, UInt8

_COARSE_PX = 175
"""Longer side at which the page and its light are looked for."""

WIDEST_STROKE = 1 / 6
"""All strokes are narrower, as a share of the longer side."""


def reduction(shape: tuple[int, ...]) -> int:
    """Return by which factor a picture of that shape is reduced."""
    return max(1, round(max(shape) / _COARSE_PX))


def to_coarse(view: UInt8) -> UInt8:
    """Reduce a view, shape (H, W), to some 175 pixels on its longer side, by means of squares of pixels."""
    return np.asarray(Image.fromarray(view).reduce(reduction(view.shape)))


def to_fine(values: UInt8, shape: tuple[int, ...]) -> UInt8:
    """Interpolate what :func:`to_coarse` gave at the pixels of a view of that shape."""
    factor, (height, width) = reduction(shape), values.shape
    larger = Image.fromarray(values).resize((width * factor, height * factor), Image.Resampling.BILINEAR)
    return np.asarray(larger)[: shape[0], : shape[1]]


def fine_mask(mask: Bool, shape: tuple[int, ...]) -> Bool:
    """Return which pixels of a view of that shape are in a mask of coarse pixels."""
    return to_fine(np.where(mask, np.uint8(255), np.uint8(0)), shape) > 127


def paper_around(values: UInt8, widest: float = WIDEST_STROKE) -> UInt8:
    """Return the paper around each coarse pixel: what a closing leaves that is wider than any stroke."""
    side = int(max(values.shape) * widest) | 1
    # Beyond the edge of the picture, the pixels of the edge are repeated.
    beyond = np.pad(values, side, mode="edge")
    closed = ndimage.minimum_filter(ndimage.maximum_filter(beyond, side), side)
    return np.maximum(closed[side:-side, side:-side], 1)


def eroded(mask: Bool, steps: int) -> Bool:
    """Draw in a page by so many coarse pixels, except where the picture ends and the page continues."""
    return np.asarray(ndimage.binary_erosion(mask, iterations=steps, border_value=1))
