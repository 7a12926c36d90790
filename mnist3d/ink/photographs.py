"""Handwriting in photographs and scans: the page is found, its light evened out, and its ink checked.

A closing wider than any stroke estimates the paper around a pixel, and follows the edges of shadows and of
the page. The picture is divided by it. The dark rest is ink, unless a check finds something else: then the
picture is refused.
"""

from __future__ import annotations

import contextlib
import math
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

from mnist3d.ink import grey_levels, pages
from mnist3d.ink.pages import (
    WIDEST_STROKE,
    Ink,
    eroded,
    find_ink,
    fine_mask,
    ink_is_light,
    reflectance,
    to_coarse,
    without_shadows,
)
from tactile_toolkit.errors import ItemError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int64, UInt8
from tactile_toolkit.wording import with_count

CLEAN_LEVELS = 2
"""Largest difference, in grey levels, between the paper of a clean image and its margin."""

_CLEAN_MARGIN, _CLEAN_IMAGE = 0.9, 0.5
"""Least shares of the margin, and of the whole of a clean image, that are paper."""

_SHEET = 0.4
"""Share of the shorter side above which a blob is a sheet on a desk, not ink; blobs of MNIST reach 0.36."""

_WORK_PX = 1000
"""Longer side at which pictures are processed; digits end as 500 px."""

_CROSSED = 0.15
_NARROW = 0.5
_CORE = 0.2
_KEPT = 0.9
"""Limits of second attempts: ink on the outline, width of strokes, depth of the core, share of it kept."""

_WIDEST_PART = 0.5
"""Coloured parts of drawings are narrower than this share of the longer side."""

_GAIN = 2
"""Factor by which the greys of edges are made steeper."""

_RIM, _SPECK, _DOT = 0.05, 0.02, 0.005
"""Shares of the longer side: reach of the border of a scan, least length of a digit and of a dot."""

_PART = 0.1
_THIN_PART = 0.4
_GAP = 0.14
_OTHER = 0.2
"""Shares of the longest piece: least length and thickness of its parts, widest gap, least other digit."""

_SMALLEST, _BLOB, _WIDEST = 0.08, 0.45, 1.5
"""Least size of ink relative to the page, largest ratios of thickness to length and of width to height."""

_SOFT = 0.1
"""Least change within a pixel, as a share of the contrast, at nine tenths of the edges of ink."""

_TOUCHING, _THICK, _ALONG = 0.05, 1.5, 0.5
"""Largest share of the rim of a page that a drawing touches, its thickness there in strokes, and the share of
its own length along the rim."""

_BESIDE_PX, _EDGE = 3, 0.5
"""Ink is compared with the clearest ink so near, and ends where its contrast is this share of it."""

NEAR_PX = 2
"""Width of the grey edges of ink, pixels."""


def is_clean(levels: UInt8) -> bool:
    """Return whether an image is clean: its margin and most of the image have one level.

    Images whose shorter side has less than 64 px are clean. A sheet on a desk of one level is not, since no
    stroke is as wide as a sheet.
    """
    if min(levels.shape) < grey_levels.SMALL_PX:
        return True
    paper = int(np.median(grey_levels.margin(levels)))
    differs = (levels < max(0, paper - CLEAN_LEVELS)) | (levels > min(255, paper + CLEAN_LEVELS))
    most = (1 - _CLEAN_IMAGE) * differs.size
    if grey_levels.margin(differs).mean() > 1 - _CLEAN_MARGIN or np.count_nonzero(differs) > most:
        return False
    few = differs[:: max(1, differs.shape[0] // 128), :: max(1, differs.shape[1] // 128)]
    return not ndimage.minimum_filter(few, max(2, int(_SHEET * min(few.shape))), mode="constant").any()


def even_out(
    picture: UInt8, ink: str = "auto", *, whole: bool = False, notes: list[str] | None = None
) -> UInt8:
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
    notes : list of str, optional
        With ``whole``, sentences on what was left out are added.

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
    reduced = Image.fromarray(picture)
    if scale < 1:
        reduced = reduced.resize(size, Image.Resampling.BOX)
    levels = _even_out(_views(reduced), ink, whole, [] if notes is None else notes)
    if scale < 1:
        levels = np.asarray(Image.fromarray(levels).resize((width, height), Image.Resampling.BILINEAR))
    return levels


def _views(picture: Image.Image) -> UInt8:
    """Return the grey levels and, for a coloured picture, its three channels, shape (N, H, W)."""
    grey = np.asarray(picture.convert("L"))
    if picture.mode == "L":
        return grey[None]
    return np.stack([grey, *np.moveaxis(np.asarray(picture), -1, 0)])


def _even_out(views: UInt8, ink: str, whole: bool, notes: list[str]) -> UInt8:
    page = pages.find_page(views.min(axis=0))
    if ink == "light" or (ink == "auto" and ink_is_light(to_coarse(views[0]), page)):
        views = 255 - views
    if whole:
        return _drawing_on(views, page, notes)
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
        grey_levels.refuse("cut-off")
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
        grey_levels.refuse("no-ink", sentence="empty-page")
    return levels


_SECOND_ATTEMPTS = {"cut-off": _across_shadow, "not-a-digit": _under_fingers}


def _ink_on(views: UInt8, page: Bool, widest: float = WIDEST_STROKE) -> UInt8:
    """Return the levels of the one digit on a page."""
    inside = fine_mask(eroded(page, 2), views[0].shape)
    page_ink = find_ink(reflectance(views, page, widest), inside)
    digit = find_one_digit(pages.without_lines(without_shadows(page_ink), inside), inside, page_ink)
    return _levels_of(digit, page_ink)


def _drawing_on(views: UInt8, page: Bool, notes: list[str]) -> UInt8:
    """Return the levels of all ink on a page, and note what was left out."""
    inside = fine_mask(eroded(page, 2), views[0].shape)
    drawn = _any_ink(views, page, inside)
    inked = pages.without_lines(drawn.mask, inside)
    drawing = find_drawing(inked, inside, drawn)
    if not page.all():
        notes.append(f"left out what surrounds the page, {1 - page.mean():.0%} of the picture")
    if (drawn.mask & ~inked).any():
        notes.append("left out lines that run across the page, as on ruled paper")
    dark = inside & (drawn.reflectance < _EDGE)
    labels, _ = ndimage.label(ndimage.binary_opening(dark & ~drawing & (inked | ~drawn.mask)))
    sides = [max(part.stop - part.start for part in box) for box in ndimage.find_objects(labels)]
    count = sum(side > _SPECK * max(dark.shape) for side in sides)
    if count:
        notes.append(f"left out {with_count(count, 'grey or blurred parts')}, such as shadows")
    return _levels_of(drawing, drawn)


def _any_ink(views: UInt8, page: Bool, inside: Bool) -> Ink:
    """Return the ink of all colours, relative to the darkest or most coloured ink beside each pixel.

    So light strokes have the same edges as dark ones. The reflectance of the result is 0 for ink.
    """
    page_ink = find_ink(reflectance(views, page, WIDEST_STROKE), inside)
    relative = _relative(1 - page_ink.reflectance, pages.least_contrast(page_ink.reflectance[inside]))
    coloured = np.zeros_like(inside)
    if len(views) > 1:
        channels = np.stack([reflectance(view[None], page, _WIDEST_PART) for view in views[1:]])
        colour = _relative(grey_levels.colourfulness(channels), grey_levels.CHROMATIC)
        coloured = inside & (colour > _EDGE)
        relative = np.maximum(relative, colour)
    grey = without_shadows(page_ink._replace(mask=inside & ~coloured & (relative > _EDGE)))
    return Ink(grey | coloured, 0.0, 1 - relative)


def _relative(contrast: Float32, least: float) -> Float32:
    """Divide the contrast of ink by the greatest beside it, so that edges are where it is half of that."""
    beside = ndimage.maximum_filter(contrast, 2 * _BESIDE_PX + 1)
    return np.asarray(contrast / np.maximum(beside, least / _EDGE), np.float32)


def _levels_of(inked: Bool, page_ink: Ink) -> UInt8:
    """Return the levels of ink; the greys of its edges are kept, but steeper.

    So any threshold divides them in the same place.
    """
    gain = _GAIN * 255 / (1 - page_ink.ink)
    levels = np.rint(127.5 + gain * (page_ink.reflectance - (1 + page_ink.ink) / 2))
    near = ndimage.binary_dilation(inked, iterations=NEAR_PX) & ~page_ink.mask
    shown = np.where(near, np.clip(levels, 128, 255), 255)
    return np.where(inked, np.clip(levels, 0, 127), shown).astype(np.uint8)


def find_one_digit(mask: Bool, inside: Bool, page_ink: Ink) -> Bool:
    """Return the ink of the one digit.

    Raises ItemError ``no-ink``, ``several-digits``, ``cut-off`` or ``not-a-digit``.
    """
    pieces = _Pieces.of(mask, inside, page_ink)
    labels = pieces.labels
    numbers = pieces.numbers
    depth = pieces.depth
    spans = pieces.spans
    possible = pieces.is_sharp & (spans > _SPECK * max(mask.shape))
    # Ink along the rim only is the border of a scan.
    possible &= pieces.farthest > _RIM * max(mask.shape)
    if not possible.any():
        grey_levels.refuse("no-ink", sentence="empty-page")
    main = int(np.where(possible, np.bincount(labels[mask])[1:], 0).argmax())
    stroke = float(np.percentile(depth[labels == main + 1], 90))
    possible &= spans >= _PART * spans[main]
    possible &= pieces.greatest(depth) >= _THIN_PART * stroke
    # Pieces near each other form one digit.
    away = ndimage.distance_transform_cdt(~np.isin(labels, numbers[possible]))
    groups = pieces.greatest(ndimage.label(away <= _GAP / 2 * spans[main])[0])
    digits = np.unique(groups[possible & (spans >= _OTHER * spans[main])])
    if len(digits) > 1:
        grey_levels.refuse("several-digits", len(digits))
    digit = np.isin(labels, numbers[possible & (groups == groups[main])])
    if pieces.from_rim[digit].min() <= NEAR_PX:
        grey_levels.refuse("cut-off")
    _check(digit, float(depth[digit].max()), inside)
    if np.percentile(pieces.slopes[digit & pieces.edges], 10) < _SOFT:
        grey_levels.refuse("not-a-digit", "ink with partly blurred edges", "sharp edges, as of a pen")
    return digit


def find_drawing(mask: Bool, inside: Bool, page_ink: Ink) -> Bool:
    """Return all ink with sharp edges, except the border of a scan and specks.

    Strokes may run to the edge of the page. Raises ItemError ``no-ink``, or ``cut-off`` if something else
    reaches it, such as a finger or the desk: it is thicker than the strokes, or touches much of the edge.
    """
    pieces = _Pieces.of(mask, inside, page_ink)
    numbers = pieces.numbers
    spans = pieces.spans
    sharp = pieces.is_sharp & (spans > _DOT * max(mask.shape))
    at_rim = inside & (pieces.from_rim <= NEAR_PX)
    # The border of a scan lies along the rim; parts of a drawing may lie near it, or run into it.
    along = ndimage.sum(at_rim, pieces.labels, numbers) / NEAR_PX
    is_inner = (pieces.farthest > _RIM * max(mask.shape)) | (along < _ALONG * spans)
    if not (sharp & is_inner).any():
        grey_levels.refuse("no-ink", sentence="empty-page")
    depth = pieces.depth
    stroke = float(np.percentile(depth[np.isin(pieces.labels, numbers[sharp & is_inner])], 90))
    # A border is thinner, or longer, than what a pen leaves along the edge.
    is_mark = pieces.greatest(depth) >= _THIN_PART * stroke
    is_mark &= spans < _OTHER * max(mask.shape)
    drawing = np.isin(pieces.labels, numbers[sharp & (is_inner | is_mark)])
    touching = drawing & at_rim
    beside = drawing & ndimage.binary_dilation(touching, iterations=2 * math.ceil(stroke))
    if touching.sum() > _TOUCHING * at_rim.sum() or depth[beside].max(initial=0) > _THICK * stroke:
        grey_levels.refuse("cut-off", sentence="drawing-cut-off")
    return drawing


class _Pieces(NamedTuple):
    """The pieces of the ink on a page.

    ``labels`` numbers the piece of each pixel. The others up to ``farthest`` have a value for each piece: its
    number, its longer side, whether its edges are sharp, and its reach from the rim.
    """

    labels: AnyArray
    numbers: Int64
    spans: Int64
    is_sharp: Bool
    farthest: AnyArray
    depth: Float64
    from_rim: AnyArray
    slopes: Float32
    edges: Bool

    @classmethod
    def of(cls, mask: Bool, inside: Bool, page_ink: Ink) -> _Pieces:
        """Find the pieces; ItemError ``no-ink`` if there are none."""
        labels, count = ndimage.label(mask, np.ones((3, 3)))
        if not count:
            grey_levels.refuse("no-ink", sentence="empty-page")
        numbers = np.arange(1, count + 1)
        depth = np.asarray(ndimage.distance_transform_edt(mask))
        from_rim = ndimage.distance_transform_cdt(np.pad(inside, 1))[1:-1, 1:-1]
        # A blur of a pixel removes noise.
        slopes = ndimage.gaussian_gradient_magnitude(page_ink.reflectance, 1.0) / (1 - page_ink.ink)
        slopes = ndimage.maximum_filter(slopes, 3)
        edges = (depth > 0) & (depth <= 1)
        boxes = ndimage.find_objects(labels)
        spans = np.array([max(part.stop - part.start for part in box) for box in boxes])
        farthest = np.asarray(ndimage.maximum(from_rim[mask], labels[mask], numbers))
        is_sharp = np.asarray(ndimage.median(slopes[edges], labels[edges], numbers)) >= _SOFT
        return cls(labels, numbers, spans, is_sharp, farthest, depth, from_rim, slopes, edges)

    def greatest(self, values: AnyArray) -> AnyArray:
        """Return the greatest value of a map in each piece."""
        # Without the paper, which would be sorted, too: that takes most of the time.
        ink = self.labels > 0
        return np.asarray(ndimage.maximum(values[ink], self.labels[ink], self.numbers))


def _check(digit: Bool, depth_px: float, inside: Bool) -> None:
    """Refuse ink that is too small, too wide or a blob."""
    height, width = (int(np.ptp(np.flatnonzero(digit.any(axis=axis)))) + 1 for axis in (1, 0))
    small = max(height, width) / min(int(inside.any(axis=axis).sum()) for axis in (0, 1))
    thick = 2 * depth_px / max(height, width)
    wide = width / height
    for fits, what, expected in (
        (small >= _SMALLEST, f"ink as long as {small:.0%} of the page", f"{_SMALLEST:.0%} or more"),
        (wide <= _WIDEST, f"ink {wide:.1f} times as wide as it is high", f"at most {_WIDEST} times"),
        (thick <= _BLOB, f"ink as thick as {thick:.0%} of its length", f"at most {_BLOB:.0%}"),
    ):
        if not fits:
            grey_levels.refuse("not-a-digit", what, expected)
