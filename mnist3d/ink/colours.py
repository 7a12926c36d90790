"""Coloured drawings: everything whose colour differs from that of the paper is ink.

Grey levels alone lose light colours: the grey of an orange sun is nearer to white paper than to a black
outline. Here a pixel is compared with the paper by its largest difference in a channel.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from mnist3d.ink.grey_levels import margin
from tactile_toolkit.array_types import Bool, Float32, UInt8

DIFFERENT = 32
"""Least difference of ink from paper in one channel, grey levels; noise of JPEG near edges is half of it."""

CHROMATIC = 0.15
"""Least difference between the reflectances of channels where ink of a photograph has a colour."""

_SQUARE = np.ones((3, 3), bool)
# Largest range of levels within 3 x 3 pixels of an evenly coloured part.
_EVEN = 16
# Pixels that an edge is wide; ink is compared with the darkest ink so near.
_EDGE_PX = 3
# Limits for a graphic: largest difference of paper from its level, least level of paper, least share of the
# margin that is paper, and of the picture that is paper or ink.
_SAME, _LIGHT, _EVEN_MARGIN, _PLAIN = 8, 200, 0.95, 0.97
# Least share of the picture that grey levels lose before colours are compared.
_LOST = 2e-4


def unlike_paper(colours: UInt8) -> UInt8:
    """Return how much each pixel differs from the paper: the largest difference in a channel.

    Parameters
    ----------
    colours : ndarray of uint8, shape (H, W, C)
        The paper has the median colour of the margin.

    Returns
    -------
    ndarray of uint8, shape (H, W)
    """
    paper = np.median(
        np.stack([margin(colours[..., channel]) for channel in range(colours.shape[2])]), axis=1
    )
    away = np.abs(colours.astype(np.int16) - paper.astype(np.int16)).max(axis=2)
    return np.asarray(away, np.uint8)


def is_graphic(colours: UInt8) -> bool:
    """Return whether a picture is a graphic on light paper, such as a logo, however much of it is ink.

    Its paper has one level up to the margin, and only the edges of its ink lie between paper and ink.
    """
    away = unlike_paper(np.atleast_3d(colours))
    is_paper, is_ink = away <= _SAME, away >= DIFFERENT
    if not is_paper.any() or colours[is_paper].min() < _LIGHT:
        return False
    return bool(margin(is_paper).mean() >= _EVEN_MARGIN and (is_paper | is_ink).mean() >= _PLAIN)


def loses_colours(away: UInt8, dark: Bool) -> bool:
    """Return whether parts that differ from the paper are not in the ink that grey levels show."""
    lost = (away >= DIFFERENT) & ~ndimage.binary_dilation(dark, iterations=_EDGE_PX)
    return bool(np.count_nonzero(ndimage.binary_opening(lost, _SQUARE)) > _LOST * lost.size)


def ink_of_colours(away: UInt8) -> UInt8:
    """Return grey levels, 0 for ink of any colour and 255 for paper, from differences to the paper.

    The edge of ink lies where the difference is half of that of the ink beside it, as for black ink. Evenly
    coloured parts are ink however light they are.
    """
    side = 2 * _EDGE_PX + 1
    beside = np.maximum(ndimage.maximum_filter(away, side), DIFFERENT).astype(np.float32)
    levels = np.rint(255 * np.clip(1 - away / beside, 0, 1)).astype(np.uint8)
    spread = ndimage.maximum_filter(away, 3) - ndimage.minimum_filter(away, 3)
    even = ndimage.maximum_filter((away >= DIFFERENT) & (spread <= _EVEN), 3)
    # Between a light part and its dark outline, the edge of the outline belongs to neither.
    inked = even | (levels < 128)
    filled = ndimage.binary_closing(inked, iterations=_EDGE_PX) & (away >= DIFFERENT)
    levels[filled & ~(levels < 128) & _beside(even)] = 0
    return levels


def _beside(mask: Bool) -> Bool:
    return np.asarray(ndimage.binary_dilation(mask, iterations=_EDGE_PX))


def coloured_ink(reflectances: Float32) -> Bool:
    """Return the mask of coloured ink in a photograph: one channel is darker than another, unlike in shadows.

    Parameters
    ----------
    reflectances : ndarray of float32, shape (3, H, W)
        Channels divided by the paper around each pixel; paper is 1 in each.
    """
    # A blur of a pixel removes the noise of cameras, which is coloured.
    smooth = np.stack([ndimage.gaussian_filter(each, 1.0) for each in reflectances])
    found = smooth.max(axis=0) - smooth.min(axis=0) > CHROMATIC
    return np.asarray(ndimage.binary_opening(found, _SQUARE))
