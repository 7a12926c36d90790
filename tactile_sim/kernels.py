"""Inner loops in numba.

All kernels of touches lie in this one file, because numba's cache on disk looks at the file of a kernel only.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from tactile_toolkit.array_types import Bool, Float32, Float64, Int32, Int64
from tactile_toolkit.compiled import compiled

_EDGE_PX = 1e-9  # as in tactile_toolkit.mesh.raster, whose steps these are


Point: TypeAlias = tuple[float, float, float]


@compiled
def rasterise(
    out: Float64, vertices: Float64, faces: Int32, blocks: Float64, affine: Float64, layers: Any
) -> None:
    """Raise each pixel of ``out`` to the highest triangle over it that faces upwards.

    ``out``, shape (H, W), has its first row at the top; ``vertices`` (V, 3) and ``faces`` (F, 3) are the
    solid, ``blocks`` (B, 4) balls around runs of its faces, centre and radius: a run whose ball is outside
    the window is left out. ``affine``, shape (3, 4), maps a vertex to column, row counted from the bottom,
    both in pixels whose points have integer coordinates, and height. ``layers`` are those of a printed solid
    (:func:`tactile_sim.pressing.seen_layers`), None for one as it was modelled: numba compiles a kernel of
    its own without them. Only sums, products, quotients and comparisons of IEEE doubles are used, which every
    processor rounds alike.
    """
    rows, columns = out.shape
    per_block = (len(faces) + len(blocks) - 1) // len(blocks)
    reach_x, reach_y = _length(affine[0]), _length(affine[1])
    for block in range(len(blocks)):
        middle = _mapped(affine, blocks, block)
        # A thousandth of a pixel more: a ball is rounded, too.
        far_x, far_y = blocks[block, 3] * reach_x + 1e-3, blocks[block, 3] * reach_y + 1e-3
        if middle[0] + far_x < 0.0 or middle[0] - far_x > columns - 1:
            continue
        if middle[1] + far_y < 0.0 or middle[1] - far_y > rows - 1:
            continue
        for face in range(block * per_block, min((block + 1) * per_block, len(faces))):
            one, two, three = faces[face, 0], faces[face, 1], faces[face, 2]
            a, b = _mapped(affine, vertices, one), _mapped(affine, vertices, two)
            c = _mapped(affine, vertices, three)
            # Faces that look down or stand upright; so written, NaN is left out as well.
            if not (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0:
                continue
            if max(a[0], b[0], c[0]) + _EDGE_PX < 0.0 or min(a[0], b[0], c[0]) - _EDGE_PX > columns - 1:
                continue
            first_row = max(math.ceil(min(a[1], b[1], c[1]) - _EDGE_PX), 0)
            last_row = min(math.floor(max(a[1], b[1], c[1]) + _EDGE_PX), rows - 1)
            if first_row <= last_row:
                run = 0.0
                if layers is not None:
                    run = _run(vertices[one], vertices[two], vertices[three], layers)
                _raise_rows(out, first_row, last_row, (a, b, c), run, layers)


@compiled
def _length(row: Float64) -> float:
    return math.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])


@compiled
def _mapped(affine: Float64, points: Float64, index: int) -> Point:
    x, y, z = points[index, 0], points[index, 1], points[index, 2]
    return (
        ((affine[0, 0] * x + affine[0, 1] * y) + affine[0, 2] * z) + affine[0, 3],
        ((affine[1, 0] * x + affine[1, 1] * y) + affine[1, 2] * z) + affine[1, 3],
        ((affine[2, 0] * x + affine[2, 1] * y) + affine[2, 2] * z) + affine[2, 3],
    )


@compiled
def _raise_rows(
    out: Float64,
    first_row: int,
    last_row: int,
    corners: tuple[Point, Point, Point],
    run: float,
    layers: Any,
) -> None:
    """Raise the pixels over a triangle that faces upwards, in the rows that it meets."""
    rows, columns = out.shape
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    area = abx * acy - aby * acx
    low_x, high_x = min(ax, bx, cx), max(ax, bx, cx)
    low_z, high_z = min(az, bz, cz), max(az, bz, cz)
    along_row = (abz * acy - aby * acz) / area
    along_column = (abx * acz - abz * acx) / area
    l0, m0, r0, s0 = _side(ax, ay, bx, by)
    l1, m1, r1, s1 = _side(bx, by, cx, cy)
    l2, m2, r2, s2 = _side(cx, cy, ax, ay)
    for row in range(first_row, last_row + 1):
        left = max(low_x - _EDGE_PX, l0 + m0 * row, l1 + m1 * row, l2 + m2 * row)
        right = min(high_x + _EDGE_PX, r0 + s0 * row, r1 + s1 * row, r2 + s2 * row)
        first, last = max(math.ceil(left), 0), min(math.floor(right), columns - 1)
        if first > last:
            continue
        level = az + along_column * (row - ay)
        start = min(max(level + along_row * (first - ax), low_z), high_z)
        end = min(max(level + along_row * (last - ax), low_z), high_z)
        # Both ends are bounded by the corners: a steep sliver cannot shoot beyond its own heights.
        rise = (end - start) / max(last - first, 1)
        line = out[rows - 1 - row]
        for step in range(last - first + 1):
            height = start + rise * step
            if layers is not None:
                height += _layer_rise(height, run, layers)
            if height > line[first + step]:
                line[first + step] = height


@compiled
def _run(a: Float64, b: Float64, c: Float64, layers: Float64) -> float:
    """Return how far a triangle runs outwards for a step down."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    return float(z / max(math.sqrt(x * x + y * y), layers[4] * abs(z)))


@compiled
def _layer_rise(height: float, run: float, layers: Float64) -> float:
    """Return how far above a point of the solid its layer ends; -inf where none does.

    In the section across the contour lines, with the point at the origin of the line of sight, ``across`` and
    ``down`` lead from the middle of the round end of a layer to the point.
    """
    layer, slack, count, over = layers[0], layers[1], layers[2], height + layers[3]
    radius, number = 0.5 * layer, math.floor((over + slack) / layer - 0.5)
    if number < 0 or number >= count:
        return -np.inf
    down = over - (number + 0.5) * layer
    across = radius - run * (down + slack)
    if across <= 0.0:
        return float(min(radius - down, 2.0 * layer))
    root = down * down - ((across * across + down * down) - radius * radius)
    return float(min(math.sqrt(root) - down, 2.0 * layer)) if root >= 0.0 else -np.inf


@compiled
def _side(start_x: float, start_y: float, end_x: float, end_y: float) -> tuple[float, float, float, float]:
    along_x, along_y = end_x - start_x, end_y - start_y
    if along_y < -_EDGE_PX:
        per_row = along_x / along_y
        slack = _EDGE_PX * (1.0 + abs(per_row))
        return (start_x - per_row * start_y) - slack, per_row, np.inf, 0.0
    if along_y > _EDGE_PX:
        per_row = along_x / along_y
        slack = _EDGE_PX * (1.0 + abs(per_row))
        return -np.inf, 0.0, (start_x - per_row * start_y) + slack, per_row
    return -np.inf, 0.0, np.inf, 0.0


@compiled
def to_depth(heights_m: Float64, image: Float32, press_m: float, gel_m: float) -> float:
    """Turn heights into depth, in place, and the depth image; return the greatest height, metres."""
    rows, columns = heights_m.shape
    # One greatest value for each column, and comparisons as selections: LLVM does several pixels at once.
    greatest = heights_m[0].copy()
    for row in range(1, rows):
        line = heights_m[row]
        for column in range(columns):
            greatest[column] = line[column] if line[column] > greatest[column] else greatest[column]
    highest = greatest[0]
    for column in range(1, columns):
        highest = max(highest, greatest[column])
    span = gel_m - press_m
    for row in range(rows):
        line, shown = heights_m[row], image[row]
        for column in range(columns):
            depth = press_m + (highest - line[column])
            line[column] = depth
            clipped = depth if depth > press_m else press_m
            clipped = clipped if clipped < gel_m else gel_m
            shown[column] = np.float32((clipped - press_m) / span)
    return float(highest)


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
    """Return the angle of a direction, -pi to pi, to 3e-9, by products, sums and quotients."""
    far, near = max(abs(x), abs(y)), min(abs(x), abs(y))
    ratio = near / far
    folded = (ratio - 1.0) / (ratio + 1.0) if ratio > 0.41421356237309503 else ratio
    square = folded * folded
    # Nine terms of the arcus tangent's series; below tan(pi / 8), where it is folded, they are right to 3e-9.
    series = 1.0 / 17.0
    for odd in range(15, 0, -2):
        series = 1.0 / odd - square * series
    angle = folded * series
    if ratio > 0.41421356237309503:
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


Pair: TypeAlias = tuple[Float64, Float64]


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
    """What follows from the size of a picture."""

    gel_mm: Float64
    background: Float64
    pyramid: tuple[Pair, ...]
    shadow_blur: Pair
    windows: Int64
    shadow_step: Float32


@compiled
def _pressed_gel(
    height_mm: Float64, gel_mm: Float64, contact_scale: float, pyramid: tuple[Pair, ...]
) -> tuple[Float64, Bool]:
    """Return the surface of the gel, which leaves the solid smoothly, and where it lies on the solid."""
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
            # What is level in one direction is so exactly: rounding must not choose the end of the circle.
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
    """Darken what lies lower behind each of the pixels at the rim of the contact, along a fan of rays."""
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
                    # Towards 0, as the package's cast: what leaves the picture by less than a pixel still
                    # counts.
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
