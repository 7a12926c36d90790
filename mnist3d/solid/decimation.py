"""Meshes within their budget of vertices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mnist3d.ink.refusals import refuse
from mnist3d.solid.surface import bodies_and_holes
from tactile_toolkit.mesh import Mesh, self_crossing

FIRST_TOLERANCE_MM = 0.01
# Small steps: see the note on many careful passes in `decimate`.
TOLERANCE_GROWTH = 1.25
FEW_TOO_MANY = 2.0

E_FOLD_MM = 0.1
"""Up to so many times the vertices allowed, one pass will do: each so much tolerance leaves 1 / e of them."""

BUDGET_SLACK = 1.5
"""No mesh has more vertices than this many times its budget."""


def decimate(mesh: Mesh, target_vertices: int) -> Mesh:
    """Drop the vertices that matter least until the budget is met; a mesh within it comes back itself.

    A mesh with more than 1.5 times as many vertices, but at most 3 times, keeps up to 1.5 times as many.
    Raises ItemError ``vertex-budget`` where even these are too few for its bodies and holes.
    """
    if len(mesh.vertices_m) <= target_vertices:
        return mesh
    counts = bodies_and_holes(len(mesh.vertices_m), mesh.faces)
    most = BUDGET_SLACK * target_vertices
    passes, tolerance_mm = [mesh.to_manifold()], FIRST_TOLERANCE_MM
    over = len(mesh.vertices_m) / most
    if 1 < over <= FEW_TOO_MANY:
        solid = passes[0].simplify(tolerance_mm + E_FOLD_MM * math.log(over))
        simpler = _mesh_of(solid)
        fits = len(simpler.vertices_m) <= most
        if fits and _is_held(solid, counts) and not _crosses_itself(simpler, counts[0]):
            return simpler
    # Many careful passes: one pass with a wide tolerance leaves more vertices, and worse placed ones.
    while passes[-1].num_vert() > target_vertices:
        simpler = passes[-1].simplify(tolerance_mm)
        if not _is_held(simpler, counts):
            break
        passes.append(simpler)
        tolerance_mm *= TOLERANCE_GROWTH
    # A pass may flatten a thin tip into a sheet folded onto itself. To look for that takes as long as many
    # passes, so it is looked for from the end.
    while len(passes) > 1 and _crosses_itself(_mesh_of(passes[-1]), counts[0]):
        passes.pop()
    solid = passes[-1]
    found = solid.num_vert()
    if found > most:
        enough = math.ceil(found / BUDGET_SLACK)
        refuse("vertex-budget", found, *counts, target_vertices, BUDGET_SLACK, enough)
    return _mesh_of(solid)


def _mesh_of(solid: Any) -> Mesh:
    mesh = Mesh.from_manifold(solid)
    mesh.vertices_m[:, 2] -= mesh.vertices_m[:, 2].min()
    return Mesh(mesh.vertices_m.astype(np.float32), mesh.faces)


def _crosses_itself(mesh: Mesh, bodies: int) -> bool:
    return self_crossing(mesh.vertices_mm, mesh.faces.astype(np.int64), bodies) is not None


def _is_held(solid: Any, counts: tuple[int, int]) -> bool:
    """Return whether a symmetric solid has so many bodies and holes, and no walls of it have met."""
    if bodies_and_holes(solid.num_vert(), np.asarray(solid.to_mesh64().tri_verts)) != counts:
        return False
    low, high = solid.bounding_box()[2], solid.bounding_box()[5]
    # Walls meet in the mid-plane first, where the solid is widest.
    return len(solid.slice((low + high) / 2).to_polygons()) == sum(counts)
