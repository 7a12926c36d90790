"""The fast way to the same solid: one distance transform, one lattice as fine as the vertex budget allows.

The distance of every pixel from the outline holds all erosions at once. The solid is evaluated as a
real-valued depth on a lattice several pixels wide, so its zero is found between the nodes. Only the upper
half is made; its surface ends in the mid-plane and is mirrored as it is, which makes the mesh symmetric to
the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mnist3d.ink import count_bodies_and_holes, repair_corners
from mnist3d.spec import depth_px, half_height_px
from mnist3d.steps import marching_cubes, scale, smooth
from tactile_toolkit.arithmetic import decay
from tactile_toolkit.errors import ItemError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mnist3d.spec import SolidSpec
    from tactile_toolkit.mesh.mesh import Mesh

__all__ = ["distance_px", "lattice_solid", "signed_distance_px"]

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
height would otherwise go up and down with where the nodes happen to lie.
"""

GRAIN_PX = 2.0**-12
"""Sampled distances are rounded to this."""

_FACTOR_GRAIN_PX, _WEIGHT_GRAIN = 2.0**-16, 2.0**-24
"""Grids of what is sampled, below 2^7 px, and of weights, below 2: their sums need no more than 50 bits."""

NUDGE = 0.03
"""Least depth of a node in pitches: it keeps the vertices on the edges around a node apart."""

CHORD_LOSS = 0.11
"""How far the surface is set outward, in pitch^2 / R.

Triangles with corners on a cylinder of radius R lie inside it by this much on average: 1/12 to 1/8 by
geometry, this value as measured on 20 of the real digits against the literal solid.
"""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneLattice:
    """Distances from the outline at the nodes of a lattice in the mid-plane, in pixels.

    ``s_px`` is positive inside, ``pitch_px`` the distance of neighbouring nodes, ``first_px`` the row and
    column of the first node.
    """

    s_px: NDArray[np.float32]
    pitch_px: float
    first_px: tuple[float, float]


def lattice_solid(mask: NDArray[np.bool_], spec: SolidSpec) -> Mesh:
    """Build the solid of clean ink (:func:`mnist3d.ink.clean`).

    Raises ItemError ``topology`` where no lattice down to one pixel keeps the bodies and holes of the ink.
    """
    # Two nodes of paper on each side even at the coarsest pitch, so that the surface closes.
    margin_px = math.ceil(2 * LARGEST_PITCH_PX)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = int(rows[0]) - margin_px, int(columns[0]) - margin_px
    crop = np.pad(mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], margin_px)
    counts = count_bodies_and_holes(crop)
    # Deeper than the half thickness the surface is flat; 4 px more keep the cut-off out of the blur there.
    distance = signed_distance_px(crop, math.ceil(spec.half_thickness_px) + 4, 2 * LARGEST_PITCH_PX)
    for lattice in _lattices(distance, spec):
        if not _may_hold(lattice, counts):
            continue
        vertices, faces = _mirror_surface(*_upper_surface(lattice, spec))
        if _bodies_and_holes(vertices, faces) == counts:
            corner = np.array([lattice.first_px[0] + top, lattice.first_px[1] + left, 0], dtype=np.float32)
            return scale(vertices + corner, faces, (mask.shape[0], mask.shape[1]), spec)
    message = f"no lattice keeps the {counts[0]} bodies and {counts[1]} holes of the ink"
    raise ItemError(reason="topology", message=message)


def signed_distance_px(mask: NDArray[np.bool_], inside_px: float, outside_px: float) -> NDArray[np.float32]:
    """Measure how far each pixel centre lies from the outline of the ink, positive inside, up to two reaches.

    The outline runs between pixels, half a pixel from the centres on either side of it. What lies beyond the
    image is paper only if the image says so at its edge.
    """
    inside = distance_px(mask, inside_px + 0.5)
    outside = distance_px(~mask, outside_px + 0.5)
    return np.where(mask, inside - np.float32(0.5), np.float32(0.5) - outside)


def distance_px(mask: NDArray[np.bool_], reach_px: float) -> NDArray[np.float32]:
    """Measure how far each marked pixel centre lies from the nearest unmarked one.

    Exact up to ``reach_px`` (below 128) and that value beyond. First along the columns, then over the offsets
    of the rows (Felzenszwalb and Huttenlocher 2012 write the transform that way); with a short reach plain
    passes over small integers beat their lower envelope.
    """
    reach = math.ceil(reach_px)
    height, width = mask.shape
    rows = np.arange(height, dtype=np.int16)[:, None]
    above = np.maximum.accumulate(np.where(mask, np.int16(-reach), rows), axis=0)
    below = np.minimum.accumulate(np.where(mask, np.int16(height + reach), rows)[::-1], axis=0)[::-1]
    along_columns = np.minimum(np.minimum(rows - above, below - rows), np.int16(reach))
    squared = along_columns * along_columns
    padded = np.full((height, width + 2 * reach), reach * reach, dtype=np.int16)
    padded[:, reach : reach + width] = squared
    beside = np.empty_like(squared)
    for offset in range(1, reach):
        left, right = reach - offset, reach + offset
        np.minimum(padded[:, left : left + width], padded[:, right : right + width], out=beside)
        beside += np.int16(offset * offset)
        np.minimum(squared, beside, out=squared)
    return np.asarray(np.minimum(np.sqrt(squared, dtype=np.float32), np.float32(reach_px)))


def _lattices(distance: NDArray[np.float32], spec: SolidSpec) -> Iterator[PlaneLattice]:
    """Sample the distances at finer and finer lattices, from the vertex budget's pitch down to the pixels."""
    if spec.lattice_pitch_mm is None:
        pitch_px = _fitting_pitch_px(distance, spec)
    else:
        pitch_px = min(spec.lattice_pitch_mm / spec.pixel_pitch_mm, LARGEST_PITCH_PX)
    while pitch_px > 1:
        for phase in PHASES:
            yield _sample(distance, pitch_px, phase)
        pitch_px *= REFINEMENT
    # Nodes on the pixel centres and no blur: the signs are those of the ink itself.
    yield PlaneLattice(distance, 1.0, (0.0, 0.0))


def _fitting_pitch_px(distance: NDArray[np.float32], spec: SolidSpec) -> float:
    """Find the pitch at which marching cubes will meet the vertex budget.

    A vertex lies on every edge of the lattice that passes through the surface, so their number is known
    before the surface is made, and it falls with the square of the pitch.
    """
    pitch = FIRST_PITCH_PX
    for _ in range(2):  # the second round corrects for what the first lattice was too coarse to see
        rows, columns = (np.arange(0, side - 1, pitch).round().astype(np.intp) for side in distance.shape)
        crossed = _crossed_edges(distance[np.ix_(rows, columns)], pitch, spec)
        pitch = float(np.clip(pitch * math.sqrt(crossed / spec.target_vertices), 1.0, LARGEST_PITCH_PX))
    return pitch


def _crossed_edges(s_px: NDArray[np.float32], pitch_px: float, spec: SolidSpec) -> int:
    """Count the edges that pass through the whole surface: beside and above the nodes, the rim only once."""
    layers = np.ceil(half_height_px(s_px, spec) / np.float32(pitch_px)).astype(np.int32)
    beside = np.abs(np.diff(layers, axis=0)).sum() + np.abs(np.diff(layers, axis=1)).sum()
    inked = layers > 0
    rim = np.count_nonzero(inked[1:] != inked[:-1]) + np.count_nonzero(inked[:, 1:] != inked[:, :-1])
    return int(2 * (beside + np.count_nonzero(inked)) - rim)


def _sample(distance: NDArray[np.float32], pitch_px: float, phase: tuple[float, float]) -> PlaneLattice:
    rows = np.arange(phase[0] * pitch_px, distance.shape[0] - 1, pitch_px)
    columns = np.arange(phase[1] * pitch_px, distance.shape[1] - 1, pitch_px)
    s = _blurred(distance, rows, columns, BLUR_PER_PITCH * pitch_px)
    ridge = _blurred(distance, rows, columns, RIDGE_BLUR_PER_PITCH * pitch_px)
    share = np.clip(s / np.float32(RIDGE_DEPTH_PER_PITCH * pitch_px) - 1, 0, 1)
    return PlaneLattice(s + share * (ridge - s), pitch_px, (float(rows[0]), float(columns[0])))


def _blurred(
    distance: NDArray[np.float32], rows: NDArray[np.float64], columns: NDArray[np.float64], sigma_px: float
) -> NDArray[np.float32]:
    down = _weights(rows, distance.shape[0], sigma_px)
    across = _weights(columns, distance.shape[1], sigma_px)
    # Factors on grids so coarse that every product and every sum of them is exact in double precision: so
    # matrix products, which add up in an order of the processor's own, give the same bits everywhere.
    halfway = _on_grid(down @ _on_grid(distance.astype(np.float64), _FACTOR_GRAIN_PX), _FACTOR_GRAIN_PX)
    return _on_grid(halfway @ across.T, GRAIN_PX).astype(np.float32)


def _on_grid(values: NDArray[np.float64], grain: float) -> NDArray[np.float64]:
    return np.asarray(np.round(values * (1 / grain)) * grain)


def _weights(nodes: NDArray[np.float64], count: int, sigma_px: float) -> NDArray[np.float64]:
    # Twice a Gaussian less a wider one: it lets the waves pass that a Gaussian wears down, so that tips,
    # notches and ridges lose less than half as much, and still holds back what the lattice cannot carry.
    away = (nodes[:, None] - np.arange(count)) / (2 * sigma_px)
    wide = decay(away * away)
    narrow = wide * wide
    weights = narrow * (2 / narrow.sum(axis=1, keepdims=True)) - wide / wide.sum(axis=1, keepdims=True)
    return _on_grid(weights, _WEIGHT_GRAIN)


def _may_hold(lattice: PlaneLattice, counts: tuple[int, int]) -> bool:
    """Look at the signs in the mid-plane, which settle the matter unless inked nodes touch at a corner."""
    inside = lattice.s_px > 0
    if np.array_equal(repair_corners(inside), inside):
        return count_bodies_and_holes(inside) == counts
    return bool(inside.any())


def _upper_surface(lattice: PlaneLattice, spec: SolidSpec) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    pitch = lattice.pitch_px
    heights = np.arange(0, spec.half_thickness_px + 2 * pitch, pitch).astype(np.float32)
    depth = depth_px(lattice.s_px[:, :, None], heights, spec)
    depth += np.float32(CHORD_LOSS * pitch**2 / spec.half_thickness_px)
    # A node on the surface itself would give triangles without area.
    least = np.float32(NUDGE * pitch)
    depth = np.where(np.abs(depth) < least, np.where(depth > 0, least, -least), depth)
    vertices, faces = marching_cubes(depth, 0.0)
    faces = _in_storage_order(faces)
    rim = vertices[:, 2] == 0
    moved = smooth(vertices, faces, spec.smoothing_iterations, spec.smoothing_factor, rim)
    moved = np.where(_beside_thin_parts(vertices, depth > 0)[:, None], vertices, moved)
    moved[:, 2] = np.where(rim, 0, np.maximum(moved[:, 2], np.float32(NUDGE)))
    return np.asarray(moved * np.float32(pitch), dtype=np.float32), faces


def _in_storage_order(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Begin each triangle at its lowest vertex and sort the triangles; the winding stays.

    Neighbouring rows then hold nearly equal numbers, which halves what zstd makes of them.
    """
    if not len(faces):
        return faces
    turns = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    begun = np.take_along_axis(faces, turns, axis=1)
    # On a surface no two triangles leave the same vertex by the same edge, so two numbers settle the order.
    edge = begun[:, 0].astype(np.int64) * (int(faces.max()) + 1) + begun[:, 1]
    return np.asarray(begun[np.argsort(edge, kind="stable")])


def _beside_thin_parts(vertices: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the vertices at walls and gaps of one node, whose sides smoothing might push past each other.

    Vertices count in pitches; each lies on an edge of the lattice between two nodes.
    """
    # Higher up there is always a wider layer below, so a ridge of one node is safe and may be smoothed.
    plane = inside[:, :, 0]
    thin = np.zeros_like(plane)
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = np.roll(plane, (down, across), axis=(0, 1))
        other = np.roll(plane, (-down, -across), axis=(0, 1))
        thin |= (one == other) & (one != plane)
    low, high = np.floor(vertices[:, :2]).astype(np.intp), np.ceil(vertices[:, :2]).astype(np.intp)
    return np.asarray(thin[tuple(low.T)] | thin[tuple(high.T)])


def _mirror_surface(
    vertices: NDArray[np.float32], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Add the lower half to a surface that ends in the mid-plane, where its rim has the height 0 exactly.

    The mirror images of the vertices off the mid-plane follow those of the upper half, in the same order.
    """
    off_plane = vertices[:, 2] != 0
    image = np.arange(len(vertices), dtype=np.int32)
    image[off_plane] = len(vertices) + np.arange(np.count_nonzero(off_plane), dtype=np.int32)
    lower = vertices[off_plane] * np.array([1, 1, -1], dtype=np.float32)
    return np.concatenate([vertices, lower]), np.concatenate([faces, image[faces][:, [0, 2, 1]]])


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
