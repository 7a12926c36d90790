"""Surfaces before they are scaled, and the bodies and holes that they bound."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tactile_toolkit.array_types import AnyArray, Float32, Int32, Int64
from tactile_toolkit.mesh import connected


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface before it is scaled: a whole one, or the upper half of one, whose rim lies in the mid-plane.

    Attributes
    ----------
    vertices_px : ndarray of float32, shape (V, 3)
        Row, column and height above the mid-plane, from ``corner_px`` of the image.
    faces : ndarray of int32, shape (F, 3)
        Rows of the vertices, counter-clockwise seen from outside.
    corner_px : tuple
        Row, column and height.
    rim, still : ndarray of int
        Rows of vertices that stay in the mid-plane, and that stay where they are, when it is smoothed.
    least_px : float
        Least height of the other vertices.
    """

    vertices_px: Float32
    faces: Int32
    corner_px: tuple[int, int, int] = (0, 0, 0)
    rim: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    still: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    least_px: float = -math.inf


def bodies_and_holes(vertices: int, faces: AnyArray, rim: int = 0) -> tuple[int, int]:
    """Count the bodies of a closed surface and the holes through them.

    With a ``rim``, the number of vertices in the mid-plane, the surface is the upper half of one.
    """
    corners = faces.astype(np.int64)
    least = connected(corners[:, :2].ravel(), corners[:, 1:].ravel(), vertices)
    bodies = int(np.count_nonzero(least == np.arange(vertices)))
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = 2 * vertices - rim - len(faces) if rim else vertices - len(faces) // 2
    return bodies, bodies - euler // 2
