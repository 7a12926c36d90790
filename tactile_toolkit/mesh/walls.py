"""Measures of a print, in compiled loops: thinnest wall, widths of a section, overhanging area.

The thinnest wall is the diameter of the smallest ball between parts of the surface that face each other. Two
parts face each other where the segment between them enters the solid nearly at right angles to the surface at
both ends, or at an edge that points into the solid, such as that of a notch. The two sides of an outer edge
or tip sharper than twice the angle of :data:`FACING`, 36 degrees, face each other where they meet: the wall
is 0 there. Those of blunter edges do not. Triangles do not face each other if one lies behind the plane of
the other, or in it.

The result does not depend on how faces are divided into triangles. Round surfaces are measured at their flat
faces: a rod of 32 sides is reported 3 % thinner than its circumscribed cylinder, one of 64 sides 2 %.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.mesh.box_tree import (
    DEEPEST,
    Vector,
    corner_of,
    cross,
    curve_order,
    dot,
    normalized,
    row_of,
    sub,
    tree_of,
)
from tactile_toolkit.value_types import Float32, Float64, Int64

Solid: TypeAlias = tuple[Float64, Int64, Float64, Float64, Int64]
"""The result of :func:`_surface_of`."""

FACING = 0.95
"""Smallest cosine between the segment across a wall and the inward normal: 18 degrees."""

# A direction along the surface counts as leading no nearer up to this cosine: 3 degrees.
_ALONG = 0.05

# Points closer to a plane lie in it: less than the resolution of the data, more than rounding.
_LEVEL = 1e-9

# Each segment across a wall starts this close to a direction in the boxes: by FACING, or at a notch between
# two directions, where it may turn by _ALONG beyond either. That is 18.4 degrees.
_STRAIGHT = math.sqrt(FACING**2 - _ALONG**2)

# Two inward normals that face each other are opposite up to 36 degrees.
_FACED = 2 * FACING**2 - 1

# A corner whose normal is within 20 degrees of that of a face belongs to a round surface.
_ROUND_CORNER = math.cos(math.radians(20.0))

# Sets of directions without a pair this close to opposite do not face each other; 1e-9 allows for rounding.
_OPPOSED = 1 - 2 * _STRAIGHT**2 + 1e-9

# Along an axis, a segment exceeds the directions by at most this: the distance of the ends of two of them.
_ASLANT = math.sqrt(2 - 2 * _STRAIGHT) + 1e-9

_BLOCK = 16
# A point, at distance 0 from itself, must not limit its own disc.
_MIN_SQUARED_MM2 = np.float32(1e-3)
# More than the rounding of single precision.
_NEARLY = np.float32(1 - 1e-5)
_FLATTEST = np.float32(1e-9)


def thinnest_wall_mm(vertices_mm: Float64, faces: Int64, reach_mm: float) -> float:
    """Return the thinnest wall of a closed manifold mesh, up to a reach; infinity if there is none.

    The value is rounded to a nanometre, so it does not depend on the order of the triangles.
    """
    vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    # One corner of each triangle is close enough to its centre.
    numbered = curve_order(vertices_mm.take(faces[:, 0], axis=0))
    solid = _surface_of(vertices_mm, faces)
    low = np.full((len(faces), 9), np.inf)
    high = np.full((len(faces), 9), -np.inf)
    _boxes(*solid, reach_mm, low, high)
    boxes, held = tree_of(numbered, low, high)
    best = _thinnest_wall(*solid, numbered, boxes, held, np.ones((DEEPEST, 2), np.int64), reach_mm)
    return round(best, 6) if best < reach_mm else math.inf


def leaning_out(points: Float64, faces: Int64, bed: float, sine: float) -> Float64:
    """Return twice the areas of triangles above a bed that face down by an angle of more than this sine."""
    doubled = np.empty(len(faces))
    return doubled[: _leaning_out(points, faces, bed, sine, doubled)]


def largest_discs(points: Float32, inward: Float32) -> tuple[Float32, Float32]:
    """Return the radius of the largest disc at each point of outlines, and the distance of its contact.

    A disc that touches here and passes through a point at distance d and depth h has the curvature
    2 h / d^2. A block of points farther away than the best diameter so far cannot tighten it.
    """
    count = len(points)
    radii, contacts = np.empty(count, np.float32), np.empty(count, np.float32)
    # The middles of the blocks, and how far each reaches.
    blocks = np.zeros(((count + _BLOCK - 1) // _BLOCK, 3), np.float32)
    _find_largest(points, inward, blocks, radii, contacts)
    return radii, contacts


def _surface_of(points: Float64, faces: Int64) -> Solid:
    """Return points, faces, inward normals of triangles and at corners, and twins of half-edges.

    Half-edge 3 f + k leads from corner k of triangle f to the next corner.
    """
    inward, at_corner = np.zeros((len(faces), 3)), np.zeros((len(points), 3))
    twin = np.arange(3 * len(faces))
    leaving = np.empty((3 * len(faces), 2), np.int64)
    begun = np.zeros(len(points) + 1, np.int64)
    np.cumsum(np.bincount(faces.ravel(), minlength=len(points)), out=begun[1:])
    _surface(points, faces, begun, begun.copy(), leaving, inward, at_corner, twin)
    return points, faces, inward, at_corner, twin


@compiled(
    "(float64[:,::1], int64[:,::1], float64[:,::1], float64[:,::1], int64[::1], int64[::1], "
    "float64[:,:,::1], int64[:,::1], int64[:,::1], float64)"
)
def _thinnest_wall(
    points: Float64,
    faces: Int64,
    inward: Float64,
    at_corner: Float64,
    twin: Int64,
    numbered: Int64,
    boxes: Float64,
    held: Int64,
    stack: Int64,
    reach: float,
) -> float:
    """Return the least distance below the reach at which two triangles face each other, or the reach.

    Branch and bound: pairs of boxes are pruned that are farther apart than the best distance so far, that do
    not lie in front of each other within the reach, or whose directions are not opposite.
    """
    count = len(numbered)
    best = reach
    top = 1
    while top:
        top -= 1
        node, partner = stack[top, 0], stack[top, 1]
        if node >= count and partner >= count:
            faced, facing = numbered[node - count] & 0xFFFFFFFF, numbered[partner - count] & 0xFFFFFFFF
            best = _between(points, faces, inward, at_corner, twin, faced, facing, best)
            continue
        for first in range(2 if node < count else 1):
            for second in range(first if node == partner else 0, 2 if partner < count else 1):
                left, right = held[node, first], held[partner, second]
                if _may_face(boxes, left, right, best):
                    stack[top, 0], stack[top, 1] = left, right
                    top += 1
    return best


@part
def _may_face(boxes: Float64, node: int, partner: int, best: float) -> bool:
    """Return whether triangles of two nodes may face each other nearer than the best distance so far."""
    squared, cosine = 0.0, 0.0
    for axis in range(3):
        low, high = boxes[node, 0, axis], boxes[node, 1, axis]
        low_other, high_other = boxes[partner, 0, axis], boxes[partner, 1, axis]
        # Each must overlap the sweep of the other.
        if boxes[node, 0, 6 + axis] > high_other or boxes[node, 1, 6 + axis] < low_other:
            return False
        if boxes[partner, 0, 6 + axis] > high or boxes[partner, 1, 6 + axis] < low:
            return False
        apart = max(max(low - high_other, low_other - high), 0.0)
        squared += apart * apart
        # The smallest cosine between directions of the two.
        least, most = boxes[node, 0, 3 + axis], boxes[node, 1, 3 + axis]
        least_other, most_other = boxes[partner, 0, 3 + axis], boxes[partner, 1, 3 + axis]
        cosine += min(
            min(least * least_other, least * most_other), min(most * least_other, most * most_other)
        )
    return squared < best * best and cosine < _OPPOSED


@compiled(
    "(float64[:,::1], int64[:,::1], int64[::1], int64[::1], int64[:,::1], float64[:,::1], "
    "float64[:,::1], int64[::1])"
)
def _surface(
    points: Float64,
    faces: Int64,
    begun: Int64,
    filled: Int64,
    leaving: Int64,
    inward: Float64,
    at_corner: Float64,
    twin: Int64,
) -> None:
    """Write the normals and twins of :func:`_surface_of`.

    The half-edges that leave a corner are at ``begun`` to ``filled`` of ``leaving``, with their ends.
    """
    for face in range(len(faces)):
        a = corner_of(points, faces, face, 0)
        doubled = cross(sub(corner_of(points, faces, face, 2), a), sub(corner_of(points, faces, face, 1), a))
        inward[face, 0], inward[face, 1], inward[face, 2] = normalized(doubled)
        for k in range(3):
            corner = faces[face, k]
            at_corner[corner, 0] += doubled[0]
            at_corner[corner, 1] += doubled[1]
            at_corner[corner, 2] += doubled[2]
            end = faces[face, (k + 1) % 3]
            half = 3 * face + k
            for entry in range(begun[end], filled[end]):
                if leaving[entry, 1] == corner:
                    twin[half], twin[leaving[entry, 0]] = leaving[entry, 0], half
            leaving[filled[corner], 0], leaving[filled[corner], 1] = half, end
            filled[corner] += 1
    for corner in range(len(points)):
        unit = normalized(row_of(at_corner, corner))
        at_corner[corner, 0], at_corner[corner, 1], at_corner[corner, 2] = unit


@compiled(
    "(float64[:,::1], int64[:,::1], float64[:,::1], float64[:,::1], int64[::1], float64, "
    "float64[:,::1], float64[:,::1])"
)
def _boxes(
    points: Float64,
    faces: Int64,
    inward: Float64,
    at_corner: Float64,
    twin: Int64,
    reach: float,
    low: Float64,
    high: Float64,
) -> None:
    """Write boxes, shape (F, 9), around triangles, around directions in which they face others, and sweeps.

    The sweep of a triangle is the space in which it may face something within the reach.
    """
    for face in range(len(faces)):
        own = row_of(inward, face)
        for k in range(3):
            corner = faces[face, k]
            neighbour = twin[3 * face + k] // 3
            # The intersection of the tangents at its ends completes the hull of the arc between the two,
            # except the ends of arcs beyond 90 degrees, which no segment at a notch has: it enters both
            # sides.
            turn = max(1 + dot(own, row_of(inward, neighbour)), 1e-12)
            outside = max(turn, math.sqrt(turn))
            for axis in range(3):
                coordinate, most = points[corner, axis], at_corner[corner, axis]
                mine, beyond = inward[face, axis], inward[neighbour, axis]
                between = (mine + beyond) / outside
                low[face, axis], high[face, axis] = (
                    min(low[face, axis], coordinate),
                    max(high[face, axis], coordinate),
                )
                least, greatest = min(mine, beyond), max(mine, beyond)
                least, greatest = min(least, min(between, most)), max(greatest, max(between, most))
                low[face, 3 + axis] = min(low[face, 3 + axis], least)
                high[face, 3 + axis] = max(high[face, 3 + axis], greatest)
        for axis in range(3):
            low[face, 6 + axis] = low[face, axis] + reach * min(low[face, 3 + axis] - _ASLANT, 0.0)
            high[face, 6 + axis] = high[face, axis] + reach * max(high[face, 3 + axis] + _ASLANT, 0.0)


@part
def _between(
    points: Float64,
    faces: Int64,
    inward: Float64,
    at_corner: Float64,
    twin: Int64,
    face: int,
    partner: int,
    best: float,
) -> float:
    """Return the least distance at which two triangles face each other, at most the best so far."""
    is_joined = False
    for k in range(3):
        for there in range(3):
            is_joined |= faces[face, k] == faces[partner, there]
    if is_joined and dot(row_of(inward, face), row_of(inward, partner)) > -_FACED:
        return best
    # Part of each must lie in front of the other.
    for turn in range(2):
        here, there = (partner, face) if turn else (face, partner)
        into = row_of(inward, here)
        base = corner_of(points, faces, here, 0)
        least = np.inf
        most = -np.inf
        for k in range(3):
            depth = dot(sub(corner_of(points, faces, there, k), base), into)
            least, most = min(least, depth), max(most, depth)
        if most <= _LEVEL or least >= best:
            return best
    if is_joined:
        return 0.0  # the edge or the tip where they meet
    for turn in range(2):
        here, there = (partner, face) if turn else (face, partner)
        best = _from_corners(points, faces, inward, at_corner, here, there, best)
    for k in range(9):
        best = _between_edges(points, faces, inward, twin, 3 * face + k // 3, 3 * partner + k % 3, best)
    return best


@part
def _from_corners(
    points: Float64, faces: Int64, inward: Float64, at_corner: Float64, face: int, partner: int, best: float
) -> float:
    """Return the least perpendicular distance from a corner of a triangle to the interior of the other."""
    own = row_of(inward, face)
    into = row_of(inward, partner)
    base = corner_of(points, faces, partner, 0)
    opposed = -dot(own, into)
    for k in range(3):
        point = corner_of(points, faces, face, k)
        depth = dot(sub(point, base), into)
        round_into = corner_of(at_corner, faces, face, k)
        cosine = opposed
        if dot(round_into, own) >= _ROUND_CORNER:
            cosine = -dot(round_into, into)
        # The ball that touches both is wider than the segment where that is oblique.
        width = 2 * depth / (1 + cosine)
        inside = depth > 0 and cosine >= FACING and width < best
        for start in range(3):
            corner = corner_of(points, faces, partner, start)
            along = sub(corner_of(points, faces, partner, (start + 1) % 3), corner)
            side = dot(cross(along, into), sub(point, corner))
            inside = inside and side >= -1e-9 * dot(along, along)
        if inside:
            best = width
    return best


@part
def _between_edges(
    points: Float64, faces: Int64, inward: Float64, twin: Int64, edge: int, partner: int, best: float
) -> float:
    """Return the least distance between two half-edges that face each other."""
    p, q = corner_of(points, faces, edge // 3, edge % 3), corner_of(points, faces, partner // 3, partner % 3)
    u = sub(corner_of(points, faces, edge // 3, (edge + 1) % 3), p)
    v = sub(corner_of(points, faces, partner // 3, (partner + 1) % 3), q)
    r = sub(p, q)
    uu = dot(u, u)
    vv = dot(v, v)
    uv = dot(u, v)
    ur = dot(u, r)
    vr = dot(v, r)
    slant = uu * vv - uv * uv
    s = min(max((uv * vr - ur * vv) / slant, 0.0), 1.0) if slant > 1e-12 * uu * vv else 0.5
    t = min(max((uv * s + vr) / vv, 0.0), 1.0)
    s = min(max((uv * t - ur) / uu, 0.0), 1.0)
    gap = t * v[0] - s * u[0] - r[0], t * v[1] - s * u[1] - r[1], t * v[2] - s * u[2] - r[2]
    distance = math.sqrt(dot(gap, gap))
    if not 0 < distance < best:
        return best
    there = gap[0] / distance, gap[1] / distance, gap[2] / distance
    back = -there[0], -there[1], -there[2]
    cosine = min(
        _cosine_in(points, faces, inward, twin, edge, there),
        _cosine_in(points, faces, inward, twin, partner, back),
    )
    return min(best, distance / cosine) if cosine >= FACING else best


@part
def _cosine_in(points: Float64, faces: Int64, inward: Float64, twin: Int64, half: int, way: Vector) -> float:
    """Return the cosine between a direction at an edge and the inward normal; 1 at a notch."""
    start = corner_of(points, faces, half // 3, half % 3)
    along = normalized(sub(corner_of(points, faces, half // 3, (half + 1) % 3), start))
    ours = row_of(inward, half // 3)
    theirs = row_of(inward, twin[half] // 3)
    in_ours, in_theirs = dot(ours, way), dot(theirs, way)
    most, least = max(max(-1.0, in_ours), in_theirs), min(min(1.0, in_ours), in_theirs)
    # Away from the edge along the surface.
    nearest = max(max(-1.0, dot(cross(along, ours), way)), -dot(cross(along, theirs), way))
    lengthwise = dot(along, way)
    is_notch = nearest <= _ALONG and least > _LEVEL and lengthwise * lengthwise <= 1 - FACING * FACING
    if not is_notch:
        return most
    # At a flat edge the ball touches faces and must not be oblique to them.
    is_hollow = dot(ours, cross(theirs, along)) < -_LEVEL
    return 1.0 if is_hollow else math.sqrt(1 - lengthwise * lengthwise)


@compiled("(float64[:,::1], int64[:,::1], float64, float64, float64[::1])")
def _leaning_out(points: Float64, faces: Int64, bed: float, sine: float, doubled: Float64) -> int:
    count = 0
    for face in range(len(faces)):
        a = corner_of(points, faces, face, 0)
        b = corner_of(points, faces, face, 1)
        c = corner_of(points, faces, face, 2)
        normal = cross(sub(b, a), sub(c, a))
        size = math.sqrt(dot(normal, normal))
        if normal[2] < 0 and normal[2] < -sine * size and max(max(a[2], b[2]), c[2]) > bed:
            doubled[count] = size
            count += 1
    return count


@compiled("(float32[:,::1], float32[:,::1], float32[:,::1], float32[::1], float32[::1])")
def _find_largest(
    points: Float32, inward: Float32, blocks: Float32, radii: Float32, contacts: Float32
) -> None:
    count = len(points)
    for block in range(len(blocks)):
        first = block * _BLOCK
        last = min((block + 1) * _BLOCK, count)
        middle = (first + last) // 2
        blocks[block, 0], blocks[block, 1] = points[middle, 0], points[middle, 1]
        for point in range(first, last):
            reach = _apart(points, point, blocks, block)
            if reach > blocks[block, 2]:
                blocks[block, 2] = reach
    sharpest = count - count  # not the literal 0, for which numba compiles another version
    for point in range(count):
        # The contact of the disc before is close to that of this one, so nearly all blocks are pruned.
        before = _bend(points, inward, point, sharpest)[0]
        contact = np.float32(0)
        best = (before if before > contact else contact) * _NEARLY - np.float32(1e-30)
        for block in range(len(blocks)):
            if (_apart(points, point, blocks, block) - blocks[block, 2]) * best > 1 / _NEARLY:
                continue
            for contact_point in range(block * _BLOCK, min((block + 1) * _BLOCK, count)):
                bend, squared = _bend(points, inward, point, contact_point)
                if bend > best:
                    best, contact, sharpest = bend, squared, contact_point
        radii[point] = np.float32(0.5) / (best if best > _FLATTEST else _FLATTEST)
        contacts[point] = np.sqrt(contact)


@part
def _apart(points: Float32, point: int, blocks: Float32, block: int) -> np.float32:
    """Return the distance of a point from the middle of a block."""
    x, y = points[point, 0] - blocks[block, 0], points[point, 1] - blocks[block, 1]
    distance: np.float32 = np.sqrt(x * x + y * y)
    return distance


@part
def _bend(points: Float32, inward: Float32, here: int, there: int) -> tuple[np.float32, np.float32]:
    away_x, away_y = points[there, 0] - points[here, 0], points[there, 1] - points[here, 1]
    squared = away_x * away_x + away_y * away_y
    if squared < _MIN_SQUARED_MM2:
        squared = _MIN_SQUARED_MM2
    return (inward[here, 0] * away_x + inward[here, 1] * away_y) / squared, squared
