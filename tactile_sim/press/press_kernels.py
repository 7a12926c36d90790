"""Kernels of pressing, in numba: the highest triangle over each pixel, and from heights to depth.

All of them lie in this one file, because numba's cache on disk checks only the file of a kernel.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float32, Float64, Int32

_EDGE_PX = 1e-9  # as in tactile_toolkit.mesh.raster, whose steps these are
_WARP_STEPS, _SAME_PX = 8, 1e-4  # displacements change by far less than their size from point to point
Point: TypeAlias = tuple[float, float, float]


@compiled
def rasterise(
    out: Float64,
    vertices: Float64,
    faces: Int32,
    blocks: Float64,
    affine: Float64,
    layers: Float64 | None,
    highest: float = math.inf,
) -> None:
    """Raise each pixel of ``out`` to the highest triangle over it that faces upwards.

    ``out``, shape (H, W), has its first row at the top; ``vertices`` (V, 3) and ``faces`` (F, 3) are the
    solid, ``blocks`` (B, 4) balls around runs of its faces, centre and radius: a run whose ball is outside
    the window is left out. ``affine``, shape (3, 4), maps a vertex to column, row counted from the bottom,
    both in pixels whose points have integer coordinates, and height. ``layers`` are those of a printed solid
    (:meth:`tactile_sim.Pressable.layers`), None for a solid as it was modelled, for which numba compiles a
    kernel without them. Points above ``highest`` do not count. Only sums, products, quotients, square roots
    and comparisons of IEEE doubles are used, which every processor rounds alike.
    """
    rows, columns = out.shape
    per_block = (len(faces) + len(blocks) - 1) // len(blocks)
    reach_x, reach_y = _length(affine[0]), _length(affine[1])
    for block in range(len(blocks)):
        middle = _mapped(affine, blocks, block)
        # A thousandth of a pixel more: the ball is rounded, too.
        far_x, far_y = blocks[block, 3] * reach_x + 1e-3, blocks[block, 3] * reach_y + 1e-3
        if middle[0] + far_x < 0.0 or middle[0] - far_x > columns - 1:
            continue
        if middle[1] + far_y < 0.0 or middle[1] - far_y > rows - 1:
            continue
        for face in range(block * per_block, min((block + 1) * per_block, len(faces))):
            # As 64 bits, like the numbers of blocks: numba compiles a function for each type.
            first, second = np.int64(faces[face, 0]), np.int64(faces[face, 1])
            third = np.int64(faces[face, 2])
            a, b = _mapped(affine, vertices, first), _mapped(affine, vertices, second)
            c = _mapped(affine, vertices, third)
            # Faces that look down or are vertical; written so that NaN is left out as well.
            if not (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0:
                continue
            if max(a[0], b[0], c[0]) + _EDGE_PX < 0.0 or min(a[0], b[0], c[0]) - _EDGE_PX > columns - 1:
                continue
            first_row = max(math.ceil(min(a[1], b[1], c[1]) - _EDGE_PX), 0)
            last_row = min(math.floor(max(a[1], b[1], c[1]) + _EDGE_PX), rows - 1)
            if first_row <= last_row:
                run = 0.0
                if layers is not None:
                    run = _run(vertices[first], vertices[second], vertices[third], layers)
                _raise_rows(out, first_row, last_row, (a, b, c), run, layers, highest)


@part
def _length(row: Float64) -> float:
    return math.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])


@part
def _mapped(affine: Float64, points: Float64, index: int | np.int64) -> Point:
    x, y, z = points[index, 0], points[index, 1], points[index, 2]
    return (
        ((affine[0, 0] * x + affine[0, 1] * y) + affine[0, 2] * z) + affine[0, 3],
        ((affine[1, 0] * x + affine[1, 1] * y) + affine[1, 2] * z) + affine[1, 3],
        ((affine[2, 0] * x + affine[2, 1] * y) + affine[2, 2] * z) + affine[2, 3],
    )


@part
def _raise_rows(
    out: Float64,
    first_row: int,
    last_row: int,
    corners: tuple[Point, Point, Point],
    run: float,
    layers: Float64 | None,
    highest: float,
) -> None:
    """Raise the pixels over a triangle that faces upwards, in the rows that it covers."""
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
        first = max(math.ceil(left), 0)
        last = min(math.floor(right), columns - 1)
        if first > last:
            continue
        level = az + along_column * (row - ay)
        start = min(max(level + along_row * (first - ax), low_z), high_z)
        end = min(max(level + along_row * (last - ax), low_z), high_z)
        # Both ends are bounded by the corners, so that a steep sliver stays within its own heights.
        rise = (end - start) / max(last - first, 1)
        line = out[rows - 1 - row]
        for step in range(last - first + 1):
            height = start + rise * step
            if layers is not None:
                height += _layer_rise(height, run, layers)
            if line[first + step] < height <= highest:
                line[first + step] = height


@part
def _run(a: Float64, b: Float64, c: Float64, layers: Float64) -> float:
    """Return the slope of a triangle: horizontal distance per unit of height."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    return float(z / max(math.sqrt(x * x + y * y), layers[4] * abs(z)))


@part
def _layer_rise(height: float, run: float, layers: Float64) -> float:
    """Return the distance from a point of the solid up to the end of its layer; -inf if there is no layer.

    In the section across the contour lines, ``across`` and ``down`` lead from the middle of the round end of
    a layer to the point.
    """
    layer = layers[0]
    slack = layers[1]
    count = layers[2]
    over = height + layers[3]
    radius = 0.5 * layer
    number = math.floor((over + slack) / layer - 0.5)
    if number < 0 or number >= count:
        return -np.inf
    down = over - (number + 0.5) * layer
    across = radius - run * (down + slack)
    if across <= 0.0:
        return float(min(radius - down, 2.0 * layer))
    root = down * down - ((across * across + down * down) - radius * radius)
    return float(min(math.sqrt(root) - down, 2.0 * layer)) if root >= 0.0 else -np.inf


@part
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
def show_surface(
    out: Float64,
    corner: tuple[int, int],
    inward_m: Float64,
    moved_m: Float64,
    pixel_m: tuple[float, float],
    gel_m: float,
) -> None:
    """Write how far the surface of an elastic gel is from the sensor, as it looks through the gel; metres.

    ``out`` (h, w) is the window whose first pixel is at row and column ``corner`` of the whole gel, of which
    ``inward_m`` (H, W, 1) is how far the surface is pressed in, and ``moved_m`` (H, W, 2) how far along x and
    y what is seen has moved, both by points at rest.
    """
    rows, columns, _ = inward_m.shape
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            here_x, here_y = float(column + corner[1]), float(row + corner[0])
            x, y = here_x, here_y
            for _ in range(_WARP_STEPS):
                left, top, across, down = _cell(x, y, rows, columns)
                before_x, before_y = x, y
                x = here_x - _mixed(moved_m, 0, left, top, across, down) / pixel_m[0]
                y = here_y + _mixed(moved_m, 1, left, top, across, down) / pixel_m[1]
                if abs(x - before_x) + abs(y - before_y) < _SAME_PX:
                    break
            left, top, across, down = _cell(x, y, rows, columns)
            out[row, column] = gel_m - _mixed(inward_m, 0, left, top, across, down)


@part
def _cell(x: float, y: float, rows: int, columns: int) -> tuple[int, int, float, float]:
    """Return the pixel to the upper left of a column and a row, and how far they are beyond it."""
    x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    left, top = min(int(x), max(columns - 2, 0)), min(int(y), max(rows - 2, 0))
    return left, top, x - left, y - top


@part
def _mixed(values: Float64, k: int, left: int, top: int, across: float, down: float) -> float:
    """Interpolate map ``k`` linearly between four pixels; a map may have a single row or column."""
    right, bottom = min(left + 1, values.shape[1] - 1), min(top + 1, values.shape[0] - 1)
    upper = values[top, left, k] * (1.0 - across) + values[top, right, k] * across
    lower = values[bottom, left, k] * (1.0 - across) + values[bottom, right, k] * across
    return float(upper * (1.0 - down) + lower * down)
