"""Inner loops in numba. No fastmath: every operation is an IEEE one, in the order in which it stands.

All kernels lie in this one file, because numba's cache on disk looks at the file of a kernel only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["finish_numba", "raise_heights_numba"]

F = TypeVar("F", bound=Callable[..., Any])


def _compiled(function: F) -> F:
    """Compile on first use; kept beside this file or in the user's cache folder, where one can be written."""
    jit: Any = numba.njit
    compiled: F
    try:
        compiled = jit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # numba finds no folder for its cache
        compiled = jit(nogil=True, error_model="numpy")(function)
    return compiled


_EDGE_PX = 1e-9  # as in tactile_toolkit.mesh.raster, whose steps these are


@_compiled
def raise_heights_numba(
    out: NDArray[np.float64],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    blocks: NDArray[np.float64],
    affine: NDArray[np.float64],
) -> None:
    """Do as :func:`tactile_sim.heights.raise_heights` with numpy, one triangle after another.

    ``blocks``, shape (B, 4), are balls around as many runs of faces, centre and radius: a run whose ball is
    outside the window is left out.
    """
    rows, columns = out.shape
    per_block = (len(faces) + len(blocks) - 1) // len(blocks)
    xx, xy, xz, x0 = affine[0, 0], affine[0, 1], affine[0, 2], affine[0, 3]
    yx, yy, yz, y0 = affine[1, 0], affine[1, 1], affine[1, 2], affine[1, 3]
    zx, zy, zz, z0 = affine[2, 0], affine[2, 1], affine[2, 2], affine[2, 3]
    reach_x, reach_y = math.sqrt(xx * xx + xy * xy + xz * xz), math.sqrt(yx * yx + yy * yy + yz * yz)
    for block in range(len(blocks)):
        x, y, z, radius = blocks[block, 0], blocks[block, 1], blocks[block, 2], blocks[block, 3]
        middle_x, middle_y = xx * x + xy * y + xz * z + x0, yx * x + yy * y + yz * z + y0
        far_x, far_y = radius * reach_x + 1e-3, radius * reach_y + 1e-3
        if middle_x + far_x < 0.0 or middle_x - far_x > columns - 1:
            continue
        if middle_y + far_y < 0.0 or middle_y - far_y > rows - 1:
            continue
        for face in range(block * per_block, min((block + 1) * per_block, len(faces))):
            a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
            x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
            ax, ay = ((xx * x + xy * y) + xz * z) + x0, ((yx * x + yy * y) + yz * z) + y0
            az = ((zx * x + zy * y) + zz * z) + z0
            x, y, z = vertices[b, 0], vertices[b, 1], vertices[b, 2]
            bx, by = ((xx * x + xy * y) + xz * z) + x0, ((yx * x + yy * y) + yz * z) + y0
            bz = ((zx * x + zy * y) + zz * z) + z0
            x, y, z = vertices[c, 0], vertices[c, 1], vertices[c, 2]
            cx, cy = ((xx * x + xy * y) + xz * z) + x0, ((yx * x + yy * y) + yz * z) + y0
            cz = ((zx * x + zy * y) + zz * z) + z0
            abx, aby, acx, acy = bx - ax, by - ay, cx - ax, cy - ay
            area = abx * acy - aby * acx
            if not area > 0.0:
                continue
            low_x, high_x = min(min(ax, bx), cx), max(max(ax, bx), cx)
            low_y, high_y = min(min(ay, by), cy), max(max(ay, by), cy)
            if high_x + _EDGE_PX < 0.0 or low_x - _EDGE_PX > columns - 1:
                continue
            first_row = max(math.ceil(low_y - _EDGE_PX), 0)
            last_row = min(math.floor(high_y + _EDGE_PX), rows - 1)
            if first_row > last_row:
                continue
            abz, acz = bz - az, cz - az
            low_z, high_z = min(min(az, bz), cz), max(max(az, bz), cz)
            along_row = (abz * acy - aby * acz) / area
            along_column = (abx * acz - abz * acx) / area
            l0, m0, r0, s0 = _side(ax, ay, bx, by)
            l1, m1, r1, s1 = _side(bx, by, cx, cy)
            l2, m2, r2, s2 = _side(cx, cy, ax, ay)
            for row in range(first_row, last_row + 1):
                left = max(max(max(low_x - _EDGE_PX, l0 + m0 * row), l1 + m1 * row), l2 + m2 * row)
                right = min(min(min(high_x + _EDGE_PX, r0 + s0 * row), r1 + s1 * row), r2 + s2 * row)
                first, last = max(math.ceil(left), 0), min(math.floor(right), columns - 1)
                if first > last:
                    continue
                level = az + along_column * (row - ay)
                start = min(max(level + along_row * (first - ax), low_z), high_z)
                end = min(max(level + along_row * (last - ax), low_z), high_z)
                rise = (end - start) / max(last - first, 1)
                line = out[rows - 1 - row]
                for step in range(last - first + 1):
                    height = start + rise * step
                    if height > line[first + step]:
                        line[first + step] = height


@_compiled
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


@_compiled
def finish_numba(
    heights_m: NDArray[np.float64], image: NDArray[np.float32], press_m: float, gel_m: float
) -> float:
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
