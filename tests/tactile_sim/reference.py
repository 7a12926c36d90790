"""The reference of the kernels: the same operations in the same order, in numpy.

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
        patch.setattr("tactile_sim.kernels.rasterise", rasterise)
        patch.setattr("tactile_sim.kernels.to_depth", to_depth)
        return tactile_sim.render_touch(*arguments, **options)


def rasterise(
    out: Numbers, vertices: Numbers, faces: NDArray[np.int32], _: Numbers, affine: Numbers, layers: Any
) -> None:
    """Raise each pixel of ``out`` (H, W) to the highest triangle over it that faces upwards."""
    x, y, z = vertices.T
    points = np.stack([((row[0] * x + row[1] * y) + row[2] * z) + row[3] for row in affine])
    upright: Any = out[::-1]
    profile = profiles(vertices, faces, layers) if layers is not None else ()
    for face, line, pixel, height in covered_pixels(points, faces, out.shape):
        row, column = np.divmod(pixel, out.shape[1])
        if layers is not None:
            run, sideways = (each[face[line]] for each in profile)
            height = height + layer_rises(column, row, height, run, sideways, layers)
        # Unbuffered: triangles share pixels at their edges.
        np.maximum.at(upright, (row, column), height)


def to_depth(heights_m: Numbers, image: NDArray[np.float32], press_m: float, gel_m: float) -> float:
    """Turn heights (H, W) into depth in place and fill the depth image; return the greatest height."""
    highest = float(heights_m.max())
    heights_m[...] = press_m + (highest - heights_m)
    image[...] = (np.clip(heights_m, press_m, gel_m) - press_m) / (gel_m - press_m)
    return highest


def profiles(vertices: Numbers, faces: NDArray[np.integer[Any]], layers: Numbers) -> tuple[Numbers, Numbers]:
    """Return of each face how far it runs outwards for a step down, and how sideways it is seen."""
    a, b, c = (vertices[corner].T for corner in faces.T)
    (abx, aby, abz), (acx, acy, acz) = b - a, c - a
    x, y, z = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    level = np.maximum(np.sqrt(x * x + y * y), layers[11] * np.abs(z))
    return z / level, (layers[3] * x + layers[4] * y) / level


def layer_rises(
    column: NDArray[np.int64],
    row: NDArray[np.int64],
    height: Numbers,
    run: Numbers,
    sideways: Numbers,
    layers: Numbers,
) -> Numbers:
    """Return how far above points of the solid its layers end, towards the sensor; -inf where there is none.

    ``column``, ``row`` and ``height`` are the points as the sensor sees them, ``run`` and ``sideways`` the
    :func:`profiles` of their faces. In the section across the contour lines, with the point at the origin of
    the line of sight, ``across`` and ``down`` lead from the middle of the round end of a layer to the point.
    """
    layer, slack, count, upward = layers[0], layers[1], layers[2], layers[5]
    over = ((layers[6] * column + layers[7] * row) + layers[8] * height) + layers[9]
    radius = 0.5 * layer
    square = sideways * sideways + upward * upward
    middle = np.floor((over + slack) / layer - 0.5)
    best = np.full(len(over), -np.inf)
    for around in range(-int(layers[10]), int(layers[10]) + 1):
        number = middle + around
        printed = (number >= 0) & (number < count)
        down = over - (number + 0.5) * layer
        across = radius - run * (down + slack)
        with np.errstate(all="ignore"):  # what is divided by nothing is never chosen
            flat = ((radius if upward > 0 else -radius) - down) / upward
            ends_flat = across + flat * sideways <= 0
            half = across * sideways + down * upward
            root = half * half - square * ((across * across + down * down) - radius * radius)
            round_end = (np.sqrt(root) - half) / square
            ends_round = ~ends_flat & (root >= 0) & (across + round_end * sideways >= 0)
        best = np.where(printed & ends_flat, np.maximum(best, flat), best)
        best = np.where(printed & ends_round, np.maximum(best, round_end), best)
    return np.asarray(np.minimum(best, 2.0 * layer))
