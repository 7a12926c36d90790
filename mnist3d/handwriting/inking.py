"""Ink on the page, drawn along pen paths with the pen of a writer."""

from __future__ import annotations

import math

import numpy as np

from mnist3d.handwriting import keyed_random, page_layout, writer_style
from tactile_toolkit.array_types import Float32, Float64, UInt8

_CELL_PX = 4
_NODES = page_layout.PAGE_PX // _CELL_PX + 1
# Cells between the nodes of the wide grain of the edge noise.
_COARSE = 4
# Distances are exact up to this far outside the ink; edge noise must stay below it.
_BEYOND_PX = 7.0
_FAR_PX = 50.0
# Reach of a speckle, pixels.
_DOT_PX = 4
# White margin without specks, pixels.
_EDGE_PX = 10

_DRY, _WIDE = 0.75, 1.25
"""Bounds of the stroke width, relative to the width of the pen."""

_PRESSURE_WAVE_PX = 70.0


def ink_paths(
    paths: list[Float64], pen_px: float, style: writer_style.WriterStyle, rng: keyed_random.KeyedRng
) -> UInt8:
    """Ink evenly sampled paths with the pen of a writer.

    Each path has the shape (N, 2), in pixels. Returns the page, shape (500, 500), uint8, 0 for ink.

    The distance to the edge of the ink is computed on a grid of 4 px near the strokes, roughened there and
    then interpolated. That is 1/16 of the work, and noise of that grain looks like a felt tip on paper.
    `pen_px` is the mean width of a stroke.
    """
    radii = [_radii(path, 0.5 * pen_px, style, rng) for path in paths]
    field = np.full(_NODES * _NODES, _FAR_PX, dtype=np.float32)
    for path, radius in zip(paths, radii, strict=True):
        _stamp(field, path.astype(np.float32), radius)
    page = _rasterise(field.reshape(_NODES, _NODES) + _roughness(style.roughness_px, rng))
    _add_speckles(page, paths, radii, style, rng)
    return page


def _radii(
    path: Float64, half_px: float, style: writer_style.WriterStyle, rng: keyed_random.KeyedRng
) -> Float32:
    number = len(path)
    knots = int(number * page_layout.SPACING_PX / _PRESSURE_WAVE_PX) + 3
    at = np.arange(number) * ((knots - 1) / number)
    press = 1.0 + style.pressure * np.interp(at, np.arange(knots), rng.approx_normals(knots))
    step = path[np.minimum(np.arange(number) + 1, number - 1)] - path[np.maximum(np.arange(number) - 1, 0)]
    along = step[:, 0] + style.nib_lean * step[:, 1]
    square = (step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]) * (1.0 + style.nib_lean * style.nib_lean)
    chisel = 1.0 + style.nib * (0.5 - along * along / np.maximum(square, 1e-6))
    radius = half_px * np.clip(press * chisel, _DRY, _WIDE)
    return np.asarray(np.floor(radius * 64.0 + 0.5) / 64.0, dtype=np.float32)


def _stamp(field: Float32, path: Float32, radius: Float32) -> None:
    """Lower the field to the signed distance from the capsules between consecutive samples."""
    start, step = path[:-1], path[1:] - path[:-1]
    swell = radius[1:] - radius[:-1]
    reach = int((float(radius.max()) + _BEYOND_PX + 0.5 * page_layout.SPACING_PX) / _CELL_PX) + 1
    span = np.arange(-reach, reach + 1)
    node = np.floor((start + 0.5 * step) / _CELL_PX + np.float32(0.5)).astype(np.int64)
    column = np.clip(node[:, 0, None] + span, 0, _NODES - 1)
    row = np.clip(node[:, 1, None] + span, 0, _NODES - 1)
    off_x = (column * _CELL_PX).astype(np.float32) - start[:, 0, None]
    off_y = (row * _CELL_PX).astype(np.float32) - start[:, 1, None]
    square = np.maximum(step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1], np.float32(1e-6))
    t_x = off_x * (step[:, 0] / square)[:, None]
    t_y = off_y * (step[:, 1] / square)[:, None]
    t = np.clip(t_x[:, None, :] + t_y[:, :, None], np.float32(0.0), np.float32(1.0))
    gap_x = off_x[:, None, :] - t * step[:, 0, None, None]
    gap_y = off_y[:, :, None] - t * step[:, 1, None, None]
    away = np.sqrt(gap_x * gap_x + gap_y * gap_y) - (radius[:-1, None, None] + t * swell[:, None, None])
    # Unbuffered, as neighbouring capsules share nodes of the field.
    np.minimum.at(field, (row[:, :, None] * _NODES + column[:, None, :]).ravel(), away.ravel())


def _roughness(size_px: float, rng: keyed_random.KeyedRng) -> Float32:
    """Return edge noise of two grains on the grid, each within +-`size_px`."""
    wide = _NODES // _COARSE + 2
    coarse = rng.bytes(wide * wide).reshape(wide, wide)
    fine = rng.bytes(_NODES * _NODES).reshape(_NODES, _NODES)
    unit = np.float32(size_px / 127.5)
    grain = _enlarge(coarse.astype(np.float32), _COARSE)[:_NODES, :_NODES]
    return (grain - np.float32(127.5)) * unit + (fine.astype(np.float32) - np.float32(127.5)) * unit


def _enlarge(grid: Float32, factor: int) -> Float32:
    """Interpolate linearly between nodes: (R, C) to ((R - 1) * factor, (C - 1) * factor)."""
    share = (np.arange(factor, dtype=np.float32) / np.float32(factor))[None, :, None]
    tall = (grid[:-1, None] + (grid[1:] - grid[:-1])[:, None] * share).reshape(-1, grid.shape[1])
    share = share.reshape(1, 1, factor)
    wide = tall[:, :-1, None] + (tall[:, 1:] - tall[:, :-1])[:, :, None] * share
    return wide.reshape(tall.shape[0], -1)


def _rasterise(field: Float32) -> UInt8:
    """Convert the field to grey levels; the edge fades over one pixel."""
    rows = np.flatnonzero((field < _CELL_PX).any(axis=1))
    columns = np.flatnonzero((field < _CELL_PX).any(axis=0))
    top, left = max(rows[0] - 1, 0), max(columns[0] - 1, 0)
    grey = _enlarge(field[top : rows[-1] + 2, left : columns[-1] + 2], _CELL_PX)
    grey *= np.float32(255.0)
    grey += np.float32(127.5)
    np.clip(grey, np.float32(0.0), np.float32(255.0), out=grey)
    page = np.full((page_layout.PAGE_PX, page_layout.PAGE_PX), 255, dtype=np.uint8)
    part = page[top * _CELL_PX :, left * _CELL_PX :][: grey.shape[0], : grey.shape[1]]
    part[:] = grey[: part.shape[0], : part.shape[1]].astype(np.uint8)
    return page


def _add_speckles(
    page: UInt8,
    paths: list[Float64],
    radii: list[Float32],
    style: writer_style.WriterStyle,
    rng: keyed_random.KeyedRng,
) -> None:
    """Add light speckles to the ink and dark ones next to it."""
    for number, light in ((style.gaps, True), (style.specks, False)):
        for _ in range(int(number * 2.0 * rng.unit())):
            stroke = rng.pick([float(len(path)) for path in paths])
            sample = int(rng.unit() * len(paths[stroke]))
            radius = float(radii[stroke][sample])
            aside = rng.uniform(-0.75, 0.75) * radius if light else radius + rng.uniform(4.0, 30.0)
            _dot(page, paths[stroke][sample], aside, light, rng)


def _dot(page: UInt8, at: Float64, aside: float, light: bool, rng: keyed_random.KeyedRng) -> None:
    lean_x, lean_y = rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0)
    norm = math.sqrt(lean_x * lean_x + lean_y * lean_y + 1e-9)
    x, y = float(at[0]) + aside * lean_x / norm, float(at[1]) + aside * lean_y / norm
    half_x, half_y = rng.uniform(0.7, 2.6), rng.uniform(0.7, 2.6)
    low, high = _EDGE_PX + _DOT_PX, page_layout.PAGE_PX - 1 - _EDGE_PX - _DOT_PX
    column, row = int(min(max(x, low), high)), int(min(max(y, low), high))
    offsets = np.arange(-_DOT_PX, _DOT_PX + 1, dtype=np.float64)
    across, down = offsets / half_x, offsets / half_y
    depth = np.clip(1.5 - ((across * across)[None, :] + (down * down)[:, None]), 0.0, 1.0) * 255.0
    part = page[row - _DOT_PX : row + _DOT_PX + 1, column - _DOT_PX : column + _DOT_PX + 1]
    if light:
        part[:] = np.maximum(part, depth.astype(np.uint8))
    else:
        part[:] = np.minimum(part, 255 - depth.astype(np.uint8))
