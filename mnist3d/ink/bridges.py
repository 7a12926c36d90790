"""Bars that join the pieces of a drawing."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from mnist3d.ink.cleaning import repair_corners
from tactile_toolkit.array_types import Bool, Float64

# A strip of width w is w / 4 deep on average.
_WIDTH_PER_DEPTH = 4.0


def join_bodies(mask: Bool, width_px: float) -> Bool:
    """Join pieces of clean ink by straight bars until one is left, so that the drawing prints in one piece.

    Each round joins the first piece to the nearest other one, where they are closest. A bar reaches into the
    ink at both ends by half its width, so that the joint is as wide as the bar. Bars are as wide as the
    strokes, and at most ``width_px``: wider ones would fill letters.
    """
    labels, count = ndimage.label(mask)
    if count < 2:
        return mask
    width_px = min(width_px, stroke_width_px(mask))
    while True:
        labels, count = ndimage.label(mask)
        if count < 2:
            return mask
        here, there = (np.argwhere(part).astype(np.float64) for part in (labels == 1, labels > 1))
        found = cKDTree(there).query(here)
        distances, nearest = np.asarray(found[0]), np.asarray(found[1])
        # Straight edges are close along a stretch; a bridge in its middle is better than at its end.
        close = np.flatnonzero(distances <= distances.min() + 0.5)
        middle = int(close[len(close) // 2])
        mask = repair_corners(mask | _bar(mask.shape, here[middle], there[nearest[middle]], width_px))


def stroke_width_px(mask: Bool) -> float:
    """Return the width of the strokes of ink, by its mean depth."""
    return float(_WIDTH_PER_DEPTH * _depth_px(mask)[mask].mean())


def thinnest_stroke_px(mask: Bool) -> float:
    """Return the width of the strokes of the piece of ink with the thinnest ones."""
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    depths = ndimage.mean(_depth_px(mask), labels, np.arange(1, count + 1))
    return float(_WIDTH_PER_DEPTH * np.min(depths))


def _depth_px(mask: Bool) -> Float64:
    """Return the depth of the centre of each pixel; the outline runs half a pixel outside of ink."""
    return np.asarray(ndimage.distance_transform_edt(np.pad(mask, 1)))[1:-1, 1:-1] - 0.5


def _bar(shape: tuple[int, ...], start: Float64, end: Float64, width_px: float) -> Bool:
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    down, across = rows - start[0], columns - start[1]
    way = down * along[0] + across * along[1]
    aside = across * along[0] - down * along[1]
    # 0.75 px joins pieces that lie diagonally, however thin the bar.
    half = max(width_px / 2, 0.75)
    return np.asarray((np.abs(aside) <= half) & (way >= -half) & (way <= length + half))
