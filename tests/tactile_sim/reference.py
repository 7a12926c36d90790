"""The reference of the kernels: the same operations in the same order, in NumPy.

Both use sums, products, quotients and comparisons of IEEE doubles only, which every processor rounds alike,
so that their bytes are equal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tactile_sim
from tactile_toolkit.mesh.raster import covered_pixels

Numbers = NDArray[np.float64]


def press(*arguments: Any, **options: Any) -> tactile_sim.Pressed:
    """Do as :func:`tactile_sim.render_touch` without numba."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tactile_sim.press.press_kernels.rasterise", rasterise)
        patch.setattr("tactile_sim.press.press_kernels.to_depth", to_depth)
        return tactile_sim.render_touch(*arguments, **options)


def rasterise(
    out: Numbers, vertices: Numbers, faces: NDArray[np.int32], _: Numbers, affine: Numbers, layers: Any
) -> None:
    """Raise each pixel of ``out`` (H, W) to the highest triangle over it that faces upwards."""
    x, y, z = vertices.T
    points = np.stack([((row[0] * x + row[1] * y) + row[2] * z) + row[3] for row in affine])
    upright: Any = out[::-1]
    run = runs(vertices, faces, layers) if layers is not None else np.zeros(0)
    for face, line, pixel, height in covered_pixels(points, faces, out.shape):
        row, column = np.divmod(pixel, out.shape[1])
        if layers is not None:
            height = height + layer_rises(height, run[face[line]], layers)
        # Unbuffered: triangles share pixels at their edges.
        np.maximum.at(upright, (row, column), height)


def to_depth(heights_m: Numbers, image: NDArray[np.float32], press_m: float, gel_m: float) -> float:
    """Turn heights (H, W) into depth in place and fill the depth image; return the greatest height."""
    highest = float(heights_m.max())
    heights_m[...] = press_m + (highest - heights_m)
    image[...] = (np.clip(heights_m, press_m, gel_m) - press_m) / (gel_m - press_m)
    return highest


def runs(vertices: Numbers, faces: NDArray[np.integer[Any]], layers: Numbers) -> Numbers:
    """Return for each face the horizontal distance per unit of height."""
    a, b, c = (vertices[corner].T for corner in faces.T)
    (abx, aby, abz), (acx, acy, acz) = b - a, c - a
    x, y, z = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    return np.asarray(z / np.maximum(np.sqrt(x * x + y * y), layers[4] * np.abs(z)))


def layer_rises(height: Numbers, run: Numbers, layers: Numbers) -> Numbers:
    """Return how far above points of the solid their layer ends; -inf if there is no layer.

    ``run`` are the :func:`runs` of their faces. In the section across the contour lines, with the point at
    the origin of the line of sight, ``across`` and ``down`` lead from the middle of the round end of a layer
    to the point.
    """
    layer, slack, count, over = layers[0], layers[1], layers[2], height + layers[3]
    radius, number = 0.5 * layer, np.floor((over + slack) / layer - 0.5)
    down = over - (number + 0.5) * layer
    across = radius - run * (down + slack)
    root = down * down - ((across * across + down * down) - radius * radius)
    with np.errstate(invalid="ignore"):  # points without a root are not chosen
        rise = np.where(across <= 0, radius - down, np.where(root >= 0, np.sqrt(root) - down, -np.inf))
    return np.where((number >= 0) & (number < count), np.minimum(rise, 2.0 * layer), -np.inf)
