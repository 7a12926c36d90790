"""Grey levels of images of any number type, and which of them are paper."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.array_types import AnyArray, Bool, UInt8
from tactile_toolkit.errors import ItemError

if TYPE_CHECKING:
    pass
from mnist3d.ink.refusals import refuse

MIN_SIDE_PX = 8
"""Smaller images cannot show a digit."""

SMALL_PX = 64
"""Images whose longer side is shorter would make a block of a few millimetres: they are to be resampled."""

PAPER_SHARE = 0.75
"""At least so much of the margin of an image is paper; the margin is a fiftieth of the shorter side wide."""

MOST_INK = 0.5
"""More ink than such a share of an image is not a digit, but what surrounds its page."""

MOST_BORDER = 0.05
"""Ink that touches more of the border of an image is cut off, or not ink at all."""


def as_levels(pixels: AnyArray) -> UInt8:
    """Turn an image of any number type into grey levels from 0 to 255; ItemError where it has none."""
    image = np.asarray(pixels)
    if image.ndim != 2 or min(image.shape) < MIN_SIDE_PX:
        refuse("bad-shape", image.shape, MIN_SIDE_PX)
    if image.dtype == np.uint8:
        return image
    if image.dtype == np.bool_:
        return np.where(image, np.uint8(255), np.uint8(0))
    if image.dtype.kind not in "iuf":
        refuse("bad-dtype", image.dtype)
    if not np.isfinite(image).all():
        refuse("not-finite", int((~np.isfinite(image)).sum()))
    if image.min() < 0 or image.max() > 255:
        refuse("bad-range", image.min(), image.max())
    if image.dtype.kind == "f" and image.max() <= 1:
        image = image.astype(np.float64) * 255
    return np.round(image).astype(np.uint8)


def levels_and_threshold(pixels: AnyArray, ink: str) -> tuple[UInt8, int | None]:
    """Turn an image of any number type into grey levels from 0 (ink) to 255 (paper).

    Integers are levels from 0 to 255, floats run from 0 to 1 or to 255, bool has two levels. With ``"auto"``
    the margin of the image is paper. Otsu's threshold comes with them where it is known by then. Raises
    ItemError ``bad-shape``, ``bad-dtype``, ``not-finite``, ``bad-range`` or ``unclear-ink``.
    """
    levels = as_levels(pixels)
    threshold = otsu_threshold(levels) if ink == "auto" and levels.min() < levels.max() else None
    if ink == "light" or (threshold is not None and paper_is_dark(levels, threshold, "the image")):
        return 255 - levels, None
    return levels, threshold


def margin(values: AnyArray) -> AnyArray:
    """Return the pixels along the edge of an image, a fiftieth of the shorter side wide."""
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
    # scikit-image finds the same, but importing it costs every process up to a second.
    # Most of a page is white: the rest is counted.
    counts = np.bincount(levels[levels < 255], minlength=256).astype(np.float64)
    counts[255] = levels.size - counts.sum()
    below = np.cumsum(counts)
    weighted = np.cumsum(counts * np.arange(256))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = (weighted[-1] * below / below[-1] - weighted) ** 2 / (below * (below[-1] - below))
    return int(np.nanargmax(np.where(np.isfinite(spread), spread, -1.0)))


_PAPER = 255
# Rounding by whoever wrote the file may have left white that much above the scale.
_HALF_LEVEL = 0.5 / 255


def as_grey(values: AnyArray, full_scale: float, where: str) -> UInt8:
    """Turn brightness (0 for black, `full_scale`, 1 or 255, for white) into the nearest grey levels.

    `where` names file and row. Raises ItemError ``"not-finite"`` for NaN or infinite values, ``"bad-pixels"``
    for values more than half a grey level outside the scale.
    """
    if values.dtype == np.uint8 and full_scale == _PAPER:
        return np.array(values, order="C")
    next_step = "repair or rescale this image in the file, or leave it out"
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        count = int(np.count_nonzero(~np.isfinite(values)))
        found = f"{where}: found {count} pixels that are NaN or infinite, expected finite levels"
        raise ItemError("not-finite", found, next=next_step)
    low, high = float(values.min()), float(values.max())
    slack = full_scale * _HALF_LEVEL
    if low < -slack or high > full_scale + slack:
        found = f"{where}: found pixels from {low:g} to {high:g}, expected 0 to {full_scale:g}"
        raise ItemError("bad-pixels", found, next=next_step)
    if values.dtype.kind in "iu" and full_scale == _PAPER:
        return values.astype(np.uint8, order="C")
    levels = np.rint(values.astype(np.float64) * (_PAPER / full_scale))
    return np.clip(levels, 0, _PAPER).astype(np.uint8, order="C")


def require_paper_around(mask: Bool) -> None:
    """Refuse ink that covers more than half of an image, or touches a twentieth of its border.

    Raises ItemError ``all-ink`` or ``cut-off``.
    """
    covered = np.count_nonzero(mask) / mask.size
    if covered > MOST_INK:
        refuse("all-ink", covered, sentence="half-ink")
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    touched = float(border.mean())
    if touched > MOST_BORDER:
        refuse("cut-off", touched, MOST_BORDER, sentence="border")
