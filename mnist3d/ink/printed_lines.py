"""Printed lines of ruled and squared paper, which cross the page and are thinner than strokes of the pen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from skimage.transform import hough_line, hough_line_peaks

from tactile_toolkit.array_types import Bool, Int32, Int64

_THICKEST = 1 / 88
"""Largest thickness of a line, as a share of the longer side of the picture."""

_TURNS_RAD = np.deg2rad(np.arange(-20, 20.1, 0.25))
"""Directions of lines on a tilted page; on a page that is turned further, the other lines are level."""

# A line covers half of each sixth of its length on the page, which is at least this share of the picture.
_COVERED, _PARTS, _SHORTEST = 0.5, 6, 0.15
# Least Hough votes for a line, as a share of the width of the page.
_VOTES = 0.2
_REACH_PX = 2


class _Lines(NamedTuple):
    mask: Bool
    thickness_px: float


def without_lines(mask: Bool, page: Bool) -> Bool:
    """Remove printed lines from ink.

    Where a stroke crosses a line, its ink stays. If strokes are thicker than lines, stumps of lines at
    strokes are removed, too.

    Parameters
    ----------
    mask, page : ndarray of bool, shape (H, W)
        Ink, and where the page is.

    Returns
    -------
    ndarray of bool, shape (H, W)
    """
    level, upright = _level_lines(mask, page), _level_lines(mask.T, page.T)
    thickness_px = max(level.thickness_px, upright.thickness_px)
    lines = level.mask | upright.mask.T
    left = mask & ~lines
    if not lines.any() or not left.any():
        return left
    depth, radius_px = ndimage.distance_transform_edt(left), thickness_px / 2 + 0.75
    if np.percentile(depth[left], 90) <= 1.3 * radius_px:
        return left
    opened = ndimage.distance_transform_edt(depth <= radius_px) <= radius_px
    return left & (opened | ~ndimage.binary_dilation(lines, iterations=int(2 * thickness_px)))


def _level_lines(mask: Bool, page: Bool) -> _Lines:
    """Find the lines that are nearly level."""
    runs, width = _runs_down(mask), mask.shape[1]
    thin = mask & (runs <= max(3, _THICKEST * max(mask.shape)))
    lines, thickness_px = np.zeros_like(mask), 0.0
    page_px = int(page.any(axis=0).sum())
    if thin.sum() < _COVERED * page_px:
        return _Lines(lines, thickness_px)
    votes, turns, distances = hough_line(thin, np.pi / 2 + _TURNS_RAD)  # type: ignore[no-untyped-call]
    _, turns, distances = hough_line_peaks(  # type: ignore[no-untyped-call]
        votes, turns, distances, min_distance=5, min_angle=8, threshold=_VOTES * page_px
    )
    columns = np.arange(width)
    for turn, distance in zip(turns, distances, strict=True):
        at = np.rint((distance - columns * np.cos(turn)) / np.sin(turn)).astype(np.intp)
        rows = np.clip(at, 0, mask.shape[0] - 1)
        on_page = page[rows, columns] & (rows == at)
        if on_page.sum() < _SHORTEST * width:
            continue
        band = _band(rows, _REACH_PX, mask)
        covered = np.array_split(np.asarray(mask[band, columns].any(axis=0))[on_page], _PARTS)
        found = np.where(thin[band, columns], runs[band, columns], 0).max(axis=0)[on_page]
        if min(part.mean() for part in covered) < _COVERED or not found.any():
            continue
        thickness = float(np.median(found[found > 0]))
        # Thicker ink belongs to strokes.
        limit = 1.25 * thickness + 1.5
        band = _band(rows, int(limit) + _REACH_PX, mask)
        lines[band, columns] |= mask[band, columns] & (runs[band, columns] <= limit)
        thickness_px = max(thickness_px, thickness)
    return _Lines(lines, thickness_px)


def _band(rows: Int64, reach_px: int, mask: Bool) -> Int64:
    """Return the rows around a line, shape (2 reach + 1, columns)."""
    beside = np.arange(-reach_px, reach_px + 1)[:, None]
    return np.asarray(np.clip(rows + beside, 0, mask.shape[0] - 1))


def _runs_down(mask: Bool) -> Int32:
    """Return for each pixel the length of its run of ink down the column; 0 on paper."""
    flat = np.pad(mask, ((1, 1), (0, 0))).T.ravel()
    ends = np.flatnonzero(np.diff(flat.view(np.int8))) + 1
    lengths = ends[1::2] - ends[::2]
    runs = np.zeros(flat.shape, np.int32)
    runs[flat] = np.repeat(lengths, lengths)
    return np.ascontiguousarray(runs.reshape(mask.shape[1], -1).T[1:-1])
