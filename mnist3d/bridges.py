"""Bridges between the pieces of ink of one digit, so that it prints in one piece."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mnist3d.ink import repair_corners

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["join_bodies"]


def join_bodies(mask: NDArray[np.bool_], width_px: float) -> NDArray[np.bool_]:
    """Join pieces of ink by straight bars until one is left.

    Each round joins the first piece to the one nearest to it, where the two come closest. A bar reaches
    into the ink at both ends by half its width, so that the joint is as wide as the bar.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        Clean ink, from :func:`mnist3d.ink.clean`.
    width_px : float
        Width of the bars in pixels.

    Returns
    -------
    ndarray of bool, shape (H, W)
        The ink with bars, in one piece; the mask itself where it was in one piece before.
    """
    from scipy import ndimage

    while True:
        labels, count = ndimage.label(mask)
        if count < 2:
            return mask
        start, end = _closest_points(labels == 1, labels > 1)
        mask = repair_corners(mask | _bar(mask.shape, start, end, width_px))


def _closest_points(
    one: NDArray[np.bool_], others: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    from scipy.spatial import cKDTree

    here, there = np.argwhere(one).astype(np.float64), np.argwhere(others).astype(np.float64)
    found = cKDTree(there).query(here)
    distances, nearest = np.asarray(found[0]), np.asarray(found[1])
    # Two straight edges are close along a stretch: its middle makes a better bridge than its end.
    close = np.flatnonzero(distances <= distances.min() + 0.5)
    place = int(close[len(close) // 2])
    return here[place], there[nearest[place]]


def _bar(
    shape: tuple[int, ...], start: NDArray[np.float64], end: NDArray[np.float64], width_px: float
) -> NDArray[np.bool_]:
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    down, across = rows - start[0], columns - start[1]
    way = down * along[0] + across * along[1]
    aside = across * along[0] - down * along[1]
    # Half a pixel on top joins pieces that lie diagonally, however thin the bar.
    half = max(width_px / 2, 0.75)
    return np.asarray((np.abs(aside) <= half) & (way >= -half) & (way <= length + half))
