"""Kernel of a plane section: the largest disc inside at each point of its outlines."""

from __future__ import annotations

import numpy as np

from tactile_toolkit.array_types import Float32
from tactile_toolkit.compiled import compiled

_BLOCK = 16
# A point, at distance 0 from itself, must not limit its own disc.
_LEAST_SQUARED_MM2 = np.float32(1e-3)
# More than the rounding of single precision.
_NEARLY = np.float32(1 - 1e-5)


@compiled
def largest_discs(points: Float32, inward: Float32) -> tuple[Float32, Float32]:
    """Return the radius of the largest disc at each point of outlines, and the distance of its contact.

    A disc that touches here and passes through a point at distance d and depth h has the curvature
    2 h / d^2. A block of points farther away than the best diameter so far cannot tighten it.
    """
    count = len(points)
    radii, contacts = np.empty(count, np.float32), np.empty(count, np.float32)
    blocks = (count + _BLOCK - 1) // _BLOCK
    middles, spans = np.empty((blocks, 2), np.float32), np.zeros(blocks, np.float32)
    for block in range(blocks):
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, count)
        middles[block, 0], middles[block, 1] = points[(first + last) // 2]
        for point in range(first, last):
            spans[block] = max(spans[block], _apart(points[point], middles[block]))
    sharpest = 0
    for point in range(count):
        # The contact of the disc before is close to that of this one, so nearly all blocks are pruned.
        before = _bend(points, inward, point, sharpest)[0]
        best, contact = max(before, np.float32(0)) * _NEARLY - np.float32(1e-30), np.float32(0)
        for block in range(blocks):
            away = _apart(points[point], middles[block]) - spans[block]
            if away * best > 1 / _NEARLY:
                continue
            for other in range(block * _BLOCK, min((block + 1) * _BLOCK, count)):
                bend, squared = _bend(points, inward, point, other)
                if bend > best:
                    best, contact, sharpest = bend, squared, other
        radii[point], contacts[point] = np.float32(0.5) / max(best, np.float32(1e-9)), np.sqrt(contact)
    return radii, contacts


@compiled
def _apart(one: Float32, other: Float32) -> np.float32:
    distance: np.float32 = np.sqrt((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2)
    return distance


@compiled
def _bend(points: Float32, inward: Float32, here: int, there: int) -> tuple[np.float32, np.float32]:
    away_x, away_y = points[there, 0] - points[here, 0], points[there, 1] - points[here, 1]
    squared = max(away_x * away_x + away_y * away_y, _LEAST_SQUARED_MM2)
    return (inward[here, 0] * away_x + inward[here, 1] * away_y) / squared, squared
