"""The fast way to the same solid: one distance transform, one lattice as fine as the vertex budget allows.

The distance of every pixel from the outline holds all erosions at once. The solid is evaluated as a
real-valued depth on a lattice several pixels wide, so its zero is found between the nodes. Where a neck, a
gap or a whisker is narrower than the lattice can show, rows and columns of nodes are added until it is shown.
Only the upper half is made; its surface ends in the mid-plane and is mirrored as it is, which makes the mesh
symmetric to the last bit (but for those that are decimated because of very many added nodes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mnist3d.ink import count_bodies_and_holes, grown
from mnist3d.side_view import depth_px, half_height_px
from mnist3d.steps import BUDGET_SLACK, bodies_and_holes, decimate, marching_cubes, scale, smooth
from tactile_toolkit.errors import ItemError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mnist3d.spec import SolidSpec
    from tactile_toolkit.mesh.mesh import Mesh

__all__ = ["LatticeSteps", "lattice_solid", "lattice_steps", "signed_distance_px"]

F = TypeVar("F", np.float32, np.float64)

# The default budget comes to 3.9 to 5.7 px, so that two rounds settle it.
FIRST_PITCH_PX = 4.0
# Half the published thickness is 20 px: at a larger pitch two layers would have to show the shoulder.
LARGEST_PITCH_PX = 8.0

NARROW_PX = 2.0
"""Ink or paper whose middle is nearer to the outline than this is narrow: a neck, a gap, a whisker."""

NARROW_REACH_PX = 3
"""Within so many pixels of something wider, ink and paper are not narrow: outlines are rough."""

NARROW_ERROR_PX = 0.25
"""How far the outline of what is narrow may be from where it was drawn: 0.05 mm on either side."""

BLUR_PER_PITCH = 0.25
RIDGE_BLUR_PER_PITCH = 0.6
RIDGE_DEPTH_PER_PITCH = 1.0
"""Blur near the outline, blur in the depth, and where the one passes into the other.

Distances grow evenly with the depth, so a blur changes nothing there but the ridge of a narrow stroke, whose
height would otherwise go up and down with where the nodes happen to lie.
"""

BELL_REACH = 11**0.5
"""(1 - (x / r)^2)^4 has the standard deviation r / sqrt(11)."""

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

    ``s_px`` is positive inside; ``rows_px`` and ``columns_px`` say where the nodes lie, ``pitch_px`` how far
    apart they are where nothing narrow is near.
    """

    s_px: NDArray[np.float32]
    rows_px: NDArray[np.float64]
    columns_px: NDArray[np.float64]
    pitch_px: float


@dataclass(frozen=True, slots=True, eq=False)
class LatticeSteps:
    """A solid and what it was made from, step by step.

    Attributes
    ----------
    lattice : PlaneLattice
        Its nodes in the mid-plane, in pixels from ``corner_px``, the first (row, column) that it covers.
    layers : ndarray of bool, shape (R, C, L)
        Which nodes are inside, from the mid-plane up, ``lattice.pitch_px`` apart: eroded, and stacked.
    vertices_px, faces : ndarray, shape (V, 3) and (F, 3)
        The upper half as marching cubes give it, coordinates as in :mod:`mnist3d.steps`.
    mesh : Mesh
        The same smoothed, mirrored and scaled, and decimated where it has too many vertices.
    """

    lattice: PlaneLattice
    corner_px: tuple[int, int]
    layers: NDArray[np.bool_]
    vertices_px: NDArray[np.float32]
    faces: NDArray[np.int32]
    mesh: Mesh


def lattice_solid(mask: NDArray[np.bool_], spec: SolidSpec) -> Mesh:
    """Build the solid of clean ink; raises as :func:`lattice_steps`."""
    return lattice_steps(mask, spec).mesh


def lattice_steps(mask: NDArray[np.bool_], spec: SolidSpec) -> LatticeSteps:
    """Build the solid of clean ink (:func:`mnist3d.ink.clean`), and keep what each step gave.

    Raises ItemError ``topology`` where no lattice down to one pixel keeps the bodies and holes of the ink,
    ``vertex-budget`` where they need more than 1.5 times the vertices asked for.
    """
    # Two nodes of paper on each side even at the coarsest pitch, so that the surface closes.
    margin_px = math.ceil(2 * LARGEST_PITCH_PX)
    inked = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = int(inked[0][0]) - margin_px, int(inked[1][0]) - margin_px
    window = tuple(slice(lines[0], lines[-1] + 1) for lines in inked)
    crop = np.pad(mask[window], margin_px)
    counts = count_bodies_and_holes(crop)
    # Deeper than the half thickness the surface is flat; 4 px more keep the cut-off out of the blur there.
    distance = signed_distance_px(crop, math.ceil(spec.half_thickness_px) + 4, 2 * LARGEST_PITCH_PX)
    distance = _on_grid(distance, _FACTOR_GRAIN_PX)
    narrow = np.stack(np.nonzero(_narrow_parts(distance)))
    pitch_px = _first_pitch_px(distance, spec)
    rows, columns = (np.arange(0.0, side - 1, pitch_px) for side in distance.shape)
    while True:
        lattice = _sample(distance, rows, columns, pitch_px)
        error_px = np.abs(_between_nodes(lattice, *narrow) - distance[tuple(narrow)])
        missed = narrow[:, error_px > NARROW_ERROR_PX]
        if not missed.size:
            layers, raw, smoothed, upper = _upper_surface(lattice, spec)
            found = bodies_and_holes(smoothed, upper, int(np.count_nonzero(smoothed[:, 2] == 0)))
            if found == counts:
                break
            # Bodies or holes are lost where nodes touch at a corner alone, or else where the lattice shows
            # ink for paper, or paper for ink.
            missed = _corner_contacts(layers[:, :, 0], lattice)
            if not missed.size:
                shown = _between_nodes(lattice, *np.ogrid[: crop.shape[0], : crop.shape[1]])
                missed = np.stack(np.nonzero((shown > 0) != crop))
        if len(rows) == crop.shape[0] and len(columns) == crop.shape[1]:
            message = (
                f"no lattice keeps the {counts[0]} bodies and {counts[1]} holes of the ink; the finest has "
                f"{found[0]} and {found[1]}"
            )
            raise ItemError(reason="topology", message=message)
        before = len(rows), len(columns)
        rows, columns = (_refined(*each) for each in zip((rows, columns), missed, crop.shape, strict=True))
        # Where nothing more can be added line by line, every pixel becomes a node; then the loop ends.
        if (len(rows), len(columns)) == before:
            rows, columns = (np.arange(side, dtype=np.float64) for side in crop.shape)
    vertices, faces = _mirror_surface(smoothed, upper)
    corner = np.array([top, left, 0], dtype=np.float32)
    mesh = scale(vertices + corner, faces, (mask.shape[0], mask.shape[1]), spec)
    # Who asks for a pitch has asked for its vertices, too.
    bounded = spec.lattice_pitch_mm is None and len(vertices) > BUDGET_SLACK * spec.target_vertices
    mesh = decimate(mesh, spec.target_vertices) if bounded else mesh
    return LatticeSteps(lattice, (top, left), layers, raw + corner, upper, mesh)


def signed_distance_px(mask: NDArray[np.bool_], inside_px: float, outside_px: float) -> NDArray[np.float32]:
    """Measure how far each pixel centre lies from the outline of the ink, positive inside, up to two reaches.

    The outline runs between pixels, half a pixel from the centres on either side of it. What lies beyond the
    image is paper only if the image says so at its edge. Exact up to the reaches, which are below 127. First
    along the rows, then over the offsets of the columns (Felzenszwalb and Huttenlocher 2012 write the
    transform that way); with a short reach plain passes over small integers beat their lower envelope.
    """
    width, far = mask.shape[1], math.ceil(max(inside_px, outside_px)) + 1
    columns = np.arange(width, dtype=np.int16)
    # Where the run of ink or paper along the row begins and ends, for every pixel of it.
    changes = mask[:, 1:] != mask[:, :-1]
    first, last = (np.full(mask.shape, end, np.int16) for end in (-far, width + far))
    np.copyto(first[:, 1:], columns[1:], where=changes)
    np.copyto(last[:, :-1], columns[:-1], where=changes)
    np.maximum.accumulate(first, axis=1, out=first)
    np.minimum.accumulate(last[:, ::-1], axis=1, out=last[:, ::-1])
    along_rows = np.minimum(columns - first, last - columns) + np.int16(1)
    inside = _distance_px(along_rows * mask, inside_px + 0.5)
    outside = _distance_px(along_rows * ~mask, outside_px + 0.5)
    return np.where(mask, inside - np.float32(0.5), np.float32(0.5) - outside)


def _distance_px(along_rows: NDArray[np.int16], reach_px: float) -> NDArray[np.float32]:
    """Return the distance to the nearest 0, up to a reach below 128, from that within each row."""
    reach, height = math.ceil(reach_px), len(along_rows)
    along_rows = np.minimum(along_rows, np.int16(reach))
    # Sums of two squares below 128^2 fit 16 bits, which halves the memory that is walked through.
    squared = along_rows * along_rows
    padded = np.pad(squared, ((reach, reach), (0, 0)), constant_values=reach * reach)
    beside = np.empty_like(squared)
    for offset in range(1, reach):
        if offset * offset >= squared.max():
            break
        above, below = reach - offset, reach + offset
        np.minimum(padded[above : above + height], padded[below : below + height], out=beside)
        beside += np.int16(offset * offset)
        np.minimum(squared, beside, out=squared)
    return np.asarray(np.minimum(np.sqrt(squared, dtype=np.float32), np.float32(reach_px)))


def _first_pitch_px(distance: NDArray[np.float32], spec: SolidSpec) -> float:
    """Return the pitch asked for, or the one at which marching cubes will meet the vertex budget.

    A vertex lies on every edge of the lattice that passes through the surface, so their number is known
    before the surface is made, and it falls with the square of the pitch.
    """
    if spec.lattice_pitch_mm is not None:
        return min(max(spec.lattice_pitch_mm / spec.pixel_pitch_mm, 1.0), LARGEST_PITCH_PX)
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


def _narrow_parts(distance: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mark the pixels of ink and paper that nothing wide is near: necks, gaps, whiskers and notches."""
    wide_ink, wide_paper = distance >= NARROW_PX, distance <= -NARROW_PX
    for _ in range(NARROW_REACH_PX):
        wide_ink, wide_paper = grown(wide_ink), grown(wide_paper)
    return np.where(distance > 0, ~wide_ink, ~wide_paper)


def _corner_contacts(inside: NDArray[np.bool_], lattice: PlaneLattice) -> NDArray[np.intp]:
    """Return the pixels, shape (2, N), between nodes of which two touch at a corner alone.

    The surface may join them, or what lies across.
    """
    one, other = inside[:-1, :-1], inside[:-1, 1:]
    contacts = (one == inside[1:, 1:]) & (other == inside[1:, :-1]) & (one != other)
    cells = (
        np.searchsorted(nodes[1:-1], np.arange(nodes[-1] + 1), side="right")
        for nodes in (lattice.rows_px, lattice.columns_px)
    )
    return np.stack(np.nonzero(contacts[np.ix_(*cells)]))


def _refined(nodes: NDArray[np.float64], lines: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Put nodes on every pixel of the lines in which something is missed, and on those beside them."""
    missed = np.zeros(count, dtype=bool)
    missed[lines] = True
    wanted = np.flatnonzero(missed | np.append(missed[1:], False) | np.append(False, missed[:-1])) * 1.0
    if not len(wanted):
        return nodes
    place = np.searchsorted(wanted, nodes)
    below = nodes - wanted[np.maximum(place - 1, 0)]
    above = wanted[np.minimum(place, len(wanted) - 1)] - nodes
    away = np.minimum(np.abs(below), np.abs(above))
    # Between pixels a node needs a blur of two pixels to mean what lies there.
    others = np.where(away < 2, np.round(nodes), nodes)[away >= 1]
    return np.unique(np.concatenate([others, wanted]))


def _sample(
    distance: NDArray[np.float32], rows: NDArray[np.float64], columns: NDArray[np.float64], pitch_px: float
) -> PlaneLattice:
    s = _blurred(distance, rows, columns, BLUR_PER_PITCH)
    ridge = _blurred(distance, rows, columns, RIDGE_BLUR_PER_PITCH)
    share = np.clip(s / np.float32(RIDGE_DEPTH_PER_PITCH * pitch_px) - 1, 0, 1)
    return PlaneLattice(s + share * (ridge - s), rows, columns, pitch_px)


def _blurred(
    distance: NDArray[np.float32],
    rows: NDArray[np.float64],
    columns: NDArray[np.float64],
    sigma_per_pitch: float,
) -> NDArray[np.float32]:
    down = _weights(rows, distance.shape[0], sigma_per_pitch)
    across = _weights(columns, distance.shape[1], sigma_per_pitch)
    return _on_grid(_both_ways(down, across, distance), GRAIN_PX).astype(np.float32)


def _both_ways(down: Any, across: Any, values: NDArray[Any]) -> NDArray[np.float64]:
    """Apply sparse weights along both axes.

    Values and weights lie on grids so coarse that every product and every sum of them is exact in double
    precision: so they are the same bits on every processor.
    """
    halfway = down @ values.astype(np.float64)
    return np.asarray((across @ np.ascontiguousarray(_on_grid(halfway, _FACTOR_GRAIN_PX).T)).T)


def _on_grid(values: NDArray[F], grain: float) -> NDArray[F]:
    # Powers of two of the type of the values: nothing but the rounding changes a bit.
    return np.asarray(np.round(values * values.dtype.type(1 / grain)) * values.dtype.type(grain))


def _weights(nodes: NDArray[np.float64], count: int, sigma_per_pitch: float) -> Any:
    """Return a sparse matrix from pixels to nodes; a node one pixel from the next is not blurred."""
    # Pitches differ along an axis: each node is blurred as the finer of its two sides needs.
    gaps = np.diff(nodes)
    pitch = np.minimum(np.append(gaps, gaps[-1]), np.append(gaps[0], gaps))
    sigma = np.where(pitch > 1, sigma_per_pitch * pitch, 0)
    # Twice a bell less a wider one: it lets the waves pass that a bell wears down, so that tips, notches and
    # ridges lose less than half as much, and still holds back what the lattice cannot carry.
    reach = math.ceil(2**0.5 * BELL_REACH * float(sigma.max()))
    pixels = np.floor(nodes).astype(np.intp)[:, None] + np.arange(-reach, reach + 2)
    inside = (pixels >= 0) & (pixels < count)
    squared = np.where(inside, (nodes[:, None] - pixels) ** 2, np.inf)
    narrow, wide = _bells(squared, sigma), _bells(squared, 2**0.5 * sigma)
    return _sparse(2 * narrow - wide, pixels, count)


def _bells(squared: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows of weights that add up to 1, near a Gaussian; where sigma is 0 the node itself counts.

    Made of products and sums alone; exponentials differ from processor to processor.
    """
    radius = np.maximum(BELL_REACH * sigma, 0.5)[:, None]
    bell = np.maximum(1 - squared / radius**2, 0)
    bell *= bell
    bell *= bell
    return np.asarray(bell / bell.sum(axis=1, keepdims=True))


def _between_nodes(
    lattice: PlaneLattice, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return what the lattice says at pixels, linear between its nodes; exact as in :func:`_both_ways`."""
    s = _on_grid(lattice.s_px, _FACTOR_GRAIN_PX).astype(np.float64)
    row, above, below = _linear(lattice.rows_px, rows)
    column, left, right = _linear(lattice.columns_px, columns)
    before, after = (
        _on_grid(above * s[row, side] + below * s[row + 1, side], _FACTOR_GRAIN_PX)
        for side in (column, column + 1)
    )
    return np.asarray(left * before + right * after)


def _linear(nodes: NDArray[np.float64], pixels: NDArray[np.intp]) -> tuple[NDArray[Any], ...]:
    """Return the nodes before pixels and the weights of these and the next ones."""
    before = np.searchsorted(nodes[1:-1], pixels, side="right")
    share = np.clip((pixels - nodes[before]) / (nodes[before + 1] - nodes[before]), 0, 1)
    return before, _on_grid(1 - share, _WEIGHT_GRAIN), _on_grid(share, _WEIGHT_GRAIN)


def _sparse(weights: NDArray[np.float64], places: NDArray[np.intp], count: int) -> Any:
    from scipy.sparse import csr_array

    weights = _on_grid(weights, _WEIGHT_GRAIN)
    # A row reaches as far as the widest bell does; most outer weights round to nothing.
    kept = weights != 0
    starts = np.append(0, np.cumsum(np.count_nonzero(kept, axis=1)))
    return csr_array((weights[kept], places[kept], starts), shape=(len(weights), count))


def _upper_surface(
    lattice: PlaneLattice, spec: SolidSpec
) -> tuple[NDArray[np.bool_], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Return which nodes are inside, the vertices before and after they are smoothed, and the faces."""
    pitch = lattice.pitch_px
    heights = np.arange(0, spec.half_thickness_px + 2 * pitch, pitch).astype(np.float32)
    depth = depth_px(lattice.s_px[:, :, None], heights, spec)
    depth += np.float32(CHORD_LOSS * pitch**2 / spec.half_thickness_px)
    # A node on the surface itself would give triangles without area.
    least = np.float32(NUDGE * pitch)
    depth = np.where(np.abs(depth) < least, np.where(depth > 0, least, -least), depth)
    # The lower half would be the same again; mirrored, it is so to the last bit.
    vertices, faces = marching_cubes(depth, 0.0)
    faces = _in_storage_order(faces)
    inside = depth > 0
    beside_thin = _beside_thin_parts(vertices, inside)
    for axis, nodes in enumerate((lattice.rows_px, lattice.columns_px)):
        vertices[:, axis] = np.interp(vertices[:, axis], np.arange(len(nodes)), nodes)
    vertices[:, 2] *= np.float32(pitch)
    rim = vertices[:, 2] == 0
    moved = smooth(vertices, faces, spec.smoothing_iterations, spec.smoothing_factor, rim)
    # Volume and topology come before smoothness there: a wall that folds is no solid.
    moved = np.where(beside_thin[:, None], vertices, moved)
    moved[:, 2] = np.where(rim, 0, np.maximum(moved[:, 2], least))
    return inside, vertices, np.asarray(moved, dtype=np.float32), faces


def _in_storage_order(faces: NDArray[np.int32]) -> NDArray[np.int32]:
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
