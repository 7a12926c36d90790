"""Kernels of Taxim, in numba: the surface of the pressed gel, its colours, and shadows.

Sums of a pixel stay in a vector register while LLVM's vector instructions add to them, which numba does not
do by itself: a picture takes two fifths of the time. The order of operations is that of plain loops. All
kernels lie in this one file, because numba's cache on disk checks only the file of a kernel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from tactile_toolkit.array_types import Bool, Float32, Float64, Floating, Int32, Int64
from tactile_toolkit.kernels import compiled

LANES = 16
"""Number of values that are weighted at once; a row of a map has at least as many."""

_FOLDED = 0.41421356237309503  # tan(pi / 8)

_BUILD: ModuleType = cgutils
_MASK = ir.VectorType(ir.IntType(8), LANES)

_COLOURS = ir.VectorType(ir.DoubleType(), 4)

Context: TypeAlias = Any
"""A numba context, which has no types."""

Build: TypeAlias = Callable[[Context, ir.IRBuilder, Signature, Sequence[ir.Value]], ir.Value]
"""Writes the instructions of a function for LLVM."""

Pair: TypeAlias = tuple[Float64, Float64]
"""Halves of Gaussian kernels across and down, from the middle outwards."""


class Calibration(NamedTuple):
    """Tables of Taxim that do not depend on the size of the picture; lengths in mm.

    ``colours`` (bins * bins * 18 + 1,): six coefficients of three colours, by slope and direction, with one
    value more; ``fan`` (63, rays, 2) float32: cosine and sine of the rays of each direction; ``shadows``
    (63, 25, steps, 3) and ``shadow_lengths`` (63, 25); then the bins of slopes and of directions, the pixel,
    width and height of the calibration, the scale of contacts, the steps of directions and heights, and where
    heights begin.
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


def _build_weighing(
    context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
) -> ir.Value:
    """Build the code of :func:`_weigh_pixels`."""
    arrays = [context.make_array(signature.args[n])(context, builder, given[n]) for n in (0, 2, 5)]
    written, read, weighed = (array.data for array in arrays)
    count = _BUILD.unpack_tuple(builder, arrays[2].shape, 1)[0]
    one, size = ir.Constant(count.type, 1), signature.args[0].dtype.bitwidth // 8
    pixels = ir.VectorType(context.get_data_type(signature.args[0].dtype), LANES)

    def values(place: ir.Value) -> ir.Value:
        return builder.load(builder.bitcast(builder.gep(read, [place]), pixels.as_pointer()), align=size)

    def weight(tap: ir.Value) -> ir.Value:
        return spread(builder, builder.load(builder.gep(weighed, [tap])), pixels)

    def total() -> ir.Value:
        held = _BUILD.alloca_once_value(
            builder, builder.fmul(weight(ir.Constant(count.type, 0)), values(given[3]))
        )
        with _BUILD.for_range_slice(builder, one, count, one) as (tap, _):
            far = builder.mul(tap, given[4])
            pair = builder.fadd(values(builder.sub(given[3], far)), values(builder.add(given[3], far)))
            builder.store(builder.fadd(builder.load(held), builder.fmul(weight(tap), pair)), held)
        return builder.load(held)

    target = builder.bitcast(builder.gep(written, [given[1]]), pixels.as_pointer())
    if isinstance(signature.args[6], types.NoneType):
        builder.store(total(), target, align=size)
        return context.get_dummy_value()
    mask = context.make_array(signature.args[6])(context, builder, given[6]).data
    stays = builder.bitcast(builder.gep(mask, [given[7]]), _MASK.as_pointer())
    stays = builder.icmp_unsigned("!=", builder.load(stays, align=1), ir.Constant(_MASK, [0] * LANES))
    as_number = builder.bitcast(stays, ir.IntType(LANES))
    with builder.if_then(builder.icmp_unsigned("!=", as_number, ir.Constant(ir.IntType(LANES), -1))):
        found = total()
        builder.store(builder.select(stays, builder.load(target, align=size), found), target, align=size)
    return context.get_dummy_value()


def _weigh_pixels(
    _typing: object,
    out: types.Type,
    at: types.Type,
    source: types.Type,
    middle: types.Type,
    step: types.Type,
    weights: types.Type,
    kept: types.Type,
    kept_at: types.Type,
) -> tuple[Signature, Build]:
    """Weigh :data:`LANES` neighbouring values of ``source`` and those on both sides of each.

    ``out``, ``source`` and ``weights`` are contiguous, all of single or of double precision; ``kept``, bool,
    says which values of ``out`` stay as they are, from ``kept_at`` on, or is None. In plain numba::

        for lane in range(LANES):
            total = weights[0] * source[middle + lane]
            for tap in range(1, len(weights)):
                pair = source[middle + lane - tap * step] + source[middle + lane + tap * step]
                total += weights[tap] * pair
            if kept is None or not kept[kept_at + lane]:
                out[at + lane] = total
    """
    place = types.int64
    signature = types.void(out, place, source, place, place, weights, kept, place)
    return signature, _build_weighing


weigh_pixels: Callable[..., None] = intrinsic(_weigh_pixels)


def _colour_pixel(
    _typing: object,
    out: types.Type,
    at: types.Type,
    tables: types.Type,
    first: types.Type,
    x: types.Type,
    y: types.Type,
) -> tuple[Signature, Build]:
    """Write three colours of a pixel, from six coefficients of each, and a fourth value.

    In plain numba::

        for colour in range(4):
            c = tables[first + colour :: 3]
            squares = (x * x * c[0] + y * y * c[1]) + x * y * c[2]
            out[at + colour] = ((squares + x * c[3]) + y * c[4]) + c[5]
    """
    signature = types.void(out, types.int64, tables, types.int64, types.float64, types.float64)

    def build(
        context: Context, builder: ir.IRBuilder, signature: Signature, given: Sequence[ir.Value]
    ) -> ir.Value:
        written, read = (
            context.make_array(signature.args[n])(context, builder, given[n]).data for n in (0, 2)
        )
        x, y = (spread(builder, value, _COLOURS) for value in given[4:])
        places = [builder.add(given[3], ir.Constant(given[3].type, 3 * number)) for number in range(6)]
        c = [builder.load(_colours_at(builder, read, place), align=8) for place in places]
        terms = [
            builder.fmul(factor, each)
            for factor, each in zip(
                (builder.fmul(x, x), builder.fmul(y, y), builder.fmul(x, y), x, y), c, strict=False
            )
        ]
        total = terms[0]
        for term in (*terms[1:], c[5]):
            total = builder.fadd(total, term)
        builder.store(total, _colours_at(builder, written, given[1]), align=8)
        return context.get_dummy_value()

    return signature, build


colour_pixel: Callable[..., None] = intrinsic(_colour_pixel)


def _colours_at(builder: ir.IRBuilder, values: ir.Value, place: ir.Value) -> ir.Value:
    return builder.bitcast(builder.gep(values, [place]), _COLOURS.as_pointer())


def spread(builder: ir.IRBuilder, value: ir.Value, lanes: ir.VectorType) -> ir.Value:
    """Broadcast a number to all lanes."""
    empty, first = ir.Constant(lanes, ir.Undefined), ir.Constant(ir.IntType(32), 0)
    single = builder.insert_element(empty, value, first)
    return builder.shuffle_vector(single, empty, ir.Constant(ir.VectorType(first.type, lanes.count), None))


@compiled
def _blur_room(rows: int, width: int, like: Floating) -> Floating:
    """Return room for a map of so many rows, margins included, in strips; of the type of another array.

    It begins with a line of the processor's cache.
    """
    room = np.empty((width + LANES - 1) // LANES * (rows | 1) * LANES + 64 // like.itemsize, like.dtype)
    return room[(-(room.ctypes.data // like.itemsize)) % (64 // like.itemsize) :]


@compiled
def _blur_across(
    image: Floating, room: Floating, across: Floating, margin: int, step: int, inset: int
) -> None:
    """Blur the rows of a map (H, W) without an edge of ``inset``; neighbours are ``step`` values apart.

    ``room`` gets its columns in strips of :data:`LANES`, which stay in the processor's cache, each with
    ``margin`` mirrored rows above and below; an odd number of rows apart, so that neighbours do not push each
    other out of it. The last strip begins early enough to be full.
    """
    rows, width = image.shape[0] - 2 * inset, image.shape[1] - 2 * inset * step
    high, reach = (rows + 2 * margin) | 1, (len(across) - 1) * step
    line = np.empty(width + 2 * reach, image.dtype)
    middle = line[reach:]
    for row in range(rows):
        pixels = image[row + inset, inset * step :]
        for place in range(width):
            middle[place] = pixels[place]
        for far in range(step, reach + step, step):
            for place in range(step):
                line[reach - far + place] = pixels[far + place]
                middle[width - step + far + place] = pixels[width - step - far + place]
        for begin in range(0, width, LANES):
            at = (begin // LANES * high + margin + row) * LANES
            weigh_pixels(room, at, line, min(begin, width - LANES) + reach, step, across, None, 0)
    for top in range(0, (width + LANES - 1) // LANES * high, high):
        for far in range(1, margin + 1):
            for place in range(LANES):
                first, last = (top + margin) * LANES + place, (top + margin + rows - 1) * LANES + place
                room[first - far * LANES] = room[first + far * LANES]
                room[last + far * LANES] = room[last - far * LANES]


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

    Neighbours in a row are ``step`` values apart. Pairs are added from the middle outwards, so the sums of a
    pixel have one order however many are done at once. Pixels of ``out``, which may be the map itself, stay
    as they are where ``kept`` (H, W), and at an edge of ``inset``, without which the map is blurred. All
    numbers are of one precision.
    """
    whole, margin = image.shape[1], len(down) - 1
    rows, width = image.shape[0] - 2 * inset, whole - 2 * inset * step
    high, pixels = (rows + 2 * margin) | 1, out.reshape(out.size)
    room = _blur_room(rows + 2 * margin, width, image)
    _blur_across(image, room, across, margin, step, inset)
    for strip in range((width + LANES - 1) // LANES):
        begin = min(strip * LANES, width - LANES) + inset * step
        for row in range(rows):
            at, middle = (row + inset) * whole + begin, (strip * high + margin + row) * LANES
            weigh_pixels(pixels, at, room, middle, LANES, down, kept, at)


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
def _rim(mask: Bool, windows: Int64) -> Bool:
    """Return where windows around pixels of the mask, one after the other, reach outside of it.

    ``windows`` (n, 2), width and height; those of even sizes lean to the upper left.
    """
    rows, columns = mask.shape
    left, right, above, below = 0, 0, 0, 0
    for window in range(len(windows)):
        left, right = left + (windows[window, 0] - 1) // 2, right + windows[window, 0] // 2
        above, below = above + (windows[window, 1] - 1) // 2, below + windows[window, 1] // 2
    wide, out = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for far in range(-left, right + 1):
            near = wide[row, max(far, 0) :]
            pixels = mask[row, max(-far, 0) :]
            for column in range(columns - abs(far)):
                near[column] |= pixels[column]
    for row in range(rows):
        near, pixels = out[row], mask[row]
        for other in range(max(row - below, 0), min(row + above, rows - 1) + 1):
            met = wide[other]
            for column in range(columns):
                near[column] |= met[column] & (not pixels[column])
    return out


@compiled
def _pressed_gel(
    depth_m: Float64, gel_m: float, gel_mm: Float64, contact_scale: float
) -> tuple[Float64, Bool]:
    """Return the surface of the gel, mm, bent where it meets the solid, and where it is pressed by it."""
    rows, columns = depth_m.shape
    soft, contact = np.empty((rows, columns)), np.empty((rows, columns), np.bool_)
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
        line, gel, free, meets = depth_m[row], soft[row], gel_mm[row], contact[row]
        for column in range(columns):
            height = line[column] * 1000.0 - gel_m * 1000.0
            gel[column] = height if height < free[column] else free[column]
            meets[column] = (height < 0.0) & (gel[column] - free[column] < touches_mm)
    return soft, contact


@compiled
def _add_bulges(soft: Float64, depth_m: Float64, gel_m: float) -> None:
    """Raise the surface of the gel, mm, where it is higher than at rest."""
    for row in range(len(soft)):
        for column in range(soft.shape[1]):
            soft[row, column] += max(depth_m[row, column] - gel_m, 0.0) * 1000.0


@compiled
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


@compiled
def _shades(slope: Float64, direction: Float64, tables: Calibration) -> Float64:
    """Return the colours (H, 3 W + 1) of the calibration for slopes in their place.

    Directions are rounded up as in single precision: the last bin of the package holds only those of pi, and
    that of a flat pixel is the middle of the table exactly.
    """
    rows, columns = slope.shape
    bins = tables.bins
    per_slope, per_direction = (bins - 1) / (0.5 * math.pi), (bins - 1) / (2.0 * math.pi)
    # One spare value: colours are written four values at a time.
    shade = np.empty(rows * columns * 3 + 1)
    chosen = np.empty(columns, np.int64)
    for row in range(rows):
        y = row * (float(tables.height) / rows)
        steep, turned = slope[row], direction[row]
        for column in range(columns):
            last = min(int(turned[column] * per_direction + 4e-6), bins - 1)
            chosen[column] = (int(steep[column] * per_slope) * bins + last) * 18
        for column in range(columns):
            x = column * (float(tables.width) / columns)
            colour_pixel(shade, (row * columns + column) * 3, tables.colours, chosen[column], x, y)
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
    surface, places = soft.reshape(soft.size), np.empty(tables.shadows.shape[2], np.int32)
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
            dark, met = tables.shadows[toward, level], places[: tables.shadow_lengths[toward, level]]
            for ray in range(tables.fan.shape[1]):
                _follow(met, row, column, picture.shadow_step, tables.fan[toward, ray], soft.shape)
                for step in range(len(met)):
                    at = met[step]
                    if at >= 0 and here < surface[at]:
                        for colour in range(3):
                            held = shade[3 * at + colour]
                            shade[3 * at + colour] = dark[step, colour] if dark[step, colour] < held else held


@compiled
def _follow(
    met: Int32, row: int, column: int, steps_px: Float32, ray: Float32, shape: tuple[int, int]
) -> None:
    """Write the numbers of the pixels at the steps of a ray; -1 outside the picture."""
    rows, columns = np.int32(shape[0]), np.int32(shape[1])
    begin_x, begin_y, along_x, along_y = np.float32(column), np.float32(row), steps_px[0], steps_px[1]
    cosine, sine = ray[0], ray[1]
    for step in range(len(met)):
        far = np.float32(step + 1)
        x_px, y_px = begin_x + along_x * far * cosine, begin_y + along_y * far * sine
        is_outside = x_px <= -1.0 or y_px <= -1.0 or x_px >= columns or y_px >= rows
        # Rounded towards 0, like the cast of the package: up to a pixel outside the picture counts as inside.
        place = np.int32(y_px) * columns + np.int32(x_px)
        met[step] = -1 if is_outside else place


@compiled
def render_taxim(
    out: Float32,
    depths_m: Float64,
    gel_m: float,
    tables: Calibration,
    picture: PictureTables,
    is_surface: bool,
) -> None:
    """Render pictures (n, H, W, 3), 0 to 1, of depth, metres; see :mod:`tactile_sim.optics`.

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
        plane = shade[: 3 * soft.size].reshape((rows, 3 * columns))
        for across, down in (picture.shadow_blur, pyramid[len(pyramid) - 1]):
            blur(plane, across, down, 3, None, plane)
        _lay_over(plane, picture.background, out[number])


@compiled
def _lay_over(lit: Float64, background: Float64, out: Float32) -> None:
    rows, width = lit.shape
    for row in range(rows):
        values, behind, shown = lit[row], background[row], out[row].reshape(width)
        for place in range(width):
            value = values[place] + behind[place]
            value = value if value > 0.0 else 0.0
            shown[place] = np.float32(value if value < 1.0 else 1.0)
