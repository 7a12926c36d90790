"""The lattice of nodes at which a solid is evaluated.

The vertex budget decides the distance of the nodes. Where a neck, a gap or a whisker is narrower than the
lattice can show, rows and columns of nodes are added until it is shown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mnist3d import compiled_loops, digit_options
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Floating, Int64

_DISC_OFFSETS_PX = {"outline": 0.0, "disc": 0.5}
F = TypeVar("F", np.float32, np.float64)

BLUR_PER_PITCH = 0.25
"""Standard deviation of the blur near the outline, in pitches."""

RIDGE_BLUR_PER_PITCH = 0.6
"""Standard deviation of the blur far inside, in pitches.

Distances grow evenly with the depth, so a blur changes only the ridge of a narrow stroke, whose height would
otherwise depend on the positions of the nodes.
"""

RIDGE_DEPTH_PER_PITCH = 1.0
"""Depth from which, and over which, the first blur passes into the second, in pitches."""

BELL_REACH = 11**0.5
"""Half width r of a bell in standard deviations: (1 - (x / r)^2)^4 has the deviation r / sqrt(11)."""

GRAIN_PX = 2.0**-12
"""Grid to which sampled distances are rounded."""

FACTOR_GRAIN_PX, _WEIGHT_GRAIN = 2.0**-16, 2.0**-24
"""Grids of distances, below 2^7 px, and of weights, below 2: their sums need at most 50 bits."""

# The default budget needs 3.9 to 5.7 px, so two rounds are enough.
FIRST_PITCH_PX = 4.0

# Half the published thickness is 20 px: at a larger pitch, only two layers would show the shoulder.
LARGEST_PITCH_PX = 8.0

NARROW_PX = 2.0
"""Ink or paper is narrow (a neck, a gap, a whisker) if its middle is nearer to the outline than this."""

NARROW_REACH_PX = 3
"""Ink and paper within this distance, pixels, of a wider part are not narrow, as outlines are rough."""

NARROW_ERROR_PX = 0.25
"""Largest error of the outline of narrow parts: 0.05 mm."""

MIN_NODE_DEPTH = 0.03
"""Least depth of a node, in pitches: it keeps the vertices on the edges around a node apart."""


def erosion_radius_px(z_px: Floating, spec: digit_options.SolidSpec) -> Floating:
    """Return how far the outline moves inwards at heights from 0 to the half thickness, pixels."""
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.zeros_like(z_px)
    radius = z_px
    if spec.profile == "round":
        radius = np.asarray(half_px - np.sqrt(np.maximum(half_px**2 - z_px**2, 0)))
    return np.asarray(np.maximum(radius - disc_offset_px(spec), 0))


def disc_offset_px(spec: digit_options.SolidSpec) -> np.float32:
    """Return by how much an erosion is less than its radius: a disc keeps the pixels that it touches."""
    return np.float32(_DISC_OFFSETS_PX[spec.erosion])


def half_height_px(s_px: Floating, spec: digit_options.SolidSpec) -> Floating:
    """Return the height of the solid above the mid-plane, pixels; 0 outside the ink."""
    half_px = spec.half_thickness_px
    depth = np.where(s_px > 0, np.clip(s_px + disc_offset_px(spec), 0, half_px), 0)
    if spec.profile == "round":
        # The same quarter circle as in `erosion_radius_px`, solved for the height.
        return np.asarray(np.sqrt(depth * (2 * half_px - depth)))
    if spec.profile == "linear":
        return depth
    return np.where(s_px > 0, np.float32(half_px), np.float32(0))


def depth_px(s_px: Floating, z_px: Floating, spec: digit_options.SolidSpec) -> Floating:
    """Return the depth of points in the solid, pixels, positive inside; the two shapes broadcast.

    Values are true distances wherever one side of the solid is nearest, so their zero between two nodes is
    exact. A stack of binary layers would place it half-way.
    """
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.asarray(np.minimum(s_px, half_px - z_px))
    kept_px = s_px + disc_offset_px(spec)
    if spec.profile == "round":
        depth = np.asarray(half_px - np.sqrt(np.maximum(half_px - kept_px, 0) ** 2 + z_px**2))
    else:
        # The side of a linear profile is a plane at 45 degrees.
        depth = np.asarray(np.minimum((kept_px - z_px) * np.float32(0.5**0.5), half_px - z_px))
    if spec.erosion == "disc":
        depth = np.minimum(depth, s_px)
    return depth


def sampled(distance: Float32, rows: Float64, columns: Float64, pitch_px: float) -> Float32:
    """Return the distances from the outline at nodes; those near a ridge are blurred more."""
    s, ridge = (_blurred(distance, rows, columns, blur) for blur in (BLUR_PER_PITCH, RIDGE_BLUR_PER_PITCH))
    share = np.clip(s / np.float32(RIDGE_DEPTH_PER_PITCH * pitch_px) - 1, 0, 1)
    return np.asarray(s + share * (ridge - s))


def _blurred(values: Float32, rows: Float64, columns: Float64, sigma_per_pitch: float) -> Float32:
    """Return values at nodes after a blur in proportion to the distance of the nodes.

    Values and weights lie on such coarse grids that every product and sum is exact in double precision, with
    the same bits on every processor.
    """
    at_nodes = compiled_loops.blurred(
        values, rows, columns, sigma_per_pitch, BELL_REACH, _WEIGHT_GRAIN, FACTOR_GRAIN_PX
    )
    return on_grid(at_nodes, GRAIN_PX).astype(np.float32)


def on_grid(values: NDArray[F], grain: float) -> NDArray[F]:
    """Round values to multiples of a power of two."""
    # Multiplication by powers of two is exact.
    return np.asarray(np.round(values * values.dtype.type(1 / grain)) * values.dtype.type(grain))


def linear(nodes: Float64, pixels: Int64) -> tuple[AnyArray, ...]:
    """Return the nodes before pixels, and the weights of these and of the next nodes."""
    before = np.searchsorted(nodes[1:-1], pixels, side="right")
    share = np.clip((pixels - nodes[before]) / (nodes[before + 1] - nodes[before]), 0, 1)
    return before, on_grid(1 - share, _WEIGHT_GRAIN), on_grid(share, _WEIGHT_GRAIN)


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Nodes in the mid-plane of some ink, and how far each is from the outline.

    Attributes
    ----------
    ink : ndarray of bool, shape (H, W)
        The part of the image with ink in it, and paper around; the other fields are in pixels of this part.
    corner_px : tuple of int
        Row and column of the image at which this part begins.
    distance_px : ndarray of float32, shape (H, W)
        Distance of each pixel from the outline, positive inside.
    narrow : ndarray of int, shape (2, N)
        Rows and columns of the pixels of narrow ink and paper.
    rows_px, columns_px : ndarray of float64, shape (R,) and (C,)
        Positions of the nodes.
    pitch_px : float
        Distance of the nodes where nothing narrow is near.
    s_px : ndarray of float32, shape (R, C)
        Distance from the outline at the nodes.
    """

    ink: Bool
    corner_px: tuple[int, int]
    distance_px: Float32
    narrow: Int64
    rows_px: Float64
    columns_px: Float64
    pitch_px: float
    s_px: Float32

    @property
    def min_depth_px(self) -> np.float32:
        """Least depth of a node, pixels."""
        return np.float32(MIN_NODE_DEPTH * self.pitch_px)

    def heights_px(self, spec: digit_options.SolidSpec) -> Float32:
        """Return the heights of layers from the mid-plane to beyond the top of the solid, shape (L, 1, 1).

        Each height is an array: numpy squares scalars by another function, whose last bit may differ.
        """
        top_px = float(half_height_px(self.s_px.max(), spec)) + 2 * self.pitch_px
        return np.arange(0, top_px, self.pitch_px).astype(np.float32)[:, None, None]

    def finer(self, inside: Bool) -> Lattice | None:
        """Return a lattice with more nodes where bodies or holes are lost; None if each pixel is a node.

        ``inside`` states which nodes of the mid-plane are in the solid. Nodes are added where two of them
        touch at a corner only, or else where the lattice shows ink for paper, or paper for ink.
        """
        if self.s_px.shape == self.ink.shape:
            return None
        missed = self._corner_contacts(inside)
        if not missed.size:
            shown = self.between_nodes(*np.ogrid[: self.ink.shape[0], : self.ink.shape[1]])
            missed = np.stack(np.nonzero((shown > 0) != self.ink))
        return self.with_nodes_at(missed).fitted()

    def fitted(self) -> Lattice:
        """Return a lattice with nodes added until it shows all narrow parts."""
        lattice = self
        while True:
            shown_px = lattice.between_nodes(*lattice.narrow)
            error_px = np.abs(shown_px - lattice.distance_px[tuple(lattice.narrow)])
            missed = lattice.narrow[:, error_px > NARROW_ERROR_PX]
            if not missed.size:
                return lattice
            lattice = lattice.with_nodes_at(missed)

    def with_nodes_at(self, missed: Int64) -> Lattice:
        """Return a lattice with nodes on the rows and columns of pixels, shape (2, N), and next to them."""
        rows, columns = map(_refined, (self.rows_px, self.columns_px), missed, self.ink.shape)
        # If no line can be added, every pixel becomes a node.
        if (len(rows), len(columns)) == self.s_px.shape:
            rows, columns = (np.arange(side, dtype=np.float64) for side in self.ink.shape)
        s_px = sampled(self.distance_px, rows, columns, self.pitch_px)
        return replace(self, rows_px=rows, columns_px=columns, s_px=s_px)

    def _corner_contacts(self, inside: Bool) -> Int64:
        """Return the pixels, shape (2, N), in cells of the lattice whose nodes touch at a corner only.

        The surface may join either pair of opposite nodes.
        """
        upper_left, upper_right = inside[:-1, :-1], inside[:-1, 1:]
        contacts = (
            (upper_left == inside[1:, 1:]) & (upper_right == inside[1:, :-1]) & (upper_left != upper_right)
        )
        cells = (
            np.searchsorted(nodes[1:-1], np.arange(nodes[-1] + 1), side="right")
            for nodes in (self.rows_px, self.columns_px)
        )
        return np.stack(np.nonzero(contacts[np.ix_(*cells)]))

    def between_nodes(self, rows: Int64, columns: Int64) -> Float64:
        """Interpolate the lattice at pixels; exact, as :func:`~mnist3d.solid.lattice.sampled` is."""
        s = on_grid(self.s_px, FACTOR_GRAIN_PX).astype(np.float64)
        row, above, below = linear(self.rows_px, rows)
        column, left, right = linear(self.columns_px, columns)
        before, after = (
            on_grid(above * s[row, side] + below * s[row + 1, side], FACTOR_GRAIN_PX)
            for side in (column, column + 1)
        )
        return np.asarray(left * before + right * after)


def lattice_of(ink: Bool, spec: digit_options.SolidSpec) -> Lattice:
    """Lay a lattice over clean ink (:func:`mnist3d.ink.binarisation.clean`) that shows all narrow parts."""
    # Two nodes of paper on each side even at the coarsest pitch, so that the surface closes.
    margin_px = math.ceil(2 * LARGEST_PITCH_PX)
    (top, bottom), (left, right) = (np.flatnonzero(ink.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0))
    crop = np.pad(ink[top : bottom + 1, left : right + 1], margin_px)
    # Deeper than the half thickness, the surface is flat; 4 px more keep the cut-off out of the blur.
    distance = compiled_loops.signed_distance_px(
        crop, math.ceil(spec.half_thickness_px) + 4, 2 * LARGEST_PITCH_PX
    )
    distance = on_grid(distance, FACTOR_GRAIN_PX)
    narrow = compiled_loops.narrow_pixels(distance, NARROW_PX, NARROW_REACH_PX)
    if spec.lattice_pitch_mm is None:
        pitch_px = pitch_of_budget_px(distance, spec, spec.target_vertices)
    else:
        pitch_px = min(max(spec.lattice_pitch_mm / spec.pixel_pitch_mm, 1.0), LARGEST_PITCH_PX)
    rows, columns = (np.arange(0.0, side - 1, pitch_px) for side in distance.shape)
    corner_px = top - margin_px, left - margin_px
    s_px = sampled(distance, rows, columns, pitch_px)
    return Lattice(crop, corner_px, distance, narrow, rows, columns, pitch_px, s_px).fitted()


def pitch_of_budget_px(distance: Float32, spec: digit_options.SolidSpec, vertices: int) -> float:
    """Return the pitch, 1 to 8 px, at which marching cubes make about this number of vertices.

    A vertex lies on every edge of the lattice that crosses the surface, so their number is known before the
    surface is made. It falls with the square of the pitch.
    """
    pitch = FIRST_PITCH_PX
    for _ in range(2):  # the second round corrects the count, as the first lattice may be too coarse
        rows, columns = (np.arange(0, side - 1, pitch).round().astype(np.intp) for side in distance.shape)
        crossed = _crossed_edges(distance[np.ix_(rows, columns)], pitch, spec)
        pitch = float(np.clip(pitch * math.sqrt(crossed / vertices), 1.0, LARGEST_PITCH_PX))
    return pitch


def _crossed_edges(s_px: Float32, pitch_px: float, spec: digit_options.SolidSpec) -> int:
    """Count the edges that cross the whole surface, beside and above the nodes; those of the rim once."""
    layers = np.ceil(half_height_px(s_px, spec) / np.float32(pitch_px)).astype(np.int32)
    beside = np.abs(np.diff(layers, axis=0)).sum() + np.abs(np.diff(layers, axis=1)).sum()
    inked = layers > 0
    rim = np.count_nonzero(inked[1:] != inked[:-1]) + np.count_nonzero(inked[:, 1:] != inked[:, :-1])
    return int(2 * (beside + np.count_nonzero(inked)) - rim)


def _refined(nodes: Float64, lines: Int64, count: int) -> Float64:
    """Put nodes on every line with missed pixels, and on the lines next to it."""
    missed = np.zeros(count, dtype=bool)
    missed[lines] = True
    new_nodes = np.flatnonzero(missed | np.append(missed[1:], False) | np.append(False, missed[:-1])) * 1.0
    if not len(new_nodes):
        return nodes
    next_index = np.searchsorted(new_nodes, nodes)
    below = nodes - new_nodes[np.maximum(next_index - 1, 0)]
    above = new_nodes[np.minimum(next_index, len(new_nodes) - 1)] - nodes
    away = np.minimum(np.abs(below), np.abs(above))
    # A node between pixels needs a blur of two pixels.
    kept = np.where(away < 2, np.round(nodes), nodes)[away >= 1]
    return np.unique(np.concatenate([kept, new_nodes]))
