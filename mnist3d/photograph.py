"""Handwriting in photographs and scans: the page is found, its light evened out, and what is ink is checked.

A closing that is wider than any stroke leaves the paper around a pixel, and follows the edges of shadows and
of the page. A picture is divided by it. What is dark then is ink, unless a check finds that it is something
else: then the picture is refused.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mnist3d import page as pages
from mnist3d.ink import SMALL_PX, margin, refuse
from mnist3d.printed_lines import without_lines
from tactile_toolkit.array_types import Bool, Float32, UInt8
from tactile_toolkit.errors import ItemError

if TYPE_CHECKING:
    from PIL.Image import Image


CLEAN_LEVELS = 2
"""Paper of a clean image is within so many grey levels of the paper of its margin."""

_CLEAN_MARGIN, _CLEAN_IMAGE = 0.9, 0.5
"""Shares of the margin, and of all of a clean image, that are its paper."""

_SHEET = 0.4
"""Of the shorter side: what is wider is a sheet on a desk, not ink. Blobs of MNIST fill squares of 0.36."""

_WORK_PX = 1000
"""Longer side at which pictures are worked on; digits are drawn with 500 px in the end."""

_BOARD = 140
"""Only paper whose grey level is below has lighter ink."""

_CONTRAST, _DEVIATIONS = 0.15, 6
"""Ink is darker than paper by such a share at least, and by so many standard deviations of the paper."""

_MIDDLE, _SHADOW_PX = 0.35, 3 / 700
"""From ink to paper, where shadows begin; and how wide they are, of the longer side, other than edges."""

_RIM, _SPECK = 0.05, 0.02
"""Of the longer side: how far the border of a scan reaches, and how long ink is."""

_PART, _THIN_PART, _GAP, _OTHER = 0.1, 0.4, 0.14, 0.2
"""Of the longest piece: length and thickness of further pieces, gaps in a digit, length of another digit."""

_SMALLEST, _BLOB, _WIDEST = 0.08, 0.45, 1.5
"""Ink by the page's width, its thickness by its length, its width by its height."""

_SOFT = 0.1
"""Share of its contrast by which ink changes within a pixel, at nine tenths of its edges."""

_CROSSED, _NARROW, _CORE, _KEPT = 0.15, 0.5, 0.2, 0.9
"""Limits of a second look: outline of a page that is ink; width of strokes; dark ink, and how much stays."""

_NEAR_PX, _GAIN = 2, 2
"""How far the greys of edges reach, and how much steeper they are made."""


def is_clean(levels: UInt8) -> bool:
    """Return whether an image needs no evening out: margin and most of the image have one level.

    Images whose shorter side has less than 64 px are never photographs. A sheet on a desk of one level is not
    clean, since no stroke is as wide as a sheet.
    """
    if min(levels.shape) < SMALL_PX:
        return True
    from scipy import ndimage

    paper = int(np.median(margin(levels)))
    other = (levels < max(0, paper - CLEAN_LEVELS)) | (levels > min(255, paper + CLEAN_LEVELS))
    most = (1 - _CLEAN_IMAGE) * other.size
    if margin(other).mean() > 1 - _CLEAN_MARGIN or np.count_nonzero(other) > most:
        return False
    few = other[:: max(1, other.shape[0] // 128), :: max(1, other.shape[1] // 128)]
    return not ndimage.minimum_filter(few, max(2, int(_SHEET * min(few.shape))), mode="constant").any()


def even_out(picture: UInt8, ink: str = "auto") -> UInt8:
    """Return the ink of the one digit in a photograph or scan as grey levels from 0 (ink) to 255 (paper).

    Everything else is 255: what surrounds the page, the borders of scans, specks, and printed lines that
    are thinner than the strokes. Size and scale are those of the picture.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W) or (H, W, 3)
        Grey levels or RGB; of coloured pictures, the channel that shows the ink best is used.
    ink : {"auto", "dark", "light"}
        ``"auto"`` takes ink for light only where it is, on a page that is dark.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        There is not exactly one digit; ``reason`` is ``no-ink``, ``several-digits``, ``cut-off`` (the ink
        reaches the edge of the page) or ``not-a-digit``.
    """
    from PIL import Image

    height, width = picture.shape[:2]
    scale = min(1.0, _WORK_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    work = Image.fromarray(picture)
    if scale < 1:
        work = work.resize(size, Image.Resampling.BOX)
    levels = _even_out(_views(work), ink)
    if scale < 1:
        levels = np.asarray(Image.fromarray(levels).resize((width, height), Image.Resampling.BILINEAR))
    return levels


def _views(picture: Image) -> UInt8:
    """Return grey, and of a coloured picture red, green and blue, shape (N, H, W)."""
    grey = np.asarray(picture.convert("L"))
    if picture.mode == "L":
        return grey[None]
    return np.stack([grey, *np.moveaxis(np.asarray(picture), -1, 0)])


def _even_out(views: UInt8, ink: str) -> UInt8:
    page = pages.find_page(views.min(axis=0))
    if ink == "light" or (ink == "auto" and _ink_is_light(pages.coarse(views[0]), page)):
        views = 255 - views
    try:
        return _ink_on(views, page)
    except ItemError as error:
        again = {"cut-off": _across_shadow, "not-a-digit": _under_fingers}.get(error.reason)
        with contextlib.suppress(ItemError):
            levels = None if again is None else again(views, page)
            if levels is not None:
                return levels
        raise


def _across_shadow(views: UInt8, page: Bool) -> UInt8 | None:
    """Look again without the edge of the page that ink reaches over: it may be that of a shadow.

    None where the edge is now taken for ink.
    """
    levels = _ink_on(views, np.ones_like(page))
    outline = pages.fine_mask(page & ~pages.eroded(page, 2), levels.shape)
    return levels if (levels[outline] < 128).mean() < _CROSSED else None


def _under_fingers(views: UInt8, page: Bool) -> UInt8 | None:
    """Look again with a paper that also follows narrow shadows; None where it follows wide strokes, too."""
    levels = _ink_on(views, page, _NARROW * pages.WIDEST_STROKE)
    inside = pages.fine_mask(pages.eroded(page, 2), levels.shape)
    wide = _find_ink(_reflectance(views, page, pages.WIDEST_STROKE), inside)
    core = wide.mask & (wide.reflectance < wide.ink + _CORE * (1 - wide.ink))
    return levels if (levels[core] < 128).mean() > _KEPT else None


def _ink_on(views: UInt8, page: Bool, widest: float = pages.WIDEST_STROKE) -> UInt8:
    """Return the levels of the one digit on a page."""
    from scipy import ndimage

    inside = pages.fine_mask(pages.eroded(page, 2), views[0].shape)
    found = _find_ink(_reflectance(views, page, widest), inside)
    digit = _one_digit(without_lines(_without_shadows(found), inside), inside, found)
    # The greys of edges are kept, but steeper: any threshold divides them where this one did.
    gain = _GAIN * 255 / (1 - found.ink)
    levels = np.rint(127.5 + gain * (found.reflectance - (1 + found.ink) / 2))
    near = ndimage.binary_dilation(digit, iterations=_NEAR_PX) & ~found.mask
    shown = np.where(near, np.clip(levels, 128, 255), 255)
    return np.where(digit, np.clip(levels, 0, 127), shown).astype(np.uint8)


def _ink_is_light(coarse: UInt8, page: Bool) -> bool:
    """Return whether the few pixels that differ from the page around them are lighter than it."""
    from scipy import ndimage

    if np.median(coarse[page]) > _BOARD:
        return False
    # What surrounds the page is filled with its nearest pixels.
    places = ndimage.distance_transform_edt(~page, return_distances=False, return_indices=True)
    beyond = coarse[tuple(places)].astype(np.float32)
    tiny = beyond[::3, ::3]
    paper = ndimage.median_filter(tiny, int(max(tiny.shape) * 2 * pages.WIDEST_STROKE) | 1, mode="nearest")
    paper = np.kron(paper, np.ones((3, 3)))[: coarse.shape[0], : coarse.shape[1]]
    seen = pages.eroded(page, 4)
    if not seen.any():
        return False
    darkest, lightest = np.percentile(np.log((beyond + 8) / (paper + 8))[seen], [0.5, 99.5])
    return bool(lightest > -1.5 * darkest)


def _deviation(values: Float32) -> float:
    """Return the standard deviation of most values, by their median distance from the median."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _reflectance(views: UInt8, page: Bool, widest: float) -> Float32:
    """Divide the view that shows ink best by the paper around each pixel; paper becomes 1."""
    inside = pages.eroded(page, 2)
    if not inside.any():
        refuse("no-ink", sentence="empty-page")
    best, divided = -1.0, np.ones(page.shape, np.float32)
    for number, view in enumerate(views):
        coarse = pages.coarse(view)
        paper = pages.paper(coarse, widest)
        seen = np.divide(coarse, paper, dtype=np.float32)[inside]
        level = float(np.median(seen))
        clearness = (level - float(np.percentile(seen, 0.5))) / (_deviation(seen) + 0.01 * level)
        # Grey has less noise than its parts.
        clearness *= 1.3 if number == 0 else 1
        if clearness > best:
            divided = np.divide(view, pages.fine(paper, view.shape), dtype=np.float32) / np.float32(level)
            best = clearness
    return divided


class _Ink(NamedTuple):
    mask: Bool
    ink: float
    """Reflectance of ink, where that of paper is 1."""
    reflectance: Float32


def _find_ink(reflectance: Float32, inside: Bool) -> _Ink:
    """Return what is nearer to ink than to paper."""
    values = reflectance[inside]
    ink = float(np.percentile(values, 0.3))
    for _ in range(4):
        dark = values[values < (1 + ink) / 2]
        ink = float(np.median(dark)) if dark.size else 1.0
    if 1 - ink < max(_CONTRAST, _DEVIATIONS * _deviation(values[::7])):
        refuse("no-ink", sentence="empty-page")
    return _Ink((reflectance < (1 + ink) / 2) & inside, ink, reflectance)


def _without_shadows(found: _Ink) -> Bool:
    """Take away what is between ink and paper, such as shadows of fingers, but for the edges of ink."""
    from scipy import ndimage

    middle = found.mask & (found.reflectance > found.ink + _MIDDLE * (1 - found.ink))
    steps = max(1, round(_SHADOW_PX * max(middle.shape)))
    wide = ndimage.minimum_filter(middle, 2 * steps + 1)
    if not wide.any():
        return found.mask
    return found.mask & ~(middle & ndimage.maximum_filter(wide, 4 * steps + 1))


def _one_digit(mask: Bool, inside: Bool, found: _Ink) -> Bool:
    """Return the ink of the one digit; refuses none, several, and what is cut off or looks like no digit."""
    from scipy import ndimage

    labels, count = ndimage.label(mask, np.ones((3, 3)))
    if not count:
        refuse("no-ink", sentence="empty-page")
    pieces, piece, side = np.arange(1, count + 1), labels[mask], max(mask.shape)
    depth, from_rim = ndimage.distance_transform_edt(mask), ndimage.distance_transform_cdt(np.pad(inside, 1))
    # A blur of a pixel takes the noise away.
    slopes = ndimage.gaussian_gradient_magnitude(found.reflectance, 1.0) / (1 - found.ink)
    slopes = ndimage.maximum_filter(slopes, 3)
    edges = (depth > 0) & (depth <= 1)
    spans = np.array([max(part.stop - part.start for part in box) for box in ndimage.find_objects(labels)])
    # What lies along the rim alone is the border of a scan.
    possible = ndimage.maximum(from_rim[1:-1, 1:-1][mask], piece, pieces) > _RIM * side
    possible &= ndimage.median(slopes[edges], labels[edges], pieces) >= _SOFT
    possible &= spans > _SPECK * side
    if not possible.any():
        refuse("no-ink", sentence="empty-page")
    main = int(np.where(possible, np.bincount(piece)[1:], 0).argmax())
    stroke = float(np.percentile(depth[labels == main + 1], 90))
    possible &= spans >= _PART * spans[main]
    possible &= ndimage.maximum(depth[mask], piece, pieces) >= _THIN_PART * stroke
    # Pieces that are near each other are one digit.
    away = ndimage.distance_transform_cdt(~np.isin(labels, pieces[possible]))
    groups = ndimage.maximum(ndimage.label(away <= _GAP / 2 * spans[main])[0][mask], piece, pieces)
    digits = np.unique(groups[possible & (spans >= _OTHER * spans[main])])
    if len(digits) > 1:
        refuse("several-digits", len(digits))
    digit = np.isin(labels, pieces[possible & (groups == groups[main])])
    if from_rim[1:-1, 1:-1][digit].min() <= _NEAR_PX:
        refuse("cut-off")
    _check(digit, float(depth[digit].max()), inside)
    if np.percentile(slopes[digit & edges], 10) < _SOFT:
        refuse("not-a-digit", "ink whose edges are blurred in part", "the edges of a pen")
    return digit


def _check(digit: Bool, depth_px: float, inside: Bool) -> None:
    """Refuse ink that is too small, too wide or a blob."""
    height, width = (int(np.ptp(np.flatnonzero(digit.any(axis=axis)))) + 1 for axis in (1, 0))
    small = max(height, width) / min(int(inside.any(axis=axis).sum()) for axis in (0, 1))
    thick, wide = 2 * depth_px / max(height, width), width / height
    for fits, what, expected in (
        (small >= _SMALLEST, f"ink of {small:.0%} of the page", f"{_SMALLEST:.0%} or more"),
        (wide <= _WIDEST, f"ink {wide:.1f} times as wide as it is high", f"{_WIDEST} times at most"),
        (thick <= _BLOB, f"ink {thick:.0%} as thick as it is long", f"{_BLOB:.0%} at most"),
    ):
        if not fits:
            refuse("not-a-digit", what, expected)
