"""Geometry for kernels: vectors of three floats, a tree of boxes, and objects whose boxes are near."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from tactile_toolkit.kernels import compiled, part
from tactile_toolkit.value_types import Float64, Int64

Vector: TypeAlias = tuple[float, float, float]

# Size of the stack of node pairs: three for each level of the trees, which have at most 63 levels.
DEEPEST = 256
PAIRS_AT_ONCE = 1 << 18


def near_pairs(corners_mm: Float64, reach_mm: float) -> Iterator[Int64]:
    """Yield pairs of triangles, or other objects of shape (F, corners, 3), whose boxes are within reach.

    The reach counts along each axis. Each pair is yielded once, in arrays of shape (2, pairs): long and
    narrow objects may have many millions of pairs.
    """
    if not len(corners_mm):
        return
    corners_mm = np.ascontiguousarray(corners_mm.swapaxes(0, 1))  # numpy is slow along short rows
    low = corners_mm.min(axis=0) - reach_mm / 2
    high = corners_mm.max(axis=0) + reach_mm / 2
    numbered = curve_order((low + high) / 2)
    boxes, held = tree_of(numbered, low, high)
    pairs = np.empty((PAIRS_AT_ONCE, 2), np.int64)
    stack = np.ones((DEEPEST, 2), np.int64)
    top = 1
    while top:
        count, top = _meeting(numbered, boxes, held, stack, top, pairs)
        yield np.ascontiguousarray(pairs[:count].T & 0xFFFFFFFF)


def connected(ends: Int64, others: Int64, count: int) -> Int64:
    """Return the number of the connected component of each object, shape (count,)."""
    least = np.arange(count)
    _connect(np.ascontiguousarray(ends), np.ascontiguousarray(others), least)
    return least


@part
def row_of(array: Float64, row: int) -> Vector:
    """Return a row of an array, shape (N, 3)."""
    return array[row, 0], array[row, 1], array[row, 2]


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


def tree_of(numbered: Int64, low: Float64, high: Float64) -> tuple[Float64, Int64]:
    """Return the boxes of a binary tree, shape (2 N, 2, columns), low and high ends, and the two children.

    The root is node 1. The last N nodes are the boxes themselves, in order; they are their own children. Each
    node is a cell of Morton's curve, because boxes across the jumps of the curve would be wide.
    """
    boxes = np.empty((2 * len(numbered), 2, low.shape[1]))
    held = np.empty((2 * len(numbered), 2), np.int64)
    _tree(numbered, low, high, np.empty((2, 64), np.int64), boxes, held)
    return boxes, held


def curve_order(points: Float64) -> Int64:
    """Return codes and numbers of points as of :func:`_write_codes`, sorted: neighbours are near in space."""
    # Axis by axis: along rows of three numpy takes thirteen times as long.
    low = np.array([axis.min() for axis in points.T])
    span = max(*(axis.max() - least for axis, least in zip(points.T, low, strict=True)), 1e-300)
    numbered = np.arange(len(points))
    _write_codes(np.ascontiguousarray(points), low, 1023.0 / span, numbered)
    # Sorted together with their numbers: equal places stay in order, and numpy sorts integers fast.
    numbered.sort()
    return numbered


@compiled("(float64[:,::1], float64[::1], float64, int64[::1])")
def _write_codes(points: Float64, low: Float64, scale: float, numbered: Int64) -> None:
    """Write the Morton code of each point, ten bits for each axis, above its number in the lower bits."""
    for point in range(len(points)):
        for axis in range(3):
            cell = np.int64((points[point, axis] - low[axis]) * scale)
            # Spread the bits to every third place.
            cell = (cell | (cell << 16)) & 0x30000FF
            cell = (cell | (cell << 8)) & 0x300F00F
            cell = (cell | (cell << 4)) & 0x30C30C3
            cell = (cell | (cell << 2)) & 0x9249249
            numbered[point] |= cell << (32 + axis)


@compiled("(int64[::1], float64[:,::1], float64[:,::1], int64[:,::1], float64[:,:,::1], int64[:,::1])")
def _tree(numbered: Int64, low: Float64, high: Float64, waiting: Int64, boxes: Float64, held: Int64) -> None:
    """Write the nodes of :func:`tree_of`.

    ``waiting`` (2, 64) is scratch: nodes whose cells may hold more, and the bits in which the next object
    differs from each.
    """
    count = len(numbered)
    columns = low.shape[1]
    top = 0
    last = len(numbered)
    for leaf in range(count):
        thing = numbered[leaf] & 0xFFFFFFFF
        node = count + leaf
        bits = 1 << 62
        held[node, 0] = held[node, 1] = node
        for axis in range(columns):
            boxes[node, 0, axis], boxes[node, 1, axis] = low[thing, axis], high[thing, axis]
        if leaf + 1 < count:
            bits = numbered[leaf] ^ numbered[leaf + 1]
        while top and waiting[1, top - 1] < bits:
            top -= 1
            last -= 1
            left = waiting[0, top]
            held[last, 0], held[last, 1] = left, node
            for axis in range(columns):
                boxes[last, 0, axis] = min(boxes[left, 0, axis], boxes[node, 0, axis])
                boxes[last, 1, axis] = max(boxes[left, 1, axis], boxes[node, 1, axis])
            node = last
        waiting[0, top], waiting[1, top] = node, bits
        top += 1


@compiled("(int64[::1], float64[:,:,::1], int64[:,::1], int64[:,::1], int64, int64[:,::1])")
def _meeting(
    numbered: Int64, boxes: Float64, held: Int64, stack: Int64, top: int, pairs: Int64
) -> tuple[int, int]:
    """Write the pairs of boxes that overlap, each pair once; boxes as in ``numbered``.

    Return the number of pairs, and that of node pairs on the stack: those left when ``pairs`` is full.
    """
    things = len(numbered)
    columns = boxes.shape[2]
    count = 0
    while top and count < len(pairs):
        top -= 1
        node, partner = stack[top, 0], stack[top, 1]
        if node >= things and partner >= things:
            if node != partner:
                pairs[count, 0], pairs[count, 1] = numbered[node - things], numbered[partner - things]
                count += 1
            continue
        for first in range(2 if node < things else 1):
            for second in range(first if node == partner else 0, 2 if partner < things else 1):
                left = held[node, first]
                right = held[partner, second]
                meet = True
                for axis in range(columns):
                    meet &= boxes[left, 0, axis] <= boxes[right, 1, axis]
                    meet &= boxes[right, 0, axis] <= boxes[left, 1, axis]
                if meet:
                    stack[top, 0], stack[top, 1] = left, right
                    top += 1
    return count, top


@compiled("(int64[::1], int64[::1], int64[::1])")
def _connect(ends: Int64, others: Int64, least: Int64) -> None:
    for pair in range(len(ends)):
        root, end_root = ends[pair], others[pair]
        while least[root] < root:
            least[root] = least[least[root]]
            root = least[root]
        while least[end_root] < end_root:
            least[end_root] = least[least[end_root]]
            end_root = least[end_root]
        least[max(root, end_root)] = min(root, end_root)
    for thing in range(len(least)):
        least[thing] = least[least[thing]]
