"""From a shape in the unit square to pen paths on the page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mnist3d.sources.handwriting.curve import resample, smooth, through
from mnist3d.sources.handwriting.dice import Dice
from mnist3d.sources.handwriting.hand import Hand
from mnist3d.sources.handwriting.shape import Stroke

__all__ = ["PAGE_PX", "SPACING_PX", "on_page"]

PAGE_PX = 500
"""Side of the square page."""
SPACING_PX = 7.0
"""Distance of samples along a path."""
_SLANT_JITTER, _TILT_JITTER, _ASPECT_JITTER, _BOW_JITTER = 0.10, 0.03, 0.05, 0.015
"""Standard deviations between the digits of a writer whose jitter is 1."""
_WIDEST_PX = 380.0
_MARGIN_PX = 15.0
_OFF_CENTRE_PX = 16.0
_WAVE_PX = 45.0
"""Wavelength of the tremor."""
_GRID = 64.0
"""Positions are multiples of 1/64 px."""

Paths = list[NDArray[np.float64]]


def on_page(strokes: list[Stroke], hand: Hand, height_px: float, pen_px: float, dice: Dice) -> Paths:
    """Lean, stretch, scale and place a shape as its writer would.

    Parameters
    ----------
    strokes : list of Stroke
        In the unit square.
    hand : Hand
        Of the writer.
    height_px, pen_px : float
        Ink height and pen width of this digit.
    dice : Dice
        Of this digit.

    Returns
    -------
    list of ndarray of float64, shape (N, 2)
        One path for each stroke: x to the right, y down, in pixels, samples about :data:`SPACING_PX` apart.
    """
    joined = [np.concatenate([through(run) for run in stroke]) for stroke in strokes]
    leant = _lean(joined, hand, dice)
    sized = _fit(leant, height_px - pen_px, _WIDEST_PX - pen_px)
    return _place([_relax(path, hand, dice) for path in sized], pen_px, dice)


def _lean(paths: Paths, hand: Hand, dice: Dice) -> Paths:
    slant = hand.slant + _SLANT_JITTER * hand.jitter * dice.bell()
    tilt = hand.tilt + _TILT_JITTER * hand.jitter * dice.bell()
    aspect = hand.aspect + _ASPECT_JITTER * hand.jitter * dice.bell()
    bow = 4.0 * (hand.bow + _BOW_JITTER * hand.jitter * dice.bell())
    leant = []
    for path in paths:
        x, y = aspect * path[:, 0], path[:, 1]
        bent = x + slant * (1.0 - y) + bow * y * (1.0 - y)
        leant.append(np.stack([bent, y - tilt * x], axis=1))
    return leant


def _fit(paths: Paths, height: float, widest: float) -> Paths:
    low, high = _bounds(paths)
    scale = min(height / (high[1] - low[1]), widest / max(high[0] - low[0], 1e-6))
    return [(path - low) * scale for path in paths]


def _bounds(paths: Paths) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = np.concatenate(paths)
    return points.min(axis=0), points.max(axis=0)


def _relax(path: NDArray[np.float64], hand: Hand, dice: Dice) -> NDArray[np.float64]:
    path = resample(path, SPACING_PX)
    knots = int(len(path) * SPACING_PX / _WAVE_PX) + 3
    at = np.arange(len(path)) * ((knots - 1) / len(path))
    for axis in (0, 1):
        path[:, axis] += np.interp(at, np.arange(knots), hand.tremor_px * dice.bells(knots))
    return smooth(path, 1 + hand.roundness)


def _place(paths: Paths, pen_px: float, dice: Dice) -> Paths:
    low, high = _bounds(paths)
    wish = 0.5 * PAGE_PX - 0.5 * (low + high) + _OFF_CENTRE_PX * dice.bells(2)
    edge = 0.5 * pen_px + _MARGIN_PX
    shift = np.clip(wish, edge - low, PAGE_PX - edge - high)
    # Compiled interpolation may fuse multiply and add on some machines; a grid hides the last bit.
    return [np.floor((path + shift) * _GRID + 0.5) / _GRID for path in paths]
