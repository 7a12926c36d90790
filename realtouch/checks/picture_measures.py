"""Measures of pictures: averages over cells, steps of brightness, markers, runs of equal pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image
from scipy import ndimage

from realtouch.checks.rules import (
    MAX_SPECKS,
    MAX_UNEVENNESS,
    MIN_BRIGHTEST,
    MIN_DOTS,
    NOISE_FACTOR,
)
from tactile_toolkit.array_types import Bool, Float32, Float64, Floating, UInt8
from tactile_toolkit.touch import decode_image

ROWS, COLUMNS = 12, 16
"""Cells of a picture whose averages are compared: 16 x 16 mm of a GelSight Mini in cells of 1.2 mm."""
_UNEVEN = 3.0  # levels; the cells of a constant JPEG differ by up to 2
_BLOCK_PX = 16  # side of a block of JPEG with subsampled colours
_PATCHES = 4  # per side of the coarse pattern by which colours are recognised
_OTHER_WAY = 10  # percent of the cells that may change in the other direction

# Least contrast of a dot: levels, share of the brightness around it, standard deviations of noise.
_DOT_CONTRAST, _DOT_SHARE, _DOT_NOISE = 6.0, 0.06, 4.0

# Dots of GelSight, DIGIT and similar sensors are 1/14 to 1/8 of the width of the picture apart. As shares of
# this width: the side of the surroundings of a dot, the least distance of two dots, the blur.
_SURROUNDINGS, _APART, _BLUR = 1 / 8, 1 / 24, 1 / 320
_DEVIATION_PER_MAD = 1.4826  # of a normal distribution: standard deviation over median absolute deviation


def cells_of(encoded: bytes | memoryview) -> Float32:
    """Decode a picture to the averages of its cells, shape (12, 16, 3); ValueError if it is damaged."""
    pixels = decode_image(encoded, least_px=COLUMNS)
    shrunk = Image.fromarray(pixels).resize((COLUMNS, ROWS), Image.Resampling.BOX)
    return np.asarray(shrunk, np.float32)


def share_of_one_value(encoded: bytes | memoryview, cells: Float32) -> float:
    """Return the share of pixels that have the median value, in the channel where it is least.

    A black picture has the share 1. A picture whose cells differ has the share 0, and is not decoded in full.
    Even a gel that is lit evenly has noise. JPEG makes the lower and the right edge of a constant picture
    uneven, so these edges are left out.
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
    """Return the least change, in levels, of nine tenths of the cells in one direction, shape (n - 1,).

    ``cells`` have the shape (n, 12, 16, 3). A contact changes only a part of the picture, or makes one side
    brighter and the other darker; then the step is 0.
    """
    change = np.diff(cells.mean(axis=3).reshape(len(cells), -1), axis=0)
    if not len(change):
        return np.zeros(0)
    low, high = np.percentile(change, (_OTHER_WAY, 100 - _OTHER_WAY), axis=1)
    steps: Float64 = np.maximum(np.maximum(low, -high), 0.0)
    return steps


def outlying_steps(cells: Float32, least: float) -> list[tuple[int, float]]:
    """Return the index of each picture at which the brightness jumps, and the jump in levels.

    A jump of fewer than ``least`` levels does not count. A jump back to the brightness before is not listed.
    """
    steps = brightness_steps(cells)
    if not len(steps):
        return []
    usual_step = 0.0
    if len(steps) > 1:
        usual_step = np.median(np.sort(steps)[:-1])  # without the largest, which is the one in question
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
    """Return the mean colours of 4 x 4 patches of a picture, normalised, shape (48,)."""
    shape = (_PATCHES, ROWS // _PATCHES, _PATCHES, COLUMNS // _PATCHES, 3)
    return normalised(cells.reshape(shape).mean(axis=(1, 3)).ravel())


def normalised(pattern: Floating) -> Float32:
    """Subtract the mean of a pattern and divide by its standard deviation; zeros for a constant pattern."""
    deviation = float(pattern.std()) or 1.0
    found: Float32 = ((pattern - pattern.mean()) / deviation).astype(np.float32)
    return found


def with_red_as_blue(patterns: Float32) -> Float32:
    """Return colour patterns, shape (..., 48), with red and blue exchanged."""
    return patterns.reshape(*patterns.shape[:-1], -1, 3)[..., ::-1].reshape(patterns.shape)


def count_markers(background: UInt8) -> int | None:
    """Return the number of dots of a marker gel, 0 if it has none, None if that is uncertain.

    Dots are local minima of brightness, clearly darker than their surroundings, at even distances.
    """
    grey = background.mean(axis=2, dtype=np.float64)
    width_px = grey.shape[1]
    around = ndimage.uniform_filter(grey, max(3, round(width_px * _SURROUNDINGS)))
    # Blur gives a dot of several equal pixels a single darkest pixel.
    darkness = ndimage.gaussian_filter(around - grey, width_px * _BLUR)
    # The median ignores dots, which cover less than half of the picture.
    noise = _DEVIATION_PER_MAD * np.median(np.abs(darkness - np.median(darkness)))
    least = np.maximum(np.maximum(_DOT_CONTRAST, _DOT_NOISE * noise), _DOT_SHARE * around)
    peaks = darkness == ndimage.maximum_filter(darkness, max(3, round(width_px * _APART)))
    dots = np.argwhere(peaks & (darkness > least))
    if len(dots) <= MAX_SPECKS:
        return 0
    squared = ((dots[:, None] - dots[None]) ** 2).sum(axis=2).astype(np.float64)
    np.fill_diagonal(squared, np.inf)
    nearest = np.sqrt(squared.min(axis=1))
    if len(dots) < MIN_DOTS or nearest.std() > MAX_UNEVENNESS * nearest.mean():
        return None
    return len(dots)


def spans_of(same: Sequence[bool] | Bool, least: int) -> list[tuple[int, int]]:
    """Return start and length of each run of at least ``least`` equal entries.

    ``same``, shape (n - 1,), states whether entry i + 1 equals entry i.
    """
    marks = np.concatenate([[False], np.asarray(same, bool), [False]])
    edges = np.flatnonzero(marks[1:] != marks[:-1])
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(start, stop - start + 1) for start, stop in pairs if stop - start + 1 >= least]
