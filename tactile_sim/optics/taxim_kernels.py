"""Kernels of Taxim, in numba: the surface of the pressed gel, its colours, and shadows.

All kernels lie in this one file, because numba's cache on disk checks only the file of a kernel.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Bool, Float32, Float64, Floating, Int32, Int64

_FOLDED = 0.41421356237309503  # tan(pi / 8)
Pair: TypeAlias = tuple[Float64, Float64]
"""Halves of Gaussian kernels across and down, from the middle outwards."""


class Calibration(NamedTuple):
    """Tables of Taxim that do not depend on the size of the picture; lengths in mm.

    ``colours`` (bins * bins, 18): six coefficients of three colours, by slope and direction; ``fan`` (63,
    rays, 2) float32: cosine and sine of the rays of each direction; ``shadows`` (63, 25, steps, 3) and
    ``shadow_lengths`` (63, 25); then the bins of slopes and of directions, the pixel, width and height of the
    calibration, the scale of contacts, the steps of directions and heights, and where heights begin.
    """

    colours: Float64
    fan: Float32
    shadows: Float64
    shadow_lengths: Int64
    bins: int
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
    """Tables that follow from the size of a picture: the gel (H, W), the background (H, 3 W), and kernels."""

    gel_mm: Float64
    background: Float64
    pyramid: tuple[Pair, ...]
    shadow_blur: Pair
    windows: Int64
    shadow_step: Float32


@compiled
def blur(
    image: Floating,
    across: Floating,
    down: Floating,
    step: int,
    kept: Bool | None,
    out: Floating,
    inset: int = 0,
) -> None:
    """Blur a map (H, W) by halves of symmetric kernels; beyond its edge it is mirrored, without the edge.

    Neighbours in a row are ``step`` values apart. Pixels of ``out``, which may be the map itself, stay as
    they are where ``kept`` (H, W), and at an edge of ``inset``, without which the map is blurred. All numbers
    are of one precision.
    """
    rows = image.shape[0] - 2 * inset
    width = image.shape[1] - 2 * inset * step
    margin = len(down) - 1
    reach = (len(across) - 1) * step
    line = np.empty(width + 2 * reach, image.dtype)
    middle, total = line[reach:], line[:width]
    wide = np.empty((rows + 2 * margin, width), image.dtype)
    for row in range(rows):
        pixels = image[row + inset, inset * step :]
        for k in range(width):
            middle[k] = pixels[k]
        for far in range(step, reach + step, step):
            for k in range(step):
                line[reach - far + k] = pixels[far + k]
                middle[width - step + far + k] = pixels[width - step - far + k]
        _weigh(wide[margin + row], line, reach, step, across)
    for far in range(1, margin + 1):
        wide[margin - far] = wide[margin + far]
        wide[margin + rows - 1 + far] = wide[margin + rows - 1 - far]
    flat = wide.reshape(wide.size)
    for row in range(rows):
        target = out[row + inset, inset * step :]
        if kept is None:
            _weigh(target[:width], flat, (margin + row) * width, width, down)
        else:
            stays = kept[row + inset, inset * step :]
            _weigh(total, flat, (margin + row) * width, width, down)
            for k in range(width):
                target[k] = target[k] if stays[k] else total[k]


@part
def _weigh(out: Floating, source: Floating, begin: int, step: int, weights: Floating) -> None:
    """Weigh the values from ``begin`` on, and those at multiples of ``step`` on both sides of each."""
    here = source[begin:]
    first = weights[0]
    count = len(weights)
    for k in range(len(out)):
        out[k] = first * here[k]
    # Two pairs at a time: sums are loaded and stored half as often.
    for tap in range(1, count - 1, 2):
        near = weights[tap]
        far = weights[tap + 1]
        a = source[begin - tap * step :]
        b = source[begin + tap * step :]
        c = source[begin - (tap + 1) * step :]
        d = source[begin + (tap + 1) * step :]
        for k in range(len(out)):
            out[k] = (out[k] + near * (a[k] + b[k])) + far * (c[k] + d[k])
    if count % 2 == 0:
        last = weights[count - 1]
        reach = (count - 1) * step
        a = source[begin - reach :]
        b = source[begin + reach :]
        for k in range(len(out)):
            out[k] += last * (a[k] + b[k])


@part
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


@part
def _rim(mask: Bool, windows: Int64) -> Bool:
    """Return where windows around pixels of the mask, one after the other, reach outside of it.

    ``windows`` (n, 2), width and height; those of even sizes lean to the upper left.
    """
    rows, columns = mask.shape
    left = 0
    right = 0
    above = 0
    below = 0
    for window in range(len(windows)):
        left = left + (windows[window, 0] - 1) // 2
        right = right + windows[window, 0] // 2
        above = above + (windows[window, 1] - 1) // 2
        below = below + windows[window, 1] // 2
    wide, out = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for far in range(-left, right + 1):
            near = wide[row, max(far, 0) :]
            pixels = mask[row, max(-far, 0) :]
            for column in range(columns - abs(far)):
                near[column] |= pixels[column]
    for row in range(rows):
        near, pixels = out[row], mask[row]
        for line in range(max(row - below, 0), min(row + above, rows - 1) + 1):
            met = wide[line]
            for column in range(columns):
                near[column] |= met[column] & (not pixels[column])
    return out


@part
def _pressed_gel(
    depth_m: Float64, gel_m: float, gel_mm: Float64, contact_scale: float
) -> tuple[Float64, Bool]:
    """Return the surface of the gel, mm, bent where it meets the solid, and where it is pressed by it."""
    rows, columns = depth_m.shape
    soft = np.empty((rows, columns))
    contact = np.empty((rows, columns), np.bool_)
    # One least value for each column, and comparisons as selections: LLVM does several pixels at once.
    least = depth_m[0].copy()
    for row in range(1, rows):
        line = depth_m[row]
        for column in range(columns):
            least[column] = line[column] if line[column] < least[column] else least[column]
    # Taxim counts from the surface of the gel, in millimetres, negative where it is pressed.
    least_m = least[0]
    for column in range(1, columns):
        least_m = min(least_m, least[column])
    touches_mm = (least_m * 1000.0 - gel_m * 1000.0) * contact_scale
    for row in range(rows):
        line = depth_m[row]
        gel = soft[row]
        free = gel_mm[row]
        meets = contact[row]
        for column in range(columns):
            height = line[column] * 1000.0 - gel_m * 1000.0
            gel[column] = height if height < free[column] else free[column]
            meets[column] = (height < 0.0) & (gel[column] - free[column] < touches_mm)
    return soft, contact


@part
def _add_bulges(soft: Float64, depth_m: Float64, gel_m: float) -> None:
    """Raise the surface of the gel, mm, where it is higher than at rest."""
    for row in range(len(soft)):
        for column in range(soft.shape[1]):
            soft[row, column] += max(depth_m[row, column] - gel_m, 0.0) * 1000.0


@part
def _slopes(soft: Float64, per_row: float, per_column: float, flat_slope: float) -> tuple[Float64, Float64]:
    """Return slope and direction at the inner pixels; pixels at the edge copy their neighbours."""
    rows, columns = soft.shape
    slope, direction = np.empty((rows, columns)), np.empty((rows, columns))
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            down = (soft[row - 1, column] - soft[row + 1, column]) * per_row
            right = (soft[row, column - 1] - soft[row, column + 1]) * per_column
            # A slope that is 0 up to rounding is set to 0: its sign would choose the end of the circle.
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


@part
def _shades(slope: Float64, direction: Float64, tables: Calibration) -> Float64:
    """Return the colours (H, W, 3) of the calibration for slopes in their place.

    Directions are rounded up as in single precision: the last bin of the package holds only those of pi, and
    that of a flat pixel is the middle of the table exactly.
    """
    rows, columns = slope.shape
    bins = tables.bins
    per_slope, per_direction = (bins - 1) / (0.5 * math.pi), (bins - 1) / (2.0 * math.pi)
    shade = np.empty((rows, columns, 3))
    chosen = np.empty(columns, np.int64)
    for row in range(rows):
        y = row * (float(tables.height) / rows)
        steep, turned = slope[row], direction[row]
        for column in range(columns):
            last = min(int(turned[column] * per_direction + 4e-6), bins - 1)
            chosen[column] = int(steep[column] * per_slope) * bins + last
        for column in range(columns):
            x = column * (float(tables.width) / columns)
            c = tables.colours[chosen[column]]
            pixel = shade[row, column]
            for k in range(3):
                squares = (x * x * c[k] + y * y * c[3 + k]) + x * y * c[6 + k]
                pixel[k] = ((squares + x * c[9 + k]) + y * c[12 + k]) + c[15 + k]
    return shade


@part
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
    surface, colours = soft.reshape(soft.size), shade.reshape(shade.size)
    pixels = np.empty(tables.shadows.shape[2], np.int32)
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
            met = pixels[: tables.shadow_lengths[toward, level]]
            for ray in range(tables.fan.shape[1]):
                _follow(met, row, column, picture.shadow_step, tables.fan[toward, ray], soft.shape)
                for step in range(len(met)):
                    at = met[step]
                    if at >= 0 and here < surface[at]:
                        for colour in range(3):
                            held = colours[3 * at + colour]
                            darker = dark[step, colour]
                            colours[3 * at + colour] = darker if darker < held else held


@part
def _follow(
    met: Int32, row: int, column: int, steps_px: Float32, ray: Float32, shape: tuple[int, int]
) -> None:
    """Write the numbers of the pixels at the steps of a ray; -1 outside the picture."""
    rows, columns = np.int32(shape[0]), np.int32(shape[1])
    begin_x = np.float32(column)
    begin_y = np.float32(row)
    along_x = steps_px[0]
    along_y = steps_px[1]
    cosine, sine = ray[0], ray[1]
    for step in range(len(met)):
        far = np.float32(step + 1)
        x_px, y_px = begin_x + along_x * far * cosine, begin_y + along_y * far * sine
        is_outside = x_px <= -1.0 or y_px <= -1.0 or x_px >= columns or y_px >= rows
        # Rounded towards 0, like the cast of the package: up to a pixel outside the picture counts as inside.
        pixel = np.int32(y_px) * columns + np.int32(x_px)
        met[step] = -1 if is_outside else pixel


@compiled
def render_taxim(
    out: Float32,
    depths_m: Float64,
    gel_m: float,
    tables: Calibration,
    picture: PictureTables,
    is_surface: bool,
) -> None:
    """Render pictures (n, H, W, 3), 0 to 1, of depth, metres; see :mod:`tactile_sim.optics.rendering`.

    With ``is_surface``, depth is that of the gel itself, which may lie above the gel at rest: only the last
    filter, of the width of a pixel of 320, is left.
    """
    rows, columns = depths_m.shape[1:]
    per_row = rows / float(tables.height) / 2.0 / tables.pixel_mm
    per_column = columns / float(tables.width) / 2.0 / tables.pixel_mm
    pyramid = picture.pyramid
    for number in range(len(depths_m)):
        soft, contact = _pressed_gel(depths_m[number], gel_m, picture.gel_mm, tables.contact_scale)
        # Around the contact, which stays, the gel leaves the solid smoothly.
        last = len(pyramid) - 1
        if is_surface:
            _add_bulges(soft, depths_m[number], gel_m)
        else:
            for level in range(last):
                blur(soft, pyramid[level][0], pyramid[level][1], 1, contact, soft)
        blur(soft, pyramid[last][0], pyramid[last][1], 1, None, soft)
        slope, direction = _slopes(soft, per_row, per_column, tables.flat_slope)
        shade = _shades(slope, direction, tables)
        _cast_shadows(shade, soft, direction, _rim(contact, picture.windows), tables, picture)
        plane = shade.reshape((rows, 3 * columns))
        for across, down in (picture.shadow_blur, pyramid[len(pyramid) - 1]):
            blur(plane, across, down, 3, None, plane)
        _lay_over(plane, picture.background, out[number])


@part
def _lay_over(lit: Float64, background: Float64, out: Float32) -> None:
    rows, width = lit.shape
    for row in range(rows):
        values = lit[row]
        behind = background[row]
        shown = out[row].reshape(width)
        for at in range(width):
            value = values[at] + behind[at]
            value = value if value > 0.0 else 0.0
            shown[at] = np.float32(value if value < 1.0 else 1.0)
