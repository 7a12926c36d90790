"""Kernel of a plane section: the largest disc inside at each point of its outlines."""

from __future__ import annotations

import numpy as np

from tactile_toolkit.array_types import Float32
from tactile_toolkit.compiled import part, planned

_BLOCK = 16
# A point, at distance 0 from itself, must not limit its own disc.
_MIN_SQUARED_MM2 = np.float32(1e-3)
# More than the rounding of single precision.
_NEARLY = np.float32(1 - 1e-5)
_FLATTEST = np.float32(1e-9)


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


@planned("(float32[:,::1], float32[:,::1], float32[:,::1], float32[::1], float32[::1])")
def _find_largest(
    points: Float32, inward: Float32, blocks: Float32, radii: Float32, contacts: Float32
) -> None:
    count = len(points)
    for block in range(len(blocks)):
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, count)
        middle = (first + last) // 2
        blocks[block, 0], blocks[block, 1] = points[middle, 0], points[middle, 1]
        for point in range(first, last):
            reach = _apart(points, point, blocks, block)
            if reach > blocks[block, 2]:
                blocks[block, 2] = reach
    sharpest = count - count  # not the literal 0, for which numba compiles another version
    for point in range(count):
        # The contact of the disc before is close to that of this one, so nearly all blocks are pruned.
        before, contact = _bend(points, inward, point, sharpest)[0], np.float32(0)
        best = (before if before > contact else contact) * _NEARLY - np.float32(1e-30)
        for block in range(len(blocks)):
            if (_apart(points, point, blocks, block) - blocks[block, 2]) * best > 1 / _NEARLY:
                continue
            for other in range(block * _BLOCK, min((block + 1) * _BLOCK, count)):
                bend, squared = _bend(points, inward, point, other)
                if bend > best:
                    best, contact, sharpest = bend, squared, other
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
