"""From an image to the ink of a digit: the first step of Algorithm 1."""

from __future__ import annotations

from typing import Literal

from mnist3d.ink.bridges import join_bodies
from mnist3d.ink.cleaning import clean
from mnist3d.ink.grey_levels import (
    PAPER_SHARE,
    SMALL_PX,
    as_levels,
    levels_and_threshold,
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
    """Find the ink that becomes the solid: binarised, cleaned and, if asked for, joined.

    Parameters and errors as of :func:`solidify`.
    """
    if ink not in ("auto", "dark", "light"):
        raise InputError(f"ink is {ink!r}; expected 'auto', 'dark' or 'light'")
    # A threshold says which side of it is ink.
    said = "dark" if ink == "auto" and spec.threshold is not None else ink
    levels = as_levels(pixels)
    if said == "auto" and not is_clean(levels):
        levels, said = even_out(levels), "dark"
    levels, threshold = levels_and_threshold(levels, said)
    if resample:
        # Other levels have another threshold.
        levels, threshold = fit(levels), None
    elif max(levels.shape) < SMALL_PX:
        height_px, width_px = levels.shape
        size_mm = max(height_px, width_px) * spec.pixel_pitch_mm
        refuse("too-small", width_px, height_px, size_mm, SMALL_PX)
    mask = clean(ink_of_levels(levels, threshold if spec.threshold is None else spec.threshold), spec)
    return join_bodies(mask, spec.bridge_width_mm / spec.pixel_pitch_mm) if spec.join_bodies else mask


def ink_of_levels(levels: UInt8, threshold: float | None = None) -> Bool:
    """Return ink (True) from paper, in grey levels from 0 (ink) to 255 (paper).

    Pixels up to the threshold are ink; by default that is Otsu's of the image. Raises ItemError ``no-ink`` or
    ``all-ink``, the latter also when the margin is ink for the most part.
    """
    darkest, lightest = int(levels.min()), int(levels.max())
    if threshold is None and lightest == darkest:
        refuse("no-ink" if darkest > 127 else "all-ink", darkest, sentence="one-level")
    mask = levels <= (otsu_threshold(levels) if threshold is None else threshold)
    if not mask.any():
        refuse("no-ink")
    paper = float(1 - margin(mask).mean())
    if mask.all() or paper <= 1 - PAPER_SHARE:
        refuse("all-ink", 1 - paper, PAPER_SHARE)
    require_paper_around(mask)
    return mask
