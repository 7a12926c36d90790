"""Vertices of placed objects, compiled by numba."""

from __future__ import annotations

import numpy as np

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.kernels import compiled
from tactile_toolkit.value_types import Float32, Float64, Int64

_cosine_sine = compiled(cosine_sine)


@compiled
def standing_vertices(poses: Float64, corners: Float64, corner_counts: Int64) -> Float32:
    """Turn, scale and move the corners of objects; each gives two vertices, on the plate and above it.

    Each row of ``poses`` is a placement without its shape; ``corners`` are those of all objects one after
    another. Computed in double precision and rounded once: shape (2 corners, 3), float32, metres.
    """
    vertices = np.zeros((2 * len(corners), 3), np.float32)
    vertex = 0
    for number in range(len(poses)):
        x_m, y_m, angle_rad, radius_m, height_m = poses[number]
        cosine, sine = _cosine_sine(angle_rad)
        for _ in range(2 * corner_counts[number]):
            x, y = corners[vertex // 2, 0], corners[vertex // 2, 1]
            vertices[vertex, 0] = cosine * radius_m * x - sine * radius_m * y + x_m
            vertices[vertex, 1] = sine * radius_m * x + cosine * radius_m * y + y_m
            vertices[vertex, 2] = height_m * (vertex % 2)
            vertex += 1
    return vertices
