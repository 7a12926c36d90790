"""The fast way to the same solid: one distance transform, one lattice as fine as the vertex budget allows.

The distance of every pixel from the outline holds all erosions at once. The solid is evaluated as a
real-valued depth on a lattice several pixels wide, so its zero is found between the nodes. Only the upper
half is made; its surface ends in the mid-plane and is mirrored as it is, which makes the mesh symmetric to
the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mnist3d.distance import signed_distance_px
from mnist3d.ink import count_bodies_and_holes, repair_corners
from mnist3d.profile import half_height, occupancy
from mnist3d.steps import marching_cubes, scale, smooth
from mnist3d.storage_order import in_storage_order
from tactile_toolkit.errors import ItemError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mnist3d.spec import SolidSpec
    from tactile_toolkit.mesh.mesh import Mesh

__all__ = ["PlaneLattice", "fit_lattice", "lattice_solid", "mirror_surface"]

FIRST_PITCH_PX = 4.0
LARGEST_PITCH_PX = 8.0
REFINEMENT = 0.8
"""A lattice that loses a gap, a neck or a hole is followed by one this much finer."""

PHASES = ((0.0, 0.0), (0.5, 0.5), (0.5, 0.0), (0.0, 0.5))
"""Offsets tried at each pitch: a gap that one lattice misses may meet the nodes of another."""

BLUR_PER_PITCH = 0.25
RIDGE_BLUR_PER_PITCH = 0.6
RIDGE_DEPTH_PER_PITCH = 1.0
"""Blur near the outline, blur in the depth, and where the one passes into the other.

Distances grow evenly with the depth, so a blur changes nothing there but the ridge of a narrow stroke, whose
height would otherwise go up and down with the places of the nodes.
"""

GRAIN_PX = 2.0**-12
"""Sampled distances are rounded to this, so that no processor's way of adding up shows in a mesh."""

NUDGE = 0.03
"""Least depth of a node in pitches: it keeps the vertices on the edges around a node apart."""

CHORD_LOSS = 0.11
"""How far the surface is set outward, in pitch^2 / R.

Triangles with corners on a cylinder of radius R lie inside it by this much on average: 1/12 to 1/8 by
geometry, this value as measured on 20 of the real digits against the literal solid.
"""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneLattice:
    """Distances from the outline at the nodes of a lattice in the mid-plane.

    Attributes
    ----------
    s_px : ndarray of float32, shape (A, B)
        Distance from the outline in pixels, positive inside.
    pitch_px : float
        Distance of neighbouring nodes.
    first_px : tuple of float
        Row and column of the first node, in pixels of the mask.
    """

    s_px: NDArray[np.float32]
    pitch_px: float
    first_px: tuple[float, float]


def lattice_solid(mask: NDArray[np.bool_], spec: SolidSpec) -> Mesh:
    """Build the solid of an ink mask.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        Clean ink, from :func:`mnist3d.ink.clean`.
    spec : SolidSpec
        The numbers of the algorithm.

    Returns
    -------
    Mesh

    Raises
    ------
    ItemError
        ``topology``: no lattice down to one pixel keeps the bodies and holes of the ink.
    """
    (top, left), crop = _crop(mask, margin_px=math.ceil(2 * LARGEST_PITCH_PX))
    counts = count_bodies_and_holes(crop)
    distance = signed_distance_px(crop, math.ceil(spec.half_thickness_px) + 4, 2 * LARGEST_PITCH_PX)
    for lattice in _lattices(distance, spec):
        if not _may_hold(lattice, counts):
            continue
        vertices, faces = mirror_surface(*_upper_surface(lattice, spec))
        if _bodies_and_holes(vertices, faces) == counts:
            corner = np.array([lattice.first_px[0] + top, lattice.first_px[1] + left, 0], dtype=np.float32)
            return scale(vertices + corner, faces, (mask.shape[0], mask.shape[1]), spec)
    message = f"no lattice keeps the {counts[0]} bodies and {counts[1]} holes of the ink"
    raise ItemError(reason="topology", message=message)


def fit_lattice(distance: NDArray[np.float32], spec: SolidSpec) -> float:
    """Find the pitch at which marching cubes will meet the vertex budget.

    A vertex lies on every edge of the lattice that passes through the surface, so their number is known
    before the surface is made, and it falls with the square of the pitch.

    Parameters
    ----------
    distance : ndarray of float32, shape (H, W)
        From :func:`mnist3d.distance.signed_distance_px`.
    spec : SolidSpec
        The numbers of the algorithm.

    Returns
    -------
    float
        Pixels.
    """
    pitch = FIRST_PITCH_PX
    for _ in range(2):
        rows, columns = (np.arange(0, side - 1, pitch).round().astype(np.intp) for side in distance.shape)
        crossed = _crossed_edges(PlaneLattice(distance[np.ix_(rows, columns)], pitch, (0.0, 0.0)), spec)
        pitch = float(np.clip(pitch * math.sqrt(crossed / spec.target_vertices), 1.0, LARGEST_PITCH_PX))
    return pitch


def mirror_surface(
    vertices: NDArray[np.float32], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Add the lower half to a surface that ends in the mid-plane.

    Parameters
    ----------
    vertices : ndarray of float32, shape (V, 3)
        Upper half; the vertices of its rim have the height 0 exactly.
    faces : ndarray of int32, shape (F, 3)
        Triangles.

    Returns
    -------
    vertices : ndarray of float32
        Those of the upper half, then the mirror images of those off the mid-plane, in the same order.
    faces : ndarray of int32, shape (2 F, 3)
    """
    off_plane = vertices[:, 2] != 0
    image = np.arange(len(vertices), dtype=np.int32)
    image[off_plane] = len(vertices) + np.arange(np.count_nonzero(off_plane), dtype=np.int32)
    lower = vertices[off_plane] * np.array([1, 1, -1], dtype=np.float32)
    return np.concatenate([vertices, lower]), np.concatenate([faces, image[faces][:, [0, 2, 1]]])


def _may_hold(lattice: PlaneLattice, counts: tuple[int, int]) -> bool:
    """Look at the signs in the mid-plane, which settle the matter unless inked nodes touch at a corner."""
    inside = lattice.s_px > 0
    if np.array_equal(repair_corners(inside), inside):
        return count_bodies_and_holes(inside) == counts
    return bool(inside.any())


def _lattices(distance: NDArray[np.float32], spec: SolidSpec) -> Any:
    pitch = (
        fit_lattice(distance, spec)
        if spec.lattice_pitch_mm is None
        else min(spec.lattice_pitch_mm / spec.pixel_pitch_mm, LARGEST_PITCH_PX)
    )
    while pitch > 1:
        for phase in PHASES:
            yield _sample(distance, pitch, phase, BLUR_PER_PITCH)
        pitch *= REFINEMENT
    # Nodes on the pixel centres and no blur: the signs are those of the ink itself.
    yield PlaneLattice(distance, 1.0, (0.0, 0.0))


def _sample(
    distance: NDArray[np.float32], pitch: float, phase: tuple[float, float], blur: float
) -> PlaneLattice:
    rows = np.arange(phase[0] * pitch, distance.shape[0] - 1, pitch)
    columns = np.arange(phase[1] * pitch, distance.shape[1] - 1, pitch)
    s = _blurred(distance, rows, columns, blur * pitch)
    ridge = _blurred(distance, rows, columns, RIDGE_BLUR_PER_PITCH * pitch)
    share = np.clip(s / np.float32(RIDGE_DEPTH_PER_PITCH * pitch) - 1, 0, 1)
    return PlaneLattice(s + share * (ridge - s), pitch, (float(rows[0]), float(columns[0])))


def _blurred(
    distance: NDArray[np.float32], rows: NDArray[np.float64], columns: NDArray[np.float64], sigma: float
) -> NDArray[np.float32]:
    down = _weights(rows, distance.shape[0], sigma)
    across = _weights(columns, distance.shape[1], sigma)
    sampled = down @ distance.astype(np.float64) @ across.T
    return np.asarray(np.round(sampled / GRAIN_PX) * GRAIN_PX, dtype=np.float32)


def _weights(nodes: NDArray[np.float64], count: int, sigma: float) -> NDArray[np.float64]:
    # Twice a Gaussian less a wider one: it lets the waves pass that a Gaussian wears down, so that tips,
    # notches and ridges lose less than half as much, and still holds back what the lattice cannot carry.
    away = (nodes[:, None] - np.arange(count)) / (2 * sigma)
    wide = np.exp(-away * away)
    narrow = wide * wide
    return np.asarray(
        narrow * (2 / narrow.sum(axis=1, keepdims=True)) - wide / wide.sum(axis=1, keepdims=True)
    )


def _heights(pitch: float, spec: SolidSpec) -> NDArray[np.float32]:
    return np.arange(0, spec.half_thickness_px + 2 * pitch, pitch).astype(np.float32)


def _crossed_edges(lattice: PlaneLattice, spec: SolidSpec) -> int:
    top = half_height(lattice.s_px, spec.half_thickness_px, spec.profile)
    layers = np.ceil(top / np.float32(lattice.pitch_px)).astype(np.int32)
    beside = np.abs(np.diff(layers, axis=0)).sum() + np.abs(np.diff(layers, axis=1)).sum()
    inked = layers > 0
    rim = np.count_nonzero(inked[1:] != inked[:-1]) + np.count_nonzero(inked[:, 1:] != inked[:, :-1])
    return int(2 * (beside + np.count_nonzero(inked)) - rim)


def _upper_surface(lattice: PlaneLattice, spec: SolidSpec) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    pitch = lattice.pitch_px
    depth = occupancy(lattice.s_px[:, :, None], _heights(pitch, spec), spec.half_thickness_px, spec.profile)
    depth += np.float32(CHORD_LOSS * pitch**2 / spec.half_thickness_px)
    least = np.float32(NUDGE * pitch)
    depth = np.where(np.abs(depth) < least, np.where(depth > 0, least, -least), depth)
    vertices, faces = marching_cubes(depth, 0.0)
    faces = in_storage_order(faces)
    rim = vertices[:, 2] == 0
    moved = smooth(vertices, faces, spec.smoothing_iterations, spec.smoothing_factor, rim)
    moved = np.where(_beside_thin_places(vertices, depth > 0)[:, None], vertices, moved)
    moved[:, 2] = np.where(rim, 0, np.maximum(moved[:, 2], np.float32(NUDGE)))
    return np.asarray(moved * np.float32(pitch), dtype=np.float32), faces


def _beside_thin_places(vertices: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the vertices at walls and gaps of one node, whose sides smoothing might push past each other.

    Vertices count in pitches; each lies on an edge of the lattice between two nodes.
    """
    # Higher up there is always a wider layer below, so a ridge of one node is safe and may be smoothed.
    plane = inside[:, :, 0]
    thin = np.zeros_like(plane)
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one, other = _shifted(plane, down, across), _shifted(plane, -down, -across)
        thin |= (one == other) & (one != plane)
    low, high = np.floor(vertices[:, :2]).astype(np.intp), np.ceil(vertices[:, :2]).astype(np.intp)
    return np.asarray(thin[tuple(low.T)] | thin[tuple(high.T)])


def _shifted(inside: NDArray[np.bool_], down: int, across: int) -> NDArray[np.bool_]:
    return np.roll(inside, (down, across), axis=(0, 1))


def _bodies_and_holes(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> tuple[int, int]:
    from scipy import sparse
    from scipy.sparse import csgraph

    weights = np.ones(2 * len(faces), dtype=np.int8)
    ends, others = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    links = sparse.coo_matrix((weights, (ends, others)), shape=(len(vertices), len(vertices)))
    bodies = int(csgraph.connected_components(links, directed=False)[0])
    # Every edge of a closed surface borders two triangles, so V - E + F is V - F / 2.
    euler = len(vertices) - len(faces) // 2
    return bodies, bodies - euler // 2


def _crop(mask: NDArray[np.bool_], margin_px: int) -> tuple[tuple[int, int], NDArray[np.bool_]]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    inked = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    corner = (int(rows[0]) - margin_px, int(columns[0]) - margin_px)
    return corner, np.pad(inked, margin_px)
