"""Grey levels of images of any number type, and which of them are paper."""

from __future__ import annotations

import numpy as np

from mnist3d.ink.refusals import refuse
from tactile_toolkit.array_types import AnyArray, Bool, UInt8
from tactile_toolkit.wording import with_count

MIN_SIDE_PX = 8
"""Smaller images cannot show a digit."""

SMALL_PX = 64
"""Least length of the longer side; smaller images would make a block of a few millimetres."""

PAPER_SHARE = 0.75
"""Least share of the margin of an image that is paper; the margin is 1/50 of the shorter side wide."""

MAX_INK, MAX_DRAWN = 0.5, 0.95
"""Ink that covers more of an image than this share surrounds its page, and is no digit, or no drawing."""

MAX_BORDER = 0.05
"""Ink that touches more of the border of an image than this share is cut off, or not ink at all."""

_WHITE = 255
_SLACK = 0.5 / _WHITE
"""Values may lie half a level outside the scale, by rounding when a file was written."""


def as_levels(pixels: AnyArray) -> UInt8:
    """Convert an image of any number type to grey levels from 0 to 255.

    Integers are levels from 0 to 255, floats run from 0 to 1 or to 255, bool has two levels. Raises ItemError
    ``bad-shape``, ``bad-dtype``, ``not-finite`` or ``bad-pixels``.
    """
    image = np.asarray(pixels)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE_PX:
        refuse("bad-shape", image.shape, MIN_SIDE_PX)
    if image.dtype == np.uint8:
        return image
    if image.dtype.kind not in "biuf":
        refuse("bad-dtype", image.dtype)
    full_scale = _WHITE
    if image.dtype.kind in "bf" and image.max() <= 1:
        full_scale = 1
    return as_grey(image, full_scale, "the image")


def as_grey(values: AnyArray, full_scale: float, where: str) -> UInt8:
    """Convert brightness, 0 for black and `full_scale` for white, to the nearest grey levels.

    `where` names file and row. Raises ItemError ``"not-finite"`` for NaN or infinite values, ``"bad-pixels"``
    for values more than half a grey level outside the scale.
    """
    if values.dtype == np.uint8 and full_scale == _WHITE:
        return np.array(values, order="C")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        refuse("not-finite", where, with_count(int(np.count_nonzero(~np.isfinite(values))), "pixels"))
    low, high = float(values.min()), float(values.max())
    slack = full_scale * _SLACK
    if low < -slack or high > full_scale + slack:
        refuse("bad-pixels", where, low, high, full_scale)
    if values.dtype.kind in "iu" and full_scale == _WHITE:
        return values.astype(np.uint8, order="C")
    levels = np.rint(values.astype(np.float64) * (_WHITE / full_scale))
    return np.clip(levels, 0, _WHITE).astype(np.uint8, order="C")


def dark_on_light(pixels: AnyArray, ink: str) -> tuple[UInt8, int | None]:
    """Return grey levels in which ink is dark, and their Otsu threshold if it was computed.

    With ``"auto"`` the margin of the image is paper. Raises ItemError ``unclear-ink``, and the reasons of
    :func:`as_levels`.
    """
    levels, threshold = as_levels(pixels), None
    if ink == "auto" and levels.min() < levels.max():
        threshold = otsu_threshold(levels)
    if ink == "light" or (threshold is not None and paper_is_dark(levels, threshold, "the image")):
        return _WHITE - levels, None
    return levels, threshold


def margin(values: AnyArray) -> AnyArray:
    """Return the pixels along the edge of an image, 1/50 of the shorter side wide."""
    wide = max(1, min(values.shape) // 50)
    middle = values[wide:-wide]
    parts = (values[:wide], values[-wide:], middle[:, :wide], middle[:, -wide:])
    return np.concatenate([part.ravel() for part in parts])


def paper_is_dark(levels: UInt8, threshold: int, where: str) -> bool:
    """Return whether the margin, which is paper, is dark; `where` names the image.

    Raises ItemError ``unclear-ink`` when less than three quarters of it are on one side of the threshold.
    """
    light = float((margin(levels) > threshold).mean())
    if 1 - PAPER_SHARE < light < PAPER_SHARE:
        refuse("unclear-ink", where, light)
    return light <= 1 - PAPER_SHARE


def otsu_threshold(levels: UInt8) -> int:
    """Return the highest level of the darker of the two groups that differ most (Otsu 1979)."""
    # Most of a page is white, so only the rest is counted.
    counts = np.bincount(levels[levels < 255], minlength=256).astype(np.float64)
    counts[255] = levels.size - counts.sum()
    below = np.cumsum(counts)
    weighted = np.cumsum(counts * np.arange(256))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = (weighted[-1] * below / below[-1] - weighted) ** 2 / (below * (below[-1] - below))
    return int(np.nanargmax(np.where(np.isfinite(spread), spread, -1.0)))


def require_paper_around(mask: Bool, most_ink: float = MAX_INK) -> None:
    """Refuse ink that covers more than a share of an image, or touches more than 1/20 of its border.

    Raises ItemError ``all-ink`` or ``cut-off``.
    """
    covered = np.count_nonzero(mask) / mask.size
    if covered > most_ink:
        refuse("all-ink", covered, most_ink, sentence="half-ink")
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    touched = float(border.mean())
    if touched > MAX_BORDER:
        refuse("cut-off", touched, MAX_BORDER, sentence="border")
