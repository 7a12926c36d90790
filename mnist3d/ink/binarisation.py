"""Ink of a digit image as an unambiguous mask: the first step of Algorithm 1.

The mask that :func:`clean` returns has no specks, no pinholes and no two pixels that touch at a corner only.
Its numbers of bodies and holes are the same whether corners connect or not, so the solid can be compared with
them.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from mnist3d.compiled_loops import runs_of
from mnist3d.digit_options import SolidSpec
from mnist3d.ink.grey_levels import (
    MAX_INK,
    PAPER_SHARE,
    SMALL_PX,
    as_levels,
    dark_on_light,
    margin,
    otsu_threshold,
    refuse,
    require_paper_around,
)
from mnist3d.ink.photographs import even_out, is_clean
from tactile_toolkit import mesh
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Bool, Float64, Int64, UInt8

CONTACT_PX = 3
"""Largest number of pixels at which a speck may touch wider ink."""

_CORNERS_CONNECT = np.ones((3, 3), dtype=bool)

# A strip of width w is w / 4 deep on average.
_WIDTH_PER_DEPTH = 4.0

INKS = ("auto", "dark", "light")
"""Polarity of ink in pictures; ``"auto"`` decides for each."""


def binarise(pixels: AnyArray, spec: SolidSpec, *, ink: Literal["auto", "dark", "light"] = "auto") -> Bool:
    """Return the ink that becomes the solid: binarised, cleaned and, with ``spec.join_bodies``, joined.

    Parameters
    ----------
    pixels : ndarray, shape (H, W)
        Grey levels of one digit, whose side is ``spec.pixel_pitch_mm``.
    spec : SolidSpec
        Parameters of the algorithm.
    ink : {"auto", "dark", "light"}
        Which part is ink, as for :func:`mnist3d.solidify`.

    Returns
    -------
    ndarray of bool, shape (H, W)

    Raises
    ------
    ItemError
        As :func:`mnist3d.solidify`; ``several-digits`` or ``not-a-digit`` for a photograph of more, or of
        something else.
    """
    levels, otsu = ink_levels(pixels, spec.threshold, ink)
    require_large(levels, spec)
    return cleaned_ink(levels, spec, otsu)


def ink_levels(
    pixels: AnyArray, threshold: float | None, ink: str, *, whole: bool = False
) -> tuple[UInt8, int | None]:
    """Return levels of an array in which ink is dark, and their Otsu threshold if it was computed.

    With ``"auto"``, levels up to a given ``threshold`` are ink, and the light of images without clean paper
    is evened out; ``whole`` is as for :func:`~mnist3d.ink.photographs.even_out`.
    """
    if ink not in INKS:
        raise InputError(f"ink is {ink!r}; expected 'auto', 'dark' or 'light'")
    levels = as_levels(pixels)
    if ink == "auto" and threshold is not None:
        ink = "dark"
    elif ink == "auto" and not is_clean(levels):
        levels = even_out(levels, whole=whole)
        ink = "dark"
    return dark_on_light(levels, ink)


def require_large(levels: UInt8, spec: SolidSpec) -> None:
    """Refuse an image that makes a block of a few millimetres; ItemError ``too-small``."""
    if max(levels.shape) < SMALL_PX:
        height_px, width_px = levels.shape
        size_mm = max(height_px, width_px) * spec.pixel_pitch_mm
        refuse("too-small", width_px, height_px, size_mm, SMALL_PX)


def cleaned_ink(
    levels: UInt8, spec: SolidSpec, threshold: float | None = None, most_ink: float = MAX_INK
) -> Bool:
    """Return clean ink of dark levels and, with ``spec.join_bodies``, join it.

    ``spec.threshold`` is used if it is given, then ``threshold``, then Otsu's.
    """
    if spec.threshold is not None:
        threshold = spec.threshold
    mask = clean(ink_of_levels(levels, threshold, most_ink), spec)
    if spec.join_bodies:
        mask = join_bodies(mask, spec.bridge_width_mm / spec.pixel_pitch_mm)
    return mask


def ink_of_levels(levels: UInt8, threshold: float | None = None, most_ink: float = MAX_INK) -> Bool:
    """Separate ink (True) from paper in grey levels from 0 (ink) to 255 (paper).

    Pixels up to the threshold, by default Otsu's of the image, are ink. Raises ItemError ``no-ink``,
    ``all-ink`` (more than ``most_ink`` of the image, or most of its margin, is ink) or ``cut-off``.
    """
    darkest = int(levels.min())
    if threshold is None:
        if darkest == levels.max():
            reason = "no-ink" if darkest > 127 else "all-ink"
            refuse(reason, darkest, sentence="one-level")
        threshold = otsu_threshold(levels)
    mask = levels <= threshold
    if not mask.any():
        refuse("no-ink")
    paper = float(1 - margin(mask).mean())
    if mask.all() or paper <= 1 - PAPER_SHARE:
        refuse("all-ink", 1 - paper, PAPER_SHARE)
    require_paper_around(mask, most_ink)
    return mask


def clean(mask: Bool, spec: SolidSpec) -> Bool:
    """Remove specks and pinholes, and repair corner contacts, so that 4- and 8-connectivity agree.

    Specks that touch a stroke by a few pixels are removed, too: they would become fins that no printer makes.

    Raises ItemError ``no-ink`` if there were only specks.
    """
    speck_px, pinhole_px = (
        area / spec.pixel_pitch_mm**2 for area in (spec.min_speck_mm2, spec.min_pinhole_mm2)
    )
    cleaned = np.zeros_like(mask)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows):
        # Only the window with ink is processed: most of a page is paper.
        window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        # Corners first: removing whole pieces later makes no new corner contact.
        inked = repair_corners(np.pad(mask[window], 1))
        # The first piece is the paper around the digit, which is not a pinhole.
        inked = ~_without_small(~inked, pinhole_px, first_stays=True)
        inked = _without_small(inked, speck_px)
        cleaned[window] = _without_attached_specks(inked, speck_px)[1:-1, 1:-1]
    if not cleaned.any():
        refuse("no-ink", spec.min_speck_mm2, sentence="only-specks")
    return cleaned


def repair_corners(mask: Bool) -> Bool:
    """Fill one pixel wherever two pixels of ink touch at a corner only; no ink is removed."""
    mask = mask.copy()
    while True:
        upper_left, upper_right = mask[:-1, :-1], mask[:-1, 1:]
        lower_left, lower_right = mask[1:, :-1], mask[1:, 1:]
        falling = upper_left & lower_right & ~upper_right & ~lower_left
        rising = upper_right & lower_left & ~upper_left & ~lower_right
        if not (falling.any() or rising.any()):
            return mask
        mask[1:, :-1] |= falling
        mask[1:, 1:] |= rising


def _without_small(mask: Bool, min_px: float, *, first_stays: bool = False) -> Bool:
    """Remove pieces smaller than a limit; the first may stay whatever its size."""
    runs, piece = _pieces(mask)
    small = np.bincount(piece, runs[:, 2] - runs[:, 1])[piece] < min_px
    if first_stays:
        small[piece == 0] = False
    if small.any():
        mask = mask.copy()
        for row, begin, end in runs[small].tolist():
            mask[row, begin:end] = False
    return mask


def _pieces(mask: Bool) -> tuple[Int64, Int64]:
    """Return the runs of marked pixels, (row, begin, end) each, and for each the first run of its piece."""
    runs, touching = runs_of(mask)
    return runs, mesh.connected(touching[0], touching[1], len(runs))


def _without_attached_specks(mask: Bool, min_px: float) -> Bool:
    """Remove specks that touch the side of wider ink by a few pixels.

    A thin stroke stays, as it is longer than a round speck of the limit is wide. A tip stays, as it sits on
    ink that grows narrower. The mask must have a border of paper, one pixel wide.
    """
    # The roughness of an outline does not reach two pixels beyond ink that is five pixels wide.
    wide = _opened(mask, 2)
    beyond = mask & ~grown(wide)
    if not beyond.any():
        return mask
    cleaned = mask.copy()
    sides = grown(_opened(mask, 6))
    labels, _ = ndimage.label(mask & ~wide)
    for label in np.unique(labels[beyond]):
        piece = labels == label
        rows, columns = np.nonzero(piece)
        contact = wide & grown(piece, corners=False)
        is_small = math.pi / 4 * max(np.ptp(rows) + 1, np.ptp(columns) + 1) ** 2 < min_px
        touches = contact.sum() <= CONTACT_PX and not (contact & ~sides).any()
        # Ink with two contacts is a bridge.
        if is_small and touches and ndimage.label(contact, _CORNERS_CONNECT)[1] == 1:
            cleaned &= ~piece
    return repair_corners(cleaned)


def _opened(mask: Bool, radius_px: int) -> Bool:
    """Open a mask (erode, then dilate it) by an octagon that is ``2 * radius_px + 1`` pixels wide."""
    # Shifts of the whole mask take 1/12 of the time of scipy's opening (0.5 and 5.6 ms at radius 6).
    # Steps with and without corners in turn add up to octagons.
    paper = ~mask
    for step in range(radius_px):
        paper = grown(paper, corners=step % 2 == 0)
    ink = ~paper
    for step in range(radius_px):
        ink = grown(ink, corners=step % 2 == 0)
    return ink


def grown(mask: Bool, *, corners: bool = True) -> Bool:
    """Dilate a mask by a pixel to its sides and, if corners connect, to its corners."""
    wider = mask.copy()
    wider[1:] |= mask[:-1]
    wider[:-1] |= mask[1:]
    across = wider.copy() if corners else mask
    wider[:, 1:] |= across[:, :-1]
    wider[:, :-1] |= across[:, 1:]
    return wider


def count_bodies_and_holes(mask: Bool) -> tuple[int, int]:
    """Count the pieces of clean ink and the paper spots that ink encloses; outside the mask is paper."""
    runs, piece = _pieces(mask)
    bodies = int(np.count_nonzero(piece == np.arange(len(runs))))
    # Euler's formula over pixel centres: bodies - holes = centres - sides + squares.
    beside = mask[:, 1:] & mask[:, :-1]
    below = mask[1:] & mask[:-1]
    sides = np.count_nonzero(beside) + np.count_nonzero(below)
    euler = np.count_nonzero(mask) - sides + np.count_nonzero(beside[1:] & beside[:-1])
    return bodies, bodies - int(euler)


def join_bodies(mask: Bool, width_px: float) -> Bool:
    """Join pieces of clean ink by straight bars until one is left, so that the drawing prints in one piece.

    Each round joins the first piece to the nearest other one, where they are closest. A bar reaches into the
    ink at both ends by half its width, so that the joint is as wide as the bar. Bars are as wide as the
    strokes, and at most ``width_px``: wider ones would fill letters.
    """
    bar_px = None
    while True:
        labels, count = ndimage.label(mask)
        if count < 2:
            return mask
        bar_px = bar_px or min(width_px, stroke_width_px(mask))
        here, there = (np.argwhere(part).astype(np.float64) for part in (labels == 1, labels > 1))
        distances, nearest = map(np.asarray, cKDTree(there).query(here))
        # Straight edges are close along a stretch; a bridge in its middle is better than at its end.
        close = np.flatnonzero(distances <= distances.min() + 0.5)
        middle = int(close[len(close) // 2])
        mask = repair_corners(mask | _bar(mask.shape, here[middle], there[nearest[middle]], bar_px))


def stroke_width_px(mask: Bool) -> float:
    """Return the width of the strokes of ink, by its mean depth."""
    return float(_WIDTH_PER_DEPTH * _depth_px(mask)[mask].mean())


def thinnest_stroke_px(mask: Bool) -> float:
    """Return the width of the strokes of the piece of ink with the thinnest ones."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    mask = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
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
    forward = down * along[0] + across * along[1]
    aside = across * along[0] - down * along[1]
    # 0.75 px joins pieces that lie diagonally, however thin the bar.
    half = max(width_px / 2, 0.75)
    return np.asarray((np.abs(aside) <= half) & (forward >= -half) & (forward <= length + half))
