"""What pictures show at a glance: averages over cells, steps of brightness, markers, equal pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image
from scipy import ndimage

from realtouch.faults.rules import (
    MAX_UNEVENNESS,
    MIN_BRIGHTEST,
    MIN_DOTS,
    MOST_SPECKS,
    NOISE_FACTOR,
)
from tactile_toolkit.array_types import Bool, Float32, Float64, Floating, UInt8
from tactile_toolkit.touch import decode_image, decode_small

ROWS, COLUMNS = 12, 16
"""Cells of a picture whose averages are compared: 16 x 16 mm of a GelSight Mini in cells of 1.2 mm."""

_UNEVEN = 3.0  # levels; by up to 2 the cells of a constant JPEG differ
_BLOCK_PX = 16  # of JPEG
_PATCHES = 4  # a side of the coarse pattern that colours are recognised by
_SAME_WAY = 10  # percent of the cells that may change the other way
# A dot is darker than what is around it by levels, by a share of its brightness, and by deviations.
_DOT_CONTRAST, _DOT_SHARE, _DOT_NOISE = 6.0, 0.06, 4.0
# Dots of GelSight, DIGIT and their likes lie 1/14 to 1/8 of the width of the picture apart.
_AROUND, _APART = 1 / 8, 1 / 24


def cells_of(encoded: bytes | memoryview) -> Float32:
    """Decode a picture to the averages of its cells, shape (12, 16, 3); ValueError if it is damaged."""
    shrunk = Image.fromarray(decode_small(encoded, COLUMNS)).resize((COLUMNS, ROWS), Image.Resampling.BOX)
    return np.asarray(shrunk, np.float32)


def share_of_one_value(encoded: bytes | memoryview, cells: Float32) -> float:
    """Return which share of the pixels has one value, in the channel with least; 1 if the picture is black.

    Pictures whose cells differ are not looked at: their share is 0. A gel without any pattern of light has
    noise. JPEG makes the lower and the right edge of a constant picture uneven, so that they do not count.
    """
    if float(cells.max()) < MIN_BRIGHTEST:
        return 1.0
    if float(np.ptp(cells, axis=(0, 1)).max()) > _UNEVEN:
        return 0.0
    pixels = decode_image(encoded)
    if min(pixels.shape[:2]) > 2 * _BLOCK_PX:
        pixels = pixels[:-_BLOCK_PX, :-_BLOCK_PX]
    inner = pixels.reshape(-1, 3)
    return float((inner == np.median(inner, axis=0)).mean(axis=0).min())


def brightness_steps(cells: Float32) -> Float64:
    """Return by how much nine tenths of each picture, or more, changed the same way, shape (n - 1,), levels.

    ``cells`` have the shape (n, 12, 16, 3). A contact changes a part of the picture, or makes one side
    brighter and the other darker; then the step is 0.
    """
    change = np.diff(cells.mean(axis=3).reshape(len(cells), -1), axis=0)
    if not len(change):
        return np.zeros(0)
    low, high = np.percentile(change, (_SAME_WAY, 100 - _SAME_WAY), axis=1)
    steps: Float64 = np.maximum(np.maximum(low, -high), 0.0)
    return steps


def outlying_steps(cells: Float32, least: float) -> list[tuple[int, float]]:
    """Return the pictures that differ from the one before, and the step; the way back is not listed."""
    steps = brightness_steps(cells)
    if not len(steps):
        return []
    usual_step = np.median(np.sort(steps)[:-1]) if len(steps) > 1 else 0.0  # without the one to judge
    limit = max(least, NOISE_FACTOR * float(usual_step))
    found: list[tuple[int, float]] = []
    usual = 0  # the last picture before the first step
    for step in np.flatnonzero(steps > limit).tolist():
        is_back = bool(found) and brightness_steps(cells[[usual, step + 1]])[0] <= limit
        if is_back:
            usual = step + 1
            continue
        if not found:
            usual = step
        found.append((step + 1, float(steps[step])))
    return found


def colour_pattern(cells: Float32) -> Float32:
    """Return where which colour falls in, shape (48,), normalised."""
    shape = (_PATCHES, ROWS // _PATCHES, _PATCHES, COLUMNS // _PATCHES, 3)
    return normalised(cells.reshape(shape).mean(axis=(1, 3)).ravel())


def normalised(pattern: Floating) -> Float32:
    """Return a pattern less its mean, over its standard deviation; zeros if that is 0."""
    deviation = float(pattern.std()) or 1.0
    found: Float32 = ((pattern - pattern.mean()) / deviation).astype(np.float32)
    return found


def with_red_as_blue(patterns: Float32) -> Float32:
    """Return colour patterns, shape (..., 48), with red and blue exchanged."""
    return patterns.reshape(*patterns.shape[:-1], -1, 3)[..., ::-1].reshape(patterns.shape)


def count_markers(background: UInt8) -> int | None:
    """Return the number of dots of a marker gel, 0 if it has none, None if that is uncertain.

    Dots are local minima of brightness, clearly darker than what is around them, at even distances.
    """
    grey = background.mean(axis=2, dtype=np.float64)
    around = ndimage.uniform_filter(grey, max(3, round(grey.shape[1] * _AROUND)))
    # The centre of a dot of several equal pixels is one pixel after a little blur.
    darkness = ndimage.gaussian_filter(around - grey, grey.shape[1] / 320)
    noise = 1.4826 * np.median(np.abs(darkness - np.median(darkness)))  # dots cover less than half
    least = np.maximum(np.maximum(_DOT_CONTRAST, _DOT_NOISE * noise), _DOT_SHARE * around)
    peaks = darkness == ndimage.maximum_filter(darkness, max(3, round(grey.shape[1] * _APART)))
    dots = np.argwhere(peaks & (darkness > least))
    if len(dots) <= MOST_SPECKS:
        return 0
    squared = ((dots[:, None] - dots[None]) ** 2).sum(axis=2).astype(np.float64)
    np.fill_diagonal(squared, np.inf)
    nearest = np.sqrt(squared.min(axis=1))
    if len(dots) < MIN_DOTS or nearest.std() > MAX_UNEVENNESS * nearest.mean():
        return None
    return len(dots)


def spans_of(same: Sequence[bool] | Bool, least: int) -> list[tuple[int, int]]:
    """Return start and length of each run of at least ``least`` entries that equal their predecessor.

    ``same``, shape (n - 1,), states whether entry i + 1 equals entry i.
    """
    marks = np.concatenate([[False], np.asarray(same, bool), [False]])
    edges = np.flatnonzero(marks[1:] != marks[:-1])
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(start, stop - start + 1) for start, stop in pairs if stop - start + 1 >= least]
