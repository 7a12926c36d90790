"""Pen paths of a digit on the page: its shape, bent, scaled and placed as its writer would."""

from __future__ import annotations

import numpy as np

from mnist3d.handwriting import keyed_random, writer_style
from mnist3d.handwriting.curves import Stroke, Vary, resample, smooth_path, through
from tactile_toolkit.array_types import Float64

PAGE_PX = 500
"""Side of the square page."""

SPACING_PX = 7.0
"""Distance of samples along a path, pixels."""

_WAIST, _LOPSIDE, _TAPER, _SWAY, _ARCH, _SAG = 0.03, 0.03, 0.08, 0.015, 0.015, 0.015
"""Spreads of how a digit is bent, as shares of its height or width.

Shifts of its waist and of its middle line, widening of its foot, winding of its verticals, bending and
winding of its horizontals.
"""

# Bound of both shifts: from 0.25 on, a digit would fold over itself.
_MAX_SHIFT = 0.2
_WIDEST_PX = 380.0
_MARGIN_PX = 15.0
_OFF_CENTRE_PX = 16.0
# Wavelength of the tremor, pixels.
_WAVE_PX = 45.0
# Positions are multiples of 1/64 px.
_GRID = 64.0
Paths = list[Float64]


def on_page(
    strokes: list[Stroke],
    style: writer_style.WriterStyle,
    height_px: float,
    pen_px: float,
    vary: Vary,
    rng: keyed_random.KeyedRng,
) -> Paths:
    """Bend, scale and place a shape as its writer would.

    ``height_px`` is the height of the ink, ``pen_px`` the width of the pen. Each path, one for each stroke,
    has shape (N, 2): x to the right, y down, pixels, with samples about 7 px apart.
    """
    joined = [np.concatenate([through(run) for run in stroke]) for stroke in strokes]
    bent = _bend(joined, style, vary)
    low, high = _bounds(bent)
    height, widest = height_px - pen_px, _WIDEST_PX - pen_px
    scale = min(height / (high[1] - low[1]), widest / max(high[0] - low[0], 1e-6))
    paths = [_relax((path - low) * scale, style, rng) for path in bent]
    low, high = _bounds(paths)
    wish = 0.5 * PAGE_PX - 0.5 * (low + high) + _OFF_CENTRE_PX * rng.approx_normals(2)
    edge = 0.5 * pen_px + _MARGIN_PX
    # Off-centre, but not off the sheet.
    shift = np.clip(wish, edge - low, PAGE_PX - edge - high)
    # Compiled interpolation may fuse multiply and add on some machines; the grid removes the last bit.
    return [np.floor((path + shift) * _GRID + 0.5) / _GRID for path in paths]


def _bend(paths: Paths, style: writer_style.WriterStyle, vary: Vary) -> Paths:
    """Bend, stretch and slant the strokes like one sheet of rubber, so that joined strokes stay joined."""
    low, high = _bounds(paths)
    wide, tall = max(high[0] - low[0], 1e-6), high[1] - low[1]
    waist, lopside = (min(max(vary(0.0, spread), -_MAX_SHIFT), _MAX_SHIFT) for spread in (_WAIST, _LOPSIDE))
    taper, sway, arch, sag = (vary(0.0, spread) for spread in (_TAPER, _SWAY, _ARCH, _SAG))
    bent = []
    for path in paths:
        across, down = (path[:, 0] - low[0]) / wide, (path[:, 1] - low[1]) / tall
        middle, waistline = 4.0 * across * (1.0 - across), 4.0 * down * (1.0 - down)
        x = style.aspect * wide * (across - 0.5 + lopside * middle) * (1.0 + taper * (2.0 * down - 1.0))
        y = tall * (down + waist * waistline)
        wound = x + style.slant * (1.0 - y) + (style.bow + sway * (1.0 - 2.0 * down)) * waistline
        bent.append(
            np.stack([wound, y - style.tilt * x + (arch + sag * (1.0 - 2.0 * across)) * middle], axis=1)
        )
    return bent


def _bounds(paths: Paths) -> tuple[Float64, Float64]:
    points = np.concatenate(paths)
    return points.min(axis=0), points.max(axis=0)


def _relax(path: Float64, style: writer_style.WriterStyle, rng: keyed_random.KeyedRng) -> Float64:
    path = resample(path, SPACING_PX)
    knots = int(len(path) * SPACING_PX / _WAVE_PX) + 3
    at = np.arange(len(path)) * ((knots - 1) / len(path))
    for axis in (0, 1):
        path[:, axis] += np.interp(at, np.arange(knots), style.tremor_px * rng.approx_normals(knots))
    return smooth_path(path, 1 + style.roundness)
