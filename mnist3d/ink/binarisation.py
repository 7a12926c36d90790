"""Ink of a digit image: the first step of Algorithm 1."""

from __future__ import annotations

from typing import Literal

from mnist3d.ink.bridges import join_bodies
from mnist3d.ink.cleaning import clean
from mnist3d.ink.grey_levels import (
    MAX_INK,
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
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.array_types import AnyArray, Bool, UInt8
from tactile_toolkit.errors import InputError

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
        As :func:`mnist3d.solidify`.
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
        levels, ink = even_out(levels, whole=whole), "dark"
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
