"""Kernels of the twin, in numba: reliefs seen by the sensor, its response to slopes, and normal equations.

The response of a colour is the sum of two tables: one over direction and steepness of the slope of the gel,
and one over direction and depth of the gel, which models the shadows of the rim of a contact. Their entries
are quadratic in the position in the image. A pixel interpolates bilinearly between four entries of each
table. Where the gel is level, the image does not change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float32, Float64, Int64

TURNS, STEPS = 18, 10
"""Directions of both tables, and entries along steepness and along depth."""

STEEPEST = 0.6
"""Tangent of half of the angle of the steepest slope in the table: 62 degrees."""

DEEPEST = 9 / 7
"""Greatest depth in the table, as a multiple of the depth at which the contact begins."""

_LEVEL = 1e-5
"""Slope below which the gel counts as at rest, as in Taxim."""

_NEAREST = 0.2
"""Least stretch of a seen map: where it is smaller, one part of the gel hides another one."""

_BOW = 0.273  # atan(ratio) is ratio * (pi / 4 + _BOW (1 - ratio)) within 0.004 for ratios up to 1

TERMS = 6
"""Terms of an entry: 1, x, y, x^2, x y, y^2, where x and y go from -1 to 1 across the image."""

ENTRIES = TURNS * 2 * STEPS
"""Number of entries: for each direction, those of steepness and then those of depth."""

ENTRY_VALUES = 16
"""Values of an entry in :func:`render_response`: four colours without x, with x, with x^2, and four zeros.

The fourth colour is 0. Twelve values, which fill vector registers less well, take longer.
"""

ACTIVE = 8
"""Number of entries that a pixel depends on."""


class SurfaceView(NamedTuple):
    """How a surface is seen.

    The fields are the size of a pixel, metres; the share of the image that is shown, along x and y; the
    radial term of the lens; the squared width of the image over its squared diagonal; one over the distance
    of the camera, 1 / metres; and the depth at which the contact begins, metres.
    """

    pitch_x: float
    pitch_y: float
    span_x: float
    span_y: float
    lens: float
    across: float
    camera: float
    rim: float


@compiled
def sample_relief(
    out: Float64, relief: Float32, corner: Float64, affine: Float64, span: Float64, level: float
) -> None:
    """Write how far a relief rises above a level, 0 where it does not.

    ``out``, shape (H, W), first row at the greatest y; ``relief``, shape (rows, columns), heights in metres,
    first row at the least y, with the values of its edge repeated outside; ``corner`` x and y of its first
    point and the distances of its points along x and y, metres. Pixels lie at -1 to 1 across the image, times
    ``span``, which is less than 1 for a part of it and more with a margin, with y upwards. ``affine``, shape
    (2, 3), maps a position to x and y.
    """
    rows, columns = out.shape
    high, wide = relief.shape
    per_x, per_y = 1.0 / corner[2], 1.0 / corner[3]
    for row in range(rows):
        v = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        for column in range(columns):
            u = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
            x = (affine[0, 0] * u + affine[0, 1] * v + affine[0, 2] - corner[0]) * per_x
            y = (affine[1, 0] * u + affine[1, 1] * v + affine[1, 2] - corner[1]) * per_y
            x, y = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0)
            i, j = min(int(x), wide - 2), min(int(y), high - 2)
            fx, fy = x - i, y - j
            height = (1.0 - fy) * ((1.0 - fx) * relief[j, i] + fx * relief[j, i + 1]) + fy * (
                (1.0 - fx) * relief[j + 1, i] + fx * relief[j + 1, i + 1]
            )
            out[row, column] = height - level if height > level else 0.0


@part
def column_x(column: int, columns: int, view: SurfaceView) -> np.float32:
    """Return how far a pixel lies to the right, -1 to 1 times the share of the image; single precision."""
    return np.float32(view.span_x * ((2.0 * column + 1.0) / columns - 1.0))


@part
def row_y(row: int, rows: int, view: SurfaceView) -> np.float32:
    """Return how far a pixel lies above the middle, -1 to 1 times the share of the image."""
    return np.float32(view.span_y * (1.0 - (2.0 * row + 1.0) / rows))


@part
def _turn(x: np.float32, y: np.float32) -> np.float32:
    """Return the direction of a slope, in steps of the table."""
    zero, unit = np.float32(0.0), np.float32(1.0)
    quarter = np.float32(0.25 * math.pi)
    wide, high = abs(x), abs(y)
    small, large = (wide, high) if wide < high else (high, wide)
    ratio = small / (large + np.float32(1e-12))
    angle = ratio * (quarter + np.float32(_BOW) * (unit - ratio))
    angle = angle if wide > high else np.float32(0.5 * math.pi) - angle
    angle = angle if x > zero else np.float32(math.pi) - angle
    angle = angle if y > zero else np.float32(2.0 * math.pi) - angle
    # A whole turn would lie beyond the last direction.
    most = np.float32(TURNS - 1e-5)
    angle = angle * np.float32(TURNS / (2.0 * math.pi))
    return angle if angle < most else most


@part
def _row_positions(positions: Float32, soft: Float32, row: int, view: SurfaceView) -> None:
    """Write where in the tables the pixels of a row lie, (3, W): direction, steepness, depth.

    Directions are -1 where the gel is at rest. Slopes are those on the gel, not those that the camera sees.
    Single precision and no branches: several pixels are computed at once.
    """
    rows, columns = soft.shape
    zero, unit, two = np.float32(0.0), np.float32(1.0), np.float32(2.0)
    least = np.float32(_LEVEL * _LEVEL)
    last = np.float32(STEPS - 1.0)
    per_steep = np.float32(1.0 / STEEPEST)
    most = np.float32(STEPS - 1.0001)
    above = soft[max(row - 1, 0)]
    line = soft[row]
    below = soft[min(row + 1, rows - 1)]
    per_y = np.float32(1.0 / (view.pitch_y * (min(row + 1, rows - 1) - max(row - 1, 0))))
    per_x = np.float32(0.5 / view.pitch_x)
    per_deep = np.float32(-(STEPS - 1) / (DEEPEST * view.rim))
    v = row_y(row, rows, view)
    across = np.float32(view.across)
    down = np.float32(1.0 - view.across)
    both = np.float32(math.sqrt(view.across * (1.0 - view.across)))
    lens, camera = np.float32(view.lens), np.float32(view.camera)
    from_left, width = np.float32(0.5 - 0.5 * columns), np.float32(view.pitch_x)
    up = np.float32(view.pitch_y * (0.5 * rows - row - 0.5))
    nearest = np.float32(_NEAREST)
    turns, steeps, deeps = positions[0], positions[1], positions[2]
    for column in range(1, columns - 1):
        steeps[column] = (line[column + 1] - line[column - 1]) * per_x
    steeps[0] = (line[1] - line[0]) * per_x * two
    steeps[columns - 1] = (line[columns - 1] - line[columns - 2]) * per_x * two
    for column in range(columns):
        x = steeps[column]
        y = (above[column] - below[column]) * per_y
        u = column_x(column, columns, view)
        bend = unit + lens * (across * u * u + down * v * v)
        xx, yy = bend + two * lens * across * u * u, bend + two * lens * down * v * v
        xy = two * lens * both * u * v
        per_area = unit / (xx * yy - xy * xy)
        x, y = (yy * x - xy * y) * per_area, (xx * y - xy * x) * per_area
        # A point at (1 + height / distance) p is seen at p.
        stretch = unit + camera * (line[column] + bend * (width * (column + from_left) * x + up * y))
        stretch = unit / (stretch if stretch > nearest else nearest)
        x, y = x * stretch, y * stretch
        square = x * x + y * y
        turn = _turn(x, y)
        turns[column] = turn if square > least else -unit
        tangent = math.sqrt(square) / (unit + math.sqrt(unit + square))
        steep = last * math.sqrt(tangent * per_steep)
        deep = line[column] * per_deep
        deep = deep if deep > zero else zero
        steeps[column] = steep if steep < most else most
        deeps[column] = deep if deep < most else most


@compiled
def features(soft: Float32, view: SurfaceView, entries: Int64, shares: Float32) -> None:
    """Write the entries that each pixel depends on, and their shares: 0 where the gel is at rest.

    ``soft``, shape (H, W), is the height of the gel, metres, 0 where it is at rest and negative where it is
    pressed in. ``entries`` and ``shares`` have the shape (H W, ACTIVE).
    """
    rows, columns = soft.shape
    positions = np.empty((3, columns), np.float32)
    for row in range(rows):
        _row_positions(positions, soft, row, view)
        for column in range(columns):
            at = row * columns + column
            turn = positions[0, column]
            if turn < 0.0:
                entries[at], shares[at] = 0, 0.0
                continue
            first = int(turn)
            part = turn - first
            for side in range(2):
                begin = ((first + side) % TURNS) * 2 * STEPS
                share = part if side else 1.0 - part
                for kind in range(2):
                    position = positions[1 + kind, column]
                    node = int(position)
                    k = 4 * side + 2 * kind
                    entries[at, k] = begin + kind * STEPS + node
                    entries[at, k + 1] = entries[at, k] + 1
                    shares[at, k] = share * (1.0 - (position - node))
                    shares[at, k + 1] = share * (position - node)


@part
def _terms(terms: Float64, at: int, rows: int, columns: int) -> None:
    x = (2.0 * (at % columns) + 1.0) / columns - 1.0
    y = 1.0 - (2.0 * (at // columns) + 1.0) / rows
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = 1.0, x, y, x * x, x * y, y * y


@compiled
def add_normal(normal: Float64, entries: Int64, shares: Float32, weights: Float32) -> None:
    """Add weighted products of features to the lower half of the normal matrix of coefficients."""
    rows, columns = weights.shape
    terms = np.empty(TERMS)
    count = ACTIVE * TERMS
    values = np.empty(count)
    unknowns = np.empty(count, np.int64)
    for at in range(len(entries)):
        weight = weights[at // columns, at % columns]
        if weight <= 0.0 or not shares[at].any():
            continue
        _terms(terms, at, rows, columns)
        # In the order of the entries: the direction after the last one is the first.
        begin = 0 if entries[at, 0] <= entries[at, ACTIVE // 2] else ACTIVE // 2
        for number in range(ACTIVE):
            k = (begin + number) % ACTIVE
            for term in range(TERMS):
                values[number * TERMS + term] = shares[at, k] * terms[term]
                unknowns[number * TERMS + term] = entries[at, k] * TERMS + term
        for row in range(count):
            weighed = values[row] * weight
            line = normal[unknowns[row]]
            for column in range(row + 1):
                line[unknowns[column]] += weighed * values[column]


@compiled
def add_products(out: Float64, entries: Int64, shares: Float32, values: Float32) -> None:
    """Add the products of features and given columns (H, W, m) to ``out`` (coefficients, m)."""
    rows, columns, many = values.shape
    terms = np.empty(TERMS)
    for at in range(len(entries)):
        line = values[at // columns, at % columns]
        if not shares[at].any():
            continue
        _terms(terms, at, rows, columns)
        for k in range(ACTIVE):
            for term in range(TERMS):
                share = shares[at, k] * terms[term]
                total = out[entries[at, k] * TERMS + term]
                for column in range(many):
                    total[column] += share * line[column]


@compiled
def render_response(out: Float32, soft: Float32, view: SurfaceView, table: Float32) -> None:
    """Write the response (H, W, 3) of a surface (H, W), from its coefficients.

    ``table`` (3, ENTRIES, ENTRY_VALUES) has the terms of each entry without y, with y, and with y^2. They are
    summed once for each row. Pixels at rest are 0.
    """
    rows, columns = soft.shape
    turn = 2 * STEPS
    unit = np.float32(1.0)
    # The first direction is repeated after the last one.
    lines = np.empty((ENTRIES + turn, ENTRY_VALUES), np.float32)
    flat = lines.reshape(lines.size)
    size = ENTRIES * ENTRY_VALUES
    plain, once, twice = table[0].reshape(size), table[1].reshape(size), table[2].reshape(size)
    positions = np.empty((3, columns), np.float32)
    term = np.empty(ENTRY_VALUES, np.float32)
    out[:] = np.float32(0.0)
    for row in range(rows):
        _row_positions(positions, soft, row, view)
        if positions[0].max() < 0.0:
            continue
        y = row_y(row, rows, view)
        for at in range(size):
            flat[at] = plain[at] + y * (once[at] + y * twice[at])
        lines[ENTRIES:] = lines[:turn]
        for column in range(columns):
            if positions[0, column] < 0.0:
                continue
            first, i, j = int(positions[0, column]), int(positions[1, column]), int(positions[2, column])
            far = positions[0, column] - np.float32(first)
            fi, fj = positions[1, column] - np.float32(i), positions[2, column] - np.float32(j)
            near, gi, gj = unit - far, unit - fi, unit - fj
            steep = first * turn + i
            deep = first * turn + STEPS + j
            a = lines[steep]
            b = lines[steep + 1]
            c = lines[deep]
            d = lines[deep + 1]
            e = lines[steep + turn]
            f = lines[steep + turn + 1]
            g = lines[deep + turn]
            h = lines[deep + turn + 1]
            for m in range(ENTRY_VALUES):
                here = (gi * a[m] + fi * b[m]) + (gj * c[m] + fj * d[m])
                there = (gi * e[m] + fi * f[m]) + (gj * g[m] + fj * h[m])
                term[m] = near * here + far * there
            x = column_x(column, columns, view)
            pixel = out[row, column]
            for k in range(3):
                pixel[k] = term[k] + x * (term[4 + k] + x * term[8 + k])
