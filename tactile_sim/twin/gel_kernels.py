"""Kernels of the response of a twin, in numba: to slopes, depth and lost light, and its normal equations.

The response of a colour is the sum of a table over direction and steepness of the slope of the gel, of one
over its depth, which brings it nearer to the lamps, and of the light that shadows take away. Light is taken
as the sum of some distant lamps, at all sides and of several heights. A lamp is behind what rises above its
ray, and what it gave is lost: as much as the slope turns to it (Lambert). All entries are sums of terms: of
the position in the image, quadratic, and of the colours of the gel at rest, which tell where lamps are near.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_sim.twin.view_kernels import DEPTHS, STEPS, TURNS, SurfaceView, column_x, row_positions, row_y
from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float32, Float64, Int64

AZIMUTHS = 8
"""Directions of lamps whose light may be lost."""

HEIGHTS = np.array([0.2, 0.4, 0.8])
"""Tangents of the elevations of these lamps."""

_PENUMBRA = np.float32(0.1)  # tangent, over which light is lost

_TANGENTS = HEIGHTS.astype(np.float32)
_COSINES = (1 / np.hypot(1, HEIGHTS)).astype(np.float32)
_TOWARDS = np.array(
    [[math.cos(2 * math.pi * k / AZIMUTHS), math.sin(2 * math.pi * k / AZIMUTHS)] for k in range(AZIMUTHS)],
    np.float32,
)

TERMS = 9
"""Terms of an entry: 1, x, y, x^2, x y, y^2, from -1 to 1 across the image, and the colours at rest."""

COLOURS = 6
"""The first of the terms of the colours at rest; lost light has only these."""

SLOPES = TURNS * STEPS
LAMPS = SLOPES + DEPTHS
ENTRIES = LAMPS + AZIMUTHS * len(HEIGHTS)
"""Number of entries: those of slopes, by direction, of depths, and of lamps, by direction."""

ENTRY_VALUES = 4 * TERMS
"""Values of an entry in :func:`render_response`: three colours and a zero for each term."""

_LINE_VALUES = 24
_SLOPED, _FILLED = 4, 6
ACTIVE = _FILLED + AZIMUTHS * len(HEIGHTS)
"""Number of entries that a pixel may depend on: four of slopes, two of depths, and all lamps."""


@part
def _horizons(soft: Float32, view: SurfaceView, reaches: Float64) -> Float32:
    """Return how steeply the gel rises towards the camera on the way to each lamp, (AZIMUTHS, H, W).

    The tangent is the greatest over the distances ``reaches``, metres; 0 where nothing is higher.
    """
    rows, columns = soft.shape
    out = np.zeros((AZIMUTHS, rows, columns), np.float32)
    # Outside, the edge goes on: what lies farther away than a side of the map is the edge too.
    pad_x = min(int(reaches[-1] / view.pitch_x), columns) + 2
    pad_y = min(int(reaches[-1] / view.pitch_y), rows) + 2
    wide = np.empty((rows + 2 * pad_y, columns + 2 * pad_x), np.float32)
    for row in range(len(wide)):
        line = soft[min(max(row - pad_y, 0), rows - 1)]
        wide[row, :pad_x] = line[0]
        wide[row, pad_x : pad_x + columns] = line
        wide[row, pad_x + columns :] = line[columns - 1]
    for azimuth in range(AZIMUTHS):
        for reach in reaches:
            across = _TOWARDS[azimuth, 0] * reach / view.pitch_x
            up = _TOWARDS[azimuth, 1] * reach / view.pitch_y
            x = pad_x + min(max(across, -columns), columns)
            y = pad_y - min(max(up, -rows), rows)
            i, j = int(x), int(y)
            right, below = np.float32(x - i), np.float32(y - j)
            left, above = np.float32(1.0) - right, np.float32(1.0) - below
            steeper = np.float32(1.0 / reach)
            for row in range(rows):
                line = soft[row]
                upper, lower = wide[row + j, i:], wide[row + j + 1, i:]
                target = out[azimuth, row]
                for column in range(columns):
                    away = above * (left * upper[column] + right * upper[column + 1])
                    away += below * (left * lower[column] + right * lower[column + 1])
                    rise = (line[column] - away) * steeper
                    target[column] = rise if rise > target[column] else target[column]
    return out


@compiled
def lost_light(soft: Float32, view: SurfaceView, reaches: Float64) -> Float32:
    """Return the light of each lamp that the pixels of a surface lose, negative, (H, W, lamps)."""
    rows, columns = soft.shape
    ahead = _horizons(soft, view, reaches)
    unit, zero = np.float32(1.0), np.float32(0.0)
    out = np.zeros((rows, columns, ENTRIES - LAMPS), np.float32)
    positions = np.empty((5, columns), np.float32)
    for row in range(rows):
        row_positions(positions, soft, row, view)
        for column in range(columns):
            x, y = positions[3, column], positions[4, column]
            turned = unit / np.float32(math.sqrt(unit + x * x + y * y))
            for azimuth in range(AZIMUTHS):
                rise = ahead[azimuth, row, column]
                if rise <= _TANGENTS[0]:
                    continue
                level = x * _TOWARDS[azimuth, 0] + y * _TOWARDS[azimuth, 1]
                for height in range(len(_TANGENTS)):
                    share = (rise - _TANGENTS[height]) / _PENUMBRA
                    share = share if share > zero else zero
                    share = share if share < unit else unit
                    towards = (level + _TANGENTS[height]) * turned * _COSINES[height]
                    towards = towards if towards > zero else zero
                    out[row, column, azimuth * len(_TANGENTS) + height] = -share * towards
    return out


@part
def _interpolated(out: Float32, source: Float32, row: float, column: float) -> None:
    """Write the values of a map (h, w, k) at a place, which is moved into the map, bilinearly."""
    rows, columns, many = source.shape
    row, column = min(max(row, 0.0), rows - 1.0), min(max(column, 0.0), columns - 1.0)
    j, i = min(int(row), rows - 2), min(int(column), columns - 2)
    below, right = np.float32(row - j), np.float32(column - i)
    above, left = np.float32(1.0) - below, np.float32(1.0) - right
    a, b, c, d = source[j, i], source[j, i + 1], source[j + 1, i], source[j + 1, i + 1]
    for k in range(many):
        out[k] = above * (left * a[k] + right * b[k]) + below * (left * c[k] + right * d[k])


@compiled
def features(
    soft: Float32, lost: Float32, scale: float, view: SurfaceView, entries: Int64, shares: Float32
) -> None:
    """Write the entries that each pixel depends on, and their shares: 0 where the gel is at rest.

    ``soft``, shape (H, W), is the height of the gel, metres, 0 where it is at rest and negative where it is
    pressed in; ``lost`` its :func:`lost_light` on a map that is smaller by ``scale``. ``entries`` and
    ``shares`` have the shape (H W, ACTIVE).
    """
    rows, columns = soft.shape
    positions = np.empty((5, columns), np.float32)
    for row in range(rows):
        row_positions(positions, soft, row, view)
        for column in range(columns):
            at = row * columns + column
            turn = positions[0, column]
            first = max(int(turn), 0)
            part = turn - first
            node = int(positions[1, column])
            far = positions[1, column] - node
            for side in range(2):
                share = part if side else 1.0 - part
                share = share if turn >= 0.0 else 0.0
                entries[at, 2 * side] = ((first + side) % TURNS) * STEPS + node
                entries[at, 2 * side + 1] = entries[at, 2 * side] + 1
                shares[at, 2 * side] = share * (1.0 - far)
                shares[at, 2 * side + 1] = share * far
            node = int(positions[2, column])
            far = positions[2, column] - node
            entries[at, _SLOPED], entries[at, _SLOPED + 1] = SLOPES + max(node - 1, 0), SLOPES + node
            shares[at, _SLOPED] = 1.0 - far if node else 0.0
            shares[at, _SLOPED + 1] = far
            for lamp in range(_FILLED, ACTIVE):
                entries[at, lamp] = LAMPS + lamp - _FILLED
            y, x = (row + 0.5) * scale - 0.5, (column + 0.5) * scale - 0.5
            _interpolated(shares[at, _FILLED:], lost, y, x)


@compiled
def add_normal(normal: Float64, entries: Int64, shares: Float32, terms: Float32, weights: Float32) -> None:
    """Add weighted products of features to the lower half of the normal matrix of coefficients."""
    columns = weights.shape[1]
    values = np.empty(ACTIVE * TERMS)
    unknowns = np.empty(ACTIVE * TERMS, np.int64)
    for at in range(len(entries)):
        weight = weights[at // columns, at % columns]
        if weight <= 0.0:
            continue
        here = terms[at // columns, at % columns]
        # In the order of the entries: the direction after the last one is the first.
        begin = 0 if entries[at, 0] <= entries[at, 2] else 2
        count = 0
        for number in range(ACTIVE):
            k = (begin + number) % _SLOPED if number < _SLOPED else number
            if shares[at, k] == 0.0:
                continue
            for term in range(0 if number < _FILLED else COLOURS, TERMS):
                values[count] = shares[at, k] * here[term]
                unknowns[count] = entries[at, k] * TERMS + term
                count += 1
        for row in range(count):
            weighed = values[row] * weight
            line = normal[unknowns[row]]
            for column in range(row + 1):
                line[unknowns[column]] += weighed * values[column]


@compiled
def add_products(out: Float64, entries: Int64, shares: Float32, terms: Float32, values: Float32) -> None:
    """Add the products of features and given columns (H, W, m) to ``out`` (coefficients, m)."""
    columns, many = values.shape[1:]
    for at in range(len(entries)):
        line = values[at // columns, at % columns]
        here = terms[at // columns, at % columns]
        for k in range(ACTIVE):
            if shares[at, k] == 0.0:
                continue
            for term in range(0 if k < _FILLED else COLOURS, TERMS):
                share = shares[at, k] * here[term]
                total = out[entries[at, k] * TERMS + term]
                for column in range(many):
                    total[column] += share * line[column]


@part
def _darkened(lost: Float32, table: Float32) -> Float32:
    """Return what lost light takes from each term of the colours at rest, (h, w, 3 TERMS of four values)."""
    rows, columns, lamps = lost.shape
    first = 4 * COLOURS
    out = np.zeros((rows, columns, ENTRY_VALUES - first), np.float32)
    for row in range(rows):
        for column in range(columns):
            total = out[row, column]
            for lamp in range(lamps):
                share = lost[row, column, lamp]
                if share != np.float32(0.0):
                    line = table[LAMPS + lamp, first:]
                    for m in range(ENTRY_VALUES - first):
                        total[m] += share * line[m]
    return out


@compiled
def render_response(
    out: Float32,
    soft: Float32,
    lost: Float32,
    scale: float,
    view: SurfaceView,
    terms: Float32,
    table: Float32,
) -> None:
    """Write the response (H, W, 3) of a surface (H, W), from its coefficients.

    ``lost`` and ``scale`` are those of :func:`features`; ``terms`` (H, W, TERMS) those of each pixel;
    ``table`` (ENTRIES, ENTRY_VALUES) has the terms of each entry. Pixels at rest are 0.
    """
    rows, columns = soft.shape
    high, wide = lost.shape[:2]
    unit, zero = np.float32(1.0), np.float32(0.0)
    dark = _darkened(lost, table)
    behind = np.empty(dark.shape[1:], np.float32)
    lines = np.empty((LAMPS, _LINE_VALUES), np.float32)
    positions = np.empty((5, columns), np.float32)
    total = np.empty(_LINE_VALUES, np.float32)
    shade = np.empty(4, np.float32)
    for row in range(rows):
        row_positions(positions, soft, row, view)
        _sum_rows(lines, table, row_y(row, rows, view))
        down = min(max((row + 0.5) * scale - 0.5, 0.0), high - 1.0)
        j = min(int(down), high - 2)
        lower = np.float32(down - j)
        behind[:] = (unit - lower) * dark[j] + lower * dark[j + 1]
        for column in range(columns):
            turn, depth = max(positions[0, column], zero), positions[2, column]
            first, node, deep = int(turn), int(positions[1, column]), int(depth)
            part, far = turn - np.float32(first), positions[1, column] - np.float32(node)
            over, near = unit - part, unit - far
            begin = first * STEPS + node
            end = begin + STEPS if first < TURNS - 1 else node
            a, b, c, d = lines[begin], lines[begin + 1], lines[end], lines[end + 1]
            e, f = lines[SLOPES + max(deep - 1, 0)], lines[SLOPES + deep]
            is_sloped = unit if positions[0, column] >= zero else zero
            under = depth - np.float32(deep)
            above = unit - under if deep else zero
            for m in range(_LINE_VALUES):
                slope = over * (near * a[m] + far * b[m]) + part * (near * c[m] + far * d[m])
                total[m] = is_sloped * slope + (above * e[m] + under * f[m])
            across = min(max((column + 0.5) * scale - 0.5, 0.0), wide - 1.0)
            i = min(int(across), wide - 2)
            right = np.float32(across - i)
            left = unit - right
            g, h = behind[i], behind[i + 1]
            x = column_x(column, columns, view)
            red, green, blue = terms[row, column, COLOURS:]
            for k in range(4):
                lit = red * (total[12 + k] + (left * g[k] + right * h[k]))
                lit += green * (total[16 + k] + (left * g[4 + k] + right * h[4 + k]))
                lit += blue * (total[20 + k] + (left * g[8 + k] + right * h[8 + k]))
                shade[k] = total[k] + x * (total[4 + k] + x * total[8 + k]) + lit
            out[row, column, 0], out[row, column, 1], out[row, column, 2] = shade[0], shade[1], shade[2]


@part
def _sum_rows(lines: Float32, table: Float32, y: np.float32) -> None:
    """Write the entries of slopes and depths for a row: without x, with x, with x^2, and with each colour."""
    for entry in range(LAMPS):
        line, terms = lines[entry], table[entry]
        for k in range(4):
            line[k] = terms[k] + y * (terms[8 + k] + y * terms[20 + k])
            line[4 + k] = terms[4 + k] + y * terms[16 + k]
            line[8 + k] = terms[12 + k]
        for k in range(4 * COLOURS, ENTRY_VALUES):
            line[k - 12] = terms[k]
