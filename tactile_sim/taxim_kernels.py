"""Kernels of Taxim, in numba: the surface of the pressed gel, its colours, and shadows.

All of them lie in this one file, because numba's cache on disk looks at the file of a kernel only.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from tactile_toolkit.array_types import Bool, Float32, Float64, Int64
from tactile_toolkit.compiled import compiled

_FOLDED = 0.41421356237309503  # tan(pi / 8)

Pair: TypeAlias = tuple[Float64, Float64]
"""Halves of Gaussian kernels across and down, from the middle on."""


class Calibration(NamedTuple):
    """Tables of Taxim, whatever the size of the picture; lengths in mm.

    ``colours`` (125, 125, 18): six coefficients of three colours by slope and direction; ``fan``
    (63, rays, 2) float32: cosine and sine of the rays of each direction; ``shadows`` (63, 25, steps, 3) and
    ``shadow_lengths`` (63, 25); then the pixel, width and height of the calibration, the scale of contacts,
    the steps of directions and heights, and where heights begin.
    """

    colours: Float64
    fan: Float32
    shadows: Float64
    shadow_lengths: Int64
    pixel_mm: float
    width: int
    height: int
    contact_scale: float
    direction_step: float
    height_step: float
    shadow_depth_mm: float
    first_height: int
    flat_slope: float


class PictureTables(NamedTuple):
    """Tables that follow from the size of a picture."""

    gel_mm: Float64
    background: Float64
    pyramid: tuple[Pair, ...]
    shadow_blur: Pair
    windows: Int64
    shadow_step: Float32


@compiled
def _mirrored(place: int, count: int) -> int:
    if place < 0:
        return -place
    return place if place < count else 2 * count - 2 - place


@compiled
def blur(image: Float64, out: Float64, between: Float64, across: Float64, down: Float64) -> None:
    """Blur a map (H, W) by halves of symmetric kernels; beyond its edge it is mirrored, without the edge.

    Pairs are added from the middle outwards, so the sums of a pixel have one order however many are done at
    once.
    """
    rows, columns = image.shape
    half = len(across) - 1
    padded = np.empty(columns + 2 * half)
    for row in range(rows):
        for place in range(-half, columns + half):
            padded[place + half] = image[row, _mirrored(place, columns)]
        line = between[row]
        weight = across[0]
        for column in range(columns):
            line[column] = weight * padded[column + half]
        for tap in range(1, half + 1):
            weight = across[tap]
            left, right = padded[half - tap :], padded[half + tap :]
            for column in range(columns):
                line[column] += weight * (left[column] + right[column])
    for row in range(rows):
        line, middle = out[row], between[row]
        weight = down[0]
        for column in range(columns):
            line[column] = weight * middle[column]
        for tap in range(1, len(down)):
            weight = down[tap]
            above, below = between[_mirrored(row - tap, rows)], between[_mirrored(row + tap, rows)]
            for column in range(columns):
                line[column] += weight * (above[column] + below[column])


@compiled
def _angle(y: float, x: float) -> float:
    """Return the angle of a direction, -pi to pi, to 3e-9, from products, sums and quotients."""
    far, near = max(abs(x), abs(y)), min(abs(x), abs(y))
    ratio = near / far
    folded = (ratio - 1.0) / (ratio + 1.0) if ratio > _FOLDED else ratio
    square = folded * folded
    # Nine terms of the series of the arc tangent: below tan(pi / 8), where it is folded, right to 3e-9.
    series = 1.0 / 17.0
    for odd in range(15, 0, -2):
        series = 1.0 / odd - square * series
    angle = folded * series
    if ratio > _FOLDED:
        angle += math.pi / 4
    if abs(y) > abs(x):
        angle = math.pi / 2 - angle
    if x < 0.0:
        angle = math.pi - angle
    return -angle if y < 0.0 else angle


@compiled
def _dilated(mask: Bool, wide: int, high: int) -> Bool:
    """Return where a window, which leans to the upper left where it is even, meets the mask."""
    rows, columns = mask.shape
    out = np.zeros_like(mask)
    for row in range(rows):
        for column in range(columns):
            if mask[row, column]:
                for other in range(max(row - (high - 1) // 2, 0), min(row + high // 2, rows - 1) + 1):
                    for place in range(
                        max(column - (wide - 1) // 2, 0), min(column + wide // 2, columns - 1) + 1
                    ):
                        out[other, place] = True
    return out


@compiled
def _pressed_gel(
    height_mm: Float64, gel_mm: Float64, contact_scale: float, pyramid: tuple[Pair, ...]
) -> tuple[Float64, Bool]:
    """Return the surface of the gel, which leaves the solid smoothly, and where it touches the solid."""
    joined = np.minimum(height_mm, gel_mm)
    contact = (height_mm < 0.0) & (joined - gel_mm < height_mm.min() * contact_scale)
    blurred, between, soft = joined.copy(), np.empty_like(joined), np.empty_like(joined)
    for level in range(len(pyramid)):
        blur(blurred, soft, between, pyramid[level][0], pyramid[level][1])
        for place in range(soft.size if level < len(pyramid) - 1 else 0):
            blurred.flat[place] = joined.flat[place] if contact.flat[place] else soft.flat[place]
    return soft, contact


@compiled
def _slopes(soft: Float64, per_row: float, per_column: float, flat_slope: float) -> tuple[Float64, Float64]:
    """Return slope and direction at the inner pixels; those at the edge take those of their neighbours."""
    rows, columns = soft.shape
    slope, direction = np.empty((rows, columns)), np.empty((rows, columns))
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            down = (soft[row - 1, column] - soft[row + 1, column]) * per_row
            right = (soft[row, column - 1] - soft[row, column + 1]) * per_column
            # Level in one direction means exactly level: rounding must not choose the end of the circle.
            down = 0.0 if abs(down) < 1e-9 else down
            tangent = math.sqrt(down * down + right * right)
            if tangent < flat_slope:
                slope[row, column], direction[row, column] = 0.0, math.pi
            else:
                slope[row, column] = _angle(tangent, 1.0)
                direction[row, column] = _angle(down, right) + math.pi
    for table in (slope, direction):
        for row in range(1, rows - 1):
            table[row, 0], table[row, columns - 1] = table[row, 1], table[row, columns - 2]
        for column in range(columns):
            table[0, column], table[rows - 1, column] = table[1, column], table[rows - 2, column]
    return slope, direction


@compiled
def _shades(slope: Float64, direction: Float64, tables: Calibration) -> Float64:
    """Return the colours (3, H, W) of the calibration for slopes in their place.

    Directions are rounded up as in single precision: the last bin of the package holds those of pi alone, and
    that of a flat pixel is the middle of the table exactly.
    """
    rows, columns = slope.shape
    bins = len(tables.colours)
    per_slope, per_direction = (bins - 1) / (0.5 * math.pi), (bins - 1) / (2.0 * math.pi)
    shade = np.empty((3, rows, columns))
    for row in range(rows):
        y = row * (float(tables.height) / rows)
        for column in range(columns):
            x = column * (float(tables.width) / columns)
            steep = int(slope[row, column] * per_slope)
            turned = min(int(direction[row, column] * per_direction + 4e-6), bins - 1)
            chosen = tables.colours[steep, turned]
            for colour in range(3):
                c = 6 * colour
                squares = (x * x * chosen[c] + y * y * chosen[c + 1]) + x * y * chosen[c + 2]
                shade[colour, row, column] = ((squares + x * chosen[c + 3]) + y * chosen[c + 4]) + chosen[
                    c + 5
                ]
    return shade


@compiled
def _cast_shadows(
    shade: Float64,
    soft: Float64,
    direction: Float64,
    sources: Bool,
    tables: Calibration,
    picture: PictureTables,
) -> None:
    """Darken lower pixels behind each pixel at the rim of the contact, along a fan of rays."""
    rows, columns = soft.shape
    for row in range(rows):
        for column in range(columns):
            if not sources[row, column]:
                continue
            # Tables of the package hold steps of these sizes; it rounds down, too.
            toward = int(direction[row, column] / tables.direction_step)
            here = soft[row, column]
            depth = picture.gel_mm[row, column] - here - tables.shadow_depth_mm
            level = math.floor(depth / tables.height_step) + tables.first_height
            if level < 0 or level >= tables.shadow_lengths.shape[1] - 1:
                continue
            dark = tables.shadows[toward, level]
            for step in range(tables.shadow_lengths[toward, level]):
                along_x = picture.shadow_step[0] * np.float32(step + 1)
                along_y = picture.shadow_step[1] * np.float32(step + 1)
                for ray in range(tables.fan.shape[1]):
                    x_px = np.float32(column) + along_x * tables.fan[toward, ray, 0]
                    y_px = np.float32(row) + along_y * tables.fan[toward, ray, 1]
                    if x_px <= -1.0 or y_px <= -1.0 or x_px >= columns or y_px >= rows:
                        continue
                    # Towards 0, like the package's cast: less than a pixel outside the picture still counts.
                    other_column, other_row = int(x_px), int(y_px)
                    if here < soft[other_row, other_column]:
                        for colour in range(3):
                            if dark[step, colour] < shade[colour, other_row, other_column]:
                                shade[colour, other_row, other_column] = dark[step, colour]


@compiled
def render_taxim(out: Float32, heights_mm: Float64, tables: Calibration, picture: PictureTables) -> None:
    """Render pictures (n, H, W, 3), 0 to 1, of heights over the gel, mm; see :mod:`tactile_sim.optics`."""
    rows, columns = heights_mm.shape[1:]
    per_row = rows / float(tables.height) / 2.0 / tables.pixel_mm
    per_column = columns / float(tables.width) / 2.0 / tables.pixel_mm
    final_across, final_down = picture.pyramid[len(picture.pyramid) - 1]
    between, lit = np.empty((rows, columns)), np.empty((rows, columns))
    for number in range(len(heights_mm)):
        soft, contact = _pressed_gel(
            heights_mm[number], picture.gel_mm, tables.contact_scale, picture.pyramid
        )
        slope, direction = _slopes(soft, per_row, per_column, tables.flat_slope)
        shade = _shades(slope, direction, tables)
        near = _dilated(contact, picture.windows[0, 0], picture.windows[0, 1])
        near = _dilated(near, picture.windows[1, 0], picture.windows[1, 1])
        _cast_shadows(shade, soft, direction, near & ~contact, tables, picture)
        for colour in range(3):
            blur(shade[colour], soft, between, picture.shadow_blur[0], picture.shadow_blur[1])
            blur(soft, lit, between, final_across, final_down)
            for row in range(rows):
                for column in range(columns):
                    value = lit[row, column] + picture.background[colour, row, column]
                    out[number, row, column, colour] = np.float32(min(max(value, 0.0), 1.0))
