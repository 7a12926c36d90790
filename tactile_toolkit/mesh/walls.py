"""The thinnest wall of a flat solid, from the medial axis of its middle section.

For every point of the outline there is one largest disc that touches it from inside and crosses the outline
nowhere. The middles of these discs are the medial axis. Where such a disc also touches the far side of a
stroke, its diameter is the width there; where both contacts lie close together the disc only sits in a
corner or behind a rough spot, and its diameter says nothing about a wall.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


SPACING_MM = 0.4
"""Distance of outline points; the outlines of the digits have corners every 0.4 to 0.8 mm."""

NORMAL_SPAN = 2
"""Neighbours on either side that set the direction of the outline at a point."""

LEAST_CONTACT_SINE = 0.9
"""Sine of half the angle between the two contacts, seen from the middle of the disc: 128 degrees."""

# Every point is compared with every other: the first bounds the time; a block of the second stays in a cache.
MAX_POINTS = 6000
_BLOCK = 64
_LEAST_SQUARED_MM2 = np.float32(1e-3)  # the point itself, at distance 0, must not decide its own disc


def thinnest_width_mm(outlines_mm: Sequence[NDArray[np.float64]]) -> float:
    """Measure the narrowest wall between two facing stretches of the outlines of a section, 0 without any.

    Outlines are closed polygons in mm, shape (N, 2), with the material on their left: outer ones
    counter-clockwise, holes clockwise. Where they begin, and their order, change nothing: points are laid
    along each from its lowest corner.
    """
    begun = [np.roll(line, -np.lexsort(line.T)[0], axis=0) for line in outlines_mm if len(line) > 2]
    if not begun:
        return 0.0
    begun.sort(key=lambda line: (*line[0].tolist(), len(line)))
    radii, contacts = _largest_discs(*_outline_points(begun))
    facing = contacts >= 2 * LEAST_CONTACT_SINE * radii
    return float(2 * (radii[facing].min() if facing.any() else radii.max()))


def section_area_mm2(outlines_mm: Sequence[NDArray[np.float64]]) -> float:
    """Return the area that outlines enclose, turned as in :func:`thinnest_width_mm`."""
    area = 0.0
    for outline in outlines_mm:  # not sum(), which rounds otherwise from Python 3.12 on
        area += signed_area_mm2(outline)
    return area


def signed_area_mm2(outline_mm: NDArray[np.float64]) -> float:
    """Return the area within a closed polygon, negative where it is turned clockwise, as holes are."""
    x, y = outline_mm.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


def _outline_points(
    outlines: Sequence[NDArray[np.float64]],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return points along outlines, from their middle, and directions to the material."""
    lengths = [_edge_lengths(outline).sum() for outline in outlines]
    spacing_mm = max(SPACING_MM, sum(lengths) / MAX_POINTS)
    points, inward = [], []
    for outline, length in zip(outlines, lengths, strict=True):
        # A small hole too has enough points to tell its directions.
        count = max(16, round(length / spacing_mm))
        way = np.concatenate([[0.0], np.cumsum(_edge_lengths(outline))])
        # Half a step off the first corner: at a corner itself the outline has no direction.
        stops = (np.arange(count) + 0.5) * (way[-1] / count)
        closed = np.concatenate([outline, outline[:1]])
        even = np.stack([np.interp(stops, way, closed[:, axis]) for axis in (0, 1)], axis=1)
        along = np.roll(even, -NORMAL_SPAN, axis=0) - np.roll(even, NORMAL_SPAN, axis=0)
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        points.append(even)
        inward.append(left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12))
    away = np.concatenate(points)
    # Single precision is fine enough near the middle.
    away -= away.mean(axis=0)
    return away.astype(np.float32), np.concatenate(inward).astype(np.float32)


def _edge_lengths(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    edges = np.roll(outline, -1, axis=0) - outline
    return np.hypot(edges[:, 0], edges[:, 1])


def _largest_discs(
    points: NDArray[np.float32], inward: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Radius of the disc inside at every point, and how far away it touches the outline again."""
    bends = np.empty(len(points), dtype=np.float32)
    contacts = np.empty(len(points), dtype=np.float32)
    (x, y), (inward_x, inward_y) = np.ascontiguousarray(points.T), np.ascontiguousarray(inward.T)
    block = np.empty((3, _BLOCK, len(points)), dtype=np.float32)
    for start in range(0, len(points), _BLOCK):
        rows = slice(start, start + _BLOCK)
        depth, squared, spare = block[:, : len(points[rows])]
        np.subtract(x, x[rows, None], out=squared)
        np.multiply(inward_x[rows, None], squared, out=depth)
        np.square(squared, out=squared)
        np.subtract(y, y[rows, None], out=spare)
        squared += spare * spare
        spare *= inward_y[rows, None]
        depth += spare
        np.maximum(squared, _LEAST_SQUARED_MM2, out=squared)
        # A disc that touches here and passes through a point at distance d and depth h has the curvature 2
        # h / d^2.
        depth /= squared
        sharpest = depth.argmax(axis=1)[:, None]
        bends[rows] = np.take_along_axis(depth, sharpest, axis=1)[:, 0]
        contacts[rows] = np.sqrt(np.take_along_axis(squared, sharpest, axis=1)[:, 0])
    radii = np.asarray(0.5 / np.maximum(bends, 1e-9), dtype=np.float32)
    return radii, contacts
