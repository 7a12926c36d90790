"""Pictures divided by the paper around each pixel, and the ink in them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from mnist3d.ink.coarse_pictures import WIDEST_STROKE, eroded, paper_around, to_coarse, to_fine
from mnist3d.ink.refusals import refuse
from tactile_toolkit.array_types import Bool, Float32, UInt8

_BOARD = 140
"""Highest grey level of paper that can have lighter ink."""

_CONTRAST, _DEVIATIONS = 0.15, 6
"""Least difference of ink from paper: as a share, and in standard deviations of the paper."""

# Standard deviation over median absolute deviation, for a normal distribution.
_DEVIATION_PER_MAD = 1.4826

_MIDDLE, _SHADOW_PX = 0.35, 3 / 700
"""Least lightness of shadows, from ink (0) to paper (1), and least width as a share of the longer side."""


class Ink(NamedTuple):
    """The ink in a picture that was divided by its paper."""

    mask: Bool
    ink: float
    """Reflectance of ink; that of paper is 1."""
    reflectance: Float32


def ink_is_light(coarse: UInt8, page: Bool) -> bool:
    """Return whether the few pixels that differ from the page around them are lighter than the page."""
    if np.median(coarse[page]) > _BOARD:
        return False
    # The surroundings of the page are filled with its nearest pixels.
    places = ndimage.distance_transform_edt(~page, return_distances=False, return_indices=True)
    beyond = coarse[tuple(places)].astype(np.float32)
    tiny = beyond[::3, ::3]
    paper = ndimage.median_filter(tiny, int(max(tiny.shape) * 2 * WIDEST_STROKE) | 1, mode="nearest")
    paper = np.kron(paper, np.ones((3, 3)))[: coarse.shape[0], : coarse.shape[1]]
    seen = eroded(page, 4)
    if not seen.any():
        return False
    darkest, lightest = np.percentile(np.log((beyond + 8) / (paper + 8))[seen], [0.5, 99.5])
    return bool(lightest > -1.5 * darkest)


def _deviation(values: Float32) -> float:
    """Return a robust standard deviation, from the median distance from the median."""
    return float(_DEVIATION_PER_MAD * np.median(np.abs(values - np.median(values))))


def reflectance(views: UInt8, page: Bool, widest: float) -> Float32:
    """Divide the view with the clearest ink by the paper around each pixel; paper becomes 1."""
    inside = eroded(page, 2)
    if not inside.any():
        refuse("no-ink", sentence="empty-page")
    best, divided = -1.0, np.ones(views.shape[1:], np.float32)
    for number, view in enumerate(views):
        coarse = to_coarse(view)
        paper = paper_around(coarse, widest)
        seen = np.divide(coarse, paper, dtype=np.float32)[inside]
        level = float(np.median(seen))
        if level == 0:
            continue  # a channel in which most of the picture is black shows no paper
        clearness = (level - float(np.percentile(seen, 0.5))) / (_deviation(seen) + 0.01 * level)
        if number == 0:
            clearness *= 1.3  # grey has less noise than single channels
        if clearness > best:
            divided = np.divide(view, to_fine(paper, view.shape), dtype=np.float32) / np.float32(level)
            best = clearness
    return divided


def find_ink(reflectance: Float32, inside: Bool) -> Ink:
    """Return the pixels inside the page whose reflectance is nearer to ink than to paper."""
    values = reflectance[inside]
    ink = float(np.percentile(values, 0.3))
    for _ in range(4):
        dark = values[values < (1 + ink) / 2]
        ink = 1.0
        if dark.size:
            ink = float(np.median(dark))
    if 1 - ink < max(_CONTRAST, _DEVIATIONS * _deviation(values[::7])):
        refuse("no-ink", sentence="empty-page")
    return Ink((reflectance < (1 + ink) / 2) & inside, ink, reflectance)


def without_shadows(found: Ink) -> Bool:
    """Remove parts that are lighter than ink, such as shadows of fingers, but keep the edges of ink."""
    middle = found.mask & (found.reflectance > found.ink + _MIDDLE * (1 - found.ink))
    steps = max(1, round(_SHADOW_PX * max(middle.shape)))
    wide = ndimage.minimum_filter(middle, 2 * steps + 1)
    if not wide.any():
        return found.mask
    return found.mask & ~(middle & ndimage.maximum_filter(wide, 4 * steps + 1))
