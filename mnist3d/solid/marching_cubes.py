"""Marching cubes: the surface of a stack of layers."""

from __future__ import annotations

import numpy as np
from skimage import measure

from mnist3d.solid.lattice import Lattice
from mnist3d.solid.surface import Surface
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Int32, Int64


def half_surface(upper_half: Float32, lattice: Lattice) -> Surface:
    """Return the surface of the upper half of a solid, where the depth of the nodes passes 0."""
    vertices, faces = isosurface(upper_half, 0.0)
    still = _beside_thin_parts(vertices, upper_half[:, :, 0] > 0)
    for axis, nodes in enumerate((lattice.rows_px, lattice.columns_px)):
        vertices[:, axis] = np.interp(vertices[:, axis], np.arange(len(nodes)), nodes)
    vertices[:, 2] *= np.float32(lattice.pitch_px)
    rim = np.flatnonzero(vertices[:, 2] == 0)
    corner_px, least_px = (*lattice.corner_px, 0), float(lattice.least_px)
    return Surface(vertices, _in_storage_order(faces), corner_px, rim, still, least_px)


def isosurface(volume: AnyArray, level: float) -> tuple[Float32, Int32]:
    """Return vertices and faces of the surface at which a volume, larger inside the solid, passes a level.

    Coordinates are in the order of the axes, in steps between nodes from 0 at the first.
    """
    # "descent", scikit-image's default, would turn the triangles of such a volume inwards.
    vertices, faces, _, _ = measure.marching_cubes(  # type: ignore[no-untyped-call]
        np.ascontiguousarray(volume, dtype=np.float32), level, gradient_direction="ascent"
    )
    return vertices.astype(np.float32, copy=False), faces.astype(np.int32, copy=False)


def _in_storage_order(faces: Int32) -> Int32:
    """Begin each triangle at its lowest vertex and sort the triangles; the winding stays.

    Neighbouring rows then hold similar numbers, which halves their size after zstd.
    """
    if not len(faces):
        return faces
    # No two triangles leave a vertex by the same edge, so the edge from the lowest vertex decides the order.
    count = int(faces.max()) + 1
    a, b, c = faces.T.astype(np.int64)
    edge = np.minimum(np.minimum(a * count + b, b * count + c), c * count + a)
    order = np.argsort(edge, kind="stable")
    first, second = np.divmod(edge[order], count)
    third = (a + b + c)[order] - first - second
    return np.stack([first, second, third], axis=1).astype(np.int32)


def _beside_thin_parts(vertices: Float32, plane: Bool) -> Int64:
    """Return the vertices at walls and gaps of one node, whose sides smoothing might push past each other.

    ``plane`` states which nodes of the mid-plane are inside. Vertices are in pitches; each lies on an edge
    between two nodes.
    """
    # Above the mid-plane there is a wider layer below, so a ridge of one node may be smoothed.
    thin = np.zeros_like(plane)
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = np.roll(plane, (down, across), axis=(0, 1))
        other = np.roll(plane, (-down, -across), axis=(0, 1))
        thin |= (one == other) & (one != plane)
    low, high = np.floor(vertices[:, :2]).astype(np.intp), np.ceil(vertices[:, :2]).astype(np.intp)
    return np.flatnonzero(thin[tuple(low.T)] | thin[tuple(high.T)])
