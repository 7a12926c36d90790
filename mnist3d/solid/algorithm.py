"""Algorithm 1 of the Tactile MNIST paper: a printable solid from a digit image.

Most users need :func:`solidify` only. :func:`solid_steps` takes the steps in order, from the ink that
:func:`~mnist3d.ink.binarisation.binarise` returns: :func:`erode`, :func:`stack`, :func:`marching_cubes`,
:func:`smooth`, :func:`mirror` and :func:`scale`. :func:`literal_solid` takes them as they are printed.

The printed algorithm erodes the ink with one kernel after another and stacks the binary layers. Here the
distance of each pixel from the outline holds all erosions at once: a kernel of radius r leaves the pixels
that are farther than r from the outline. :func:`erode` returns how deep each node lies in the eroded ink, not
only whether it lies in it. Marching cubes then find the surface between the nodes, which may lie several
pixels apart. The paper mirrors before marching cubes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Unpack

import manifold3d
import numpy as np
from scipy import ndimage
from skimage import measure

from mnist3d import compiled_loops
from mnist3d.digit_options import SizeKeywords, SolidSize, SolidSpec
from mnist3d.ink import binarisation, grey_levels
from mnist3d.solid import picture_ink
from mnist3d.solid.lattice import Lattice, depth_px, erosion_radius_px, lattice_of
from tactile_toolkit import mesh as meshes
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int32, Int64, UInt8

CHORD_LOSS = 0.11
"""Distance by which the surface is moved outwards, in units of pitch^2 / R.

Triangles with corners on a cylinder of radius R lie inside it by this much on average: 1/12 to 1/8 by
geometry, 0.11 as measured on 20 real digits against the literal solid.
"""
TAUBIN_RATIO = -1.06
"""Ratio of the outward to the inward step that keeps the volume (Taubin 1995: slightly above one)."""

FIRST_TOLERANCE_MM = 0.01

# Several passes of growing tolerance leave fewer and better placed vertices than one with a wide tolerance.
TOLERANCE_GROWTH = 1.25

# A single pass is tried for meshes of up to this many times the allowed vertices.
MAX_FOR_ONE_PASS = 2.0

E_FOLD_MM = 0.1
"""Tolerance at which one pass leaves about 1/e of the vertices."""

FLAT_MM = (0.01, 0.002)
"""Largest distances of a vertex from the surface without it, in even parts of drawings, tried in order."""

BUDGET_SLACK = 1.5
"""Largest number of vertices, as a multiple of the budget."""


def solidify(
    picture: picture_ink.PictureLike,
    spec: SolidSpec | None = None,
    *,
    base_mm: float | None = None,
    method: Literal["fast", "literal"] = "fast",
    ink: Literal["auto", "dark", "light"] = "auto",
    threshold: Literal["auto", "local", "global"] = "auto",
    **size: Unpack[SizeKeywords],
) -> meshes.Mesh:
    """Turn a picture into a closed, printable mesh; ``mnist3d solidify`` makes the same one.

    Parameters
    ----------
    picture : path, PIL.Image.Image or ndarray
        A file, an image, or an array of shape (H, W), (H, W, 3) or (H, W, 4), row 0 at the top. Integers
        count from 0 to 255, floats from 0 to 1 or to 255; bool is accepted too. The picture may show any
        drawing: a digit, a word, a logo.
    spec : SolidSpec, optional
        Parameters of the algorithm; the published ones by default. Without it, pictures other than grey
        levels are drawings to print: they keep specks down to 0.64 mm^2, get as many vertices as their
        strokes need, and stand on a flat underside, exactly as thick as ``half_thickness_mm`` says.
    base_mm : float, optional
        Put the upper half of the solid on a plate of this thickness, which joins separate parts.
    method : {"fast", "literal"}
        ``"fast"``: one distance transform and a lattice of real values; ``"literal"``: the algorithm as the
        paper prints it.
    ink : {"auto", "dark", "light"}
        Which part is ink. ``"auto"`` takes the margin of a clean image for paper and evens out the light of
        photographs and scans (``mnist3d.ink.photographs``); with ``spec.threshold``, levels up to it are ink.
        ``"dark"`` and ``"light"`` apply one threshold to a whole array of grey levels.
    threshold : {"auto", "local", "global"}
        Even out the light and find the page, or apply one threshold to the picture; ``"auto"`` takes
        ``"local"`` for pictures without clean paper.
    **size
        At most one of ``height_mm``, ``width_mm`` and ``pixel_mm``: size of the solid along y or x, or of a
        pixel. By default, the longer side of the picture is 500 pixels of ``spec.pixel_pitch_mm``: 100 mm.

    Returns
    -------
    Mesh
        Metres. Origin at the centre of the picture or, with ``height_mm`` or ``width_mm``, of its ink; x
        right, y up, z out of the plate, lowest point at z = 0.

    Raises
    ------
    ItemError
        The picture cannot be used; ``reason`` is one of ``unreadable``, ``bad-shape``, ``bad-dtype``,
        ``bad-pixels``, ``not-finite``, ``too-small``, ``unclear-ink``, ``no-ink``, ``all-ink``, ``cut-off``,
        ``topology``, ``vertex-budget``.
    InputError
        An option is unknown, or two sizes are given.
    """
    if method not in ("fast", "literal"):
        raise InputError(f"method is {method!r}; expected 'fast' or 'literal'")
    sized = picture_ink.sized_ink(picture, spec, SolidSize(**size), which=ink, threshold=threshold)
    return solid_of_ink(sized, base_mm, method)


def solid_of_ink(
    sized: picture_ink.SizedInk, base_mm: float | None = None, method: str = "fast"
) -> meshes.Mesh:
    """Build the solid of ink on its sheet; see :func:`solidify`."""
    if method == "literal":
        made = literal_solid(sized.mask, sized.spec)
    else:
        made = solid_steps(sized.mask, sized.spec).mesh
    if not sized.is_drawing:
        made = fit_to_size(made, sized.size)
        return made if base_mm is None else meshes.with_flat_underside(made, base_mm)
    thickness_mm = sized.spec.half_thickness_mm * (2 if base_mm is None else 1)
    if sized.spec.lattice_pitch_mm is not None:
        for tolerance_mm in FLAT_MM:
            simpler = without_flat_vertices(made, tolerance_mm)
            # Without some vertices, the surface may cross itself.
            with suppress(ItemError):
                if simpler is not None:
                    return meshes.with_flat_underside(fit_to_size(simpler, sized.size), base_mm, thickness_mm)
    return meshes.with_flat_underside(fit_to_size(made, sized.size), base_mm, thickness_mm)


def solid_of_sheet(pixels: UInt8, spec: SolidSpec, *, is_drawing: bool = False) -> meshes.Mesh:
    """Build the solid of a digit that a source has drawn on its sheet, dark ink on light paper.

    For a drawing, parts as thin as its strokes are kept, such as the dot of an i.
    """
    if is_drawing:
        spec = picture_ink.for_strokes(binarisation.ink_of_levels(pixels, spec.threshold), spec)
    return solid_steps(binarisation.binarise(pixels, spec, ink="dark"), spec).mesh


class SolidSteps(NamedTuple):
    """The results of the steps from ink to mesh.

    Attributes
    ----------
    lattice : Lattice
        Nodes at which the solid is evaluated.
    upper_half : ndarray of float32, shape (R, C, L)
        Depth of the nodes of the layers from the mid-plane up, pixels, positive inside.
    surface : Surface
        Surface of the upper half, before smoothing.
    mesh : Mesh
        The finished solid.
    """

    lattice: Lattice
    upper_half: Float32
    surface: Surface
    mesh: meshes.Mesh


def solid_steps(ink: Bool, spec: SolidSpec) -> SolidSteps:
    """Build the solid of clean ink, on finer lattices until it has all bodies and holes of the ink.

    Raises ItemError ``topology`` or ``vertex-budget``.
    """
    lattice = lattice_of(ink, spec)
    ink_counts = binarisation.count_bodies_and_holes(lattice.ink)
    while True:
        layers = erode(lattice, lattice.heights_px(spec), spec)
        upper_half = stack(list(layers))
        surface = marching_cubes(upper_half, lattice)
        smoothed = smooth(surface, spec.smoothing_iterations, spec.smoothing_factor)
        surface_counts = bodies_and_holes(len(smoothed.vertices_px), smoothed.faces, len(smoothed.rim))
        if surface_counts == ink_counts:
            break
        finer = lattice.finer(layers[0] > 0)
        if finer is None:
            grey_levels.refuse("topology", *ink_counts, *surface_counts)
        lattice = finer
    mesh = scale(mirror(smoothed), ink.shape, spec)
    # With a given pitch, the number of vertices follows from it.
    if spec.lattice_pitch_mm is None and len(mesh.vertices_m) > BUDGET_SLACK * spec.target_vertices:
        mesh = decimate(mesh, spec.target_vertices)
    return SolidSteps(lattice, upper_half, surface, mesh)


def erode(lattice: Lattice, heights_px: Float32, spec: SolidSpec) -> Float32:
    """Return the depth of each node in the layers at heights, shape (L, 1, 1): pixels, shape (L, R, C).

    It is positive where binary erosion with the kernel of this height keeps the node, and 0 on the surface.
    """
    outwards_px = np.float32(CHORD_LOSS * lattice.pitch_px**2 / spec.half_thickness_px)
    depth = depth_px(lattice.s_px, heights_px, spec) + outwards_px
    # A node on the surface itself would give triangles without area.
    min_depth_px = lattice.min_depth_px
    return np.where(np.abs(depth) < min_depth_px, np.where(depth > 0, min_depth_px, -min_depth_px), depth)


def stack(layers: Sequence[AnyArray]) -> AnyArray:
    """Put layers of shape (H, W) on top of one another, from the mid-plane up: shape (H, W, L)."""
    return np.stack(layers, axis=2)


def marching_cubes(upper_half: Float32, lattice: Lattice) -> Surface:
    """Return the surface of the upper half of a solid, where the depth of the nodes passes 0."""
    vertices, faces = isosurface(upper_half, 0.0)
    fixed = _beside_thin_parts(vertices, upper_half[:, :, 0] > 0)
    for axis, nodes in enumerate((lattice.rows_px, lattice.columns_px)):
        vertices[:, axis] = np.interp(vertices[:, axis], np.arange(len(nodes)), nodes)
    vertices[:, 2] *= np.float32(lattice.pitch_px)
    rim = np.flatnonzero(vertices[:, 2] == 0)
    corner_px = (*lattice.corner_px, 0)
    min_z_px = float(lattice.min_depth_px)
    return Surface(vertices, _in_storage_order(faces), corner_px, rim, fixed, min_z_px)


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
        before = np.roll(plane, (down, across), axis=(0, 1))
        after = np.roll(plane, (-down, -across), axis=(0, 1))
        thin |= (before == after) & (before != plane)
    low, high = np.floor(vertices[:, :2]).astype(np.intp), np.ceil(vertices[:, :2]).astype(np.intp)
    return np.flatnonzero(thin[tuple(low.T)] | thin[tuple(high.T)])


def smooth(surface: Surface, iterations: int, factor: float) -> Surface:
    """Smooth a surface without shrinking it (Taubin 1995).

    Each round moves vertices by ``factor`` of the way to the mean of their neighbours, and then back by a
    slightly longer step. The rim stays in the mid-plane, so an upper half moves as it would in the whole.
    """
    rim = surface.rim
    is_in_plane = np.bincount(rim, minlength=len(surface.vertices_px))
    step_factors = np.array([factor, factor * TAUBIN_RATIO] * iterations, np.float32)
    vertices = compiled_loops.smoothed(surface.vertices_px.copy(), surface.faces, is_in_plane, step_factors)
    # A wall that folds is not a solid, so thin parts are not smoothed.
    vertices[surface.fixed] = surface.vertices_px[surface.fixed]
    vertices[:, 2] = np.maximum(vertices[:, 2], np.float32(surface.min_z_px))
    vertices[rim, 2] = 0
    return replace(surface, vertices_px=vertices)


def mirror(upper: Surface) -> Surface:
    """Add the mirror image of the upper half of a surface, and join both at the rim.

    The paper mirrors the stack of layers. Marching cubes and smoothing treat both halves alike, so mirroring
    after them gives the same surface in half the time, and its halves agree to the last bit.

    The mirrored vertices follow those of the upper half, in the same order; those of the rim are not doubled.
    """
    count = len(upper.vertices_px)
    off_plane = np.delete(np.arange(count), upper.rim)
    image = np.arange(count, dtype=np.int32)
    image[off_plane] = count + np.arange(len(off_plane), dtype=np.int32)
    below = upper.vertices_px.take(off_plane, 0) * np.array([1, 1, -1], np.float32)
    faces = np.concatenate([upper.faces, image.take(upper.faces[:, [0, 2, 1]])])
    return replace(upper, vertices_px=np.concatenate([upper.vertices_px, below]), faces=faces)


def scale(surface: Surface, shape: tuple[int, ...], spec: SolidSpec) -> meshes.Mesh:
    """Convert a surface from pixels of an image of the given shape to metres, and set it on the plate.

    The centre of the image becomes the origin, the lowest point lies at z = 0. Vertices end on the grid on
    which they are stored.
    """
    corner_px = np.array(surface.corner_px, dtype=np.float32)
    row, column, height = (surface.vertices_px + corner_px).astype(np.float64).T
    centred = np.stack([column - (shape[1] - 1) / 2, (shape[0] - 1) / 2 - row, height], axis=1)
    vertices_mm = centred * spec.pixel_pitch_mm
    if spec.vertex_quantum_mm > 0:
        # Rounded about the mid-plane, where up and down round alike, and only then set on the plate.
        vertices_mm = np.round(vertices_mm / spec.vertex_quantum_mm) * spec.vertex_quantum_mm
    vertices_mm[:, 2] -= vertices_mm[:, 2].min()
    return meshes.Mesh((vertices_mm / meshes.MM_PER_M).astype(np.float32), surface.faces)


def fit_to_size(solid: meshes.Mesh, size: SolidSize) -> meshes.Mesh:
    """Scale a solid along x and y to a given height or width; the thickness stays.

    The size of the pixels does not determine it: the outline lies between pixels, cleaning moves it, and the
    lattice cuts off tips, which adds up to more than half a millimetre. The middle of the solid becomes the
    origin of x and y.
    """
    asked = next(((axis, mm) for axis, mm in enumerate((size.width_mm, size.height_mm)) if mm), None)
    if asked is None:
        return solid
    axis, asked_mm = asked
    vertices_m = solid.vertices_m.astype(np.float64)
    low, high = vertices_m[:, :2].min(axis=0), vertices_m[:, :2].max(axis=0)
    vertices_m[:, :2] -= (low + high) / 2
    vertices_m[:, :2] *= asked_mm / meshes.MM_PER_M / float(high[axis] - low[axis])
    return meshes.Mesh(vertices_m.astype(np.float32), solid.faces)


def literal_solid(ink: Bool, spec: SolidSpec, *, decimated: bool = True) -> meshes.Mesh:
    """Build the solid of clean ink as the paper prints it: the reference for the fast method, slow and plain.

    Binary layers at full resolution, marching cubes on the binary stack, smoothing, then decimation to the
    vertex budget; ``decimated=False`` leaves the solid as fine as its pixels.

    Raises ItemError ``topology`` if the surface has other numbers of bodies or holes than the ink, and
    ``vertex-budget`` as :func:`mnist3d.solid.algorithm.decimate` does.
    """
    upper_half = stack([eroded_by_disc(ink, radius_px) for radius_px in erosion_radii_px(spec)])
    volume = np.concatenate([upper_half[:, :, ::-1], upper_half], axis=2)
    # A margin of empty voxels closes the surface; the corner undoes the shift by one pixel.
    surface = Surface(*isosurface(np.pad(volume, 1), 0.5), corner_px=(-1, -1, -1))
    ink_counts = binarisation.count_bodies_and_holes(ink)
    surface_counts = bodies_and_holes(len(surface.vertices_px), surface.faces)
    if surface_counts != ink_counts:
        grey_levels.refuse("topology", *surface_counts, *ink_counts, sentence="layers")
    smoothed = smooth(surface, spec.literal_smoothing_iterations, spec.smoothing_factor)
    mesh = scale(smoothed, ink.shape, spec)
    if decimated:
        mesh = decimate(mesh, spec.target_vertices)
    return mesh


def erosion_radii_px(spec: SolidSpec) -> Float64:
    """List the erosion radius of each layer above the mid-plane, in increasing order.

    Layer k is one pixel thick and its middle lies k + 0.5 px up.
    """
    heights = np.arange(round(spec.half_thickness_px)) + 0.5
    return np.asarray(erosion_radius_px(heights, spec), dtype=np.float64)


def eroded_by_disc(ink: Bool, radius_px: float) -> Bool:
    """Erode ink by a radius, measured from its outline; outside the image is paper.

    The outline lies half a pixel outside the outermost centres, so this is binary erosion with a disc of all
    offsets shorter than ``radius_px + 0.5``. The usual disc, of offsets up to the radius, leaves half a pixel
    more. ``SolidSpec.erosion`` chooses between them through the radii of :func:`erosion_radii_px`.
    """
    # One transform serves any radius; repeated small erosions would draw polygons.
    distance = np.asarray(ndimage.distance_transform_edt(np.pad(ink, 1)))
    return np.asarray(ink & (distance[1:-1, 1:-1] >= radius_px + 0.5))


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
    rim, fixed : ndarray of int
        Rows of the vertices that smoothing keeps in the mid-plane, and of those that it does not move.
    min_z_px : float
        Least height of all other vertices after smoothing.
    """

    vertices_px: Float32
    faces: Int32
    corner_px: tuple[int, int, int] = (0, 0, 0)
    rim: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    fixed: Int64 = field(default_factory=lambda: np.zeros(0, np.intp))
    min_z_px: float = -math.inf


def bodies_and_holes(vertices: int, faces: AnyArray, rim: int = 0) -> tuple[int, int]:
    """Count the bodies of a closed surface and the holes through them.

    ``vertices`` is the number of vertices. For the upper half of a surface, ``rim`` is the number of those in
    the mid-plane.
    """
    corners = faces.astype(np.int64)
    least = meshes.connected(corners[:, :2].ravel(), corners[:, 1:].ravel(), vertices)
    bodies = int(np.count_nonzero(least == np.arange(vertices)))
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = vertices - len(faces) // 2
    if rim:
        euler = 2 * vertices - rim - len(faces)
    return bodies, bodies - euler // 2


def decimate(mesh: meshes.Mesh, target_vertices: int) -> meshes.Mesh:
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
    vertices = solid.num_vert()
    if vertices > most:
        enough = math.ceil(vertices / BUDGET_SLACK)
        grey_levels.refuse("vertex-budget", vertices, *counts, target_vertices, BUDGET_SLACK, enough)
    return _mesh_of(solid)


def without_flat_vertices(mesh: meshes.Mesh, tolerance_mm: float) -> meshes.Mesh | None:
    """Remove vertices that change the surface by a tolerance at most; None if bodies or holes would be lost.

    Fine lattices have many of them in even parts: a drawing keeps a fifth of its triangles. The result may
    cross itself.
    """
    counts = bodies_and_holes(len(mesh.vertices_m), mesh.faces)
    solid = mesh.to_manifold().simplify(tolerance_mm)
    return _mesh_of(solid) if _keeps_topology(solid, counts) else None


def _mesh_of(solid: manifold3d.Manifold) -> meshes.Mesh:
    mesh = meshes.Mesh.from_manifold(solid)
    mesh.vertices_m[:, 2] -= mesh.vertices_m[:, 2].min()
    return meshes.Mesh(mesh.vertices_m.astype(np.float32), mesh.faces)


def _keeps_topology(solid: manifold3d.Manifold, counts: tuple[int, int]) -> bool:
    """Return whether a symmetric solid has these bodies and holes, and none of its walls have met."""
    if bodies_and_holes(solid.num_vert(), np.asarray(solid.to_mesh64().tri_verts)) != counts:
        return False
    low, high = solid.bounding_box()[2], solid.bounding_box()[5]
    # Walls meet first in the mid-plane, where the solid is widest.
    return len(solid.slice((low + high) / 2).to_polygons()) == sum(counts)
