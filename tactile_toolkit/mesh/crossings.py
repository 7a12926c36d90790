"""Self-crossings of closed surfaces: edges against triangles, over a tree of boxes.

Where two sheets of a closed surface cross, some space is enclosed twice, or inside out, and the volume counts
it so. Sheets that only touch do not enclose space twice and are accepted.

Sheets cross where an edge passes through a triangle with which it shares no corner, and neighbours where one
is folded back onto the other. An edge that meets a triangle only within :func:`tolerance_mm` of its ends, or
of the rim of the triangle, may touch it or be the seam of a crossing: winding numbers around it decide.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.mesh.box_tree import (
    Vector,
    connected,
    corner_of,
    cross,
    dot,
    near_pairs,
    normalized,
    row_of,
    sub,
)
from tactile_toolkit.value_types import Float64, Int64

_TOLERANCE = 2.0**-21

# Greatest number of faces that do not look up; each takes a pass over all faces.
_MAX_ODD = 64

# Doubtful places that are tested; each takes a winding number over all faces, and 26 over those near it.
_DOUBTS_TRIED = 32

# Doubtful places from which they are chosen, at most about so many.
_MAX_DOUBTS = 1_000_000

# Faces farther away than this many of the distances below have nearly one solid angle from all those points.
_NEAR = 2000.0

# Distance, in tolerances, from a doubtful place to the points at which winding numbers are computed. None of
# the directions lies in a plane in which faces of hand-made objects usually lie.
_ASIDE = 16.0
_GRID = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_GRID += (0.137, 0.211, 0.293)
_DIRECTIONS = _GRID / np.linalg.norm(_GRID, axis=1, keepdims=True)


def tolerance_mm(vertices_mm: Float64) -> float:
    """Return the depth to which sheets may overlap, mm: a few times the rounding of single precision."""
    return _TOLERANCE * float(np.abs(vertices_mm).max())


def self_crossing(vertices_mm: Float64, faces: Int64, bodies: int = 1) -> Float64 | None:
    """Return a point, shape (3,), mm, where a body of a closed manifold mesh crosses itself, or None.

    ``bodies`` is the number of connected surfaces of the mesh; crossings of different ones are ignored.
    """
    suspects = faces_not_proven_free(vertices_mm, faces)
    if not len(suspects):
        return None
    if bodies == 1:
        return _crossing_among(vertices_mm, faces, suspects)
    body = connected(faces.ravel(), np.roll(faces, -1, axis=1).ravel(), len(vertices_mm))[faces[:, 0]]
    for number in np.unique(body[suspects]):
        own = np.flatnonzero(body == number)
        point_mm = _crossing_among(vertices_mm, faces[own], np.flatnonzero(np.isin(own, suspects)))
        if point_mm is not None:
            return point_mm
    return None


def faces_not_proven_free(vertices_mm: Float64, faces: Int64) -> Int64:
    """Return the faces that may cross others; fewer than all where the surface splits along a level plane.

    Over each point of the plane, the number of faces of the upper half that look up exceeds the number of
    those that do not by the winding number of its rim. For a simple rim that is at most one: then two faces
    share a point only where a face does not look up, and there are few of these.
    """
    x, y, z = vertices_mm.T
    is_split, odd, edges = halves(vertices_mm, faces, (z.max() + z.min()) / 2)
    if not is_split or len(odd) > _MAX_ODD or not _rim_is_simple(vertices_mm, edges):
        return np.arange(len(faces))
    if not len(odd):
        return odd
    corners = np.ascontiguousarray(faces.T)
    sides = [np.stack([np.minimum.reduce(at), np.maximum.reduce(at)]) for at in (x[corners], y[corners])]
    near = np.zeros(len(faces), dtype=bool)
    for face in odd:
        near |= np.logical_and.reduce([(at[0] <= at[1, face]) & (at[1] >= at[0, face]) for at in sides])
    return np.flatnonzero(near)


def _rim_is_simple(points: Float64, edges: Int64) -> bool:
    """Return whether the rim of a half consists of separate lines that wind once at most."""
    start, end = edges.T
    # An edge that the half has in both directions is not part of its rim.
    forth = np.sort(start * len(points) + end)
    back = end * len(points) + start
    rim = forth[np.searchsorted(forth[:-1], back)] != back
    start, end = start[rim], end[rim]
    if np.bincount(start, minlength=1).max() > 1:
        return False  # lines that share a corner
    p, q = points[start], points[end]
    for first, second in near_pairs(np.stack([p, q], axis=1), 0.0):
        a = p[first]
        b = q[first]
        c = p[second]
        d = q[second]
        turn_c, turn_d = _turn(a, b, c), _turn(a, b, d)
        # Edges cross unless one of them has both ends of the other on one side.
        apart = (turn_c * turn_d > 0) | (_turn(c, d, a) * _turn(c, d, b) > 0)
        # Neighbours share a corner; otherwise they are apart unless one runs back along the other.
        joined = (start[first] == end[second]) | (end[first] == start[second])
        onwards = ((b - a) * (d - c)).sum(axis=1) > 0
        if not np.where(joined, (turn_c != 0) | (turn_d != 0) | onwards, apart).all():
            return False
    # Simple closed lines: the others wind around each 0 times, or once where it winds backwards.
    line = connected(start, end, len(points))[start]
    for number in np.unique(line):
        own = line == number
        area = _turn(np.zeros_like(p[own]), p[own], q[own]).sum()
        point = p[own][:1]
        a = p[~own]
        b = q[~own]
        left = _turn(a, b, point)
        upwards = b[:, 1] > point[:, 1]
        passing = ((a[:, 1] > point[:, 1]) != upwards) & np.where(upwards, left > 0, left < 0)
        if np.where(upwards, 1, -1)[passing].sum() != (0 if area > 0 else 1):
            return False
    return True


def _turn(a: Float64, b: Float64, c: Float64) -> Float64:
    """Return the sense of rotation of points, shape (N, 3), seen from above: positive counter-clockwise."""
    return np.asarray((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))


def _crossing_among(vertices_mm: Float64, faces: Int64, suspects: Int64) -> Float64 | None:
    """Return a point, shape (3,), mm, where two of the suspected faces cross, or None."""
    tolerance = tolerance_mm(vertices_mm)
    a, b, c = (vertices_mm[faces[suspects, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    doubled = np.sqrt((normal * normal).sum(axis=1))
    longest = np.sqrt(np.max([((v - u) ** 2).sum(axis=1) for u, v in ((a, b), (b, c), (c, a))], axis=0))
    # Nothing passes through a triangle narrower than the tolerance; its neighbours have its edges too.
    wide = doubled > tolerance * longest
    triangles = faces[suspects[wide]].astype(np.int64)
    normal = normal[wide] / doubled[wide, None]
    points = np.ascontiguousarray(vertices_mm, dtype=np.float64)
    doubtful = [np.zeros((0, 3))]
    count = 0
    for pairs in near_pairs(vertices_mm[triangles], tolerance):
        is_certain, crossings_mm = passages(points, triangles, normal, pairs, tolerance)
        if is_certain:
            return np.asarray(crossings_mm[0])
        if count < _MAX_DOUBTS:
            doubtful.append(crossings_mm.copy())
            count += len(crossings_mm)
    points_mm = np.concatenate(doubtful)
    chosen = np.linspace(0, len(points_mm) - 1, min(len(points_mm), _DOUBTS_TRIED)).astype(np.int64)
    triangles_mm = vertices_mm[faces]
    for point_mm in points_mm[chosen]:
        winding = _windings_around(triangles_mm, point_mm, _ASIDE * tolerance)
        # Off the surface these are integers, 1 inside and 0 outside; the quarter allows for rounding.
        if ((winding > 1.25) | (winding < -0.25)).any():
            return np.asarray(point_mm)
    return None


def _windings_around(triangles_mm: Float64, point_mm: Float64, aside_mm: float) -> Float64:
    """Return the winding numbers of a surface at points in all directions from one, at a small distance."""
    reach_mm = _NEAR * aside_mm
    low, high = triangles_mm.min(axis=1), triangles_mm.max(axis=1)
    is_near = ((low < point_mm + reach_mm) & (high > point_mm - reach_mm)).all(axis=1)
    near = _winding_numbers(triangles_mm[is_near], point_mm + aside_mm * _DIRECTIONS)
    return near + _winding_numbers(triangles_mm[~is_near], point_mm[None])


def _winding_numbers(triangles_mm: Float64, points_mm: Float64) -> Float64:
    """Return winding numbers of a surface, from solid angles (Van Oosterom and Strackee 1983)."""
    windings = np.empty(len(points_mm))
    for index, point in enumerate(points_mm):
        a, b, c = np.moveaxis(triangles_mm - point, 1, 0)
        la, lb, lc = (np.sqrt((corner * corner).sum(axis=1)) for corner in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=1)
        base = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        windings[index] = np.arctan2(volume, base).sum() / (2 * np.pi)
    return windings


def halves(points: Float64, faces: Int64, level: float) -> tuple[bool, Int64, Int64]:
    """Return whether a level plane divides triangles into two halves, and what remains to be checked.

    To check are the numbers of triangles that do not face away from the plane, shape (M,), and the edges in
    the plane of triangles above it, shape (N, 2).
    """
    odd = np.empty(len(faces), np.int64)
    edges = np.empty((3 * len(faces), 2), np.int64)
    is_divided, odds, count = _halves(points, faces, level, odd, edges)
    return is_divided, odd[:odds], edges[:count]


@compiled("(float64[:,::1], int64[:,::1], float64, int64[::1], int64[:,::1])")
def _halves(points: Float64, faces: Int64, level: float, odd: Int64, edges: Int64) -> tuple[bool, int, int]:
    reaches, odds, count = False, 0, 0
    for face in range(len(faces)):
        a = corner_of(points, faces, face, 0)
        b = corner_of(points, faces, face, 1)
        c = corner_of(points, faces, face, 2)
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
                at = faces[face, k]
                beyond = faces[face, (k + 1) % 3]
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


@compiled("(float64[:,::1], int64[:,::1], float64[:,::1], int64[:,::1], float64, float64[:,::1])")
def _passages(
    points: Float64, triangles: Int64, normal: Float64, pairs: Int64, tolerance: float, doubtful: Float64
) -> tuple[bool, int]:
    """Write the places; a certain one is the last."""
    count = 0
    for pair in range(pairs.shape[1]):
        first, second = pairs[0, pair], pairs[1, pair]
        # The normals are opposite within 8 degrees, as at folds and at thin edges, which differ by their gap.
        opposed = dot(row_of(normal, first), row_of(normal, second)) < -0.99
        for k in range(6):
            target, passing = (first, second) if k < 3 else (second, first)
            into = row_of(normal, target)
            certainty, crossing = _passage(points, triangles, into, target, passing, k % 3, tolerance)
            if opposed and _is_fold(points, triangles, target, passing, k % 3, tolerance):
                certainty = 2
            if certainty:
                doubtful[count, 0], doubtful[count, 1], doubtful[count, 2] = crossing
                count += 1
            if certainty == 2:
                return True, count
    return False, count


@part
def _passage(
    points: Float64, triangles: Int64, into: Vector, target: int, passing: int, k: int, tolerance: float
) -> tuple[int, Vector]:
    """Return whether an edge passes through a target: 0 for no, 1 for perhaps, 2 for yes; and where."""
    start = triangles[passing, k]
    end = triangles[passing, (k + 1) % 3]
    p = row_of(points, start)
    q = row_of(points, end)
    base = corner_of(points, triangles, target, 0)
    at_p, at_q = dot(sub(p, base), into), dot(sub(q, base), into)
    if min(at_p, at_q) > tolerance or max(at_p, at_q) < -tolerance:
        return 0, p
    share = 0.5 if at_p == at_q else min(max(at_p / (at_p - at_q), 0.0), 1.0)
    crossing = p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2])
    inside = np.inf
    for side in range(3):
        corner = triangles[target, side]
        if corner in (start, end):
            return 0, p
        here = row_of(points, corner)
        along = sub(corner_of(points, triangles, target, (side + 1) % 3), here)
        inward = cross(into, along)
        inside = min(inside, dot(sub(crossing, here), inward) / math.sqrt(dot(along, along)))
    through = min(at_p, at_q) < -tolerance and max(at_p, at_q) > tolerance
    return (0 if inside < -tolerance else 2 if through and inside > tolerance else 1), crossing


@part
def _is_fold(points: Float64, triangles: Int64, face: int, neighbour: int, k: int, tolerance: float) -> bool:
    """Return whether triangles that share edge k of the first are folded onto each other."""
    start = triangles[face, k]
    end = triangles[face, (k + 1) % 3]
    p = row_of(points, start)
    shared = 0
    apex = corner_of(points, triangles, face, (k + 2) % 3)
    far = p
    for side in range(3):
        corner = triangles[neighbour, side]
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
