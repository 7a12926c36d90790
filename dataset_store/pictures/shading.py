"""Meshes in shaded relief: a depth buffer in numpy, which needs no graphics driver and no further package."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["OBLIQUE", "TOP", "View", "averaged", "doubled_areas", "face_buffer", "shades"]

_LIGHT = np.array([-0.45, 0.55, 0.70])
"""Where the light comes from: right, up and out of the picture."""

_DARKEST, _RANGE = 60, 180
_ROWS_AT_ONCE = 1 << 20
_PIXELS_AT_ONCE = 1 << 20
_DEPTH_STEPS = 1 << 30


@dataclass(frozen=True, slots=True)
class View:
    """From where a mesh is looked at, without perspective.

    Attributes
    ----------
    azimuth_deg : float
        How far the viewer has walked around the z axis, counter-clockwise from -y, degrees.
    elevation_deg : float
        How high the viewer stands: 90 looks straight down, with x right and y up in the picture.
    """

    azimuth_deg: float
    elevation_deg: float

    @property
    def axes(self) -> NDArray[np.float64]:
        """Directions right, up and towards the viewer, one a row: shape (3, 3), of length one."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        towards = np.array(
            [
                math.cos(elevation) * math.sin(azimuth),
                -math.cos(elevation) * math.cos(azimuth),
                math.sin(elevation),
            ]
        )
        right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Turn points, shape (n, 3), into right, up and towards the viewer, in the same unit."""
        return np.asarray(points, np.float64) @ self.axes.T


TOP = View(0.0, 90.0)
"""Straight from above."""

OBLIQUE = View(-25.0, 42.0)
"""From the front, somewhat left and well above: digits stay readable and show their height."""


def averaged(pixels: NDArray[np.uint8], factor: int, paper: int = 255) -> NDArray[np.uint8]:
    """Return a picture so many times smaller, each pixel the mean of those that it covers.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W) or (H, W, 3)
        The picture; sides that are no multiple of ``factor`` are filled up with ``paper`` first.
    factor : int
        How many times smaller.
    paper : int
        Level beyond the edge.
    """
    height, width = (-(-side // factor) for side in pixels.shape[:2])
    spread = [(0, height * factor - pixels.shape[0]), (0, width * factor - pixels.shape[1])]
    whole = np.pad(pixels, [*spread, *[(0, 0)] * (pixels.ndim - 2)], constant_values=paper)
    blocks = whole.reshape(height, factor, width, factor, *pixels.shape[2:])
    sums = blocks.sum(axis=(1, 3), dtype=np.uint32)
    return np.asarray((sums + factor * factor // 2) // (factor * factor), np.uint8)


def shades(points: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Return how bright each triangle is, shape (F,), 60 to 240.

    Parameters
    ----------
    points : ndarray of float64, shape (V, 3)
        Right, up and towards the viewer.
    faces : ndarray of int, shape (F, 3)
        Triangles. One that faces away is lit as if it did not, so that damaged meshes show something, too.
    """
    corners = points[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    lengths = np.linalg.norm(normals, axis=1)
    light = (normals / np.where(lengths > 0, lengths, 1.0)[:, None]) @ _LIGHT
    return np.asarray(_DARKEST + _RANGE * np.clip(light, 0, 1)).astype(np.uint8)


def face_buffer(
    points: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], size: tuple[int, int]
) -> NDArray[np.int64]:
    """Find the triangle that is seen at each pixel.

    Parameters
    ----------
    points : ndarray, shape (V, 3)
        Column, row and closeness to the viewer; columns and rows in pixels, 0 at the outer edge of the first.
    faces : ndarray of int, shape (F, 3)
        Triangles, either way around.
    size : tuple of int
        Width and height of the picture, pixels.

    Returns
    -------
    ndarray of int64, shape (height, width)
        Number of the closest triangle over the middle of each pixel, -1 where there is none; of equally close
        ones the later.
    """
    width, height = size
    corners = np.asarray(points, np.float64)[np.asarray(faces)]
    nearest = np.full(width * height, -1, np.int64)
    if not len(faces):
        return nearest.reshape(height, width)
    low, span = corners[:, :, 2].min(), max(float(np.ptp(corners[:, :, 2])), 1e-12)
    slopes = _depth_slopes(corners)
    for some in _some_at_once(corners, height):
        spans = _spans(corners, some, width, height)
        for triangle, row, column in _pixels(*spans):
            depth = (
                slopes[triangle, 0] + slopes[triangle, 1] * (column + 0.5) + slopes[triangle, 2] * (row + 0.5)
            )
            steps = np.clip((depth - low) / span * _DEPTH_STEPS, 0, _DEPTH_STEPS).astype(np.int64)
            # The depth in the upper bits and the triangle in the lower: the largest is the one seen.
            np.maximum.at(nearest, row * width + column, (steps << 32) | triangle)
    return np.where(nearest < 0, -1, nearest & 0xFFFFFFFF).reshape(height, width)


def doubled_areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return twice the area of each triangle as projected along the third axis, shape (F,).

    Parameters
    ----------
    corners : ndarray of float64, shape (F, 3, 3)
        Triangle, corner, axis.

    Returns
    -------
    ndarray of float64, shape (F,)
        Positive where the corners are counter-clockwise with the first axis right and the second up.
    """
    one, other = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def _some_at_once(corners: NDArray[np.float64], height: int) -> Iterator[NDArray[np.int64]]:
    """Yield numbers of triangles that have an area, so many that their rows fit in memory."""
    wanted = np.flatnonzero(doubled_areas(corners) != 0)
    rows = np.clip(np.ptp(corners[wanted, :, 1], axis=1), 1, height)
    parts = (np.cumsum(rows) // _ROWS_AT_ONCE).astype(int)
    yield from np.split(wanted, np.flatnonzero(np.diff(parts)) + 1) if len(wanted) else []


def _spans(
    corners: NDArray[np.float64], some: NDArray[np.int64], width: int, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the runs of pixels whose middles triangles cover: triangle, row, first column, length."""
    ys = corners[some, :, 1]
    first = np.clip(np.ceil(ys.min(axis=1) - 0.5), 0, height).astype(np.int64)
    counts = np.clip(np.floor(ys.max(axis=1) - 0.5).astype(np.int64) + 1, 0, height) - first
    counts = np.maximum(counts, 0)
    triangle = np.repeat(some, counts)
    row = _counted(first, counts)
    left, right = np.full(len(row), -np.inf), np.full(len(row), np.inf)
    turn = np.sign(doubled_areas(corners))[triangle]
    for corner in range(3):
        start, end = corners[triangle, corner, :2], corners[triangle, (corner + 1) % 3, :2]
        # On the inner side of the edge: slope * column + rest >= 0.
        slope = turn * (start[:, 1] - end[:, 1])
        rest = turn * (end[:, 0] - start[:, 0]) * (row + 0.5 - start[:, 1]) - slope * start[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            meets = -rest / slope
        left = np.maximum(
            left, np.where(slope > 0, meets, np.where((slope == 0) & (rest < 0), np.inf, -np.inf))
        )
        right = np.minimum(right, np.where(slope < 0, meets, np.inf))
    begin = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
    length = np.clip(np.floor(right - 0.5) + 1, 0, width).astype(np.int64) - begin
    kept = length > 0
    return triangle[kept], row[kept], begin[kept], length[kept]


def _pixels(
    triangle: NDArray[np.int64], row: NDArray[np.int64], begin: NDArray[np.int64], length: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the pixels of runs, some runs at a time: triangle, row and column of each."""
    parts = np.cumsum(length) // _PIXELS_AT_ONCE
    for runs in np.split(np.arange(len(length)), np.flatnonzero(np.diff(parts)) + 1):
        many = length[runs]
        yield np.repeat(triangle[runs], many), np.repeat(row[runs], many), _counted(begin[runs], many)


def _counted(first: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ``first[0], first[0] + 1, ...`` so many of each, one after another."""
    ends = np.cumsum(counts)
    return np.asarray(np.arange(ends[-1] if len(ends) else 0) + np.repeat(first - (ends - counts), counts))


def _depth_slopes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how close each triangle's plane is: at the origin, and its change per column and row."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = doubled_areas(corners)
    area = np.where(area == 0, 1.0, area)
    per_column = (one[:, 2] * other[:, 1] - other[:, 2] * one[:, 1]) / area
    per_row = (other[:, 2] * one[:, 0] - one[:, 2] * other[:, 0]) / area
    at_origin = corners[:, 0, 2] - per_column * corners[:, 0, 0] - per_row * corners[:, 0, 1]
    return np.stack([at_origin, per_column, per_row], axis=1)
