"""Pairs of triangles that lie near each other: down a tree of boxes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = ["OPPOSED", "near_pairs"]

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

# Pairs that are looked at together: bounds the memory.
_AT_ONCE = 1 << 17

OPPOSED = -0.3
"""Largest cosine of the angle between directions that oppose each other."""


def near_pairs(
    corners_mm: Numbers, reach_mm: float, inward: Numbers | None = None
) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of triangles, shape (F, 3, 3), whose boxes are within reach along each axis, in parts.

    With ``inward``, a direction for each, only those pairs whose directions oppose each other.
    """
    if not len(corners_mm):
        return
    low, high = corners_mm.min(axis=1) - reach_mm / 2, corners_mm.max(axis=1) + reach_mm / 2
    order = _along_a_curve((low + high) / 2)
    if inward is not None:
        low, high = np.concatenate([low, inward], axis=1), np.concatenate([high, inward], axis=1)
    levels = max(1, int(np.ceil(np.log2(max(len(order), 2)))))
    # Leaves without a triangle are boxes inside out, which meet nothing.
    lows = np.full((1 << levels, low.shape[1]), np.inf)
    highs = np.full((1 << levels, low.shape[1]), -np.inf)
    lows[: len(order)], highs[: len(order)] = low[order], high[order]
    tree = [(lows, highs)]
    for _ in range(levels):
        lows, highs = tree[-1]
        tree.append((np.minimum(lows[::2], lows[1::2]), np.maximum(highs[::2], highs[1::2])))
    root = np.zeros(1, np.int64)
    waiting = [(levels, root, root)]
    while waiting:
        # Depth first: all pairs of one level would not fit into memory.
        level, one, other = waiting.pop()
        if level == 0:
            apart = one != other
            yield order[one[apart]], order[other[apart]]
            continue
        if len(one) > _AT_ONCE:
            half = len(one) // 2
            waiting += [(level, one[half:], other[half:]), (level, one[:half], other[:half])]
            continue
        same = one == other
        left, right = 2 * one, 2 * other
        one = np.concatenate([left, left + 1, left, left[~same] + 1])
        other = np.concatenate([right, right + 1, right + 1, right[~same]])
        lows, highs = tree[level - 1]
        meet = np.ones(len(one), dtype=bool)
        for axis in range(3):
            near, far = lows[:, axis], highs[:, axis]
            meet &= (near[one] <= far[other]) & (near[other] <= far[one])
        one, other = one[meet], other[meet]
        if inward is not None:
            # The least cosine between directions of two boxes of directions.
            cosine = np.zeros(len(one))
            for axis in range(3, 6):
                bounds = [(a[one, axis], b[other, axis]) for a in (lows, highs) for b in (lows, highs)]
                cosine += np.minimum.reduce([first * second for first, second in bounds])
            opposed = cosine < OPPOSED
            one, other = one[opposed], other[opposed]
        waiting.append((level - 1, one, other))


def _along_a_curve(points: Numbers) -> Indices:
    """Return an order of points in which neighbours are near: that of Morton's curve."""
    low = points.min(axis=0)
    span = max(float((points.max(axis=0) - low).max()), 1e-300)
    # Ten bits for each axis, then each bit moved to every third place.
    cells = ((points - low) * (1023.0 / span)).astype(np.int64)
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        cells = (cells | (cells << shift)) & mask
    return np.argsort(cells[:, 0] | (cells[:, 1] << 1) | (cells[:, 2] << 2), kind="stable")
