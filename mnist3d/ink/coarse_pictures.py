"""Pictures reduced to about 175 pixels, in which the page and its paper are found.

Grey levels stay integers, so their means and interpolations are the same on every processor.
"""

from __future__ import annotations

import numpy as np
from PIL import Image
from scipy import ndimage

from tactile_toolkit.array_types import Bool, UInt8

_COARSE_PX = 175
"""Longer side of a reduced picture."""

WIDEST_STROKE = 1 / 6
"""Strokes are narrower than this share of the longer side."""


def reduction(shape: tuple[int, ...]) -> int:
    """Return the factor by which a picture of this shape is reduced."""
    return max(1, round(max(shape) / _COARSE_PX))


def to_coarse(view: UInt8) -> UInt8:
    """Reduce a view, shape (H, W), to about 175 pixels on its longer side; each is the mean of a square."""
    return np.asarray(Image.fromarray(view).reduce(reduction(view.shape)))


def to_fine(values: UInt8, shape: tuple[int, ...]) -> UInt8:
    """Enlarge a picture that :func:`to_coarse` reduced to the shape of its view, by interpolation."""
    factor, (height, width) = reduction(shape), values.shape
    larger = Image.fromarray(values).resize((width * factor, height * factor), Image.Resampling.BILINEAR)
    return np.asarray(larger)[: shape[0], : shape[1]]


def fine_mask(mask: Bool, shape: tuple[int, ...]) -> Bool:
    """Enlarge a mask of coarse pixels to the shape of a view."""
    return to_fine(np.where(mask, np.uint8(255), np.uint8(0)), shape) > 127


def paper_around(values: UInt8, widest: float = WIDEST_STROKE) -> UInt8:
    """Return the level of the paper around each coarse pixel, by a closing wider than any stroke."""
    side = int(max(values.shape) * widest) | 1
    # Beyond the edge of the picture, the pixels of the edge are repeated.
    beyond = np.pad(values, side, mode="edge")
    closed = ndimage.minimum_filter(ndimage.maximum_filter(beyond, side), side)
    return np.maximum(closed[side:-side, side:-side], 1)


def eroded(mask: Bool, steps: int) -> Bool:
    """Erode a page by some coarse pixels, but not at the edge of the picture, where the page continues."""
    return np.asarray(ndimage.binary_erosion(mask, iterations=steps, border_value=1))
