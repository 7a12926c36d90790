"""Pairs of triangles that lie near each other, and the thinnest wall of a solid.

The thinnest wall is the diameter of the smallest ball between parts of the surface that face each other. Two
parts face each other where the segment between them enters the solid nearly at right angles to the surface at
both ends, or at an edge that points into the solid, such as that of a notch. The two sides of an outer edge
or tip sharper than twice the angle of :data:`FACING`, 36 degrees, face each other where they meet: the wall
is 0 there. Those of blunter edges do not. Triangles do not face each other if one lies behind the plane of
the other, or in it.

The result does not depend on how faces are divided into triangles. Round surfaces are measured at their flat
faces: a rod of 32 sides is reported 3 % thinner than its circumscribed cylinder, one of 64 sides 2 %.

The tree of boxes and the kernels that use it share this file, because numba's disk cache is invalidated by
changes of the file of a kernel only.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.compiled import compiled
from tactile_toolkit.mesh.vectors import Vector, cross, dot, normalized, row_of, sub

Solid: TypeAlias = tuple[Float64, Int64, Float64, Float64, Int64]
"""The result of :func:`_surface`."""

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

# Size of the stack of node pairs: three for each level of the trees, which have at most 63 levels.
_DEEPEST = 256


def near_pairs(corners_mm: Float64, reach_mm: float) -> Int64:
    """Return pairs of triangles, or other objects of shape (F, corners, 3), whose boxes are within reach.

    The reach counts along each axis. The result has shape (2, pairs), each pair once.
    """
    if not len(corners_mm):
        return np.zeros((2, 0), np.int64)
    corners_mm = np.ascontiguousarray(corners_mm.swapaxes(0, 1))  # numpy is slow along short rows
    low, high = corners_mm.min(axis=0) - reach_mm / 2, corners_mm.max(axis=0) + reach_mm / 2
    return np.ascontiguousarray(_meeting(_along_a_curve((low + high) / 2), low, high).T & 0xFFFFFFFF)


def thinnest_wall_mm(vertices_mm: Float64, faces: Int64, reach_mm: float) -> float:
    """Return the thinnest wall of a closed manifold mesh, up to a reach; infinity if there is none.

    The value is rounded to a nanometre, so it does not depend on the order of the triangles.
    """
    vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    # One corner of each triangle is close enough to its centre.
    numbered = _along_a_curve(vertices_mm.take(faces[:, 0], axis=0))
    return round(float(_thinnest_wall(vertices_mm, faces, numbered, reach_mm)), 6)


def _along_a_curve(points: Float64) -> Int64:
    """Return :func:`_numbered`, sorted: points along a curve on which neighbours are near."""
    # Axis by axis: along rows of three numpy takes thirteen times as long.
    low = np.array([axis.min() for axis in points.T])
    span = max(*(axis.max() - least for axis, least in zip(points.T, low, strict=True)), 1e-300)
    # Sorted together with their numbers: equal places stay in order, and numpy sorts integers fast.
    return np.sort(_numbered(points, low, 1023.0 / span))


@compiled
def _numbered(points: Float64, low: Float64, scale: float) -> Int64:
    """Return the Morton code of each point, ten bits for each axis, with its number in the lower bits."""
    numbered = np.arange(len(points))
    for point in range(len(points)):
        for axis in range(3):
            cell = int((points[point, axis] - low[axis]) * scale)
            # Spread the bits to every third place.
            for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
                cell = (cell | (cell << shift)) & mask
            numbered[point] |= cell << (32 + axis)
    return numbered


@compiled
def _tree(numbered: Int64, low: Float64, high: Float64) -> tuple[Float64, Int64]:
    """Return the boxes of a binary tree, shape (2 N, 2, columns), low and high ends, and the two children.

    The root is node 1. The last N nodes are the boxes themselves, in order; they are their own children. Each
    node is a cell of Morton's curve, because boxes across the jumps of the curve would be wide.
    """
    count, columns = len(numbered), low.shape[1]
    boxes, held = np.empty((2 * count, 2, columns)), np.empty((2 * count, 2), np.int64)
    # Nodes whose cells may hold more, and the bits in which the next object differs from each.
    waiting, apart, top, last = np.empty(64, np.int64), np.empty(64, np.int64), 0, count
    for leaf in range(count):
        thing, node = numbered[leaf] & 0xFFFFFFFF, count + leaf
        held[node, 0] = held[node, 1] = node
        for axis in range(columns):
            boxes[node, 0, axis], boxes[node, 1, axis] = low[thing, axis], high[thing, axis]
        bits = numbered[leaf] ^ numbered[leaf + 1] if leaf + 1 < count else 1 << 62
        while top and apart[top - 1] < bits:
            top -= 1
            last -= 1
            held[last, 0], held[last, 1] = waiting[top], node
            for axis in range(columns):
                boxes[last, 0, axis] = min(boxes[waiting[top], 0, axis], boxes[node, 0, axis])
                boxes[last, 1, axis] = max(boxes[waiting[top], 1, axis], boxes[node, 1, axis])
            node = last
        waiting[top], apart[top] = node, bits
        top += 1
    return boxes, held


@compiled
def _meeting(numbered: Int64, low: Float64, high: Float64) -> Int64:
    """Return the pairs of boxes that overlap, each pair once; boxes as in ``numbered``."""
    (boxes, held), count = _tree(numbered, low, high), len(numbered)
    found, pairs, stack, top = np.empty((1024, 2), np.int64), 0, np.ones((_DEEPEST, 2), np.int64), 1
    while top:
        top -= 1
        one, other = stack[top, 0], stack[top, 1]
        if min(one, other) >= count:
            if one != other:
                if pairs == len(found):
                    # Copied one by one: numba takes a second to compile the joining of arrays.
                    kept, found = found, np.empty((2 * pairs, 2), np.int64)
                    for pair in range(pairs):
                        found[pair, 0], found[pair, 1] = kept[pair, 0], kept[pair, 1]
                found[pairs, 0], found[pairs, 1] = numbered[one - count], numbered[other - count]
                pairs += 1
            continue
        for first in range(2 if one < count else 1):
            for second in range(first if one == other else 0, 2 if other < count else 1):
                left, right, meet = held[one, first], held[other, second], True
                for axis in range(low.shape[1]):
                    meet &= boxes[left, 0, axis] <= boxes[right, 1, axis]
                    meet &= boxes[right, 0, axis] <= boxes[left, 1, axis]
                if meet:
                    stack[top, 0], stack[top, 1] = left, right
                    top += 1
    return found[:pairs]


@compiled
def connected(ends: Int64, others: Int64, count: int) -> Int64:
    """Return the number of the connected component of each object, shape (count,)."""
    least = np.arange(count)
    for pair in range(len(ends)):
        one, other = ends[pair], others[pair]
        while least[one] < one:
            least[one] = least[least[one]]
            one = least[one]
        while least[other] < other:
            least[other] = least[least[other]]
            other = least[other]
        least[max(one, other)] = min(one, other)
    for thing in range(count):
        least[thing] = least[least[thing]]
    return least


@compiled
def _thinnest_wall(points: Float64, faces: Int64, numbered: Int64, reach: float) -> float:
    """Return the least distance below the reach at which two triangles face each other, or infinity.

    Branch and bound: pairs of boxes are pruned that are farther apart than the best distance so far, that do
    not lie in front of each other within the reach, or whose directions are not opposite.
    """
    solid = _surface(points, faces)
    low, high = _boxes(solid, reach)
    boxes, held = _tree(numbered, low, high)
    count, best = len(numbered), reach
    stack, top = np.ones((_DEEPEST, 2), np.int64), 1
    while top:
        top -= 1
        one, other = stack[top, 0], stack[top, 1]
        if min(one, other) >= count:
            faced, facing = numbered[one - count] & 0xFFFFFFFF, numbered[other - count] & 0xFFFFFFFF
            best = _between(solid, faced, facing, best)
            continue
        for first in range(2 if one < count else 1):
            for second in range(first if one == other else 0, 2 if other < count else 1):
                left, right = held[one, first], held[other, second]
                if _may_face(boxes, left, right, best):
                    stack[top, 0], stack[top, 1] = left, right
                    top += 1
    return best if best < reach else np.inf


@compiled
def _may_face(boxes: Float64, one: int, other: int, best: float) -> bool:
    """Return whether triangles of two nodes may face each other nearer than the best distance so far."""
    # Each must overlap the sweep of the other.
    for axis in range(3):
        if (
            boxes[one, 0, 6 + axis] > boxes[other, 1, axis]
            or boxes[one, 1, 6 + axis] < boxes[other, 0, axis]
            or boxes[other, 0, 6 + axis] > boxes[one, 1, axis]
            or boxes[other, 1, 6 + axis] < boxes[one, 0, axis]
        ):
            return False
    squared, cosine = 0.0, 0.0
    for axis in range(3):
        apart = max(
            boxes[one, 0, axis] - boxes[other, 1, axis], boxes[other, 0, axis] - boxes[one, 1, axis], 0.0
        )
        squared += apart * apart
        # The smallest cosine between directions of the two.
        least, most = boxes[one, 0, 3 + axis], boxes[one, 1, 3 + axis]
        least_other, most_other = boxes[other, 0, 3 + axis], boxes[other, 1, 3 + axis]
        cosine += min(least * least_other, least * most_other, most * least_other, most * most_other)
    return squared < best * best and cosine < _OPPOSED


@compiled
def _surface(points: Float64, faces: Int64) -> Solid:
    """Return points, faces, inward normals of triangles and at corners, and twins of half-edges.

    Half-edge 3 f + k leads from corner k of triangle f to the next corner.
    """
    inward, at_corner = np.zeros((len(faces), 3)), np.zeros((len(points), 3))
    begun = np.zeros(len(points) + 1, np.int64)
    following = (1, 2, 0)
    for face in range(len(faces)):
        a, b, c = (
            row_of(points, faces[face, 0]),
            row_of(points, faces[face, 1]),
            row_of(points, faces[face, 2]),
        )
        doubled = cross(sub(c, a), sub(b, a))
        unit = normalized(doubled)
        for k in range(3):
            begun[faces[face, k] + 1] += 1
            for axis in range(3):
                inward[face, axis] = unit[axis]
                at_corner[faces[face, k], axis] += doubled[axis]
    for corner in range(len(points)):
        begun[corner + 1] += begun[corner]
        unit = normalized(row_of(at_corner, corner))
        for axis in range(3):
            at_corner[corner, axis] = unit[axis]
    # The half-edges so far that leave each corner, and their ends.
    leaving, filled = np.empty((3 * len(faces), 2), np.int64), begun.copy()
    twin = np.arange(3 * len(faces))
    for face in range(len(faces)):
        for k in range(3):
            half, start, end = 3 * face + k, faces[face, k], faces[face, following[k]]
            for place in range(begun[end], filled[end]):
                if leaving[place, 1] == start:
                    twin[half], twin[leaving[place, 0]] = leaving[place, 0], half
            leaving[filled[start], 0], leaving[filled[start], 1] = half, end
            filled[start] += 1
    return points, faces, inward, at_corner, twin


@compiled
def _boxes(solid: Solid, reach: float) -> tuple[Float64, Float64]:
    """Return boxes, shape (F, 9), around triangles, around directions in which they face others, and sweeps.

    The sweep of a triangle is the space in which it may face something within the reach.
    """
    points, faces, inward, at_corner, twin = solid
    low, high = np.full((len(faces), 9), np.inf), np.full((len(faces), 9), -np.inf)
    for face in range(len(faces)):
        own = row_of(inward, face)
        for k in range(3):
            corner, beyond = faces[face, k], row_of(inward, twin[3 * face + k] // 3)
            # The intersection of the tangents at its ends completes the hull of the arc between the two,
            # except the ends of arcs beyond 90 degrees, which no segment at a notch has: it enters both
            # sides.
            turn = max(1 + dot(own, beyond), 1e-12)
            outside = max(turn, math.sqrt(turn))
            for axis in range(3):
                place, most = points[corner, axis], at_corner[corner, axis]
                between = (own[axis] + beyond[axis]) / outside
                low[face, axis], high[face, axis] = min(low[face, axis], place), max(high[face, axis], place)
                low[face, 3 + axis] = min(low[face, 3 + axis], own[axis], beyond[axis], between, most)
                high[face, 3 + axis] = max(high[face, 3 + axis], own[axis], beyond[axis], between, most)
        for axis in range(3):
            low[face, 6 + axis] = low[face, axis] + reach * min(low[face, 3 + axis] - _ASLANT, 0.0)
            high[face, 6 + axis] = high[face, axis] + reach * max(high[face, 3 + axis] + _ASLANT, 0.0)
    return low, high


@compiled
def _between(solid: Solid, one: int, other: int, best: float) -> float:
    """Return the least distance at which two triangles face each other, at most the best so far."""
    points, faces, inward, _, _ = solid
    is_joined = False
    for k in range(3):
        corner = faces[one, k]
        is_joined |= corner == faces[other, 0] or corner == faces[other, 1] or corner == faces[other, 2]
    if is_joined and dot(row_of(inward, one), row_of(inward, other)) > -_FACED:
        return best
    # Part of each must lie in front of the other.
    for here, there in ((one, other), (other, one)):
        into, base = row_of(inward, here), row_of(points, faces[here, 0])
        least, most = np.inf, -np.inf
        for k in range(3):
            depth = dot(sub(row_of(points, faces[there, k]), base), into)
            least, most = min(least, depth), max(most, depth)
        if most <= _LEVEL or least >= best:
            return best
    if is_joined:
        return 0.0  # the edge or the tip where they meet
    for here, there in ((one, other), (other, one)):
        best = _from_corners(solid, here, there, best)
    for half in range(3 * one, 3 * one + 3):
        for opposite in range(3 * other, 3 * other + 3):
            best = _between_edges(solid, half, opposite, best)
    return best


@compiled
def _from_corners(solid: Solid, one: int, other: int, best: float) -> float:
    """Return the least perpendicular distance from a corner of a triangle to the inside of the other."""
    points, faces, inward, at_corner, _ = solid
    into, base = row_of(inward, other), row_of(points, faces[other, 0])
    opposed = -dot(row_of(inward, one), into)
    for k in range(3):
        point = row_of(points, faces[one, k])
        depth = dot(sub(point, base), into)
        round_into = row_of(at_corner, faces[one, k])
        cosine = opposed
        if dot(round_into, row_of(inward, one)) >= _ROUND_CORNER:
            cosine = -dot(round_into, into)
        # The ball that touches both is wider than the segment where that is oblique.
        width = 2 * depth / (1 + cosine)
        inside = depth > 0 and cosine >= FACING and width < best
        for start in range(3):
            corner = row_of(points, faces[other, start])
            along = sub(row_of(points, faces[other, (start + 1) % 3]), corner)
            side = dot(cross(along, into), sub(point, corner))
            inside = inside and side >= -1e-9 * dot(along, along)
        if inside:
            best = width
    return best


@compiled
def _between_edges(solid: Solid, one: int, other: int, best: float) -> float:
    """Return the least distance between two half-edges that face each other."""
    points, faces, _, _, _ = solid
    p, q = row_of(points, faces[one // 3, one % 3]), row_of(points, faces[other // 3, other % 3])
    u = sub(row_of(points, faces[one // 3, (one + 1) % 3]), p)
    v = sub(row_of(points, faces[other // 3, (other + 1) % 3]), q)
    r = sub(p, q)
    uu, vv, uv, ur, vr = dot(u, u), dot(v, v), dot(u, v), dot(u, r), dot(v, r)
    slant = uu * vv - uv * uv
    s = min(max((uv * vr - ur * vv) / slant, 0.0), 1.0) if slant > 1e-12 * uu * vv else 0.5
    t = min(max((uv * s + vr) / vv, 0.0), 1.0)
    s = min(max((uv * t - ur) / uu, 0.0), 1.0)
    way = t * v[0] - s * u[0] - r[0], t * v[1] - s * u[1] - r[1], t * v[2] - s * u[2] - r[2]
    distance = math.sqrt(dot(way, way))
    if not 0 < distance < best:
        return best
    there = way[0] / distance, way[1] / distance, way[2] / distance
    back = -there[0], -there[1], -there[2]
    cosine = min(_cosine_in(solid, one, there), _cosine_in(solid, other, back))
    return min(best, distance / cosine) if cosine >= FACING else best


@compiled
def _cosine_in(solid: Solid, half: int, way: Vector) -> float:
    """Return the cosine between a direction at an edge and the inward normal; 1 at a notch."""
    points, faces, inward, _, twin = solid
    start, end = row_of(points, faces[half // 3, half % 3]), row_of(points, faces[half // 3, (half + 1) % 3])
    along = normalized(sub(end, start))
    most, least, nearest = -1.0, 1.0, -1.0
    ours, theirs = row_of(inward, half // 3), row_of(inward, twin[half] // 3)
    for side, turned in ((half, 1.0), (twin[half], -1.0)):
        into = row_of(inward, side // 3)
        cosine = dot(into, way)
        most, least = max(most, cosine), min(least, cosine)
        # Away from the edge along the surface.
        nearest = max(nearest, turned * dot(cross(along, into), way))
    lengthwise = dot(along, way)
    is_notch = nearest <= _ALONG and least > _LEVEL and lengthwise * lengthwise <= 1 - FACING * FACING
    if not is_notch:
        return most
    # At a flat edge the ball touches faces and must not be oblique to them.
    is_hollow = dot(ours, cross(theirs, along)) < -_LEVEL
    return 1.0 if is_hollow else math.sqrt(1 - lengthwise * lengthwise)
