"""The narrowest wall of a plane section, from its medial axis.

Each point of an outline has one largest disc that touches it from inside and crosses the outline nowhere. The
centres of these discs form the medial axis. Where such a disc also touches the far side of a stroke, its
diameter is the width there. Where both contacts lie close together, the disc only sits in a corner or behind
a rough spot, and its diameter says nothing about a wall.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactile_toolkit.array_types import Float32, Float64

SPACING_MM = 0.4
"""Distance of outline points; outlines of digits have corners every 0.4 to 0.8 mm."""

NORMAL_SPAN = 2
"""Number of neighbours on each side that define the direction of the outline at a point."""

MIN_CONTACT_SINE = 0.9
"""Sine of half the angle between two contacts, seen from the centre of the disc: 128 degrees."""

MAX_POINTS = 6000
"""Bounds the time, because each point is compared with many others."""


def thinnest_width_mm(outlines_mm: Sequence[Float64]) -> float:
    """Measure the narrowest wall between two facing parts of the outlines of a section; 0 without outlines.

    Outlines are closed polygons in mm, shape (N, 2), with the material on their left: outer ones are
    counter-clockwise, holes clockwise. The result does not depend on their order and first corner: points are
    placed from the lowest corner on.
    """
    # numba takes half a second to import.
    from tactile_toolkit.mesh.section_kernels import largest_discs

    begun = [np.roll(line, -np.lexsort(line.T)[0], axis=0) for line in outlines_mm if len(line) > 2]
    if not begun:
        return 0.0
    begun.sort(key=lambda line: (*line[0].tolist(), len(line)))
    radii, contacts = largest_discs(*_outline_points(begun))
    facing = contacts >= 2 * MIN_CONTACT_SINE * radii
    return float(2 * (radii[facing].min() if facing.any() else radii.max()))


def section_area_mm2(outlines_mm: Sequence[Float64]) -> float:
    """Return the area enclosed by outlines, oriented as in :func:`thinnest_width_mm`."""
    area = 0.0
    for outline in outlines_mm:  # not sum(), which rounds differently from Python 3.12 on
        x, y = outline.T
        area += float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    return area


def _outline_points(outlines: Sequence[Float64]) -> tuple[Float32, Float32]:
    """Return points along outlines, relative to their mean, and directions towards the material."""
    lengths = [_edge_lengths(outline).sum() for outline in outlines]
    spacing_mm = max(SPACING_MM, sum(lengths) / MAX_POINTS)
    points, inward = [], []
    for outline, length in zip(outlines, lengths, strict=True):
        # Small holes need enough points for their directions too.
        count = max(16, round(length / spacing_mm))
        way = np.concatenate([[0.0], np.cumsum(_edge_lengths(outline))])
        # Half a step from the first corner: the outline has no direction at a corner.
        stops = (np.arange(count) + 0.5) * (way[-1] / count)
        closed = np.concatenate([outline, outline[:1]])
        even = np.stack([np.interp(stops, way, closed[:, axis]) for axis in (0, 1)], axis=1)
        along = np.roll(even, -NORMAL_SPAN, axis=0) - np.roll(even, NORMAL_SPAN, axis=0)
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        points.append(even)
        inward.append(left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12))
    away = np.concatenate(points)
    # Single precision is accurate enough near the mean.
    away -= away.mean(axis=0)
    return away.astype(np.float32), np.concatenate(inward).astype(np.float32)


def _edge_lengths(outline: Float64) -> Float64:
    edges = np.roll(outline, -1, axis=0) - outline
    return np.hypot(edges[:, 0], edges[:, 1])
