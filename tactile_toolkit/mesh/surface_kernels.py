"""Kernels for surfaces: division into halves, triangles that cross, overhangs."""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.compiled import part, planned
from tactile_toolkit.mesh.vectors import Vector, corner_of, cross, dot, normalized, row_of, sub


def halves(points: Float64, faces: Int64, level: float) -> tuple[bool, Int64, Int64]:
    """Return whether a level plane divides triangles into two halves, and what remains to be checked.

    To check are the numbers of triangles that do not face away from the plane, shape (M,), and the edges in
    the plane of triangles above it, shape (N, 2).
    """
    odd, edges = np.empty(len(faces), np.int64), np.empty((3 * len(faces), 2), np.int64)
    is_divided, odds, count = _halves(points, faces, level, odd, edges)
    return is_divided, odd[:odds], edges[:count]


@planned("(float64[:,::1], int64[:,::1], float64, int64[::1], int64[:,::1])")
def _halves(points: Float64, faces: Int64, level: float, odd: Int64, edges: Int64) -> tuple[bool, int, int]:
    reaches, odds, count = False, 0, 0
    for face in range(len(faces)):
        a, b, c = (
            corner_of(points, faces, face, 0),
            corner_of(points, faces, face, 1),
            corner_of(points, faces, face, 2),
        )
        least, most = min(min(a[2], b[2]), c[2]), max(max(a[2], b[2]), c[2])
        # The triangle crosses the plane, or lies in it.
        if (least < level < most) or least == most == level:
            return False, 0, 0
        reaches |= least == level or most == level
        upwards = cross(sub(b, a), sub(c, a))[2]
        if (upwards if most > level else -upwards) <= 0:
            odd[odds] = face
            odds += 1
        if least == level:
            for k in range(3):
                at, beyond = faces[face, k], faces[face, (k + 1) % 3]
                if points[at, 2] == level and points[beyond, 2] == level:
                    edges[count, 0], edges[count, 1] = at, beyond
                    count += 1
    return reaches, odds, count


def passages(
    points: Float64, triangles: Int64, normal: Float64, pairs: Int64, tolerance: float
) -> tuple[bool, Float64]:
    """Return whether triangles of a pair certainly cross or are folded onto each other, and where.

    If none do, return the places where an edge may pass through a triangle, shape (N, 3).
    """
    doubtful = np.empty((6 * pairs.shape[1], 3))
    is_certain, count = _passages(points, triangles, normal, pairs, tolerance, doubtful)
    return is_certain, doubtful[count - 1 if is_certain else 0 : count]


@planned("(float64[:,::1], int64[:,::1], float64[:,::1], int64[:,::1], float64, float64[:,::1])")
def _passages(
    points: Float64, triangles: Int64, normal: Float64, pairs: Int64, tolerance: float, doubtful: Float64
) -> tuple[bool, int]:
    """Write the places; a certain one is the last."""
    count = 0
    for pair in range(pairs.shape[1]):
        one, other = pairs[0, pair], pairs[1, pair]
        # The normals are opposite within 8 degrees, as at folds and at thin edges, which differ by their gap.
        opposed = dot(row_of(normal, one), row_of(normal, other)) < -0.99
        for k in range(6):
            target, passing = (one, other) if k < 3 else (other, one)
            into = row_of(normal, target)
            found, place = _passage(points, triangles, into, target, passing, k % 3, tolerance)
            if opposed and _is_fold(points, triangles, target, passing, k % 3, tolerance):
                found = 2
            if found:
                doubtful[count, 0], doubtful[count, 1], doubtful[count, 2] = place
                count += 1
            if found == 2:
                return True, count
    return False, count


@part
def _passage(
    points: Float64, triangles: Int64, into: Vector, target: int, passing: int, k: int, tolerance: float
) -> tuple[int, Vector]:
    """Return whether an edge passes through a target: 0 for no, 1 for perhaps, 2 for yes; and where."""
    start, end = triangles[passing, k], triangles[passing, (k + 1) % 3]
    p, q, base = row_of(points, start), row_of(points, end), corner_of(points, triangles, target, 0)
    at_p, at_q = dot(sub(p, base), into), dot(sub(q, base), into)
    if min(at_p, at_q) > tolerance or max(at_p, at_q) < -tolerance:
        return 0, p
    share = 0.5 if at_p == at_q else min(max(at_p / (at_p - at_q), 0.0), 1.0)
    place = p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2])
    inside = np.inf
    for side in range(3):
        corner = triangles[target, side]
        if corner in (start, end):
            return 0, p
        here = row_of(points, corner)
        along = sub(corner_of(points, triangles, target, (side + 1) % 3), here)
        inward = cross(into, along)
        inside = min(inside, dot(sub(place, here), inward) / math.sqrt(dot(along, along)))
    through = min(at_p, at_q) < -tolerance and max(at_p, at_q) > tolerance
    return (0 if inside < -tolerance else 2 if through and inside > tolerance else 1), place


@part
def _is_fold(points: Float64, triangles: Int64, one: int, other: int, k: int, tolerance: float) -> bool:
    """Return whether triangles that share edge k of the first are folded onto each other."""
    start, end = triangles[one, k], triangles[one, (k + 1) % 3]
    p, shared = row_of(points, start), 0
    apex, far = corner_of(points, triangles, one, (k + 2) % 3), p
    for place in range(3):
        corner = triangles[other, place]
        if corner in (start, end):
            shared += 1
        else:
            far = row_of(points, corner)
    if shared != 2:
        return False
    along = normalized(sub(row_of(points, end), p))
    first, second = _across(sub(apex, p), along), _across(sub(far, p), along)
    between = sub(normalized(first), normalized(second))
    # Distance of the shorter one from the longer.
    shorter = min(dot(first, first), dot(second, second))
    return math.sqrt(shorter * dot(between, between)) <= tolerance


@part
def _across(u: Vector, along: Vector) -> Vector:
    """Return the component of a vector perpendicular to a direction."""
    part = dot(u, along)
    return u[0] - part * along[0], u[1] - part * along[1], u[2] - part * along[2]


def leaning_out(points: Float64, faces: Int64, bed: float, sine: float) -> Float64:
    """Return twice the areas of triangles above a bed that face down by an angle of more than this sine."""
    doubled = np.empty(len(faces))
    return doubled[: _leaning_out(points, faces, bed, sine, doubled)]


@planned("(float64[:,::1], int64[:,::1], float64, float64, float64[::1])")
def _leaning_out(points: Float64, faces: Int64, bed: float, sine: float, doubled: Float64) -> int:
    count = 0
    for face in range(len(faces)):
        a, b, c = (
            corner_of(points, faces, face, 0),
            corner_of(points, faces, face, 1),
            corner_of(points, faces, face, 2),
        )
        normal = cross(sub(b, a), sub(c, a))
        size = math.sqrt(dot(normal, normal))
        if normal[2] < 0 and normal[2] < -sine * size and max(max(a[2], b[2]), c[2]) > bed:
            doubled[count] = size
            count += 1
    return count
