"""Handwriting in photographs and scans: the page is found, its light evened out, and its ink checked.

A closing wider than any stroke estimates the paper around a pixel, and follows the edges of shadows and of
the page. The picture is divided by it. The dark rest is ink, unless a check finds something else: then the
picture is refused.
"""

from __future__ import annotations

import contextlib

import numpy as np
from PIL import Image
from scipy import ndimage

from mnist3d.ink import colours, grey_levels, one_digit, page_outline, printed_lines, refusals
from mnist3d.ink.coarse_pictures import WIDEST_STROKE, eroded, fine_mask, to_coarse
from mnist3d.ink.reflectance import Ink, find_ink, ink_is_light, reflectance, without_shadows
from tactile_toolkit.array_types import Bool, UInt8
from tactile_toolkit.errors import ItemError

CLEAN_LEVELS = 2
"""Largest difference, in grey levels, between the paper of a clean image and its margin."""

_CLEAN_MARGIN, _CLEAN_IMAGE = 0.9, 0.5
"""Least shares of the margin, and of the whole of a clean image, that are paper."""

_SHEET = 0.4
"""Share of the shorter side above which a blob is a sheet on a desk, not ink; blobs of MNIST reach 0.36."""

_WORK_PX = 1000
"""Longer side at which pictures are processed; digits end as 500 px."""

_CROSSED, _NARROW, _CORE, _KEPT = 0.15, 0.5, 0.2, 0.9
"""Limits of second attempts: ink on the outline, width of strokes, depth of the core, share of it kept."""

_WIDEST_PART = 0.5
"""Coloured parts of drawings are narrower than this share of the longer side."""

_GAIN = 2
"""Factor by which the greys of edges are made steeper."""


def is_clean(levels: UInt8) -> bool:
    """Return whether an image is clean: its margin and most of the image have one level.

    Images whose shorter side has less than 64 px are clean. A sheet on a desk of one level is not, since no
    stroke is as wide as a sheet.
    """
    if min(levels.shape) < grey_levels.SMALL_PX:
        return True
    paper = int(np.median(grey_levels.margin(levels)))
    other = (levels < max(0, paper - CLEAN_LEVELS)) | (levels > min(255, paper + CLEAN_LEVELS))
    most = (1 - _CLEAN_IMAGE) * other.size
    if grey_levels.margin(other).mean() > 1 - _CLEAN_MARGIN or np.count_nonzero(other) > most:
        return False
    few = other[:: max(1, other.shape[0] // 128), :: max(1, other.shape[1] // 128)]
    return not ndimage.minimum_filter(few, max(2, int(_SHEET * min(few.shape))), mode="constant").any()


def even_out(picture: UInt8, ink: str = "auto", *, whole: bool = False) -> UInt8:
    """Return the ink of the one digit in a photograph or scan as grey levels from 0 (ink) to 255 (paper).

    With ``whole``, all ink of the page is kept, also several pieces, blobs, and coloured parts. Everything
    else is 255: the surroundings of the page, borders of scans, specks, and printed lines that are thinner
    than the strokes. Size and scale are those of the picture.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W) or (H, W, 3)
        Grey levels or RGB; of coloured pictures, the channel that shows the ink best is used.
    ink : {"auto", "dark", "light"}
        ``"auto"`` takes ink for light only if it is lighter than a dark page.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        There is no ink or, unless ``whole``, not exactly one digit; ``reason`` is ``no-ink``,
        ``several-digits``, ``cut-off`` (the ink reaches the edge of the page) or ``not-a-digit``.
    """
    height, width = picture.shape[:2]
    scale = min(1.0, _WORK_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    work = Image.fromarray(picture)
    if scale < 1:
        work = work.resize(size, Image.Resampling.BOX)
    levels = _even_out(_views(work), ink, whole)
    if scale < 1:
        levels = np.asarray(Image.fromarray(levels).resize((width, height), Image.Resampling.BILINEAR))
    return levels


def _views(picture: Image.Image) -> UInt8:
    """Return the grey levels and, for a coloured picture, its three channels, shape (N, H, W)."""
    grey = np.asarray(picture.convert("L"))
    if picture.mode == "L":
        return grey[None]
    return np.stack([grey, *np.moveaxis(np.asarray(picture), -1, 0)])


def _even_out(views: UInt8, ink: str, whole: bool) -> UInt8:
    page = page_outline.find_page(views.min(axis=0))
    if ink == "light" or (ink == "auto" and ink_is_light(to_coarse(views[0]), page)):
        views = 255 - views
    if whole:
        return _drawing_on(views, page)
    try:
        return _ink_on(views, page)
    except ItemError as error:
        try_again = _SECOND_ATTEMPTS.get(error.reason)
        if try_again is None:
            raise
        with contextlib.suppress(ItemError):
            return try_again(views, page)
        raise


def _across_shadow(views: UInt8, page: Bool) -> UInt8:
    """Try again without the outline of the page, which may be the edge of a shadow that ink crosses.

    Raises ItemError ``cut-off`` if the outline itself is now taken for ink.
    """
    levels = _ink_on(views, np.ones_like(page))
    outline = fine_mask(page & ~eroded(page, 2), levels.shape)
    if (levels[outline] < 128).mean() >= _CROSSED:
        refusals.refuse("cut-off")
    return levels


def _under_fingers(views: UInt8, page: Bool) -> UInt8:
    """Try again with a paper estimate that also follows narrow shadows.

    Raises ItemError ``no-ink`` if it follows wide strokes, too.
    """
    levels = _ink_on(views, page, _NARROW * WIDEST_STROKE)
    inside = fine_mask(eroded(page, 2), levels.shape)
    wide = find_ink(reflectance(views, page, WIDEST_STROKE), inside)
    core = wide.mask & (wide.reflectance < wide.ink + _CORE * (1 - wide.ink))
    if (levels[core] < 128).mean() <= _KEPT:
        refusals.refuse("no-ink", sentence="empty-page")
    return levels


_SECOND_ATTEMPTS = {"cut-off": _across_shadow, "not-a-digit": _under_fingers}


def _ink_on(views: UInt8, page: Bool, widest: float = WIDEST_STROKE) -> UInt8:
    """Return the levels of the one digit on a page."""
    inside = fine_mask(eroded(page, 2), views[0].shape)
    found = find_ink(reflectance(views, page, widest), inside)
    digit = one_digit.find_one_digit(
        printed_lines.without_lines(without_shadows(found), inside), inside, found
    )
    return _levels_of(digit, found)


def _drawing_on(views: UInt8, page: Bool) -> UInt8:
    """Return the levels of all ink on a page."""
    inside = fine_mask(eroded(page, 2), views[0].shape)
    found = find_ink(reflectance(views, page, WIDEST_STROKE), inside)
    inked = printed_lines.without_lines(without_shadows(found), inside)
    if len(views) > 1:
        channels = np.stack([reflectance(view[None], page, _WIDEST_PART) for view in views[1:]])
        inked |= colours.coloured_ink(channels) & inside
    return _levels_of(one_digit.find_drawing(inked, inside, found), found)


def _levels_of(inked: Bool, found: Ink) -> UInt8:
    """Return the levels of ink; the greys of its edges are kept, but steeper.

    So any threshold divides them in the same place.
    """
    gain = _GAIN * 255 / (1 - found.ink)
    levels = np.rint(127.5 + gain * (found.reflectance - (1 + found.ink) / 2))
    near = ndimage.binary_dilation(inked, iterations=one_digit.NEAR_PX) & ~found.mask
    shown = np.where(near, np.clip(levels, 128, 255), 255)
    return np.where(inked, np.clip(levels, 0, 127), shown).astype(np.uint8)
