"""Triangles that lie near each other, and the thinnest wall between those that face each other.

The thinnest wall is the smallest ball between stretches of surface that face each other. They face each
other where the way from one to the other starts into the solid nearly at right angles to the surface, on both
sides; or at an edge that points into the solid, as that of a notch, where every way along the surface leads
further apart. The two sides of an outer edge or tip sharper than twice the angle of :data:`FACING`, 36
degrees, face each other where they meet: the wall is 0 there. Those of blunter edges do not. Nor do triangles
of which one lies wholly behind the plane of the other, or in it.

A solid has the same thinnest wall however its faces are divided into triangles. Of a round surface the flat
faces are measured: a rod of 32 sides comes out 3 % thinner than the cylinder around it, one of 64 sides 2 %.

The tree of boxes stays in this file: numba's cache on disk looks at the file of a kernel only.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.compiled import compiled
from tactile_toolkit.mesh.vectors import Vector, cross, dot, normalized, row, sub

Solid: TypeAlias = tuple[Float64, Int64, Float64, Float64, Int64]
"""Points, faces, and what :func:`_surface` finds of them."""

FACING = 0.95
"""Least cosine between the way across a wall and the direction into the solid: 18 degrees."""

# Cosine up to which a way along the surface counts as leading no nearer: 3 degrees.
_ALONG = 0.05

# What lies no further before a triangle is in its plane: less than the data resolve, more than rounding.
_LEVEL = 1e-9

# Every way across a wall starts this near to a direction in the boxes: by FACING, or at a notch between two
# directions, where it may besides turn by _ALONG past either. That is 18.4 degrees.
_STRAIGHT = math.sqrt(FACING**2 - _ALONG**2)

# Two directions into the solid that face each other are at least so far opposite: to 36 degrees.
_FACED = 2 * FACING**2 - 1

# A corner whose direction is nearer than this to that of a face, 20 degrees, is one of a round surface.
_ROUND_CORNER = math.cos(math.radians(20.0))

# So directions of which none are this near to opposite do not face each other; the last is for rounding.
_OPPOSED = 1 - 2 * _STRAIGHT**2 + 1e-9

# And along an axis the way leads at most so much further than the directions do: the ends of two of them lie
# so far apart.
_ASLANT = math.sqrt(2 - 2 * _STRAIGHT) + 1e-9

# Pairs of nodes that wait: three more for each level of the trees, of which none has more than 63.
_DEEPEST = 256


def near_pairs(corners_mm: Float64, reach_mm: float) -> Int64:
    """Return pairs of triangles, or other things of shape (F, corners, 3), whose boxes are within reach.

    Along each axis; shape (2, pairs), each pair once.
    """
    if not len(corners_mm):
        return np.zeros((2, 0), np.int64)
    corners_mm = np.ascontiguousarray(corners_mm.swapaxes(0, 1))  # numpy is slow along short rows
    low, high = corners_mm.min(axis=0) - reach_mm / 2, corners_mm.max(axis=0) + reach_mm / 2
    return np.ascontiguousarray(_meeting(_along_a_curve((low + high) / 2), low, high).T & 0xFFFFFFFF)


def thinnest_wall_mm(vertices_mm: Float64, faces: Int64, reach_mm: float) -> float:
    """Return the thinnest wall of a closed manifold mesh, up to a reach; infinity where there is none.

    Rounded to a nanometre, it depends on the triangles only, not on their order.
    """
    vertices_mm = np.ascontiguousarray(vertices_mm, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    # A corner of each triangle: near enough to its middle, and less to gather.
    numbered = _along_a_curve(vertices_mm.take(faces[:, 0], axis=0))
    return round(float(_thinnest_wall(vertices_mm, faces, numbered, reach_mm)), 6)


def _along_a_curve(points: Float64) -> Int64:
    """Return :func:`_numbered` sorted: points in an order in which neighbours are near, that of the curve."""
    # Axis by axis: along rows of three numpy takes thirteen times as long.
    low = np.array([axis.min() for axis in points.T])
    span = max(*(axis.max() - least for axis, least in zip(points.T, low, strict=True)), 1e-300)
    # Sorted together with their numbers: equal ones stay in order, and numpy has vector code for it.
    return np.sort(_numbered(points, low, 1023.0 / span))


@compiled
def _numbered(points: Float64, low: Float64, scale: float) -> Int64:
    """Return the place of each point on Morton's curve, ten bits for each axis, and below it its number."""
    numbered = np.arange(len(points))
    for point in range(len(points)):
        for axis in range(3):
            cell = int((points[point, axis] - low[axis]) * scale)
            # Each bit moves to every third place.
            for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
                cell = (cell | (cell << shift)) & mask
            numbered[point] |= cell << (32 + axis)
    return numbered


@compiled
def _tree(numbered: Int64, low: Float64, high: Float64) -> tuple[Float64, Int64]:
    """Return the boxes of a binary tree, shape (2 N, 2, columns), low and high ends; and which two each has.

    The root is node 1. The last N are the boxes themselves, in order, and hold themselves. Each node is a
    cell of Morton's curve: the curve jumps between cells, and boxes over jumps are wide.
    """
    count, columns = len(numbered), low.shape[1]
    boxes, held = np.empty((2 * count, 2, columns)), np.empty((2 * count, 2), np.int64)
    # Nodes whose cells may hold more, and the bits in which the next thing lies apart from each.
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
    """Return the pairs of boxes that meet, each pair once; each box as ``numbered`` has it."""
    (boxes, held), count = _tree(numbered, low, high), len(numbered)
    found, pairs, stack, top = np.empty((1024, 2), np.int64), 0, np.ones((_DEEPEST, 2), np.int64), 1
    while top:
        top -= 1
        one, other = stack[top, 0], stack[top, 1]
        if min(one, other) >= count:
            if one != other:
                if pairs == len(found):
                    # One by one: numba takes a second to compile how numpy joins arrays.
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
    """Return a number for each thing, shape (count,), that is the same for those that pairs connect."""
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

    Branch and bound: boxes that are further apart than the best so far, do not lie before each other within
    the reach, or whose directions do not oppose each other, are left out with all that they hold.
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
    """Return whether something of two nodes may face each other nearer than the best so far."""
    # Each lies in what the other sweeps over.
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
        # The least cosine between directions of the two.
        least, most = boxes[one, 0, 3 + axis], boxes[one, 1, 3 + axis]
        least_other, most_other = boxes[other, 0, 3 + axis], boxes[other, 1, 3 + axis]
        cosine += min(least * least_other, least * most_other, most * least_other, most * most_other)
    return squared < best * best and cosine < _OPPOSED


@compiled
def _surface(points: Float64, faces: Int64) -> Solid:
    """Return points, faces, directions into the solid of triangles and at corners, and twins of half-edges.

    Half-edge 3 f + k leads from corner k of triangle f to the next one.
    """
    inward, at_corner = np.zeros((len(faces), 3)), np.zeros((len(points), 3))
    begun = np.zeros(len(points) + 1, np.int64)
    following = (1, 2, 0)
    for face in range(len(faces)):
        a, b, c = row(points, faces[face, 0]), row(points, faces[face, 1]), row(points, faces[face, 2])
        doubled = cross(sub(c, a), sub(b, a))
        unit = normalized(doubled)
        for k in range(3):
            begun[faces[face, k] + 1] += 1
            for axis in range(3):
                inward[face, axis] = unit[axis]
                at_corner[faces[face, k], axis] += doubled[axis]
    for corner in range(len(points)):
        begun[corner + 1] += begun[corner]
        unit = normalized(row(at_corner, corner))
        for axis in range(3):
            at_corner[corner, axis] = unit[axis]
    # The half-edges so far that leave each corner, and where they lead.
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
    """Return boxes, shape (F, 9), around triangles, the directions in which each may face others, its sweep.

    That is where it may face something within the reach.
    """
    points, faces, inward, at_corner, twin = solid
    low, high = np.full((len(faces), 9), np.inf), np.full((len(faces), 9), -np.inf)
    for face in range(len(faces)):
        own = row(inward, face)
        for k in range(3):
            corner, beyond = faces[face, k], row(inward, twin[3 * face + k] // 3)
            # The two and this one hold the arc between them, where the tangents at its ends meet; but for
            # the ends of arcs beyond 90 degrees, which no way at a notch turns to, as it sinks into both.
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
    """Return the least distance at which two triangles face each other, or the best so far."""
    points, faces, inward, _, _ = solid
    is_joined = False
    for k in range(3):
        corner = faces[one, k]
        is_joined |= corner == faces[other, 0] or corner == faces[other, 1] or corner == faces[other, 2]
    if is_joined and dot(row(inward, one), row(inward, other)) > -_FACED:
        return best
    # Each has to have something of the other before it.
    for here, there in ((one, other), (other, one)):
        into, base = row(inward, here), row(points, faces[here, 0])
        least, most = np.inf, -np.inf
        for k in range(3):
            depth = dot(sub(row(points, faces[there, k]), base), into)
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
    """Return the least distance from a corner of the one triangle straight to the inside of the other."""
    points, faces, inward, at_corner, _ = solid
    into, base = row(inward, other), row(points, faces[other, 0])
    opposed = -dot(row(inward, one), into)
    for k in range(3):
        point = row(points, faces[one, k])
        depth = dot(sub(point, base), into)
        round_into = row(at_corner, faces[one, k])
        cosine = opposed
        if dot(round_into, row(inward, one)) >= _ROUND_CORNER:
            cosine = -dot(round_into, into)
        # The ball that touches there, and this plane, is wider than the way where that is aslant.
        width = 2 * depth / (1 + cosine)
        inside = depth > 0 and cosine >= FACING and width < best
        for start in range(3):
            corner = row(points, faces[other, start])
            along = sub(row(points, faces[other, (start + 1) % 3]), corner)
            side = dot(cross(along, into), sub(point, corner))
            inside = inside and side >= -1e-9 * dot(along, along)
        if inside:
            best = width
    return best


@compiled
def _between_edges(solid: Solid, one: int, other: int, best: float) -> float:
    """Return the least distance between two half-edges that face each other."""
    points, faces, _, _, _ = solid
    p, q = row(points, faces[one // 3, one % 3]), row(points, faces[other // 3, other % 3])
    u = sub(row(points, faces[one // 3, (one + 1) % 3]), p)
    v = sub(row(points, faces[other // 3, (other + 1) % 3]), q)
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
    """Return how straight a way that starts at an edge leads into the solid; 1 at an edge that is a notch."""
    points, faces, inward, _, twin = solid
    start, end = row(points, faces[half // 3, half % 3]), row(points, faces[half // 3, (half + 1) % 3])
    along = normalized(sub(end, start))
    most, least, nearest = -1.0, 1.0, -1.0
    ours, theirs = row(inward, half // 3), row(inward, twin[half] // 3)
    for side, turned in ((half, 1.0), (twin[half], -1.0)):
        into = row(inward, side // 3)
        cosine = dot(into, way)
        most, least = max(most, cosine), min(least, cosine)
        # Away from the edge along the surface.
        nearest = max(nearest, turned * dot(cross(along, into), way))
    lengthwise = dot(along, way)
    is_notch = nearest <= _ALONG and least > _LEVEL and lengthwise * lengthwise <= 1 - FACING * FACING
    if not is_notch:
        return most
    # At a flat edge the ball touches faces, and may not lie aslant to them.
    is_hollow = dot(ours, cross(theirs, along)) < -_LEVEL
    return 1.0 if is_hollow else math.sqrt(1 - lengthwise * lengthwise)
