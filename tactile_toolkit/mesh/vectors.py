"""Vectors of three floats for kernels."""

from __future__ import annotations

import math
from typing import TypeAlias

from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.compiled import part

Vector: TypeAlias = tuple[float, float, float]


@part
def row_of(array: Float64, place: int) -> Vector:
    """Return a row of an array, shape (N, 3)."""
    return array[place, 0], array[place, 1], array[place, 2]


@part
def corner_of(points: Float64, faces: Int64, face: int, k: int) -> Vector:
    """Return a corner of a triangle, from points, shape (N, 3)."""
    corner = faces[face, k]
    return points[corner, 0], points[corner, 1], points[corner, 2]


@part
def sub(u: Vector, v: Vector) -> Vector:
    """Return the difference."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@part
def dot(u: Vector, v: Vector) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@part
def cross(u: Vector, v: Vector) -> Vector:
    """Return the vector product."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@part
def normalized(u: Vector) -> Vector:
    """Return the vector of length 1 in the same direction."""
    length = max(math.sqrt(dot(u, u)), 1e-300)
    return u[0] / length, u[1] / length, u[2] / length
