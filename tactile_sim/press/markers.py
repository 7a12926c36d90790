"""Markers on a gel: their positions in the image, motion with the surface, and drawing."""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import AnyArray, Float64, UInt8

_RADIUS = 0.18  # of the distance of two markers: about that of the dots of a GelSight Mini
_DARK = 0.15  # share of the light that a marker reflects


def marker_grid_px(markers: tuple[int, int], size_px: tuple[int, int]) -> Float64:
    """Return the positions of the markers of a gel at rest in the image.

    Parameters
    ----------
    markers : tuple of int
        Columns and rows of markers, evenly spaced, half a step from the edge of the image.
    size_px : tuple of int
        Width and height of the image, pixels.

    Returns
    -------
    ndarray of float64, shape (rows, columns, 2)
        Column and row in pixels, from 0 in the middle of the first pixel.
    """
    across, down = (
        (np.arange(count) + 0.5) * size / count - 0.5 for count, size in zip(markers, size_px, strict=True)
    )
    return np.stack(np.meshgrid(across, down), axis=-1)


def marker_positions_px(
    displacement_m: Float64,
    window_m: tuple[float, float],
    markers: tuple[int, int],
    size_px: tuple[int, int],
) -> Float64:
    """Return the positions of markers that have moved with the surface of the gel.

    Parameters
    ----------
    displacement_m : ndarray, shape (H, W, 3)
        Displacement of the surface that the image shows, metres: along x, along y, and into the gel.
    window_m : tuple of float
        Width and height of that part of the gel, metres.
    markers : tuple of int
        Columns and rows of markers.
    size_px : tuple of int
        Width and height of the image, pixels; not necessarily W and H.

    Returns
    -------
    ndarray of float64, shape (rows, columns, 2)
        Column and row in pixels; y of the gel is against the rows. Less :func:`marker_grid_px`, this is the
        flow.
    """
    rest = marker_grid_px(markers, size_px)
    height, width = displacement_m.shape[:2]
    places = (rest + 0.5) / size_px * [width, height] - 0.5
    moved_m = _between(displacement_m[..., :2], places)
    return rest + moved_m * [size_px[0] / window_m[0], -size_px[1] / window_m[1]]


def _between(values: AnyArray, places: Float64) -> Float64:
    """Interpolate a map (H, W, k) linearly at columns and rows (..., 2), clamped to the edge."""
    most = np.array(values.shape[1::-1]) - 1
    inside = np.clip(places, 0, most)
    first = np.minimum(inside.astype(np.int64), np.maximum(most - 1, 0))
    after = np.minimum(first + 1, most)
    across, down = np.moveaxis((inside - first)[..., None], -2, 0)
    upper = (
        values[first[..., 1], first[..., 0]] * (1 - across) + values[first[..., 1], after[..., 0]] * across
    )
    lower = (
        values[after[..., 1], first[..., 0]] * (1 - across) + values[after[..., 1], after[..., 0]] * across
    )
    between: Float64 = upper * (1 - down) + lower * down
    return between


def draw_markers(picture: UInt8, positions_px: Float64) -> UInt8:
    """Return an image (H, W, 3) with dark dots at positions (rows, columns, 2), pixels.

    Their edges are a pixel wide. They do not change with depth or slope.
    """
    rows, columns = positions_px.shape[:2]
    height, width = picture.shape[:2]
    radius = max(_RADIUS * min(width / columns, height / rows), 0.5)
    reach = math.ceil(radius + 1)
    light = np.ones((height, width))
    for x, y in positions_px.reshape(-1, 2).tolist():
        left = max(math.floor(x) - reach, 0)
        right = min(math.ceil(x) + reach + 1, width)
        top = max(math.floor(y) - reach, 0)
        bottom = min(math.ceil(y) + reach + 1, height)
        if left >= right or top >= bottom:
            continue
        far = np.hypot(np.arange(left, right)[None, :] - x, np.arange(top, bottom)[:, None] - y)
        covered = np.clip(radius + 0.5 - far, 0, 1)
        part = light[top:bottom, left:right]
        np.minimum(part, 1 - (1 - _DARK) * covered, out=part)
    return np.asarray(np.rint(picture * light[..., None]), np.uint8)
