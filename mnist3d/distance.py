"""Distances from the outline of the ink, no further than they matter."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["distance_px", "signed_distance_px"]


def signed_distance_px(mask: NDArray[np.bool_], inside_px: float, outside_px: float) -> NDArray[np.float32]:
    """Measure how far each pixel centre lies from the outline of the ink.

    The outline runs between pixels, half a pixel from the centres on either side of it.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        True where there is ink. What lies beyond the image is paper only if the image says so at its edge.
    inside_px, outside_px : float
        Distances are cut off at these values; a smaller reach costs less.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Pixels, positive inside the ink.
    """
    inside = distance_px(mask, inside_px + 0.5)
    outside = distance_px(~mask, outside_px + 0.5)
    return np.where(mask, inside - np.float32(0.5), np.float32(0.5) - outside)


def distance_px(mask: NDArray[np.bool_], reach_px: float) -> NDArray[np.float32]:
    """Measure how far each marked pixel centre lies from the nearest unmarked one.

    Exact up to ``reach_px`` and that value beyond. First along the columns, then over the offsets of the
    rows (Felzenszwalb and Huttenlocher 2012 write the transform that way); with a short reach plain passes
    over small integers beat their lower envelope.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        Pixels to measure at.
    reach_px : float
        Longest distance of interest, below 128.

    Returns
    -------
    ndarray of float32, shape (H, W)
        0 at unmarked pixels.
    """
    reach = math.ceil(reach_px)
    along_columns = _column_distance(mask, reach)
    squared = along_columns * along_columns
    height, width = mask.shape
    padded = np.full((height, width + 2 * reach), reach * reach, dtype=np.int16)
    padded[:, reach : reach + width] = squared
    beside = np.empty_like(squared)
    for offset in range(1, reach):
        left, right = reach - offset, reach + offset
        np.minimum(padded[:, left : left + width], padded[:, right : right + width], out=beside)
        beside += np.int16(offset * offset)
        np.minimum(squared, beside, out=squared)
    return np.asarray(np.minimum(np.sqrt(squared, dtype=np.float32), np.float32(reach_px)))


def _column_distance(mask: NDArray[np.bool_], reach: int) -> NDArray[np.int16]:
    height = mask.shape[0]
    rows = np.arange(height, dtype=np.int16)[:, None]
    above = np.maximum.accumulate(np.where(mask, np.int16(-reach), rows), axis=0)
    below = np.minimum.accumulate(np.where(mask, np.int16(height + reach), rows)[::-1], axis=0)[::-1]
    return np.minimum(np.minimum(rows - above, below - rows), np.int16(reach))
