"""The solid as the algorithm is printed: the oracle that the fast way is held to.

Binary layers at full resolution, marching cubes on the binary stack, smoothing, and only then a decimation
to the vertex budget. Slow and plain on purpose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mnist3d.steps import erode, erosion_radii_px, marching_cubes, mirror, scale, smooth, stack
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mnist3d.spec import SolidSpec

__all__ = ["decimate", "literal_solid"]

FIRST_TOLERANCE_MM = 0.03
TOLERANCE_GROWTH = 1.25


def literal_solid(mask: NDArray[np.bool_], spec: SolidSpec, *, decimated: bool = True) -> Mesh:
    """Build a solid exactly in the published steps.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        Clean ink, from :func:`mnist3d.ink.clean`.
    spec : SolidSpec
        The numbers of the algorithm.
    decimated : bool
        False gives the mesh before its decimation, with all the detail of the layers.

    Returns
    -------
    Mesh
    """
    layers = [erode(mask, radius) for radius in erosion_radii_px(spec)]
    volume = np.pad(mirror(stack(layers)), 1)
    vertices, faces = marching_cubes(volume, 0.5)
    vertices = smooth(vertices, faces, spec.literal_smoothing_iterations, spec.smoothing_factor)
    mesh = scale(vertices - np.float32(1), faces, (mask.shape[0], mask.shape[1]), spec)
    return decimate(mesh, spec.target_vertices) if decimated else mesh


def decimate(mesh: Mesh, target_vertices: int) -> Mesh:
    """Drop the vertices that matter least until the budget is met.

    Parameters
    ----------
    mesh : Mesh
        A valid solid.
    target_vertices : int
        Largest number of vertices to keep.

    Returns
    -------
    Mesh
        The mesh itself where it is small enough.
    """
    if len(mesh.vertices_m) <= target_vertices:
        return mesh
    solid, tolerance_mm = mesh.to_manifold(), FIRST_TOLERANCE_MM
    # Many careful passes: one pass with a wide tolerance leaves more vertices, and worse placed ones.
    while solid.num_vert() > target_vertices:
        solid = solid.simplify(tolerance_mm)
        tolerance_mm *= TOLERANCE_GROWTH
    return _from_manifold(solid)


def _from_manifold(solid: Any) -> Mesh:
    mesh = solid.to_mesh64()
    vertices_m = np.asarray(mesh.vert_properties)[:, :3] / MM_PER_M
    vertices_m[:, 2] -= vertices_m[:, 2].min()
    return Mesh(vertices_m.astype(np.float32), np.asarray(mesh.tri_verts).astype(np.int32))
