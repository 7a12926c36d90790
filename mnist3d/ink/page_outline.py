"""The outline of the page in a photograph or scan."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours
from skimage.morphology import convex_hull_image

from mnist3d.ink.coarse_pictures import paper_around, reduction, to_coarse
from tactile_toolkit.array_types import Bool, Float32, UInt8

_SHARE, _CONVEX = 0.2, 0.95
"""Least shares of the picture, and of its own convex hull, that a page fills."""

_STEP, _SHARP = 0.1, 0.7
"""Least step of log brightness at the outline of a page, and least share of it within a few pixels."""

_LEVELS = 12
"""Number of brightness levels at which a page is sought."""

# Added to levels, so that the logarithm of black is finite and its noise small.
_DARK = 4


def find_page(darkest: UInt8) -> Bool:
    """Return the page, in coarse pixels; the whole picture if no outline is found.

    The page is the convex bright part whose outline is a sharp step almost everywhere. Shadows are soft.

    Parameters
    ----------
    darkest : ndarray of uint8, shape (H, W)
        The darkest of the channels of each pixel, which shows wood and coloured cloth as dark.

    Returns
    -------
    ndarray of bool
        Shape of :func:`to_coarse`.
    """
    tones = np.log(np.arange(256, dtype=np.float32) + _DARK)
    tone, tone_px = tones[paper_around(to_coarse(darkest))], tones[darkest]
    page, best = np.ones(tone.shape, bool), _STEP
    low, high = np.percentile(tone, [1, 99])
    if low == high:
        return page
    for level in np.linspace(low, high, _LEVELS + 2)[1:-1]:
        labels, _ = ndimage.label(tone > level)
        sizes = np.bincount(labels.ravel())
        largest = int(sizes[1:].argmax()) + 1
        if sizes[largest] < _SHARE * tone.size:
            continue
        part = ndimage.binary_fill_holes(labels == largest)
        hull = convex_hull_image(part)  # type: ignore[no-untyped-call]
        if part.all() or part.sum() < _CONVEX * hull.sum():
            continue
        step, sharpness = _step_at_outline(tone_px, part)
        if sharpness > _SHARP and step > best:
            page, best = part, step
    return page


def _step_at_outline(tone_px: Float32, part: Bool) -> tuple[float, float]:
    """Return the step that four fifths of an outline reach, and the share of it within a few pixels.

    Ink that crosses the outline, and objects on the desk, affect only a small part of it.
    """
    soft = ndimage.gaussian_filter(part.astype(np.float32), 1.5)
    lines = find_contours(part.astype(np.float32), 0.5)  # type: ignore[no-untyped-call]
    points = np.concatenate(lines).T
    shape, factor = np.array(part.shape)[:, None], reduction(tone_px.shape)
    points = points[:, ((points > 3) & (points < shape - 4)).all(axis=0)]
    if points.shape[1] < 20:
        return 0.0, 0.0
    slopes = np.asarray(np.gradient(soft))
    inwards = np.stack([ndimage.map_coordinates(slope, points, order=1) for slope in slopes])
    inwards /= np.hypot(inwards[0], inwards[1]) + 1e-6
    along = np.arange(-3 * factor, 3 * factor + 1)
    sharp_px = factor + 1
    at = points[..., None] * factor + (factor - 1) / 2 + inwards[..., None] * along
    tones = ndimage.map_coordinates(tone_px, at, order=1, mode="nearest")
    # Neighbours see the same edge, but different noise.
    tones = ndimage.uniform_filter1d(tones, 9, axis=0)
    steps = tones[:, -factor:].mean(axis=1) - tones[:, :factor].mean(axis=1)
    near = (tones[:, sharp_px:] - tones[:, :-sharp_px]).max(axis=1)
    return float(np.percentile(steps, 20)), float(np.median(near / np.maximum(steps, 0.05)))
