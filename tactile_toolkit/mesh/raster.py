"""From triangles to pixels: every triangle is cut into rows of pixels, and a pixel keeps the highest of them.

A span is the part of one row whose pixel centres one triangle covers. Cutting by rows instead of testing
every pixel of a bounding box touches only pixels that are covered, and all spans are cut at once, in numpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Spans", "raise_pixels", "spans_of"]

_EDGE_PX = 1e-9
"""A centre no further than this outside an edge counts as on it: rounding must leave no hole between
neighbours."""

_AT_ONCE = 1 << 20
"""Spans or pixels that are worked on together: bounds the memory of large triangles on fine grids."""

Numbers = NDArray[np.float64]
Places = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """Runs of covered pixels, each within one row.

    Attributes
    ----------
    row, column, count : ndarray of int64, shape (n,)
        Row, first column and number of pixels.
    height, rise : ndarray of float64, shape (n,)
        Height above the first pixel, and what it grows by from one pixel to the next.
    """

    row: Places
    column: Places
    count: Places
    height: Numbers
    rise: Numbers

    def part(self, start: int, stop: int) -> Spans:
        """Return some of them."""
        some = slice(start, stop)
        return Spans(self.row[some], self.column[some], self.count[some], self.height[some], self.rise[some])


@dataclass(frozen=True, slots=True, eq=False)
class _Triangles:
    """Triangles that face upwards and may cover a pixel centre.

    Attributes
    ----------
    first_row, rows : ndarray of int64, shape (n,)
        Rows of pixel centres that they meet.
    sides : ndarray, shape (3, 4, n)
        For each edge ``l, l', r, r'``: row y covers columns from ``l + l' y`` to ``r + r' y``.
    columns : ndarray, shape (2, n)
        Least and greatest column.
    start : ndarray, shape (3, n)
        Column, row and height of the first corner.
    slope : ndarray, shape (2, n)
        What the height grows by along a row, and from one row to the next.
    heights : ndarray, shape (2, n)
        Least and greatest height.
    """

    first_row: Places
    rows: Places
    sides: Numbers
    columns: Numbers
    start: Numbers
    slope: Numbers
    heights: Numbers


def spans_of(places: Numbers, faces: NDArray[np.integer[Any]]) -> Iterator[Spans]:
    """Cut triangles into spans.

    Parameters
    ----------
    places : ndarray, shape (3, V)
        Column and row, in pixels whose centres have whole numbers, and height of each vertex.
    faces : ndarray of int, shape (F, 3)
        Triangles; those that do not run counter-clockwise seen from above give no span.

    Yields
    ------
    Spans
        Some at a time.
    """
    triangles = _upward(places, faces)
    for start, stop in _parts(triangles.rows):
        count = triangles.rows[start:stop]
        owner = np.repeat(np.arange(start, stop), count)
        row = triangles.first_row[owner] + _places_within(count)
        yield _cut(triangles, owner, row)


def raise_pixels(highest: NDArray[np.float32], spans: Spans, columns: int) -> None:
    """Raise the pixels of a grid to the height of the spans that lie above them.

    Parameters
    ----------
    highest : ndarray of float32, shape (rows * columns,)
        Height of each pixel so far; changed in place.
    spans : Spans
        What covers them.
    columns : int
        Pixels in a row.
    """
    for start, stop in _parts(spans.count):
        part = spans.part(start, stop)
        within = _places_within(part.count)
        pixel = np.repeat(part.row * columns + part.column, part.count) + within
        height = np.repeat(part.height, part.count) + np.repeat(part.rise, part.count) * within
        np.maximum.at(highest, pixel, height.astype(np.float32))


def _upward(places: Numbers, faces: NDArray[np.integer[Any]]) -> _Triangles:
    """Pick the triangles that face upwards; upright ones cover nothing."""
    seen = places[:2]
    corners = [np.take(seen, corner, axis=1) for corner in faces.T]
    first = np.ceil(np.minimum.reduce(corners) - _EDGE_PX)
    last = np.floor(np.maximum.reduce(corners) + _EDGE_PX)
    (ab_x, ab_y), (ac_x, ac_y) = corners[1] - corners[0], corners[2] - corners[0]
    area = ab_x * ac_y - ab_y * ac_x  # twice the area as seen from above
    kept = np.flatnonzero((area > 0) & (first[0] <= last[0]) & (first[1] <= last[1]))
    rows = (last[1] - first[1])[kept].astype(np.int64) + 1
    return _prepared(places, faces[kept].T, area[kept], first[1, kept].astype(np.int64), rows)


def _prepared(
    places: Numbers, faces: NDArray[np.integer[Any]], area: Numbers, first_row: Places, rows: Places
) -> _Triangles:
    a, b, c = (np.take(places, corner, axis=1) for corner in faces)
    ab, ac = b - a, c - a
    slope = np.stack([ab[2] * ac[1] - ab[1] * ac[2], ab[0] * ac[2] - ab[2] * ac[0]]) / area
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return _Triangles(
        first_row,
        rows,
        sides=np.stack([_side(a, b), _side(b, c), _side(c, a)]),
        columns=np.stack([low[0] - _EDGE_PX, high[0] + _EDGE_PX]),
        start=a,
        slope=slope,
        heights=np.stack([low[2], high[2]]),
    )


def _side(start: Numbers, end: Numbers) -> Numbers:
    """Return which columns an edge leaves to a row: ``l, l', r, r'`` of :class:`_Triangles`.

    The inside is left of every edge. So an edge that runs down the rows bounds them from below, one that runs
    up from above, and a level one not at all.
    """
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    falls, rises = along_y < -_EDGE_PX, along_y > _EDGE_PX
    per_row = along_x / np.where(falls | rises, along_y, 1.0)
    slack = _EDGE_PX * (1.0 + np.abs(per_row))  # at least the distance from the edge, measured along the row
    crossing = start[0] - per_row * start[1]
    return np.stack(
        [
            np.where(falls, crossing - slack, -np.inf),
            np.where(falls, per_row, 0.0),
            np.where(rises, crossing + slack, np.inf),
            np.where(rises, per_row, 0.0),
        ]
    )


def _cut(triangles: _Triangles, owner: Places, row: Places) -> Spans:
    """Find the pixels that triangles cover in given rows, and their heights."""
    left, right = np.take(triangles.columns, owner, axis=1)
    for side in triangles.sides:
        low, low_per_row, high, high_per_row = np.take(side, owner, axis=1)
        left = np.maximum(left, low + low_per_row * row)
        right = np.minimum(right, high + high_per_row * row)
    first, last = np.ceil(left), np.floor(right)
    there = np.flatnonzero(first <= last)
    owner, row, first, last = owner[there], row[there], first[there], last[there]
    column, steps = first.astype(np.int64), (last - first).astype(np.int64)
    start, end = _heights(triangles, owner, row, first, last)
    # From end to end instead of by the slope: so no height leaves the triangle's own range.
    return Spans(row, column, steps + 1, start, (end - start) / np.maximum(steps, 1))


def _heights(
    triangles: _Triangles, owner: Places, row: Places, first: Numbers, last: Numbers
) -> tuple[Numbers, Numbers]:
    """Return the heights of triangles above two columns of a row, kept to the range of their corners."""
    x, y, z = np.take(triangles.start, owner, axis=1)
    along_row, along_column = np.take(triangles.slope, owner, axis=1)
    low, high = np.take(triangles.heights, owner, axis=1)
    level = z + along_column * (row - y)
    start, end = (np.clip(level + along_row * (column - x), low, high) for column in (first, last))
    return start, end


def _parts(counts: Places) -> Iterator[tuple[int, int]]:
    """Divide items into runs of at most :data:`_AT_ONCE` things in all, or of a single item."""
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _AT_ONCE, side="right")))
        yield start, stop
        start = stop


def _places_within(counts: Places) -> Places:
    """Return 0, 1, ... for the things of each item in turn."""
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    return np.asarray(np.arange(total) - np.repeat(ends - counts, counts))
