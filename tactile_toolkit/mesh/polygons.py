"""Polygons with more than three corners, cut into triangles."""

from __future__ import annotations

from collections.abc import Callable

import manifold3d
import numpy as np

from tactile_toolkit.array_types import AnyArray, Float64, Int32, Int64
from tactile_toolkit.errors import InputError

# The time for a polygon that crosses itself grows with the square of its number of corners.
_MAX_CORNERS = 10_000


def cut_polygons(vertices: Float64, sizes: Int64, corners: Int64) -> Int32:
    """Triangulate polygons, convex or not.

    Parameters
    ----------
    vertices : ndarray of float64, shape (V, 3)
        In any unit.
    sizes : ndarray of int64, shape (P,)
        Number of corners of each polygon.
    corners : ndarray of int64, shape (sum of sizes,)
        Rows of ``vertices``, polygon after polygon.

    Returns
    -------
    ndarray of int32, shape (F, 3)
        Oriented as their polygons.

    Raises
    ------
    InputError
        A polygon has fewer than 3 or more than 10,000 corners, or names a vertex that is not there.
    """
    beyond = corners[(corners < 0) | (corners >= len(vertices))]
    if len(beyond):
        raise InputError(f"a face names vertex {beyond[0]}, counted from 0; there are {len(vertices):,}")
    if not len(sizes) or (sizes == 3).all():
        return corners.reshape(-1, 3).astype(np.int32)
    wrong = sizes[(sizes < 3) | (sizes > _MAX_CORNERS)]
    if len(wrong):
        raise InputError(f"a face has {wrong[0]:,} corners; expected 3 to {_MAX_CORNERS:,}")
    starts = np.cumsum(sizes) - sizes
    found = []
    for size in np.unique(sizes).tolist():
        polygons = corners[starts[sizes == size][:, None] + np.arange(size)]
        found.append(polygons if size == 3 else _cut_equal(vertices, polygons))
    return np.concatenate(found).astype(np.int32)


def _cut_equal(vertices: Float64, polygons: Int64) -> Int64:
    """Triangulate polygons with equal numbers of corners, shape (P, corners)."""
    places = vertices[polygons]
    places -= places[:, :1]
    following = np.roll(places, -1, axis=1)
    normal = np.cross(places, following).sum(axis=1)
    # Projected along the axis closest to the normal; mirrored where the normal points against it.
    axis = np.abs(normal).argmax(axis=1)
    rows = np.arange(len(polygons))
    upwards = np.where(normal[rows, axis] < 0, -1.0, 1.0)
    x = np.take_along_axis(places, ((axis + 1) % 3)[:, None, None], axis=2)[..., 0]
    y = np.take_along_axis(places, ((axis + 2) % 3)[:, None, None], axis=2)[..., 0] * upwards[:, None]
    flat = np.stack([x, y], axis=2)
    along = np.roll(flat, -1, axis=1) - flat
    onward = np.roll(along, -1, axis=1)
    turns = along[..., 0] * onward[..., 1] - along[..., 1] * onward[..., 0]
    is_convex = (turns > 0).all(axis=1)
    middle = np.arange(1, polygons.shape[1] - 1)
    fan = np.stack([np.zeros_like(middle), middle, middle + 1], axis=1)
    found = [polygons[is_convex][:, fan].reshape(-1, 3)]
    cut: Callable[..., AnyArray] = manifold3d.triangulate
    found += [polygons[row][np.asarray(cut([flat[row]]))] for row in np.flatnonzero(~is_convex).tolist()]
    return np.concatenate(found)
