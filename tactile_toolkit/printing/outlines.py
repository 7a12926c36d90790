"""Outlines of objects seen from above, and the cells of a plate that they need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Grid", "Outline", "cells_touched", "outline_of", "signed_area"]

Rings = Sequence["NDArray[np.float64]"]

_ARC_SEGMENTS = 64
_SAMPLES_PER_CELL = 8


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """What an object covers of the plate, its lower left corner at the origin.

    Attributes
    ----------
    rings : tuple of ndarray of float64, shape (n, 2)
        Closed rings in mm, holes turned the other way round.
    size_mm : tuple of float
        Along x and y.
    low_mm : tuple of float
        Where the lower left corner is in the object's own frame.
    """

    rings: tuple[NDArray[np.float64], ...]
    size_mm: tuple[float, float]
    low_mm: tuple[float, float]

    @property
    def parts(self) -> int:
        """How many separate parts are seen from above."""
        return sum(signed_area(ring) > 0 for ring in self.rings)

    def claimed(self) -> Outline:
        """Return what no other object may enter: of one part, the outline; of several, their convex hull.

        Parts that stand alone would not be told from those of another object that stands among them.
        """
        if self.parts <= 1:
            return self
        import manifold3d

        hull = manifold3d.CrossSection([*self.rings], manifold3d.FillRule.Positive).hull()
        rings = tuple(np.asarray(ring, np.float64) for ring in hull.to_polygons())
        return Outline(rings, self.size_mm, self.low_mm)

    def grown(self, by_mm: float) -> Any:
        """Return everything within a distance of the outline.

        Returns
        -------
        manifold3d.CrossSection
        """
        import manifold3d

        section = manifold3d.CrossSection([*self.rings], manifold3d.FillRule.Positive)
        # Arcs become chords, which lie inside them: the polygon is drawn around the arc instead.
        around_mm = by_mm / math.cos(math.pi / _ARC_SEGMENTS)
        return section.offset(around_mm, manifold3d.JoinType.Round, circular_segments=_ARC_SEGMENTS)


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells over a plate and half a gap around it.

    An object needs the cells that it touches when grown by half the gap. Objects that share no cell, each
    moved by whole cells, are therefore at least a gap apart.

    Attributes
    ----------
    plate_mm : tuple of float
        Width and depth of the plate.
    gap_mm : float
        Distance between objects.
    pitch_mm : float
        Largest side of a cell.
    """

    plate_mm: tuple[float, float]
    gap_mm: float
    pitch_mm: float

    @property
    def columns(self) -> int:
        """Number of cells along x."""
        return math.ceil((self.plate_mm[0] + self.gap_mm) / self.pitch_mm)

    @property
    def rows(self) -> int:
        """Number of cells along y."""
        return math.ceil((self.plate_mm[1] + self.gap_mm) / self.pitch_mm)

    @property
    def cell_mm(self) -> tuple[float, float]:
        """Sides of a cell: whole cells fill the plate exactly."""
        width_mm, depth_mm = self.plate_mm
        return (width_mm + self.gap_mm) / self.columns, (depth_mm + self.gap_mm) / self.rows

    @property
    def area_mm2(self) -> float:
        """Area of all cells."""
        return (self.plate_mm[0] + self.gap_mm) * (self.plate_mm[1] + self.gap_mm)

    def cells_of(self, outline: Outline, apart_mm: float | None = None) -> NDArray[np.bool_]:
        """Return the cells that an outline needs.

        Parameters
        ----------
        outline : Outline
        apart_mm : float, optional
            Distance to keep, the gap by default; at most the gap.

        Returns
        -------
        ndarray of bool, shape (rows, columns)
            Its first cell begins half a gap left of and below the outline's lower left corner.
        """
        apart_mm = self.gap_mm if apart_mm is None else apart_mm
        shape = self._extent(outline)
        cell_mm = np.array(self.cell_mm)
        # Sampled edges may cut the corner of a cell unseen; growing by half a step makes up for it.
        slack_mm = float(cell_mm.max()) / _SAMPLES_PER_CELL / 2
        rings = outline.grown(apart_mm / 2 + slack_mm).to_polygons()
        return cells_touched([(np.asarray(ring) + self.gap_mm / 2) / cell_mm for ring in rings], shape)

    def _extent(self, outline: Outline) -> tuple[int, int]:
        columns, rows = (
            math.ceil((side_mm + self.gap_mm) / cell_mm - 1e-6)
            for side_mm, cell_mm in zip(outline.size_mm, self.cell_mm, strict=True)
        )
        return rows, columns


def outline_of(manifold: Any) -> Outline:
    """Return what a solid covers of the plate.

    Parameters
    ----------
    manifold : manifold3d.Manifold
        In mm, z up.

    Returns
    -------
    Outline
    """
    section = manifold.project()
    left, front, right, back = section.bounds()
    rings = tuple(np.asarray(ring, np.float64) - (left, front) for ring in section.to_polygons())
    return Outline(rings, (right - left, back - front), (left, front))


def signed_area(ring: NDArray[np.float64]) -> float:
    """Return the area within a closed ring, negative where it is turned clockwise, as holes are."""
    x, y = ring.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def cells_touched(rings: Rings, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the cells that polygons touch.

    Parameters
    ----------
    rings : sequence of ndarray of float64, shape (n, 2)
        Closed rings in units of cells, x then y; rings within rings are holes.
    shape : tuple of int
        Rows and columns; what lies outside is cut off.

    Returns
    -------
    ndarray of bool, shape (rows, columns)
        Cells whose middle is inside, and cells that an edge runs through. A corner cut by less than an
        eighth of a cell may be missed.
    """
    starts = np.concatenate(list(rings))
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    return np.asarray(_middles_inside(starts, ends, shape) | _crossed(starts, ends, shape))


def _middles_inside(
    starts: NDArray[np.float64], ends: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Count, for each middle, the edges to its left: an odd number means inside."""
    rows = np.arange(shape[0]) + 0.5
    low, high = np.minimum(starts[:, 1], ends[:, 1]), np.maximum(starts[:, 1], ends[:, 1])
    edge, row = np.nonzero((low[:, None] <= rows) & (rows < high[:, None]))
    share = (rows[row] - starts[edge, 1]) / (ends[edge, 1] - starts[edge, 1])
    x = starts[edge, 0] + share * (ends[edge, 0] - starts[edge, 0])
    flips = np.zeros((shape[0], shape[1] + 1), np.int64)
    np.add.at(flips, (row, np.clip(np.ceil(x - 0.5), 0, shape[1]).astype(int)), 1)
    return np.asarray(flips.cumsum(axis=1)[:, :-1] % 2 == 1)


def _crossed(
    starts: NDArray[np.float64], ends: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Walk along each edge in small steps."""
    lengths = np.linalg.norm(ends - starts, axis=1)
    steps = np.maximum(np.ceil(lengths * _SAMPLES_PER_CELL).astype(int), 1)
    edge = np.repeat(np.arange(len(steps)), steps)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)
    points = starts[edge] + (step / steps[edge])[:, None] * (ends - starts)[edge]
    column, row = np.floor(points).astype(int).T
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    cells = np.zeros(shape, bool)
    cells[row[inside], column[inside]] = True
    return cells
