"""From the image of a digit to its ink: the first step of Algorithm 1."""

from __future__ import annotations

from typing import Literal

from mnist3d.ink.bridges import join_bodies
from mnist3d.ink.cleaning import clean
from mnist3d.ink.grey_levels import (
    PAPER_SHARE,
    SMALL_PX,
    as_levels,
    dark_on_light,
    margin,
    otsu_threshold,
    require_paper_around,
)
from mnist3d.ink.photographs import even_out, is_clean
from mnist3d.ink.refusals import refuse
from mnist3d.ink.sheet import fit
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.array_types import AnyArray, Bool, UInt8
from tactile_toolkit.errors import InputError


def binarise(
    pixels: AnyArray,
    spec: SolidSpec,
    *,
    ink: Literal["auto", "dark", "light"] = "auto",
    resample: bool = False,
) -> Bool:
    """Return the ink that becomes the solid: binarised, cleaned and, with ``spec.join_bodies``, joined.

    Parameters and errors are those of :func:`mnist3d.solidify`; the mask has the shape (H, W).
    """
    if ink not in ("auto", "dark", "light"):
        raise InputError(f"ink is {ink!r}; expected 'auto', 'dark' or 'light'")
    levels = as_levels(pixels)
    if ink == "auto" and spec.threshold is not None:
        ink = "dark"  # levels up to the threshold are ink
    elif ink == "auto" and not is_clean(levels):
        levels, ink = even_out(levels), "dark"
    levels, otsu = dark_on_light(levels, ink)
    if resample:
        # The threshold of the image does not fit resampled levels.
        levels, otsu = fit(levels), None
    elif max(levels.shape) < SMALL_PX:
        height_px, width_px = levels.shape
        size_mm = max(height_px, width_px) * spec.pixel_pitch_mm
        refuse("too-small", width_px, height_px, size_mm, SMALL_PX)
    mask = clean(ink_of_levels(levels, otsu if spec.threshold is None else spec.threshold), spec)
    if spec.join_bodies:
        mask = join_bodies(mask, spec.bridge_width_mm / spec.pixel_pitch_mm)
    return mask


def ink_of_levels(levels: UInt8, threshold: float | None = None) -> Bool:
    """Separate ink (True) from paper in grey levels from 0 (ink) to 255 (paper).

    Pixels up to the threshold, by default Otsu's of the image, are ink. Raises ItemError ``no-ink``,
    ``all-ink`` (the image or most of its margin is ink) or ``cut-off``.
    """
    darkest = int(levels.min())
    if threshold is None:
        if darkest == levels.max():
            refuse("no-ink" if darkest > 127 else "all-ink", darkest, sentence="one-level")
        threshold = otsu_threshold(levels)
    mask = levels <= threshold
    if not mask.any():
        refuse("no-ink")
    paper = float(1 - margin(mask).mean())
    if mask.all() or paper <= 1 - PAPER_SHARE:
        refuse("all-ink", 1 - paper, PAPER_SHARE)
    require_paper_around(mask)
    return mask
