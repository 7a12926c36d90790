"""The last steps of Algorithm 1: a surface around the stack of layers, smoothed and scaled to a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mnist3d.ink import refuse
from mnist3d.lattice import Lattice, Mirrored
from mnist3d.spec import SolidSpec
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Int32, Int64
from tactile_toolkit.mesh import MM_PER_M, Mesh, self_crossing

TAUBIN_RATIO = -1.06
"""Step outward over step inward that lets smoothing keep the volume (Taubin 1995: slightly above one)."""

FIRST_TOLERANCE_MM = 0.01
# Small steps: see the note on many careful passes in `decimate`.
TOLERANCE_GROWTH = 1.25

FEW_TOO_MANY = 2.0
E_FOLD_MM = 0.1
"""Up to so many times the vertices allowed, one pass will do: each so much tolerance leaves 1 / e of them."""

BUDGET_SLACK = 1.5
"""No mesh has more vertices than this many times its budget."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface before it is scaled: a whole one, or the upper half of one, whose rim lies in the mid-plane.

    Attributes
    ----------
    vertices_px : ndarray of float32, shape (V, 3)
        Row, column and height above the mid-plane, from ``corner_px`` of the image.
    faces : ndarray of int32, shape (F, 3)
        Rows of the vertices, counter-clockwise seen from outside.
    corner_px : tuple
        Row, column and height.
    rim, still : ndarray of int
        Rows of vertices that stay in the mid-plane, and that stay where they are, when it is smoothed.
    least_px : float
        Least height of the other vertices.
    """

    vertices_px: Float32
    faces: Int32
    corner_px: tuple[int, int, int] = (0, 0, 0)
    rim: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    still: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    least_px: float = -math.inf


def marching_cubes(volume: Mirrored, lattice: Lattice) -> Surface:
    """Find the surface of the upper half of the solid, where the depth of the nodes passes 0."""
    vertices, faces = isosurface(volume.upper, 0.0)
    still = _beside_thin_parts(vertices, volume.upper[:, :, 0] > 0)
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
    from skimage import measure

    extract: Any = measure.marching_cubes
    # "descent", scikit-image's default, would turn the triangles of such a volume inwards.
    vertices, faces, _, _ = extract(
        np.ascontiguousarray(volume, dtype=np.float32), level, gradient_direction="ascent"
    )
    return vertices.astype(np.float32, copy=False), faces.astype(np.int32, copy=False)


def smooth(surface: Surface, iterations: int, factor: float) -> Surface:
    """Even out a surface without shrinking it (Taubin 1995).

    Each round is a step of ``factor`` of the way to the middle of the neighbours and a slightly longer one
    back. As its rim stays in the mid-plane, the upper half moves exactly as it would within the whole.
    """
    from mnist3d import kernels

    rim = surface.rim
    flat = np.bincount(rim, minlength=len(surface.vertices_px))
    shares = np.array([factor, factor * TAUBIN_RATIO] * iterations, np.float32)
    vertices = kernels.smoothed(surface.vertices_px.copy(), surface.faces, flat, shares)
    # Volume and topology come before smoothness there: a wall that folds is not a solid.
    vertices[surface.still] = surface.vertices_px[surface.still]
    vertices[:, 2] = np.maximum(vertices[:, 2], np.float32(surface.least_px))
    vertices[rim, 2] = 0
    return replace(surface, vertices_px=vertices)


def scale(surface: Surface, shape: tuple[int, int], spec: SolidSpec) -> Mesh:
    """Turn pixels of an image of that shape into metres and set the solid on the plate; a half becomes whole.

    The middle of the image becomes the origin, the lowest point lies at z = 0; vertices end on the storage
    grid. The mirror images of the vertices off the mid-plane follow those of the upper half, in the same
    order.
    """
    vertices, faces = surface.vertices_px, surface.faces
    if len(surface.rim):
        off_plane = np.delete(np.arange(len(vertices)), surface.rim)
        image = np.arange(len(vertices), dtype=np.int32)
        image[off_plane] = len(vertices) + np.arange(len(off_plane), dtype=np.int32)
        vertices = np.concatenate([vertices, vertices.take(off_plane, 0) * np.array([1, 1, -1], np.float32)])
        faces = np.concatenate([faces, image.take(faces[:, [0, 2, 1]])])
    row, column, height = (vertices + np.array(surface.corner_px, dtype=np.float32)).astype(np.float64).T
    centred = np.stack([column - (shape[1] - 1) / 2, (shape[0] - 1) / 2 - row, height], axis=1)
    vertices_mm = centred * spec.pixel_pitch_mm
    if spec.vertex_quantum_mm > 0:
        # Rounded about the mid-plane, where up and down round alike, and only then set on the plate.
        vertices_mm = np.round(vertices_mm / spec.vertex_quantum_mm) * spec.vertex_quantum_mm
    vertices_mm[:, 2] -= vertices_mm[:, 2].min()
    return Mesh((vertices_mm / MM_PER_M).astype(np.float32), faces)


def _in_storage_order(faces: Int32) -> Int32:
    """Begin each triangle at its lowest vertex and sort the triangles; the winding stays.

    Neighbouring rows then hold nearly equal numbers, which halves what zstd makes of them.
    """
    if not len(faces):
        return faces
    # On a surface no two triangles leave the same vertex by the same edge, so two numbers settle the order;
    # of the three edges of a triangle the one from its lowest vertex has the least.
    count = int(faces.max()) + 1
    a, b, c = faces.T.astype(np.int64)
    edge = np.minimum(np.minimum(a * count + b, b * count + c), c * count + a)
    order = np.argsort(edge, kind="stable")
    first, second = np.divmod(edge[order], count)
    third = (a + b + c)[order] - first - second
    return np.stack([first, second, third], axis=1).astype(np.int32)


def _beside_thin_parts(vertices: Float32, plane: Bool) -> Int64:
    """Return the vertices at walls and gaps of one node, whose sides smoothing might push past each other.

    ``plane`` says which nodes of the mid-plane are inside. Vertices count in pitches; each lies on an edge of
    the lattice between two nodes.
    """
    # Higher up there is always a wider layer below, so a ridge of one node is safe and may be smoothed.
    thin = np.zeros_like(plane)
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = np.roll(plane, (down, across), axis=(0, 1))
        other = np.roll(plane, (-down, -across), axis=(0, 1))
        thin |= (one == other) & (one != plane)
    low, high = np.floor(vertices[:, :2]).astype(np.intp), np.ceil(vertices[:, :2]).astype(np.intp)
    return np.flatnonzero(thin[tuple(low.T)] | thin[tuple(high.T)])


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


def bodies_and_holes(vertices: int, faces: AnyArray, rim: int = 0) -> tuple[int, int]:
    """Count the bodies of a closed surface and the holes through them.

    With a ``rim``, the number of vertices in the mid-plane, the surface is the upper half of one.
    """
    from tactile_toolkit.mesh import connected

    corners = faces.astype(np.int64)
    least = connected(corners[:, :2].ravel(), corners[:, 1:].ravel(), vertices)
    bodies = int(np.count_nonzero(least == np.arange(vertices)))
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = 2 * vertices - rim - len(faces) if rim else vertices - len(faces) // 2
    return bodies, bodies - euler // 2
