"""Surfaces before they are scaled, and the bodies and holes that they bound."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tactile_toolkit.array_types import AnyArray, Float32, Int32, Int64
from tactile_toolkit.mesh import connected


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A whole surface in pixels, or the upper half of one, whose rim lies in the mid-plane.

    Attributes
    ----------
    vertices_px : ndarray of float32, shape (V, 3)
        Row, column and height, counted from ``corner_px``.
    faces : ndarray of int32, shape (F, 3)
        Rows of the vertices, counter-clockwise seen from outside.
    corner_px : tuple
        Row, column and height.
    rim, still : ndarray of int
        Rows of the vertices that smoothing keeps in the mid-plane, and of those that it does not move.
    least_px : float
        Least height of all other vertices after smoothing.
    """

    vertices_px: Float32
    faces: Int32
    corner_px: tuple[int, int, int] = (0, 0, 0)
    rim: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    still: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    least_px: float = -math.inf


def bodies_and_holes(vertices: int, faces: AnyArray, rim: int = 0) -> tuple[int, int]:
    """Count the bodies of a closed surface and the holes through them.

    ``vertices`` is the number of vertices. For the upper half of a surface, ``rim`` is the number of those in
    the mid-plane.
    """
    corners = faces.astype(np.int64)
    least = connected(corners[:, :2].ravel(), corners[:, 1:].ravel(), vertices)
    bodies = int(np.count_nonzero(least == np.arange(vertices)))
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = vertices - len(faces) // 2
    if rim:
        euler = 2 * vertices - rim - len(faces)
    return bodies, bodies - euler // 2
