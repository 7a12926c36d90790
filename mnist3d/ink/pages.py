"""The page in a photograph or scan: its outline, its light, its ink, and lines that were printed on it.

Page and paper are sought in pictures reduced to about 175 pixels. Grey levels stay integers, so their means
and interpolations are the same on every processor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage
from skimage import measure, morphology, transform  # load their parts when they are used

from mnist3d.ink.grey_levels import refuse
from tactile_toolkit.value_types import Bool, Float32, Int32, Int64, UInt8

_COARSE_PX = 175
"""Longer side of a reduced picture."""

WIDEST_STROKE = 1 / 6
"""Strokes are narrower than this share of the longer side."""

_SHARE, _CONVEX = 0.2, 0.95
"""Least shares of the picture, and of its own convex hull, that a page fills."""

_STEP, _SHARP = 0.1, 0.7
"""Least step of log brightness at the outline of a page, and least share of it within a few pixels."""

_LEVELS = 12
"""Number of brightness levels at which a page is sought."""

# Added to levels, so that the logarithm of black is finite and its noise small.
_DARK = 4

_BOARD = 140
"""Highest grey level of paper that can have lighter ink."""

_CONTRAST, _DEVIATIONS = 0.15, 6
"""Least difference of ink from paper: as a share, and in standard deviations of the paper."""

# Standard deviation over median absolute deviation, for a normal distribution.
_DEVIATION_PER_MAD = 1.4826

_MIDDLE = 0.35
_SHADOW_PX = 3 / 700
"""Least lightness of shadows, from ink (0) to paper (1), and least width as a share of the longer side."""

_THICKEST = 1 / 88
"""Largest thickness of a line, as a share of the longer side of the picture."""

_TURNS_RAD = np.deg2rad(np.arange(-20, 20.1, 0.25))
"""Directions of lines on a tilted page; on a page that is turned further, the other lines are level."""

# A line covers half of each sixth of its length on the page, which is at least this share of the picture.
_COVERED, _PARTS, _SHORTEST = 0.5, 6, 0.15

# Edges of ink along an edge of a picture where three lines run into it.
_RULED_EDGES = 5

# Least Hough votes for a line, as a share of the width of the page.
_VOTES = 0.2
_REACH_PX = 2


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
    tone = tones[paper_around(to_coarse(darkest))]
    tone_px = tones[darkest]
    page = np.ones(tone.shape, bool)
    best = _STEP
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
        hull = morphology.convex_hull_image(part)  # type: ignore[no-untyped-call]
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
    lines = measure.find_contours(part.astype(np.float32), 0.5)  # type: ignore[no-untyped-call]
    points = np.concatenate(lines).T
    shape = np.array(part.shape)[:, None]
    factor = reduction(tone_px.shape)
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


class Ink(NamedTuple):
    """The ink in a picture that was divided by its paper."""

    mask: Bool
    ink: float
    """Reflectance of ink; that of paper is 1."""
    reflectance: Float32


def ink_is_light(coarse: UInt8, page: Bool) -> bool:
    """Return whether the few pixels that differ from the page around them are lighter than the page."""
    if np.median(coarse[page]) > _BOARD:
        return False
    # The surroundings of the page are filled with its nearest pixels.
    nearest = ndimage.distance_transform_edt(~page, return_distances=False, return_indices=True)
    beyond = coarse[tuple(nearest)].astype(np.float32)
    tiny = beyond[::3, ::3]
    paper = ndimage.median_filter(tiny, int(max(tiny.shape) * 2 * WIDEST_STROKE) | 1, mode="nearest")
    paper = np.kron(paper, np.ones((3, 3)))[: coarse.shape[0], : coarse.shape[1]]
    interior = eroded(page, 4)
    if not interior.any():
        return False
    darkest, lightest = np.percentile(np.log((beyond + 8) / (paper + 8))[interior], [0.5, 99.5])
    return bool(lightest > -1.5 * darkest)


def _deviation(values: Float32) -> float:
    """Return a robust standard deviation, from the median distance from the median."""
    return float(_DEVIATION_PER_MAD * np.median(np.abs(values - np.median(values))))


def reflectance(views: UInt8, page: Bool, widest: float) -> Float32:
    """Divide the view with the clearest ink by the paper around each pixel; paper becomes 1."""
    inside = eroded(page, 2)
    if not inside.any():
        refuse("no-ink", sentence="empty-page")
    best = -1.0
    divided = np.ones(views.shape[1:], np.float32)
    for number, view in enumerate(views):
        coarse = to_coarse(view)
        paper = paper_around(coarse, widest)
        levels = np.divide(coarse, paper, dtype=np.float32)[inside]
        level = float(np.median(levels))
        if level == 0:
            continue  # a channel in which most of the picture is black shows no paper
        clearness = (level - float(np.percentile(levels, 0.5))) / (_deviation(levels) + 0.01 * level)
        if number == 0:
            clearness *= 1.3  # grey has less noise than single channels
        if clearness > best:
            divided = np.divide(view, to_fine(paper, view.shape), dtype=np.float32) / np.float32(level)
            best = clearness
    return divided


def find_ink(reflectance: Float32, inside: Bool) -> Ink:
    """Return the pixels inside the page whose reflectance is nearer to ink than to paper."""
    values = reflectance[inside]
    ink = float(np.percentile(values, 0.3))
    for _ in range(4):
        dark = values[values < (1 + ink) / 2]
        ink = 1.0
        if dark.size:
            ink = float(np.median(dark))
    if 1 - ink < least_contrast(values):
        refuse("no-ink", sentence="empty-page")
    return Ink((reflectance < (1 + ink) / 2) & inside, ink, reflectance)


def least_contrast(values: Float32) -> float:
    """Return the least difference of ink from paper, for reflectances of which most are those of paper."""
    return max(_CONTRAST, _DEVIATIONS * _deviation(values[::7]))


def without_shadows(page_ink: Ink) -> Bool:
    """Remove parts that are lighter than ink, such as shadows of fingers, but keep the edges of ink."""
    middle = page_ink.mask & (page_ink.reflectance > page_ink.ink + _MIDDLE * (1 - page_ink.ink))
    steps = max(1, round(_SHADOW_PX * max(middle.shape)))
    wide = ndimage.minimum_filter(middle, 2 * steps + 1)
    if not wide.any():
        return page_ink.mask
    return page_ink.mask & ~(middle & ndimage.maximum_filter(wide, 4 * steps + 1))


def is_ruled(mask: Bool) -> bool:
    """Return whether at least three lines of ink run into each of two opposite edges of a picture."""
    edges = (mask[0], mask[-1], mask[:, 0], mask[:, -1])
    top, bottom, left, right = (np.count_nonzero(np.diff(edge, prepend=False)) for edge in edges)
    return bool(max(min(top, bottom), min(left, right)) >= _RULED_EDGES)


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
    level = _level_lines(mask, page)
    upright = _level_lines(mask.T, page.T)
    thickness_px = max(level.thickness_px, upright.thickness_px)
    lines = level.mask | upright.mask.T
    left = mask & ~lines
    if not lines.any() or not left.any():
        return left
    depth = ndimage.distance_transform_edt(left)
    radius_px = thickness_px / 2 + 0.75
    if np.percentile(depth[left], 90) <= 1.3 * radius_px:
        return left
    opened = ndimage.distance_transform_edt(depth <= radius_px) <= radius_px
    return left & (opened | ~ndimage.binary_dilation(lines, iterations=int(2 * thickness_px)))


def _level_lines(mask: Bool, page: Bool) -> _Lines:
    """Find the lines that are nearly level."""
    runs = _runs_down(mask)
    width = mask.shape[1]
    thin = mask & (runs <= max(3, _THICKEST * max(mask.shape)))
    lines = np.zeros_like(mask)
    thickness_px = 0.0
    page_px = int(page.any(axis=0).sum())
    if thin.sum() < _COVERED * page_px:
        return _Lines(lines, thickness_px)
    votes, turns, distances = transform.hough_line(thin, np.pi / 2 + _TURNS_RAD)  # type: ignore[no-untyped-call]
    _, turns, distances = transform.hough_line_peaks(  # type: ignore[no-untyped-call]
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
        line_runs = np.where(thin[band, columns], runs[band, columns], 0).max(axis=0)[on_page]
        if min(part.mean() for part in covered) < _COVERED or not line_runs.any():
            continue
        thickness = float(np.median(line_runs[line_runs > 0]))
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
