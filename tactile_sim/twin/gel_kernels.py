"""Kernels of the response of a twin, in numba: to the light of lamps and to slopes, and its normal equations.

The response of a colour is the sum of the light of some lamps on matt gel, and of a table over direction and
steepness of its slope. Lamps stand on a ring around the image, in several heights, and face its middle. What
rises above the lower end of a lamp hides a part of it, what rises above its upper end all of it. Light falls
off with the square of the distance and with the angle from where a lamp faces, and as much is reflected as
the gel turns to the lamp (Lambert). The table is what a gel does beyond that. Its entries are sums of terms:
of the position in the image, quadratic, and of the colours of the gel at rest, which tell where lamps are
near.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_sim.twin.view_kernels import (
    STEPS,
    TURNS,
    SurfaceView,
    bend_at,
    column_x,
    row_positions,
    row_y,
    turn_of,
)
from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float32, Float64, Int64

AZIMUTHS = 16
"""Directions of lamps from the middle of the image."""

HEIGHTS = np.array([0.45, 0.7, 0.95, 1.2, 1.5, 1.9])
"""Heights of the middles of lamps above the gel, over a height that is fitted.

The shadow of a lamp between two of them is a mixture of a longer and a shorter one. A fit that cannot make
shadows long enough presses the solid deeper, by up to 0.2 mm; with lamps too high for those of a sensor, by
0.4 mm.
"""

LAMPS = AZIMUTHS * len(HEIGHTS)
ALL_LAMPS = np.arange(LAMPS)
"""The number of each lamp; those of one direction follow each other."""

FEW_LAMPS = ALL_LAMPS.reshape(AZIMUTHS, -1)[::4, [1, 4]].ravel()
"""Numbers of the lamps of four directions in two heights."""

# Values of the light of a lamp: factors of the normal of the gel along x, y and z, and what is added.
_LAMP_VALUES = 4
_LAMP_SIZE = 0.33  # of a lamp from its lower to its upper end, over the height that is fitted
_LEAST_SENT = 0.05  # share of the light of a lamp that is sent in any direction

_TOWARDS = np.array(
    [[math.cos(2 * math.pi * k / AZIMUTHS), math.sin(2 * math.pi * k / AZIMUTHS)] for k in range(AZIMUTHS)],
    np.float32,
)

TERMS = 9
"""Terms of an entry: 1, x, y, x^2, x y, y^2, from -1 to 1 across the image, and the colours at rest."""

COLOURS = 6
"""The first of the terms of the colours at rest."""

SLOPES = TURNS * STEPS
ENTRIES = SLOPES + LAMPS
"""Number of entries: those of slopes, by direction, and of lamps, by direction, which have one term."""

COEFFICIENTS = SLOPES * TERMS + LAMPS
"""Number of the terms of all entries."""

ENTRY_VALUES = 4 * TERMS
"""Values of an entry in :func:`render_response`: three colours and a zero for each term."""

_LINE_VALUES = 24
SLOPED = 4
"""Number of entries of slopes that a pixel depends on; those of lamps follow."""


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


@part
def _points_of_row(points: Float32, soft: Float32, row: int, view: SurfaceView) -> None:
    """Write x and y on the gel of the points that a row of pixels sees, metres from the middle, (2, W)."""
    rows, columns = soft.shape
    unit = np.float32(1.0)
    lens, camera = np.float32(view.lens), np.float32(view.camera)
    across = np.float32(view.across)
    from_left, width = np.float32(0.5 - 0.5 * columns), np.float32(view.pitch_x)
    up = np.float32(view.pitch_y * (0.5 * rows - row - 0.5))
    v = row_y(row, rows, view)
    for column in range(columns):
        u = column_x(column, columns, view)
        stretch = bend_at(u, v, lens, across) * (unit + camera * soft[row, column])
        points[0, column] = stretch * width * (column + from_left)
        points[1, column] = stretch * up


@part
def _ahead_at(out: Float32, ahead: Float32, points: Float32, view: SurfaceView) -> None:
    """Write :func:`_horizons` at points on the gel, (2, W), bilinearly: (AZIMUTHS, W)."""
    _, rows, columns = ahead.shape
    unit = np.float32(1.0)
    per_x, per_y = np.float32(1.0 / view.pitch_x), np.float32(1.0 / view.pitch_y)
    middle_x, middle_y = np.float32(0.5 * columns - 0.5), np.float32(0.5 * rows - 0.5)
    for column in range(columns):
        x = min(max(points[0, column] * per_x + middle_x, np.float32(0.0)), np.float32(columns - 1.0))
        y = min(max(middle_y - points[1, column] * per_y, np.float32(0.0)), np.float32(rows - 1.0))
        i, j = min(int(x), columns - 2), min(int(y), rows - 2)
        right, below = x - np.float32(i), y - np.float32(j)
        left, above = unit - right, unit - below
        for azimuth in range(AZIMUTHS):
            upper, lower = ahead[azimuth, j], ahead[azimuth, j + 1]
            out[azimuth, column] = above * (left * upper[i] + right * upper[i + 1])
            out[azimuth, column] += below * (left * lower[i] + right * lower[i + 1])


@part
def _look_at(to: Float32, ahead: Float32, points: Float32, azimuth: int, view: SurfaceView) -> None:
    """Write how far a lamp is from points on the gel (2, W): (7, W).

    The rows are the distances along x and y, the squared distance along the gel, the direction in steps of
    ``AZIMUTHS``, how steeply the gel rises on the way, between the directions of ``ahead`` (AZIMUTHS, W), the
    distance along the gel, and the square of the distance in front of the lamp.
    """
    unit = np.float32(1.0)
    per_turn = np.float32(AZIMUTHS / TURNS)
    lamp_x = np.float32(view.ring * _TOWARDS[azimuth, 0])
    lamp_y = np.float32(view.ring * _TOWARDS[azimuth, 1])
    for column in range(points.shape[1]):
        across, up = lamp_x - points[0, column], lamp_y - points[1, column]
        to[0, column], to[1, column] = across, up
        to[2, column] = across * across + up * up
        to[3, column] = turn_of(across, up) * per_turn
    for column in range(points.shape[1]):
        first = int(to[3, column])
        part = to[3, column] - np.float32(first)
        second = first + 1 if first < AZIMUTHS - 1 else 0
        to[4, column] = (unit - part) * ahead[first, column] + part * ahead[second, column]
        to[5, column] = np.float32(math.sqrt(to[2, column]))
        in_front = to[0, column] * _TOWARDS[azimuth, 0] + to[1, column] * _TOWARDS[azimuth, 1]
        to[6, column] = in_front * in_front


@part
def _strength(far: np.float32, in_front: np.float32, ring: np.float32, lobe: np.float32) -> np.float32:
    """Return the light of a lamp from squared distances: the whole one, and that in front of the lamp.

    Times the vector to the lamp, it is the light that a gel gets from each direction.
    """
    unit, least = np.float32(1.0), np.float32(_LEAST_SENT)
    sent = unit - lobe + lobe * in_front / far
    return ring * ring / (far * np.float32(math.sqrt(far))) * (sent if sent > least else least)


@compiled
def lamp_light(soft: Float32, flat: Float32, view: SurfaceView, reaches: Float64, lamps: Int64) -> Float32:
    """Return the light of some lamps on a surface, (H, W, n, 4); it is 1 as far away as the ring is wide.

    ``soft`` (H, W) is the surface as the camera sees it, ``flat`` (H, W) the same as seen from far away
    without a lens, which casts the shadows. ``lamps`` (n,) are numbers of :data:`ALL_LAMPS`. The first three
    values times the normal of the gel are the light that shadows leave; the last one is the light at rest,
    negative.
    """
    rows, columns = soft.shape
    ahead = _horizons(flat, view, reaches)
    ring, lobe, fade = np.float32(view.ring), np.float32(view.lobe), np.float32(view.fade)
    unit, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    per_size = np.float32(1.0 / (_LAMP_SIZE * view.lamp_height))
    out = np.empty((rows, columns, len(lamps), _LAMP_VALUES), np.float32)
    positions = np.empty((4, columns), np.float32)
    points = np.empty((2, columns), np.float32)
    ahead_here = np.empty((AZIMUTHS, columns), np.float32)
    to = np.empty((7, columns), np.float32)
    # By lamp, several pixels are computed at once.
    values = np.empty((len(lamps), _LAMP_VALUES, columns), np.float32)
    for row in range(rows):
        row_positions(positions, soft, row, view)
        _points_of_row(points, soft, row, view)
        _ahead_at(ahead_here, ahead, points, view)
        line = soft[row]
        seen_from = -1
        for number in range(len(lamps)):
            azimuth, height = lamps[number] // len(HEIGHTS), lamps[number] % len(HEIGHTS)
            if azimuth != seen_from:
                seen_from = azimuth
                _look_at(to, ahead_here, points, azimuth, view)
            lamp_z = np.float32(HEIGHTS[height] * view.lamp_height)
            lamp = values[number]
            for column in range(columns):
                z = lamp_z + line[column]
                far = to[2, column] + z * z
                share = _strength(far, to[6, column], ring, lobe)
                far = to[2, column] + lamp_z * lamp_z
                at_rest = lamp_z * _strength(far, to[6, column], ring, lobe)
                whole = positions[2, column] * to[0, column] + positions[3, column] * to[1, column] + z
                # Where the ray over the highest point on the way meets the lamp.
                seen = half - (to[4, column] * to[5, column] - z - fade) * per_size
                seen = seen if seen > zero else zero
                seen = seen if seen < unit else unit
                seen = share * seen if whole > zero else zero
                lamp[0, column], lamp[1, column] = seen * to[0, column], seen * to[1, column]
                lamp[2, column], lamp[3, column] = seen * z, -at_rest
        for column in range(columns):
            target = out[row, column]
            for k in range(len(values)):
                for m in range(_LAMP_VALUES):
                    target[k, m] = values[k, m, column]
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
    soft: Float32,
    light: Float32,
    scale: float,
    view: SurfaceView,
    lamps: Int64,
    entries: Int64,
    shares: Float32,
) -> None:
    """Write the entries that each pixel depends on, and their shares: 0 where the gel is at rest.

    Entries are the indices of their first coefficients.

    ``soft``, shape (H, W), is the height of the gel, metres, 0 where it is at rest and negative where it is
    pressed in; ``light`` its :func:`lamp_light` on a map that is smaller by ``scale``. ``entries`` and
    ``shares`` have the shape (H W, SLOPED + n).
    """
    rows, columns = soft.shape
    flat = light.reshape(light.shape[0], light.shape[1], -1)
    values = np.empty(flat.shape[2], np.float32)
    positions = np.empty((4, columns), np.float32)
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
                entries[at, 2 * side] = TERMS * (((first + side) % TURNS) * STEPS + node)
                entries[at, 2 * side + 1] = entries[at, 2 * side] + TERMS
                shares[at, 2 * side] = share * (1.0 - far)
                shares[at, 2 * side + 1] = share * far
            y, x = (row + 0.5) * scale - 0.5, (column + 0.5) * scale - 0.5
            _interpolated(values, flat, y, x)
            slope_x, slope_y = positions[2, column], positions[3, column]
            turned = np.float32(1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y))
            for lamp in range(len(lamps)):
                k = _LAMP_VALUES * lamp
                whole = turned * (slope_x * values[k] + slope_y * values[k + 1] + values[k + 2])
                entries[at, SLOPED + lamp] = SLOPES * TERMS + lamps[lamp]
                shares[at, SLOPED + lamp] = whole + values[k + 3]


@compiled
def add_normal(normal: Float64, entries: Int64, shares: Float32, terms: Float32, weights: Float32) -> None:
    """Add weighted products of features to the lower half of the normal matrix of coefficients.

    Every second pixel counts twice: the matrix decides how long steps are, not where they end, and compares
    ridges.
    """
    columns = weights.shape[1]
    active = entries.shape[1]
    values = np.empty(active * TERMS)
    unknowns = np.empty(active * TERMS, np.int64)
    for at in range(0, len(entries), 2):
        weight = 2.0 * weights[at // columns, at % columns]
        if weight <= 0.0:
            continue
        here = terms[at // columns, at % columns]
        # In the order of the entries: the direction after the last one is the first.
        begin = 0 if entries[at, 0] <= entries[at, 2] else 2
        count = 0
        for number in range(active):
            k = (begin + number) % SLOPED if number < SLOPED else number
            if shares[at, k] == 0.0:
                continue
            for term in range(TERMS if number < SLOPED else 1):
                values[count] = shares[at, k] * here[term]
                unknowns[count] = entries[at, k] + term
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
        for k in range(entries.shape[1]):
            if shares[at, k] == 0.0:
                continue
            for term in range(TERMS if k < SLOPED else 1):
                share = shares[at, k] * here[term]
                total = out[entries[at, k] + term]
                for column in range(many):
                    total[column] += share * line[column]


@part
def _coloured(light: Float32, table: Float32, lamps: Int64) -> Float32:
    """Return the light of some lamps in colours, (h, w, 16): four values of light by four of colour."""
    rows, columns, _, _ = light.shape
    out = np.zeros((rows, columns, 4 * _LAMP_VALUES), np.float32)
    for row in range(rows):
        for column in range(columns):
            total = out[row, column]
            for lamp in range(len(lamps)):
                colour, values = table[SLOPES + lamps[lamp]], light[row, column, lamp]
                for m in range(_LAMP_VALUES):
                    for k in range(4):
                        total[4 * m + k] += values[m] * colour[k]
    return out


@compiled
def render_response(
    out: Float32,
    soft: Float32,
    light: Float32,
    scale: float,
    view: SurfaceView,
    terms: Float32,
    table: Float32,
    lamps: Int64,
) -> None:
    """Write the response (H, W, 3) of a surface (H, W), from its coefficients.

    ``light``, ``scale`` and ``lamps`` are those of :func:`features`; ``terms`` (H, W, TERMS) those of each
    pixel; ``table`` (ENTRIES, ENTRY_VALUES) has the terms of each entry. Pixels at rest are 0.
    """
    rows, columns = soft.shape
    high, wide = light.shape[:2]
    unit, zero = np.float32(1.0), np.float32(0.0)
    lit = _coloured(light, table, lamps)
    shone = np.empty(lit.shape[1:], np.float32)
    lines = np.empty((SLOPES, _LINE_VALUES), np.float32)
    positions = np.empty((4, columns), np.float32)
    total = np.empty(_LINE_VALUES, np.float32)
    shade = np.empty(4, np.float32)
    for row in range(rows):
        row_positions(positions, soft, row, view)
        _sum_rows(lines, table, row_y(row, rows, view))
        down = min(max((row + 0.5) * scale - 0.5, 0.0), high - 1.0)
        j = min(int(down), high - 2)
        lower = np.float32(down - j)
        shone[:] = (unit - lower) * lit[j] + lower * lit[j + 1]
        for column in range(columns):
            turn = max(positions[0, column], zero)
            first, node = int(turn), int(positions[1, column])
            part, far = turn - np.float32(first), positions[1, column] - np.float32(node)
            over, near = unit - part, unit - far
            begin = first * STEPS + node
            end = begin + STEPS if first < TURNS - 1 else node
            a, b, c, d = lines[begin], lines[begin + 1], lines[end], lines[end + 1]
            is_sloped = unit if positions[0, column] >= zero else zero
            for m in range(_LINE_VALUES):
                slope = over * (near * a[m] + far * b[m]) + part * (near * c[m] + far * d[m])
                total[m] = is_sloped * slope
            across = min(max((column + 0.5) * scale - 0.5, 0.0), wide - 1.0)
            i = min(int(across), wide - 2)
            right = np.float32(across - i)
            left = unit - right
            g, h = shone[i], shone[i + 1]
            slope_x, slope_y = positions[2, column], positions[3, column]
            turned = unit / np.float32(math.sqrt(unit + slope_x * slope_x + slope_y * slope_y))
            x = column_x(column, columns, view)
            red, green, blue = terms[row, column, COLOURS:]
            for k in range(4):
                whole = slope_x * (left * g[k] + right * h[k])
                whole += slope_y * (left * g[4 + k] + right * h[4 + k])
                whole = turned * (whole + (left * g[8 + k] + right * h[8 + k]))
                shade[k] = whole + (left * g[12 + k] + right * h[12 + k])
                shade[k] += total[k] + x * (total[4 + k] + x * total[8 + k])
                shade[k] += red * total[12 + k] + green * total[16 + k] + blue * total[20 + k]
            out[row, column, 0], out[row, column, 1], out[row, column, 2] = shade[0], shade[1], shade[2]


@part
def _sum_rows(lines: Float32, table: Float32, y: np.float32) -> None:
    """Write the entries of slopes for a row: without x, with x, with x^2, and with each colour."""
    for entry in range(SLOPES):
        line, terms = lines[entry], table[entry]
        for k in range(4):
            line[k] = terms[k] + y * (terms[8 + k] + y * terms[20 + k])
            line[4 + k] = terms[4 + k] + y * terms[16 + k]
            line[8 + k] = terms[12 + k]
        for k in range(4 * COLOURS, ENTRY_VALUES):
            line[k - 12] = terms[k]
