"""Merging of vertices with equal coordinates, or with coordinates that differ by rounding."""

from __future__ import annotations

import numpy as np

from tactile_toolkit import spatial
from tactile_toolkit.array_types import Float64, Int32, Integers
from tactile_toolkit.mesh.mesh import Mesh, Surface
from tactile_toolkit.wording import with_count

# Corners closer than this fraction of the size of the object are welded where that closes the surface.
_WELDED = 1e-5
# More corners in one place are not due to rounding; this bounds memory.
_NEIGHBOURS = 16


def merge_equal_vertices(vertices: Float64, faces: Integers) -> Surface:
    """Merge vertices with equal coordinates, in order of first appearance."""
    # trimesh would merge within a tolerance; numpy's unique rows take three times as long.
    rows = vertices + 0.0  # -0.0 equals 0.0
    order = np.lexsort(rows.T)
    in_order = rows.take(order, axis=0)
    is_new = np.concatenate([[True], (in_order[1:] != in_order[:-1]).any(axis=1)])[: len(rows)]
    group = np.empty(len(rows), np.int64)
    group[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    by_appearance = np.argsort(first)
    number = np.empty(len(first), np.int32)
    number[by_appearance] = np.arange(len(first), dtype=np.int32)
    return vertices.take(first[by_appearance], axis=0), number[group].take(faces)


def welded(vertices: Float64, faces: Int32) -> Mesh:
    """Weld corners that rounding has separated, where that closes the surface; metres."""
    if not len(faces) or not np.isfinite(vertices).all() or _is_closed(faces, len(vertices)):
        return Mesh(vertices, faces)
    from scipy.sparse import coo_array, csgraph  # takes a tenth of a second to import

    # Ends of edges that do not occur in both directions.
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    forth, back = (ends @ weights for weights in ((len(vertices), 1), (1, len(vertices))))
    torn = np.unique(ends[~(np.isin(forth, back) & np.isin(back, forth))])
    if len(torn) < 2:
        return Mesh(vertices, faces)
    reach_m = _WELDED * float(np.ptp(vertices, axis=0).max())
    tree, count = spatial.cKDTree(vertices[torn]), min(_NEIGHBOURS, len(torn))
    away_m, near = map(np.asarray, tree.query(vertices[torn], count, distance_upper_bound=reach_m))
    row, column = np.nonzero(np.isfinite(away_m))
    graph = coo_array((np.ones(len(row)), (row, near[row, column])), (len(torn), len(torn)))
    group = csgraph.connected_components(graph, directed=False)[1]
    first = np.full(len(torn), len(vertices))
    np.minimum.at(first, group, torn)
    moved = np.arange(len(vertices))
    moved[torn] = first[group]
    corners = moved[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    if not len(corners) or not _is_closed(corners, len(vertices)):
        return Mesh(vertices, faces)
    used, corners_used = np.unique(corners, return_inverse=True)
    # A single distant corner would make others count as near, and weld unrelated parts.
    if (np.abs(np.ptp(vertices[used], axis=0) - np.ptp(vertices, axis=0)) > 2 * reach_m).any():
        return Mesh(vertices, faces)
    count = int((moved != np.arange(len(vertices))).sum())
    kept = corners_used.reshape(-1, 3).astype(np.int32)
    return Mesh(vertices[used], kept, (f"{with_count(count, 'corners')} welded",))


def _is_closed(faces: Integers, count: int) -> bool:
    """Return whether each edge occurs equally often in both directions; wrong with probability 2^-64."""
    corners, following = np.ascontiguousarray(faces.T), [1, 2, 0]
    random = np.random.default_rng(0).integers(1 << 63, size=(2, count), dtype=np.uint64)
    one, other = (numbers.take(corners) for numbers in random)
    return bool((one * other[following]).sum() == (other * one[following]).sum())
