"""Rasterisation of triangles: each is cut into scan lines, and a pixel keeps the highest triangle.

A scan line is the part of a row of pixels whose centres a triangle covers. Cutting by rows visits only
covered pixels, unlike testing all pixels of a bounding box, and numpy cuts all lines at once. Height maps,
voxels and pictures are made here.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float32, Float64, Int64, Integers

MAX_PIXELS = 1 << 27
"""Largest grid, 512 MiB; a finer pitch is refused."""

# A pixel centre this close outside an edge counts as on it, so that rounding leaves no gaps.
_EDGE_PX = 1e-9

# Lines or pixels that are processed together: bounds the memory of large triangles on fine grids.
_AT_ONCE = 1 << 20

# Heights that :func:`highest_faces` distinguishes: 1e-7 mm on a solid of 10 cm. With 32 bits for the number
# of the triangle, this fills a signed integer of 64 bits.
_DEPTH_STEPS = 1 << 30


def highest_values(points: Float64, faces: Integers, shape: tuple[float, float]) -> Float32:
    """Return the height of the highest triangle over the centre of each pixel, -inf where there is none.

    Parameters are as for :func:`covered_pixels`; triangles that face downwards are ignored. InputError for a
    map that is too large, whose sides may be infinite or NaN.
    """
    if not shape[0] * shape[1] <= MAX_PIXELS:
        raise InputError(
            f"a map of {shape[1]:.7g} x {shape[0]:.7g} pixels was asked for, at most {MAX_PIXELS:,} are made",
            next="choose a larger pitch",
        )
    shape = int(shape[0]), int(shape[1])
    highest = np.full(shape[0] * shape[1], -np.inf, np.float32)
    for _, _, pixel, height in covered_pixels(points, faces, shape):
        np.maximum.at(highest, pixel, height.astype(np.float32))
    return highest.reshape(shape)


def highest_faces(
    points: Float64, faces: Integers, shape: tuple[int, int], both_sides: bool = False
) -> Int64:
    """Return the highest triangle over the centre of each pixel, -1 where there is none.

    Parameters are as for :func:`covered_pixels`; among equally high triangles, the last one wins.
    """
    if not len(faces):
        return np.full(shape, -1, np.int64)
    used = np.asarray(points[2])[np.asarray(faces)]
    low = float(used.min())
    span = max(float(np.ptp(used)), 1e-12)
    highest = np.full(shape[0] * shape[1], -1, np.int64)
    for face, line, pixel, height in covered_pixels(points, faces, shape, both_sides):
        # The height is in the upper bits and the triangle in the lower ones, so one maximum finds both.
        steps = ((height - low) * (_DEPTH_STEPS / span)).astype(np.int64)
        np.maximum.at(highest, pixel, (steps << 32) | face[line])
    return np.where(highest < 0, -1, highest & 0xFFFFFFFF).reshape(shape)


def covered_pixels(
    points: Float64, faces: Integers, shape: tuple[int, int], both_sides: bool = False
) -> Iterator[tuple[Int64, Int64, Int64, Float64]]:
    """Yield pixels whose centres are covered by triangles, in parts; vertical triangles cover none.

    Each part consists of the triangle of each scan line, the scan line of each pixel, the number of the pixel
    (row by row), and the height of the triangle there. ``points``, shape (3, V), are column, row and height
    of each vertex; pixel centres have integer coordinates. ``shape`` is the number of rows and columns;
    triangles are clipped to it. Triangles that are clockwise seen from above count only with ``both_sides``.
    """
    face, first_row, rows, reach, plane = _prepared(points, np.asarray(faces), shape, both_sides)
    for start, stop in _parts(rows):
        count = rows[start:stop]
        owner = np.repeat(np.arange(start, stop), count)
        row = first_row[owner] + positions_in_runs(count)
        owner, first, count, height, rise = _cut(reach, plane, owner, row, shape[1])
        for begin, end in _parts(count):
            pixels = count[begin:end]
            line = np.repeat(np.arange(begin, end), pixels)
            within = positions_in_runs(pixels)
            yield face[owner], line, first[line] + within, height[line] + rise[line] * within


def _prepared(
    points: Float64, faces: Integers, shape: tuple[int, int], both_sides: bool
) -> tuple[Int64, Int64, Int64, Float64, Float64]:
    """Return facts about the triangles that may cover a pixel centre, counter-clockwise as seen from above.

    These are their numbers; the first row of pixel centres of each, and the number of rows; their extent,
    shape (14, n): least and greatest column, and for each edge ``l, l', r, r'``, which limits row y to
    columns from ``l + l' y`` to ``r + r' y``; and their plane, shape (7, n): column, row and height of the
    first corner, slope along a row and from row to row, least and greatest height.
    """
    corners = [np.take(points[:2], corner, axis=1) for corner in faces.T]
    last_pixel = np.array([[shape[1] - 1], [shape[0] - 1]], np.float64)
    first = np.maximum(np.ceil(np.minimum.reduce(corners) - _EDGE_PX), 0.0)
    last = np.minimum(np.floor(np.maximum.reduce(corners) + _EDGE_PX), last_pixel)
    (ab_x, ab_y), (ac_x, ac_y) = corners[1] - corners[0], corners[2] - corners[0]
    area = ab_x * ac_y - ab_y * ac_x  # twice the area as seen from above
    # Vertical triangles would only repeat the edges of their neighbours.
    faces_seen = (area > 0) | (both_sides & (area < 0))
    kept = np.flatnonzero(faces_seen & (first[0] <= last[0]) & (first[1] <= last[1]))
    area = area[kept]
    named = faces[kept].T
    if both_sides:
        named = np.where(area > 0, named, named[[0, 2, 1]])
        area = np.abs(area)
    a, b, c = (np.take(points, corner, axis=1) for corner in named)
    ab, ac = b - a, c - a
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    slope = np.stack([ab[2] * ac[1] - ab[1] * ac[2], ab[0] * ac[2] - ab[2] * ac[0]]) / area
    columns = np.stack([low[0] - _EDGE_PX, high[0] + _EDGE_PX])
    reach = np.concatenate([columns, _side(a, b), _side(b, c), _side(c, a)])
    plane = np.concatenate([a, slope, low[2:], high[2:]])
    rows = (last[1] - first[1])[kept].astype(np.int64) + 1
    return kept, first[1, kept].astype(np.int64), rows, reach, plane


def _side(start: Float64, end: Float64) -> Float64:
    """Return the limits that an edge sets to the columns of a row: ``l, l', r, r'`` of :func:`_prepared`."""
    # The inside is left of each edge: an edge towards lower rows is a lower bound of the columns, one towards
    # higher rows an upper bound, and a level one neither.
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    falls = along_y < -_EDGE_PX
    rises = along_y > _EDGE_PX
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


def _cut(
    reach: Float64, plane: Float64, owner: Int64, row: Int64, columns: int
) -> tuple[Int64, Int64, Int64, Float64, Float64]:
    """Find the scan lines of triangles in given rows.

    Returns for each scan line the triangle, the number of its first pixel, the number of pixels, the height
    at the first pixel, and the increase of the height from pixel to pixel.
    """
    left, right = np.take(reach[:2], owner, axis=1)
    for side in reach[2:].reshape(3, 4, -1):
        low, low_per_row, high, high_per_row = np.take(side, owner, axis=1)
        left = np.maximum(left, low + low_per_row * row)
        right = np.minimum(right, high + high_per_row * row)
    first = np.maximum(np.ceil(left), 0.0)
    last = np.minimum(np.floor(right), columns - 1)
    there = np.flatnonzero(first <= last)
    owner = owner[there]
    row = row[there]
    first = first[there]
    last = last[there]
    column = first.astype(np.int64)
    steps = (last - first).astype(np.int64)
    x, y, z, along_row, along_column, low, high = np.take(plane, owner, axis=1)
    level = z + along_column * (row - y)
    # Interpolated between the ends, so that no height leaves the range of a steep triangle.
    start, end = (np.clip(level + along_row * (edge - x), low, high) for edge in (first, last))
    rise = (end - start) / np.maximum(steps, 1)
    return owner, row * columns + column, steps + 1, start, rise


def _parts(counts: Int64) -> Iterator[tuple[int, int]]:
    """Divide items into runs with a total count of at most :data:`_AT_ONCE`, or of a single item."""
    ends = np.cumsum(np.append(0, counts))
    start = 0
    while start < len(counts):
        stop = max(start + 1, int(np.searchsorted(ends, ends[start] + _AT_ONCE, side="right")) - 1)
        yield start, stop
        start = stop


def positions_in_runs(counts: Int64) -> Int64:
    """Return the positions within runs of given lengths: of counts 2 and 3 these are 0, 1, 0, 1, 2."""
    starts = np.cumsum(counts) - counts
    return np.asarray(np.arange(int(counts.sum())) - np.repeat(starts, counts))
