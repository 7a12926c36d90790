"""The surface under each pixel: triangles cut into scan lines, in numpy or in numba, with the same bytes.

numpy is the reference: the scan lines of :mod:`tactile_toolkit.mesh.raster`. The numba path
(:mod:`tactile_sim.kernels`) does the same operations in the same order on one triangle after another. Both
use sums, products, quotients and comparisons of IEEE doubles only, which every processor rounds alike.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_sim.layers import layer_rises, profiles
from tactile_toolkit.mesh.raster import scan_lines

__all__ = ["Backend", "face_blocks", "finish", "raise_heights"]

# Runs of 16 to 64 are alike: a touch of a digit takes 0.10 ms, and 0.24 where all its faces are looked at (64
# x 64, one core).
_FACES_PER_BLOCK = 32
# A seventh of the window; of a digit about as many faces as a run lie in each.
_CELL_OF_FACES_M = 0.002

Backend = Literal["numba", "numpy"]


def raise_heights(
    out: NDArray[np.float64],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    blocks: NDArray[np.float64],
    affine: NDArray[np.float64],
    layers: NDArray[np.float64] | None,
    backend: Backend,
) -> None:
    """Raise each pixel of ``out`` to the highest triangle over it that faces upwards.

    ``out``, shape (H, W), has its first row at the top; ``vertices`` (V, 3) float64 and ``faces`` (F, 3)
    int32 are the solid, ``blocks`` (B, 4) balls around runs of its faces (:func:`face_blocks`); ``affine``,
    shape (3, 4), turns a vertex into column, row counted from the bottom, both in pixels whose points have
    whole numbers, and height. ``layers`` are those of a printed solid
    (:func:`tactile_sim.layers.seen_layers`), None for one as it was modelled.
    """
    if backend == "numba":
        from tactile_sim.kernels import raise_heights_numba

        raise_heights_numba(out, vertices, faces, blocks, affine, layers)
        return
    x, y, z = vertices.T
    points = np.stack([((row[0] * x + row[1] * y) + row[2] * z) + row[3] for row in affine])
    upright: Any = out[::-1]
    profile = profiles(vertices, faces, layers) if layers is not None else ()
    for lines in scan_lines(points, faces, out.shape):
        line = np.repeat(np.arange(len(lines.count)), lines.count)
        within = np.arange(len(line)) - np.repeat(np.cumsum(lines.count) - lines.count, lines.count)
        height = lines.height[line] + lines.rise[line] * within
        if layers is not None:
            run, sideways = (each[lines.face[line]] for each in profile)
            height += layer_rises(lines.column[line] + within, lines.row[line], height, run, sideways, layers)
        # Unbuffered: triangles share pixels at their edges.
        np.maximum.at(upright, (lines.row[line], lines.column[line] + within), height)


def finish(
    heights_m: NDArray[np.float64],
    image: NDArray[np.float32],
    press_m: float,
    gel_m: float,
    backend: Backend,
) -> float:
    """Turn heights (H, W) into depth in place and fill the depth image; return the greatest height."""
    if backend == "numba":
        from tactile_sim.kernels import finish_numba

        return float(finish_numba(heights_m, image, press_m, gel_m))
    highest = float(heights_m.max())
    heights_m[...] = press_m + (highest - heights_m)
    image[...] = (np.clip(heights_m, press_m, gel_m) - press_m) / (gel_m - press_m)
    return highest


def face_blocks(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Sort faces so that neighbours lie together; return them and a ball around each run of about 32.

    Most of a solid is outside the window of a touch: whole runs are left out by one test.
    """
    # Corner by corner throughout: numpy reduces over an axis of three many times slower.
    first, second, third = (vertices[faces[:, k]] for k in range(3))
    middles = (first[:, :2] + second[:, :2] + third[:, :2]) / 3
    cells = np.floor((middles - vertices[:, :2].min(axis=0)) / _CELL_OF_FACES_M).astype(np.int64)
    one, other = second - first, third - first
    # Faces that look down are never felt: kept apart, they make the balls of the others smaller.
    down = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] <= 0
    order = np.lexsort((cells[:, 0], cells[:, 1], down))
    corners = [each[order] for each in (first, second, third)]
    # Runs of one length, the last one shorter: the kernel knows from their number where each begins.
    count = -(-len(faces) // _FACES_PER_BLOCK)
    per_block = -(-len(faces) // count)
    starts = np.arange(0, len(faces), per_block)
    low, high = (
        each.reduceat(each(each(corners[0], corners[1]), corners[2]), starts)
        for each in (np.minimum, np.maximum)
    )
    centre = (low + high) / 2
    around = np.repeat(centre, per_block, axis=0)[: len(faces)]
    x, y, z = ((corner - around).T for corner in corners)
    far = np.maximum(np.maximum((x * x).sum(axis=0), (y * y).sum(axis=0)), (z * z).sum(axis=0))
    blocks = np.column_stack([centre, np.sqrt(np.maximum.reduceat(far, starts))])
    return np.ascontiguousarray(faces[order]), blocks
