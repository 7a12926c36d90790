"""Kernels of the twin, in numba: reliefs seen by the sensor, its response to slopes, and normal equations.

The response of a colour is a table over direction and steepness of the slope of the gel, whose entries are
quadratic in the place in the image, and the same over direction and depth of the gel, which shows where the
rim of a contact casts shadows. A pixel lies between four entries of each table, which share it bilinearly.
Where the gel is level, nothing changes. All kernels lie in this one file, because numba's cache looks at the
file of a kernel only.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import Float32, Float64, Int64
from tactile_toolkit.compiled import compiled

TURNS, STEPS = 18, 10
"""Directions of both tables, and entries along steepness and along depth."""

STEEPEST = 0.6
"""Tangent of half of the angle of the steepest slope in the table: 62 degrees."""

DEEPEST = 9 / 7
"""Greatest depth in the table, in parts of that at which the contact begins."""

_LEVEL = 1e-5
"""Slope below which the gel is at rest, as in Taxim."""

_BOW = 0.273  # angles of up to 45 degrees are ratio * (pi / 4 + _BOW (1 - ratio)) to 0.004

_RUN = 3  # pixels over which the slope at an edge is taken

PLACES = 6
"""Terms of an entry: 1, x, y, x^2, x y, y^2, where x and y go from -1 to 1 across the image."""

ENTRIES = TURNS * 2 * STEPS
"""Entries in all: for each direction, those of steepness, and those of depth."""

ACTIVE = 8
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
    per_x, per_y = 1.0 / corner[2], 1.0 / corner[3]
    across = affine[0, 0] * affine[0, 0] + affine[1, 0] * affine[1, 0]
    down = affine[0, 1] * affine[0, 1] + affine[1, 1] * affine[1, 1]
    across, down = across / (across + down), down / (across + down)
    for row in range(rows):
        v0 = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        for column in range(columns):
            u0 = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
            bend = 1.0 + lens * (across * u0 * u0 + down * v0 * v0)
            u, v = u0 * bend, v0 * bend
            x = (affine[0, 0] * u + affine[0, 1] * v + affine[0, 2] - corner[0]) * per_x
            y = (affine[1, 0] * u + affine[1, 1] * v + affine[1, 2] - corner[1]) * per_y
            x, y = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0)
            i, j = min(int(x), wide - 2), min(int(y), high - 2)
            fx, fy = x - i, y - j
            height = (1.0 - fy) * ((1.0 - fx) * relief[j, i] + fx * relief[j, i + 1]) + fy * (
                (1.0 - fx) * relief[j + 1, i] + fx * relief[j + 1, i + 1]
            )
            out[row, column] = height - level if height > level else 0.0


@compiled
def bend_surface(
    out: Float64, surface: Float64, span: Float64, margin: int, lens: float, across: float
) -> None:
    """Write a surface as it is seen through the lens, bilinear; it has ``margin`` pixels more on each side.

    ``across`` is the share of the width in the square of the diagonal.
    """
    rows, columns = out.shape
    high, wide = surface.shape
    for row in range(rows):
        v = span[1] * (1.0 - (2.0 * row + 1.0) / rows)
        for column in range(columns):
            u = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
            bend = lens * (across * u * u + (1.0 - across) * v * v)
            x = column + margin + bend * (column + 0.5 - 0.5 * columns)
            y = row + margin + bend * (row + 0.5 - 0.5 * rows)
            x, y = min(max(x, 0.0), wide - 1.0), min(max(y, 0.0), high - 1.0)
            i, j = min(int(x), wide - 2), min(int(y), high - 2)
            fx, fy = x - i, y - j
            out[row, column] = (1.0 - fy) * ((1.0 - fx) * surface[j, i] + fx * surface[j, i + 1]) + fy * (
                (1.0 - fx) * surface[j + 1, i] + fx * surface[j + 1, i + 1]
            )


@compiled
def _row_places(
    places: Float32,
    soft: Float64,
    row: int,
    pitch: Float64,
    span: Float64,
    lens: float,
    across: float,
    rim: float,
) -> None:
    """Write where in the tables the pixels of a row lie, (3, W): direction, steepness, depth.

    Directions are -1 where the gel is at rest. Slopes are those on the gel, not those seen through the lens.
    """
    rows, columns = soft.shape
    above, line, below = soft[max(row - 1, 0)], soft[row], soft[min(row + 1, rows - 1)]
    per_y = 1.0 / (pitch[1] * (min(row + 1, rows - 1) - max(row - 1, 0)))
    per_x, per_turn = 0.5 / pitch[0], TURNS / (2.0 * math.pi)
    per_steep, per_deep = 1.0 / STEEPEST, -(STEPS - 1) / (DEEPEST * rim)
    v, most = span[1] * (1.0 - (2.0 * row + 1.0) / rows), STEPS - 1.0001
    down, both = 1.0 - across, math.sqrt(across * (1.0 - across))
    turns, steeps, deeps = places[0], places[1], places[2]
    for column in range(columns):
        left, right = max(column - 1, 0), min(column + 1, columns - 1)
        x = (line[right] - line[left]) * per_x * (2.0 / (right - left))
        y = (above[column] - below[column]) * per_y
        u = span[0] * ((2.0 * column + 1.0) / columns - 1.0)
        bend = 1.0 + lens * (across * u * u + down * v * v)
        xx, yy = bend + 2.0 * lens * across * u * u, bend + 2.0 * lens * down * v * v
        xy = 2.0 * lens * both * u * v
        per_area = 1.0 / (xx * yy - xy * xy)
        x, y = (yy * x - xy * y) * per_area, (xx * y - xy * x) * per_area
        square = x * x + y * y
        wide, high = abs(x), abs(y)
        ratio = min(wide, high) / (max(wide, high) + 1e-12)
        angle = ratio * (0.25 * math.pi + _BOW * (1.0 - ratio))
        angle = angle if wide > high else 0.5 * math.pi - angle
        angle = angle if x > 0.0 else math.pi - angle
        angle = angle if y > 0.0 else 2.0 * math.pi - angle
        turns[column] = angle * per_turn if square > _LEVEL * _LEVEL else -1.0
        half = math.sqrt(square) / (1.0 + math.sqrt(1.0 + square))
        steeps[column] = min((STEPS - 1.0) * math.sqrt(half * per_steep), most)
        deeps[column] = min(max(line[column] * per_deep, 0.0), most)


@compiled
def features(soft: Float64, pitch: Float64, lens: float, rim: float, entries: Int64, shares: Float32) -> None:
    """Write the entries that each pixel takes part in, and their shares: 0 where the gel is at rest.

    ``soft``, shape (H, W), is the height of the gel, metres, 0 where it is at rest and negative where it is
    pressed in; ``pitch`` the size of a pixel, metres; ``lens`` the radial term of the camera; ``rim`` the
    depth at which the contact begins, metres. ``entries`` and ``shares`` have the shape (H W, ACTIVE).
    """
    rows, columns = soft.shape
    wide, high = columns * pitch[0], rows * pitch[1]
    across = wide * wide / (wide * wide + high * high)
    places, span = np.empty((3, columns), np.float32), np.ones(2)
    for row in range(rows):
        _row_places(places, soft, row, pitch, span, lens, across, rim)
        for column in range(columns):
            at, turn = row * columns + column, places[0, column]
            if turn < 0.0:
                entries[at], shares[at] = 0, 0.0
                continue
            first = int(turn)
            part = turn - first
            for side in range(2):
                begin = ((first + side) % TURNS) * 2 * STEPS
                share = part if side else 1.0 - part
                for kind in range(2):
                    place = places[1 + kind, column]
                    node, k = int(place), 4 * side + 2 * kind
                    entries[at, k] = begin + kind * STEPS + node
                    entries[at, k + 1] = entries[at, k] + 1
                    shares[at, k] = share * (1.0 - (place - node))
                    shares[at, k + 1] = share * (place - node)


@compiled
def _terms(terms: Float64, at: int, rows: int, columns: int, span: Float64) -> None:
    x = span[0] * ((2.0 * (at % columns) + 1.0) / columns - 1.0)
    y = span[1] * (1.0 - (2.0 * (at // columns) + 1.0) / rows)
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = 1.0, x, y, x * x, x * y, y * y


@compiled
def write_response(
    out: Float64, entries: Int64, shares: Float32, coefficients: Float64, span: Float64
) -> None:
    """Write the response (H, W, 3), levels; ``coefficients`` have the shape (ENTRIES, PLACES, 3)."""
    rows, columns = out.shape[:2]
    terms = np.empty(PLACES)
    out[:] = 0.0
    for at in range(rows * columns):
        if not shares[at].any():
            continue
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
def add_normal(normal: Float64, entries: Int64, shares: Float32, weights: Float32) -> None:
    """Add the weighted products of coefficients to the normal matrix ; each pair once."""
    rows, columns = weights.shape
    terms, count, span = np.empty(PLACES), ACTIVE * PLACES, np.ones(2)
    values, places = np.empty(count), np.empty(count, np.int64)
    for at in range(len(entries)):
        weight = weights[at // columns, at % columns]
        if weight <= 0.0 or not shares[at].any():
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
def add_products(out: Float64, entries: Int64, shares: Float32, given: Float64) -> None:
    """Add the products of coefficients and given columns (H, W, m) to ``out`` (coefficients, m)."""
    rows, columns, many = given.shape
    terms, span = np.empty(PLACES), np.ones(2)
    for at in range(len(entries)):
        line = given[at // columns, at % columns]
        if not shares[at].any():
            continue
        _terms(terms, at, rows, columns, span)
        for k in range(ACTIVE):
            for place in range(PLACES):
                share, total = shares[at, k] * terms[place], out[entries[at, k] * PLACES + place]
                for column in range(many):
                    total[column] += share * line[column]


@compiled
def render_response(
    out: Float64,
    soft: Float64,
    pitch: Float64,
    coefficients: Float32,
    span: Float64,
    lens: float,
    across: float,
    rim: float,
) -> None:
    """Write the response (H, W, 3) of a surface, as :func:`features` and :func:`write_response` do together.

    The terms of a row are summed once for the whole row, and pixels where the gel is at rest are passed over.
    ``coefficients`` have the shape (ENTRIES, PLACES, 4), the last colour 0: vectors have four lanes.
    """
    rows, columns = soft.shape
    wide, terms = 2 * STEPS * 12, np.empty(12, np.float32)
    # The first direction comes again after the last one.
    lines, places = np.empty((TURNS + 1) * wide, np.float32), np.empty((3, columns), np.float32)
    one = np.float32(1.0)
    for row in range(rows):
        y = np.float32(span[1] * (1.0 - (2.0 * row + 1.0) / rows))
        for entry in range(ENTRIES):
            held = coefficients[entry]
            for colour in range(4):
                lines[entry * 12 + colour] = held[0, colour] + y * (held[2, colour] + y * held[5, colour])
                lines[entry * 12 + 4 + colour] = held[1, colour] + y * held[4, colour]
                lines[entry * 12 + 8 + colour] = held[3, colour]
        lines[TURNS * wide :] = lines[:wide]
        _row_places(places, soft, row, pitch, span, lens, across, rim)
        for column in range(columns):
            pixel, turn = out[row, column], places[0, column]
            if turn < 0.0:
                pixel[0], pixel[1], pixel[2] = 0.0, 0.0, 0.0
                continue
            x = np.float32(span[0] * ((2.0 * column + 1.0) / columns - 1.0))
            steep, deep, first = places[1, column], places[2, column], int(turn)
            i, j, far = int(steep), int(deep), np.float32(turn - first)
            fi, fj, near = np.float32(steep - i), np.float32(deep - j), one - far
            gi, gj = one - fi, one - fj
            a, b = lines[first * wide + i * 12 :], lines[(first + 1) * wide + i * 12 :]
            c = lines[first * wide + (STEPS + j) * 12 :]
            d = lines[(first + 1) * wide + (STEPS + j) * 12 :]
            for m in range(12):
                here = (gi * a[m] + fi * a[m + 12]) + (gj * c[m] + fj * c[m + 12])
                there = (gi * b[m] + fi * b[m + 12]) + (gj * d[m] + fj * d[m + 12])
                terms[m] = near * here + far * there
            for colour in range(3):
                pixel[colour] = terms[colour] + x * (terms[colour + 4] + x * terms[colour + 8])


@compiled
def touching(contact: Float64, held: Float64, indentation: Float64, share: float, edge: float) -> None:
    """Write how much each pixel is in contact, 0 to 1, and the shape that the gel has where it is.

    Contact begins at a share of the greatest indentation, over an edge in metres.
    """
    rows, columns = indentation.shape
    greatest = 0.0
    for row in range(rows):
        for column in range(columns):
            greatest = max(greatest, indentation[row, column])
    begin, per_edge = share * greatest - 0.5 * edge, 1.0 / edge
    for row in range(rows):
        line, target, into = contact[row], held[row], indentation[row]
        for column in range(columns):
            value = (into[column] - begin) * per_edge
            value = value if value > 0.0 else 0.0
            line[column] = value if value < 1.0 else 1.0
            target[column] = -into[column]


@compiled
def shrink(out: Float64, wide: Float64, factor: int) -> None:
    """Write means of squares of a map, which goes on with the values at its edge."""
    rows, columns = wide.shape
    share = 1.0 / (factor * factor)
    for row in range(len(out)):
        target = out[row]
        target[:] = 0.0
        for down in range(factor):
            line = wide[min(row * factor + down, rows - 1)]
            for column in range(out.shape[1]):
                for across in range(factor):
                    target[column] += share * line[min(column * factor + across, columns - 1)]


@compiled
def grow(out: Float64, small: Float64, factor: int) -> None:
    """Write a map from means of its squares, bilinear."""
    rows, columns = out.shape
    high, wide = small.shape
    line = np.empty(wide)
    for row in range(rows):
        y = min(max((row + 0.5) / factor - 0.5, 0.0), high - 1.0)
        j = min(int(y), high - 2)
        above, below, part = small[j], small[j + 1], y - j
        for column in range(wide):
            line[column] = above[column] + part * (below[column] - above[column])
        target = out[row]
        for column in range(columns):
            x = min(max((column + 0.5) / factor - 0.5, 0.0), wide - 1.0)
            i = min(int(x), wide - 2)
            target[column] = line[i] + (x - i) * (line[i + 1] - line[i])


@compiled
def hold(soft: Float64, held: Float64, contact: Float64) -> None:
    """Give a surface the shape of the solid to a share, in place."""
    rows, columns = soft.shape
    for row in range(rows):
        line, target, share = soft[row], held[row], contact[row]
        for column in range(columns):
            line[column] += share[column] * (target[column] - line[column])


@compiled
def lay_over(out: Float32, response: Float64, behind: Float64) -> None:
    """Write shades, 0 to 1, (H, W, 3), of a response over a background, levels."""
    flat, change, below = out.reshape(out.size), response.reshape(out.size), behind.reshape(out.size)
    for at in range(len(flat)):
        shade = (change[at] + below[at]) * (1.0 / 255.0)
        shade = shade if shade > 0.0 else 0.0
        flat[at] = np.float32(shade if shade < 1.0 else 1.0)


@compiled
def extend(out: Float64, reached: Float64, margin: int) -> None:
    """Write a map with ``margin`` pixels more on each side, where its slopes at the edge go on.

    Values stay between 0 and the greatest of the map.
    """
    rows, columns = reached.shape
    greatest = 0.0
    for row in range(rows):
        line, wide = reached[row], out[row + margin]
        for column in range(columns):
            greatest = max(greatest, line[column])
            wide[column + margin] = line[column]
        first = (line[_RUN] - line[0]) / _RUN
        last = (line[columns - 1] - line[columns - 1 - _RUN]) / _RUN
        for far in range(1, margin + 1):
            wide[margin - far] = line[0] - far * first
            wide[margin + columns - 1 + far] = line[columns - 1] + far * last
    bottom = margin + rows - 1
    for column in range(columns + 2 * margin):
        first = (out[margin + _RUN, column] - out[margin, column]) / _RUN
        last = (out[bottom, column] - out[bottom - _RUN, column]) / _RUN
        for far in range(1, margin + 1):
            out[margin - far, column] = out[margin, column] - far * first
            out[bottom + far, column] = out[bottom, column] + far * last
    for row in range(len(out)):
        for column in range(columns + 2 * margin):
            out[row, column] = min(max(out[row, column], 0.0), greatest)
