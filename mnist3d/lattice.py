"""Erosion with all kernel sizes at once: the first steps of Algorithm 1 in their continuous form.

The printed algorithm erodes the ink with one kernel after another and stacks the binary layers. Here the
distance of every pixel from the outline holds all erosions at once: a pixel is left by the kernel of radius r
where it is further than r from the outline. So :func:`erode` gives, instead of what is left, how deep each
node lies within what is left; marching cubes then find the surface between the nodes, which may lie several
pixels apart. :func:`stack` puts these layers on one another, and :func:`mirror` stands for the lower half
without making it: it would be the same again, and mirrored last it is so to the last bit.

:class:`Lattice` says where the nodes lie: as far apart as the vertex budget asks for. Where a neck, a gap or
a whisker is narrower than the lattice can show, rows and columns of nodes are added until it is shown.
:mod:`mnist3d.literal` has the same steps as they are printed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mnist3d.spec import SolidSpec
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Floating, Int64


def erosion_radius_px(z_px: Floating, spec: SolidSpec) -> Floating:
    """Return how far the outline draws in at heights from 0 to the half thickness; grows with the height."""
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.zeros_like(z_px)
    radius = z_px
    if spec.profile == "round":
        radius = np.asarray(half_px - np.sqrt(np.maximum(half_px**2 - z_px**2, 0)))
    return np.asarray(np.maximum(radius - disc_offset_px(spec), 0))


def disc_offset_px(spec: SolidSpec) -> np.float32:
    """Return by how much an erosion falls short of its radius: a disc of pixels leaves those it touches."""
    return np.float32(0.5 if spec.erosion == "disc" else 0)


def half_height_px(s_px: Floating, spec: SolidSpec) -> Floating:
    """Return how high the solid stands above the mid-plane; 0 outside the ink."""
    half_px = spec.half_thickness_px
    depth = np.where(s_px > 0, np.clip(s_px + disc_offset_px(spec), 0, half_px), 0)
    if spec.profile == "round":
        # The same quarter circle as in `erosion_radius_px`, solved for the height.
        return np.asarray(np.sqrt(depth * (2 * half_px - depth)))
    return depth if spec.profile == "linear" else np.where(s_px > 0, np.float32(half_px), np.float32(0))


def depth_px(s_px: Floating, z_px: Floating, spec: SolidSpec) -> Floating:
    """Return how deep points lie in the solid, positive inside; the two shapes broadcast.

    The values are true distances wherever one side of the solid is nearest, so that their zero is found
    exactly between two nodes of a lattice; a stack of binary layers would place it half way instead.
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
    return np.minimum(depth, s_px) if spec.erosion == "disc" else depth


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

MIN_NODE_DEPTH = 0.03
"""Least depth of a node in pitches: it keeps the vertices on the edges around a node apart."""

CHORD_LOSS = 0.11
"""How far the surface is set outward, in pitch^2 / R.

Triangles with corners on a cylinder of radius R lie inside it by this much on average: 1/12 to 1/8 by
geometry, this value as measured on 20 of the real digits against the literal solid.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Where the solid of some ink is evaluated: nodes in the mid-plane, and how far each is from the outline.

    Attributes
    ----------
    ink : ndarray of bool, shape (H, W)
        The part of the image with ink in it, and paper around; what follows is in pixels of this part.
    corner_px : tuple of int
        Row and column of the image at which it begins.
    distance_px : ndarray of float32, shape (H, W)
        Distance of each pixel from the outline, positive inside.
    narrow : ndarray of int, shape (2, N)
        Rows and columns of pixels of ink and paper that nothing wide is near.
    rows_px, columns_px : ndarray of float64, shape (R,) and (C,)
        Where the nodes lie.
    pitch_px : float
        How far apart they are where nothing narrow is near.
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
    def least_px(self) -> np.float32:
        """Least depth of a node: it keeps the vertices on the edges around a node apart."""
        return np.float32(MIN_NODE_DEPTH * self.pitch_px)

    def heights_px(self, spec: SolidSpec) -> Float32:
        """Return the heights of the layers above the mid-plane, to beyond the top of the solid, shape (L, 1).

        Each an array of its own: numpy squares single numbers by another function, to another last bit.
        """
        top_px = spec.half_thickness_px + 2 * self.pitch_px
        return np.arange(0, top_px, self.pitch_px).astype(np.float32)[:, None]

    def finer(self, inside: Bool) -> Lattice | None:
        """Return a lattice with more nodes where bodies or holes are lost; None where each pixel has one.

        That is where nodes ``inside`` the mid-plane touch at a corner alone, or else where the lattice shows
        ink for paper, or paper for ink.
        """
        if self.s_px.shape == self.ink.shape:
            return None
        missed = self._corner_contacts(inside)
        if not missed.size:
            shown = self._between_nodes(*np.ogrid[: self.ink.shape[0], : self.ink.shape[1]])
            missed = np.stack(np.nonzero((shown > 0) != self.ink))
        return self._with_nodes_at(missed).fitted()

    def fitted(self) -> Lattice:
        """Return a lattice with nodes added until it shows all that is narrow."""
        lattice = self
        while True:
            shown_px = lattice._between_nodes(*lattice.narrow)
            error_px = np.abs(shown_px - lattice.distance_px[tuple(lattice.narrow)])
            missed = lattice.narrow[:, error_px > NARROW_ERROR_PX]
            if not missed.size:
                return lattice
            lattice = lattice._with_nodes_at(missed)

    def _with_nodes_at(self, missed: Int64) -> Lattice:
        rows, columns = map(_refined, (self.rows_px, self.columns_px), missed, self.ink.shape)
        # Where nothing more can be added line by line, every pixel becomes a node; that is the finest.
        if (len(rows), len(columns)) == self.s_px.shape:
            rows, columns = (np.arange(side, dtype=np.float64) for side in self.ink.shape)
        s_px = _sampled(self.distance_px, rows, columns, self.pitch_px)
        return replace(self, rows_px=rows, columns_px=columns, s_px=s_px)

    def _corner_contacts(self, inside: Bool) -> Int64:
        """Return the pixels, shape (2, N), between nodes of which two touch at a corner alone.

        The surface may join them, or what lies across.
        """
        one, other = inside[:-1, :-1], inside[:-1, 1:]
        contacts = (one == inside[1:, 1:]) & (other == inside[1:, :-1]) & (one != other)
        cells = (
            np.searchsorted(nodes[1:-1], np.arange(nodes[-1] + 1), side="right")
            for nodes in (self.rows_px, self.columns_px)
        )
        return np.stack(np.nonzero(contacts[np.ix_(*cells)]))

    def _between_nodes(self, rows: Int64, columns: Int64) -> Float64:
        """Return what the lattice shows at pixels, linear between its nodes; exact as :func:`_blurred`."""
        s = _on_grid(self.s_px, _FACTOR_GRAIN_PX).astype(np.float64)
        row, above, below = _linear(self.rows_px, rows)
        column, left, right = _linear(self.columns_px, columns)
        before, after = (
            _on_grid(above * s[row, side] + below * s[row + 1, side], _FACTOR_GRAIN_PX)
            for side in (column, column + 1)
        )
        return np.asarray(left * before + right * after)


class Mirrored(NamedTuple):
    """Layers from the mid-plane up, shape (R, C, L), that stand for a lower half too."""

    upper: Float32


def lattice_of(ink: Bool, spec: SolidSpec) -> Lattice:
    """Lay a lattice over clean ink (:func:`mnist3d.ink.clean`) that shows all that is narrow."""
    from mnist3d import kernels

    # Two nodes of paper on each side even at the coarsest pitch, so that the surface closes.
    margin_px = math.ceil(2 * LARGEST_PITCH_PX)
    (top, bottom), (left, right) = (np.flatnonzero(ink.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0))
    crop = np.pad(ink[top : bottom + 1, left : right + 1], margin_px)
    # Deeper than the half thickness the surface is flat; 4 px more keep the cut-off out of the blur there.
    distance = signed_distance_px(crop, math.ceil(spec.half_thickness_px) + 4, 2 * LARGEST_PITCH_PX)
    distance = _on_grid(distance, _FACTOR_GRAIN_PX)
    narrow = kernels.narrow(distance, NARROW_PX, NARROW_REACH_PX)
    pitch_px = _first_pitch_px(distance, spec)
    rows, columns = (np.arange(0.0, side - 1, pitch_px) for side in distance.shape)
    corner_px = top - margin_px, left - margin_px
    s_px = _sampled(distance, rows, columns, pitch_px)
    return Lattice(crop, corner_px, distance, narrow, rows, columns, pitch_px, s_px).fitted()


def erode(lattice: Lattice, height_px: Float32, spec: SolidSpec) -> Float32:
    """Erode the ink with the kernel that belongs to a height: one layer, shape (R, C), of how deep nodes lie.

    Positive where the binary erosion of that kernel leaves the node, and 0 on the surface: lengths in pixels.
    """
    depth = depth_px(lattice.s_px, height_px, spec)
    depth += np.float32(CHORD_LOSS * lattice.pitch_px**2 / spec.half_thickness_px)
    # A node on the surface itself would give triangles without area.
    nudged = np.where(depth > 0, lattice.least_px, -lattice.least_px)
    return np.where(np.abs(depth) < lattice.least_px, nudged, depth)


def stack(layers: Sequence[AnyArray]) -> AnyArray:
    """Put layers of shape (H, W) on top of one another, from the mid-plane up."""
    return np.stack(layers, axis=2)


def mirror(upper: Float32) -> Mirrored:
    """Let the layers above the mid-plane stand for those below it as well.

    Marching cubes and smoothing of the upper half alone give what they give of the whole; the surface is
    mirrored when it is scaled.
    """
    return Mirrored(upper)


def signed_distance_px(mask: Bool, inside_px: float, outside_px: float) -> Float32:
    """Measure how far each pixel centre lies from the outline of the ink, positive inside, up to two reaches.

    The outline runs between pixels, half a pixel from the centres on either side of it. What lies beyond the
    image is paper only if the image says so at its edge. Exact up to the reaches, which are below 127. First
    along the rows, then over the offsets of the columns (Felzenszwalb and Huttenlocher 2012 write the
    transform that way); with a short reach plain passes over small integers beat their lower envelope.
    """
    from mnist3d import kernels

    return np.asarray(kernels.signed_distance_px(mask, inside_px + 0.5, outside_px + 0.5))


def _first_pitch_px(distance: Float32, spec: SolidSpec) -> float:
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


def _crossed_edges(s_px: Float32, pitch_px: float, spec: SolidSpec) -> int:
    """Count the edges that pass through the whole surface: next to and above the nodes, the rim only once."""
    layers = np.ceil(half_height_px(s_px, spec) / np.float32(pitch_px)).astype(np.int32)
    beside = np.abs(np.diff(layers, axis=0)).sum() + np.abs(np.diff(layers, axis=1)).sum()
    inked = layers > 0
    rim = np.count_nonzero(inked[1:] != inked[:-1]) + np.count_nonzero(inked[:, 1:] != inked[:, :-1])
    return int(2 * (beside + np.count_nonzero(inked)) - rim)


def _refined(nodes: Float64, lines: Int64, count: int) -> Float64:
    """Put nodes on every pixel of the lines in which something is missed, and on those next to them."""
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


def _sampled(distance: Float32, rows: Float64, columns: Float64, pitch_px: float) -> Float32:
    """Return the distances from the outline at nodes; those near a ridge are blurred more."""
    s, ridge = (_blurred(distance, rows, columns, blur) for blur in (BLUR_PER_PITCH, RIDGE_BLUR_PER_PITCH))
    share = np.clip(s / np.float32(RIDGE_DEPTH_PER_PITCH * pitch_px) - 1, 0, 1)
    return np.asarray(s + share * (ridge - s))


def _blurred(values: Float32, rows: Float64, columns: Float64, sigma_per_pitch: float) -> Float32:
    """Return what a blur as wide as the nodes lie apart leaves of values at the nodes.

    Values and weights lie on grids so coarse that every product and every sum of them is exact in double
    precision: so they are the same bits on every processor.
    """
    from mnist3d import kernels

    blur = sigma_per_pitch, BELL_REACH, _WEIGHT_GRAIN
    halfway = _on_grid(kernels.blurred(values, rows, *blur), _FACTOR_GRAIN_PX)
    across = kernels.blurred(np.ascontiguousarray(halfway.T), columns, *blur)
    return _on_grid(across.T, GRAIN_PX).astype(np.float32)


def _on_grid(values: NDArray[F], grain: float) -> NDArray[F]:
    # Powers of two of the type of the values: nothing but the rounding changes a bit.
    return np.asarray(np.round(values * values.dtype.type(1 / grain)) * values.dtype.type(grain))


def _linear(nodes: Float64, pixels: Int64) -> tuple[AnyArray, ...]:
    """Return the nodes before pixels and the weights of these and the next ones."""
    before = np.searchsorted(nodes[1:-1], pixels, side="right")
    share = np.clip((pixels - nodes[before]) / (nodes[before + 1] - nodes[before]), 0, 1)
    return before, _on_grid(1 - share, _WEIGHT_GRAIN), _on_grid(share, _WEIGHT_GRAIN)
