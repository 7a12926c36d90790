"""Surfaces: bodies and holes that they bound, and decimation that keeps these."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import manifold3d
import numpy as np

from mnist3d.ink.grey_levels import refuse
from tactile_toolkit.array_types import AnyArray, Float32, Int32, Int64
from tactile_toolkit.mesh import Mesh, connected

FIRST_TOLERANCE_MM = 0.01

# Several passes of growing tolerance leave fewer and better placed vertices than one with a wide tolerance.
TOLERANCE_GROWTH = 1.25

# A single pass is tried for meshes of up to this many times the allowed vertices.
MAX_FOR_ONE_PASS = 2.0

E_FOLD_MM = 0.1
"""Tolerance at which one pass leaves about 1/e of the vertices."""

FLAT_MM = 0.005
"""Largest distance of a vertex from the surface without it, in even parts of drawings."""

BUDGET_SLACK = 1.5
"""Largest number of vertices, as a multiple of the budget."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A whole surface in pixels, or the upper half of one, whose rim lies in the mid-plane.

    Attributes
    ----------
    vertices_px : ndarray of float32, shape (V, 3)
        Row, column and height, counted from ``corner_px``.
    faces : ndarray of int32, shape (F, 3)
        Rows of the vertices, counter-clockwise seen from outside.
    corner_px : tuple
        Row, column and height.
    rim, still : ndarray of int
        Rows of the vertices that smoothing keeps in the mid-plane, and of those that it does not move.
    least_px : float
        Least height of all other vertices after smoothing.
    """

    vertices_px: Float32
    faces: Int32
    corner_px: tuple[int, int, int] = (0, 0, 0)
    rim: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    still: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    least_px: float = -math.inf


def bodies_and_holes(vertices: int, faces: AnyArray, rim: int = 0) -> tuple[int, int]:
    """Count the bodies of a closed surface and the holes through them.

    ``vertices`` is the number of vertices. For the upper half of a surface, ``rim`` is the number of those in
    the mid-plane.
    """
    corners = faces.astype(np.int64)
    least = connected(corners[:, :2].ravel(), corners[:, 1:].ravel(), vertices)
    bodies = int(np.count_nonzero(least == np.arange(vertices)))
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = vertices - len(faces) // 2
    if rim:
        euler = 2 * vertices - rim - len(faces)
    return bodies, bodies - euler // 2


def decimate(mesh: Mesh, target_vertices: int) -> Mesh:
    """Remove the least important vertices until the budget is met; a smaller mesh is returned unchanged.

    A mesh with 1.5 to 3 times the budget may keep up to 1.5 times. Raises ItemError ``vertex-budget`` if
    these are too few for its bodies and holes.
    """
    if len(mesh.vertices_m) <= target_vertices:
        return mesh
    counts = bodies_and_holes(len(mesh.vertices_m), mesh.faces)
    most = BUDGET_SLACK * target_vertices
    passes = [mesh.to_manifold()]
    tolerance_mm = FIRST_TOLERANCE_MM
    over = len(mesh.vertices_m) / most
    if 1 < over <= MAX_FOR_ONE_PASS:
        solid = passes[0].simplify(tolerance_mm + E_FOLD_MM * math.log(over))
        simpler = _mesh_of(solid)
        fits = len(simpler.vertices_m) <= most
        if fits and _keeps_topology(solid, counts) and simpler.crossing_mm(counts[0]) is None:
            return simpler
    while passes[-1].num_vert() > target_vertices:
        simpler = passes[-1].simplify(tolerance_mm)
        if not _keeps_topology(simpler, counts):
            break
        passes.append(simpler)
        tolerance_mm *= TOLERANCE_GROWTH
    # A pass may fold a thin tip onto itself. That check is slow, so it starts at the last pass.
    while len(passes) > 1 and _mesh_of(passes[-1]).crossing_mm(counts[0]) is not None:
        passes.pop()
    solid = passes[-1]
    found = solid.num_vert()
    if found > most:
        enough = math.ceil(found / BUDGET_SLACK)
        refuse("vertex-budget", found, *counts, target_vertices, BUDGET_SLACK, enough)
    return _mesh_of(solid)


def without_flat_vertices(mesh: Mesh) -> Mesh:
    """Remove vertices that change the surface by 0.005 mm at most, unless bodies or holes would be lost.

    Fine lattices have many of them in even parts: a drawing keeps a fifth of its triangles.
    """
    counts = bodies_and_holes(len(mesh.vertices_m), mesh.faces)
    solid = mesh.to_manifold().simplify(FLAT_MM)
    simpler = _mesh_of(solid)
    if _keeps_topology(solid, counts) and simpler.crossing_mm(counts[0]) is None:
        return simpler
    return mesh


def _mesh_of(solid: manifold3d.Manifold) -> Mesh:
    mesh = Mesh.from_manifold(solid)
    mesh.vertices_m[:, 2] -= mesh.vertices_m[:, 2].min()
    return Mesh(mesh.vertices_m.astype(np.float32), mesh.faces)


def _keeps_topology(solid: manifold3d.Manifold, counts: tuple[int, int]) -> bool:
    """Return whether a symmetric solid has these bodies and holes, and none of its walls have met."""
    if bodies_and_holes(solid.num_vert(), np.asarray(solid.to_mesh64().tri_verts)) != counts:
        return False
    low, high = solid.bounding_box()[2], solid.bounding_box()[5]
    # Walls meet first in the mid-plane, where the solid is widest.
    return len(solid.slice((low + high) / 2).to_polygons()) == sum(counts)
