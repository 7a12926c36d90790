"""Vectors of three floats for kernels.

numba's disk cache is invalidated by changes of the file of a kernel only: kernels that call these functions
are not compiled again when this file changes.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from tactile_toolkit.array_types import Float64
from tactile_toolkit.compiled import compiled

Vector: TypeAlias = tuple[float, float, float]


@compiled
def row_of(array: Float64, place: int) -> Vector:
    """Return a row of an array, shape (N, 3)."""
    return array[place, 0], array[place, 1], array[place, 2]


@compiled
def sub(u: Vector, v: Vector) -> Vector:
    """Return the difference."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@compiled
def dot(u: Vector, v: Vector) -> float:
    """Return the scalar product."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@compiled
def cross(u: Vector, v: Vector) -> Vector:
    """Return the vector product."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@compiled
def normalized(u: Vector) -> Vector:
    """Return the vector of length 1 in the same direction."""
    length = max(math.sqrt(dot(u, u)), 1e-300)
    return u[0] / length, u[1] / length, u[2] / length
