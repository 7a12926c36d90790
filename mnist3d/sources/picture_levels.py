"""Pictures of digits as grey levels: 0 for ink, 255 for paper."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import mnist3d.ink
from mnist3d.ink.colours import ink_of_colours, is_graphic, loses_colours, unlike_paper
from mnist3d.ink.grey_levels import (
    MAX_DRAWN,
    MAX_INK,
    as_grey,
    margin,
    otsu_threshold,
    paper_is_dark,
    require_paper_around,
)
from mnist3d.sources.picture_files import decode_page
from tactile_toolkit.array_types import Bool, UInt8
from tactile_toolkit.errors import ItemError

# Possible levels of white in integers: cameras and scanners store 10, 12 or 14 bits in 16.
_WHITES: tuple[int, ...] = (255, 1023, 4095, 16_383, 65_535)
# A picture with a smaller range of grey levels shows paper only.
_CONTRAST = 24
# Transparent pictures whose visible part is lighter than this share of white lie on black paper.
_MOSTLY_LIGHT = 0.5
_HALF_OPAQUE = 127.5


def read_picture(
    path: Path, ink: str = "auto", threshold: str = "auto", page: int = 0, *, whole: bool = False
) -> UInt8:
    """Read a picture in its own size, with ink 0 and paper 255; see :func:`picture_levels`.

    Parameters
    ----------
    path : Path
        File of any type that :data:`ENDINGS` lists.
    ink, threshold, whole
        As for :func:`picture_levels`.
    page : int
        Number of the page, from 0.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        ``"unreadable"``, and those of :func:`picture_levels`.
    """
    try:
        return picture_levels(decode_page(path, page), ink, threshold, str(path), whole=whole)
    except ItemError as error:
        if str(path) in error.message:
            raise
        raise ItemError(error.reason, f"{path}: {error.message}") from error


def picture_levels(
    picture: Image.Image, ink: str, threshold: str, where: str, *, whole: bool = False
) -> UInt8:
    """Return the ink of a picture as grey levels from 0 (ink) to 255 (paper), in its own size.

    Transparency shows paper. The light of photographs and scans is evened out (``mnist3d.ink.even_out``).
    The grey levels of clean images are stretched so that paper is white and ink black, unless there is no
    contrast (an empty page). With ``"auto"`` the margin of a clean image is paper, on either side of Otsu's
    threshold. Colours that grey levels lose are ink, too (:mod:`mnist3d.ink.colours`).

    Parameters
    ----------
    picture : PIL.Image.Image
        Upright, in mode L, RGB, RGBA, or one of more than 8 bits (F, I).
    ink : {"auto", "dark", "light"}
        Which part is ink.
    threshold : {"auto", "local", "global"}
        Even out only pictures that are not clean, all pictures, or none.
    where : str
        Name of the picture for messages.
    whole : bool
        The picture is a drawing of any parts, not one digit: photographs keep all their ink.

    Returns
    -------
    ndarray of uint8, shape (H, W)

    Raises
    ------
    ItemError
        ``"not-finite"`` or ``"bad-pixels"`` for floating-point pictures; ``"unclear-ink"`` when less than
        three quarters of the margin are on one side of the threshold; ``"all-ink"`` or ``"cut-off"`` when
        there is too much ink; and those of ``mnist3d.ink.even_out``.
    """
    flat = _over_paper(picture, ink) if picture.mode == "RGBA" else picture
    grey = _brightness(flat, where)
    colours = np.asarray(flat) if flat.mode == "RGB" else grey
    is_flat = np.ptp(grey) < _CONTRAST
    # Ink and paper of different colours may have the same grey.
    is_coloured = is_flat and np.ptp(colours, axis=(0, 1)).max() >= _CONTRAST
    is_clean = _is_cut_out(picture) or mnist3d.ink.is_clean(grey) or (whole and is_graphic(colours))
    most_ink = MAX_DRAWN if whole else MAX_INK
    if threshold == "local" or (threshold == "auto" and not is_clean):
        return mnist3d.ink.even_out(colours, ink, whole=whole)
    level = otsu_threshold(grey)
    if ink == "light" or (ink == "auto" and not is_flat and paper_is_dark(grey, level, where)):
        grey, level = 255 - grey, 254 - level
    dark = grey <= level
    if colours.ndim == 3 and ink != "light":
        away = unlike_paper(colours)
        if is_coloured or loses_colours(away, dark & ~np.bool_(is_flat)):
            grey = ink_of_colours(away)
            require_paper_around(grey < 128, most_ink)
            return grey
    # Without both ink and paper there is no contrast to stretch.
    if is_flat or dark.all() or not dark.any():
        return grey
    require_paper_around(dark, most_ink)
    return _stretched(grey, dark)


def _stretched(grey: UInt8, dark: Bool) -> UInt8:
    """Stretch grey levels so that dark ink becomes 0 and the rest, paper, 255."""
    # Ink of thin strokes is mostly edge, so its median would be too light; single dark pixels are specks.
    darkest, paper = float(np.percentile(grey[dark], 10)), float(np.median(grey[~dark]))
    table = np.clip((np.arange(256) - darkest) * (255 / (paper - darkest)), 0, 255)
    levels: UInt8 = np.rint(table).astype(np.uint8)[grey]
    return levels


def _brightness(picture: Image.Image, where: str) -> UInt8:
    if picture.mode in ("L", "RGB"):
        return np.asarray(picture.convert("L"))
    values, whites = np.asarray(picture), (1, 255) if picture.mode == "F" else _WHITES
    largest = float(np.fmax.reduce(values, axis=None, initial=0))
    return as_grey(values, next((float(each) for each in whites if largest <= each), whites[-1]), where)


def _is_cut_out(picture: Image.Image) -> bool:
    """Return whether the margin of a picture is transparent, which shows that it is paper."""
    return picture.mode == "RGBA" and margin(np.asarray(picture.getchannel("A"))).mean() < _HALF_OPAQUE


def _over_paper(picture: Image.Image, ink: str) -> Image.Image:
    """Lay a transparent picture on white paper, or on black if it has light ink only."""
    alpha = np.asarray(picture.getchannel("A"), np.float32)[..., None] / 255
    colours = np.asarray(picture.convert("RGB"), np.float32)
    light = np.asarray(picture.convert("RGB").convert("L"), np.float32)[..., None]
    cut_out = ink == "auto" and _is_cut_out(picture)
    paper = 255
    if ink == "light" or (cut_out and (light * alpha).sum() > _MOSTLY_LIGHT * 255 * alpha.sum()):
        paper = 0
    return Image.fromarray(np.rint(colours * alpha + paper * (1 - alpha)).astype(np.uint8))
