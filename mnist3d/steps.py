"""The published steps from ink to mesh, one function each (Tactile MNIST paper, algorithm on MNIST 3D).

Arrays of pixels are (rows, columns), stacks of layers (rows, columns, height). Surfaces are pairs of vertices
(float32, shape (V, 3)) and faces (int32, shape (F, 3), counter-clockwise seen from outside); their
coordinates are (row, column, height above the mid-plane) in pixels until :func:`scale`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mnist3d.ink import count_bodies_and_holes
from mnist3d.side_view import erosion_radius_px
from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh.crossings import self_crossing
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mnist3d.spec import SolidSpec

__all__ = [
    "BUDGET_SLACK",
    "bodies_and_holes",
    "decimate",
    "erode",
    "erosion_radii_px",
    "literal_solid",
    "marching_cubes",
    "mirror",
    "scale",
    "smooth",
    "stack",
]

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


def literal_solid(mask: NDArray[np.bool_], spec: SolidSpec, *, decimated: bool = True) -> Mesh:
    """Build the solid of clean ink as the algorithm is printed: the oracle that the fast way is held to.

    Binary layers at full resolution, marching cubes on the binary stack, smoothing, and only then a
    decimation to the vertex budget (left out with ``decimated=False``). Slow and plain on purpose.

    Raises ItemError ``topology`` where the surface has not the bodies and holes of the ink,
    ``vertex-budget`` as :func:`decimate`.
    """
    layers = [erode(mask, radius) for radius in erosion_radii_px(spec)]
    # A margin of empty voxels closes the surface; the shift by one pixel undoes it.
    volume = np.pad(mirror(stack(layers)), 1)
    vertices, faces = marching_cubes(volume, 0.5)
    counts, found = count_bodies_and_holes(mask), bodies_and_holes(vertices, faces)
    if found != counts:
        message = (
            f"the layers of the ink, stacked, have {found[0]} bodies and {found[1]} holes; the ink has "
            f"{counts[0]} and {counts[1]}; next: leave the digit out, or try method='fast'"
        )
        raise ItemError(reason="topology", message=message)
    vertices = smooth(vertices, faces, spec.literal_smoothing_iterations, spec.smoothing_factor)
    mesh = scale(vertices - np.float32(1), faces, (mask.shape[0], mask.shape[1]), spec)
    return decimate(mesh, spec.target_vertices) if decimated else mesh


def erosion_radii_px(spec: SolidSpec) -> NDArray[np.float64]:
    """List the erosion radius of each layer above the mid-plane, in increasing order.

    Layer k is one pixel thick and its middle lies k + 0.5 px up.
    """
    heights = np.arange(round(spec.half_thickness_px)) + 0.5
    return np.asarray(erosion_radius_px(heights, spec), dtype=np.float64)


def erode(mask: NDArray[np.bool_], radius_px: float) -> NDArray[np.bool_]:
    """Let the ink draw in from its outline by a radius; beyond the image is paper.

    The outline lies half a pixel outside the outermost centres, so this is binary erosion with a disc of the
    offsets shorter than ``radius_px + 0.5``. The usual disc, of offsets up to the radius, leaves half a pixel
    more: ``SolidSpec.erosion`` chooses between them by the radii of :func:`erosion_radii_px`.
    """
    from scipy import ndimage

    # One transform serves any radius; repeated small erosions would draw polygons.
    distance: Any = ndimage.distance_transform_edt(np.pad(mask, 1))
    return np.asarray(mask & (distance[1:-1, 1:-1] >= radius_px + 0.5))


def stack(layers: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Put layers of shape (H, W) on top of one another, from the mid-plane up."""
    return np.stack(layers, axis=2)


def mirror(volume: NDArray[Any]) -> NDArray[Any]:
    """Add the lower half to the layers above the mid-plane."""
    return np.concatenate([volume[:, :, ::-1], volume], axis=2)


def marching_cubes(
    volume: NDArray[Any], level: float, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Extract the surface at which a volume, larger inside the solid, passes a level.

    Coordinates are in the order of the axes, 0 at the first node, ``spacing`` between nodes.
    """
    from skimage import measure

    extract: Any = measure.marching_cubes
    # "descent", scikit-image's default, would turn the triangles of such a volume inwards.
    vertices, faces, _, _ = extract(
        np.ascontiguousarray(volume, dtype=np.float32), level, spacing=spacing, gradient_direction="ascent"
    )
    return vertices.astype(np.float32, copy=False), faces.astype(np.int32, copy=False)


def smooth(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.int32],
    iterations: int,
    factor: float,
    held: NDArray[np.bool_] | None = None,
) -> NDArray[np.floating[Any]]:
    """Even out a surface without shrinking it (Taubin 1995).

    Each round is a step of ``factor`` of the way to the middle of the neighbours and a slightly longer one
    back. Vertices that are ``held`` keep their last coordinate: with the rim of the upper half of a mirrored
    surface held, the half moves exactly as it would within the whole.
    """
    from scipy import sparse

    ends = faces[:, [0, 1, 2, 1, 2, 0]].T.reshape(-1)
    others = faces[:, [1, 2, 0, 0, 1, 2]].T.reshape(-1)
    weights = np.ones(len(ends), dtype=np.float32)
    average: Any = sparse.csr_matrix((weights, (ends, others)), shape=(len(vertices), len(vertices)))
    counts = np.bincount(ends, minlength=len(vertices))
    # The order in which neighbours are added decides the last bit: here from the last to the first.
    starts, sizes = average.indptr, np.diff(average.indptr)
    backwards = np.repeat(starts[:-1] + starts[1:] - 1, sizes) - np.arange(starts[-1])
    # A vertex without a face has no neighbours and stays where it is.
    shares = np.float32(1) / np.maximum(counts, 1).astype(np.float32)
    average.data = average.data[backwards] * np.repeat(shares, sizes)
    average.indices = average.indices[backwards]
    for _ in range(iterations):
        for share in (factor, factor * TAUBIN_RATIO):
            moved = vertices + np.float32(share) * (average @ vertices - vertices)
            if held is not None:
                moved[held, 2] = vertices[held, 2]
            vertices = moved
    return vertices


def scale(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.int32], shape: tuple[int, int], spec: SolidSpec
) -> Mesh:
    """Turn pixels of an image of that shape into metres and set the solid on the plate.

    The middle of the image becomes the origin, the lowest point lies at z = 0; vertices end on the storage
    grid.
    """
    row, column, height = vertices.astype(np.float64).T
    centred = np.stack([column - (shape[1] - 1) / 2, (shape[0] - 1) / 2 - row, height], axis=1)
    vertices_mm = centred * spec.pixel_pitch_mm
    if spec.vertex_quantum_mm > 0:
        # Rounded about the mid-plane, where up and down round alike, and only then set on the plate.
        vertices_mm = np.round(vertices_mm / spec.vertex_quantum_mm) * spec.vertex_quantum_mm
    vertices_mm[:, 2] -= vertices_mm[:, 2].min()
    return Mesh((vertices_mm / MM_PER_M).astype(np.float32), faces)


def decimate(mesh: Mesh, target_vertices: int) -> Mesh:
    """Drop the vertices that matter least until the budget is met; a mesh within it comes back itself.

    A mesh with more than 1.5 times as many vertices, but at most 3 times, keeps up to 1.5 times as many.
    Raises ItemError ``vertex-budget`` where even these are too few for its bodies and holes.
    """
    if len(mesh.vertices_m) <= target_vertices:
        return mesh
    counts = bodies_and_holes(mesh.vertices_m, mesh.faces)
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
        message = (
            f"the digit needs {found:,} vertices to keep its {counts[0]} bodies and {counts[1]} holes; "
            f"{target_vertices:,} were asked for, and at most {BUDGET_SLACK:g} times as many are given; "
            f"next: ask for {math.ceil(found / BUDGET_SLACK):,} (target_vertices, --vertices)"
        )
        raise ItemError(reason="vertex-budget", message=message)
    return _mesh_of(solid)


def _mesh_of(solid: Any) -> Mesh:
    simplified = solid.to_mesh64()
    vertices_m = np.asarray(simplified.vert_properties)[:, :3] / MM_PER_M
    vertices_m[:, 2] -= vertices_m[:, 2].min()
    return Mesh(vertices_m.astype(np.float32), np.asarray(simplified.tri_verts).astype(np.int32))


def _crosses_itself(mesh: Mesh, bodies: int) -> bool:
    vertices_mm = mesh.vertices_m.astype(np.float64) * MM_PER_M
    return self_crossing(vertices_mm, mesh.faces.astype(np.int64), bodies) is not None


def _is_held(solid: Any, counts: tuple[int, int]) -> bool:
    """Tell whether a symmetric solid has so many bodies and holes, and no walls of it have met."""
    mesh = solid.to_mesh64()
    if bodies_and_holes(np.asarray(mesh.vert_properties), np.asarray(mesh.tri_verts)) != counts:
        return False
    low, high = solid.bounding_box()[2], solid.bounding_box()[5]
    # Walls meet in the mid-plane first, where the solid is widest.
    return len(solid.slice((low + high) / 2).to_polygons()) == sum(counts)


def bodies_and_holes(vertices: NDArray[Any], faces: NDArray[Any], rim: int | None = None) -> tuple[int, int]:
    """Count the bodies of a closed surface and the holes through them.

    With a ``rim``, the number of vertices in the mid-plane, the surface is the upper half of one.
    """
    from scipy import sparse
    from scipy.sparse import csgraph

    # Nodes for the triangles and then for the vertices; only the former lead anywhere, and to three each.
    starts = np.minimum(3 * np.arange(len(faces) + len(vertices) + 1), 3 * len(faces))
    weights, nodes = np.ones(3 * len(faces)), faces.ravel() + len(faces)
    links = sparse.csr_matrix((weights, nodes, starts), shape=(len(starts) - 1, len(starts) - 1))
    bodies = int(csgraph.connected_components(links, directed=False)[0])
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = len(vertices) - len(faces) // 2 if rim is None else 2 * len(vertices) - rim - len(faces)
    return bodies, bodies - euler // 2
