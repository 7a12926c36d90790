"""What is compiled of the making of scenes; numba takes half a second to import, so functions import this."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.mesh.nearness import compiled

_cosine_sine = compiled(cosine_sine)


@compiled
def standing_vertices(
    poses: NDArray[np.float64], corners: NDArray[np.float64], corner_counts: NDArray[Any]
) -> NDArray[np.float32]:
    """Turn, scale and move the corners of objects, each standing twice: on the plate and above it.

    Each row of ``poses`` is what a placement holds after its shape. In double precision, and rounded once.
    """
    vertices = np.zeros((2 * len(corners), 3), np.float32)
    corner = 0
    for number in range(len(poses)):
        x_m, y_m, angle_rad, radius_m, height_m = poses[number]
        cosine, sine = _cosine_sine(angle_rad)
        cosine, sine = cosine * radius_m, sine * radius_m
        for _ in range(corner_counts[number]):
            x, y = corners[corner, 0], corners[corner, 1]
            for vertex in (2 * corner, 2 * corner + 1):
                vertices[vertex, 0] = cosine * x - sine * y + x_m
                vertices[vertex, 1] = sine * x + cosine * y + y_m
            vertices[2 * corner + 1, 2] = height_m
            corner += 1
    return vertices
