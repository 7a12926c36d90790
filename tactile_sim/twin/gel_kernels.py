"""Kernels of the twin, in numba: reliefs seen by the sensor, its response to slopes, and normal equations.

The response of a colour is a table over the slope of the gel, whose entries are quadratic in the place in the
image, and the same for the depth of the gel. A pixel lies between four entries of the table, which share it
bilinearly. All kernels lie in this one file, because numba's cache on disk looks at the file of a kernel only.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import Float32, Float64, Int64
from tactile_toolkit.compiled import compiled

NODES = 15
"""Entries of the table along each of the two slopes."""

STEEPEST = 0.6
"""Tangent of half of the angle of the steepest slope in the table: 62 degrees."""

_CROWDED = 1.0  # entries lie three times as close where the gel is level, which most of it is

PLACES = 6
"""Terms of an entry: 1, x, y, x^2, x y, y^2, where x and y go from -1 to 1 across the image."""

DEPTHS = NODES * NODES
"""Number of entries for slopes, after which those for the depth follow."""

ENTRIES = NODES * NODES + 2
"""Entries in all: slopes, depth in mm, and its square."""

ACTIVE = 6
"""Entries that a pixel takes part in."""


@compiled
def sample_relief(
    out: Float64, relief: Float32, corner: Float64, affine: Float64, span: Float64, lens: float, level: float
) -> None:
    """Write how far a relief rises above a level, 0 where it does not.

    ``out``, shape (H, W), first row at the greatest y; ``relief``, shape (rows, columns), heights in metres,
    first row at the least y, continued by its edge; ``corner`` x and y of its first point and the distances
    of its points along x and y, metres. Pixels lie at -1 to 1 across the image, times ``span``, which is less
    than 1 for a part of it, with y upwards. ``lens`` is the radial term of the camera: at the corners of the
    image, positions are farther out by this share. ``affine``, shape (2, 3), maps a position to x and y.
    """
    rows, columns = out.shape
    high, wide = relief.shape
    across = affine[0, 0] * affine[0, 0] + affine[1, 0] * affine[1, 0]
    down = affine[0, 1] * affine[0, 1] + affine[1, 1] * affine[1, 1]
    across, down = across / (across + down), down / (across + down)
    for row in range(rows):
        v0 = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        for column in range(columns):
            u0 = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
            bend = 1.0 + lens * (across * u0 * u0 + down * v0 * v0)
            u, v = u0 * bend, v0 * bend
            x = (affine[0, 0] * u + affine[0, 1] * v + affine[0, 2] - corner[0]) / corner[2]
            y = (affine[1, 0] * u + affine[1, 1] * v + affine[1, 2] - corner[1]) / corner[3]
            x, y = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0)
            i, j = min(int(x), wide - 2), min(int(y), high - 2)
            fx, fy = x - i, y - j
            height = (1.0 - fy) * ((1.0 - fx) * relief[j, i] + fx * relief[j, i + 1]) + fy * (
                (1.0 - fx) * relief[j + 1, i] + fx * relief[j + 1, i + 1]
            )
            out[row, column] = height - level if height > level else 0.0


@compiled
def _slope(soft: Float64, row: int, column: int, per_x: float, per_y: float) -> tuple[float, float]:
    """Return the slopes along x and y (upwards) as tangents of half of the angle."""
    rows, columns = soft.shape
    left, right = max(column - 1, 0), min(column + 1, columns - 1)
    above, below = max(row - 1, 0), min(row + 1, rows - 1)
    x = (soft[row, right] - soft[row, left]) * (per_x / (right - left))
    y = (soft[above, column] - soft[below, column]) * (per_y / (below - above))
    scale = 1.0 / (1.0 + math.sqrt(1.0 + x * x + y * y))
    return x * scale, y * scale


@compiled
def _place(slope: float) -> tuple[int, float]:
    far = 4.0 * _CROWDED * (1.0 + _CROWDED) * abs(slope) / STEEPEST
    far = (math.sqrt(1.0 + far) - 1.0) / (2.0 * _CROWDED)
    at = (1.0 + (far if slope > 0.0 else -far)) * (0.5 * (NODES - 1))
    at = min(max(at, 0.0), NODES - 1.000001)
    node = int(at)
    return node, at - node


@compiled
def features(soft: Float64, pitch: Float64, entries: Int64, shares: Float32) -> None:
    """Write the entries that each pixel takes part in, and their shares.

    ``soft``, shape (H, W), is the height of the gel, metres, 0 where it is at rest and negative where it is
    pressed in; ``pitch`` the size of a pixel, metres. ``entries`` and ``shares`` have the shape (H W, ACTIVE).
    """
    rows, columns = soft.shape
    for row in range(rows):
        for column in range(columns):
            x, y = _slope(soft, row, column, 1.0 / pitch[0], 1.0 / pitch[1])
            (i, fx), (j, fy) = _place(x), _place(y)
            at = row * columns + column
            node = j * NODES + i
            entries[at, 0], shares[at, 0] = node, (1.0 - fx) * (1.0 - fy)
            entries[at, 1], shares[at, 1] = node + 1, fx * (1.0 - fy)
            entries[at, 2], shares[at, 2] = node + NODES, (1.0 - fx) * fy
            entries[at, 3], shares[at, 3] = node + NODES + 1, fx * fy
            deep = -1e3 * soft[row, column]
            entries[at, 4], shares[at, 4] = DEPTHS, deep
            entries[at, 5], shares[at, 5] = DEPTHS + 1, deep * deep


@compiled
def _terms(terms: Float64, at: int, rows: int, columns: int, span: Float64) -> None:
    x = span[0] * ((2.0 * (at % columns) + 1.0) / columns - 1.0)
    y = span[1] * (1.0 - (2.0 * (at // columns) + 1.0) / rows)
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = 1.0, x, y, x * x, x * y, y * y


@compiled
def respond(
    out: Float64, entries: Int64, shares: Float32, coefficients: Float64, span: Float64
) -> None:
    """Write the response (H, W, 3), levels; ``coefficients`` have the shape (ENTRIES, PLACES, 3)."""
    rows, columns = out.shape[:2]
    terms = np.empty(PLACES)
    for at in range(rows * columns):
        _terms(terms, at, rows, columns, span)
        for colour in range(3):
            total = 0.0
            for k in range(ACTIVE):
                entry = coefficients[entries[at, k]]
                value = 0.0
                for place in range(PLACES):
                    value += entry[place, colour] * terms[place]
                total += shares[at, k] * value
            out[at // columns, at % columns, colour] = total


@compiled
def add_normal(
    normal: Float64, entries: Int64, shares: Float32, weights: Float32
) -> None:
    """Add the weighted products of coefficients to the normal matrix ; each pair once."""
    rows, columns = weights.shape
    terms, count, span = np.empty(PLACES), ACTIVE * PLACES, np.ones(2)
    values, places = np.empty(count), np.empty(count, np.int64)
    for at in range(len(entries)):
        weight = weights[at // columns, at % columns]
        if weight <= 0.0:
            continue
        _terms(terms, at, rows, columns, span)
        for k in range(ACTIVE):
            for place in range(PLACES):
                values[k * PLACES + place] = shares[at, k] * terms[place]
                places[k * PLACES + place] = entries[at, k] * PLACES + place
        for one in range(count):
            weighed, line = values[one] * weight, normal[places[one]]
            for other in range(one + 1):
                line[places[other]] += weighed * values[other]


@compiled
def add_products(
    out: Float64,
    entries: Int64,
    shares: Float32,
    weights: Float32,
    given: Float32,
) -> None:
    """Add the weighted products of coefficients and given columns (H, W, m) to ``out`` (coefficients, m)."""
    rows, columns, many = given.shape
    terms, span = np.empty(PLACES), np.ones(2)
    for at in range(len(entries)):
        weight, line = weights[at // columns, at % columns], given[at // columns, at % columns]
        if weight <= 0.0:
            continue
        _terms(terms, at, rows, columns, span)
        for k in range(ACTIVE):
            for place in range(PLACES):
                weighed, total = weight * shares[at, k] * terms[place], out[entries[at, k] * PLACES + place]
                for column in range(many):
                    total[column] += weighed * line[column]


@compiled
def render_response(out: Float64, soft: Float64, pitch: Float64, coefficients: Float64, span: Float64) -> None:
    """Write the response (H, W, 3) of a surface, as :func:`features` and :func:`respond` do together.

    The terms of a row are summed once for the whole row, and pixels where the gel is at rest are passed over.
    """
    rows, columns = soft.shape
    line = np.empty((ENTRIES, 3, 3))
    per_x, per_y = 1.0 / pitch[0], 1.0 / pitch[1]

    for row in range(rows):
        y = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        for entry in range(ENTRIES):
            for colour in range(3):
                held = coefficients[entry, :, colour]
                line[entry, 0, colour] = held[0] + y * (held[2] + y * held[5])
                line[entry, 1, colour] = held[1] + y * held[4]
                line[entry, 2, colour] = held[3]
        for column in range(columns):
            slope_x, slope_y = _slope(soft, row, column, per_x, per_y)
            deep = -1e3 * soft[row, column]
            pixel = out[row, column]
            if slope_x == 0.0 and slope_y == 0.0 and deep == 0.0:
                pixel[0], pixel[1], pixel[2] = 0.0, 0.0, 0.0
                continue
            x = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
            (i, fx), (j, fy) = _place(slope_x), _place(slope_y)
            node = j * NODES + i
            a, b = line[node], line[node + 1]
            c, d = line[node + NODES], line[node + NODES + 1]
            e, f = line[DEPTHS], line[DEPTHS + 1]
            wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
            for colour in range(3):
                total = 0.0
                for power in range(2, -1, -1):
                    value = (wa * a[power, colour] + wb * b[power, colour]) + (
                        wc * c[power, colour] + wd * d[power, colour]
                    )
                    value = (value + deep * e[power, colour]) + deep * deep * f[power, colour]
                    total = value + x * total
                pixel[colour] = total
