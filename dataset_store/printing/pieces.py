"""Pieces to place: an object, together with its tag where it has one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import correlate

from dataset_store.errors import InputError
from dataset_store.printing.checked import require_solid
from dataset_store.printing.objects import standing
from dataset_store.printing.outlines import Grid, Outline, outline_of
from dataset_store.printing.tags import tag_size_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dataset_store.printing.objects import PrintObject
    from dataset_store.printing.plate_spec import PlateSpec

__all__ = ["Piece", "make_piece"]

Cell = tuple[int, int]

_PLACES_TRIED = 200
_NEARER_MM = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """An object and its tag as one thing to place.

    Attributes
    ----------
    item : PrintObject
        The object.
    outline : Outline
        What it covers.
    height_mm, volume_mm3 : float
        Of the object.
    cells : ndarray of bool, shape (rows, columns)
        Cells that object and tag need.
    object_cell, tag_cell : tuple of int, or None
        Row and column of the first cell of each among ``cells``.
    area_mm2 : float
        What both need of the plate, each grown by half the gap.
    """

    item: PrintObject
    outline: Outline
    height_mm: float
    volume_mm3: float
    cells: NDArray[np.bool_]
    object_cell: Cell
    tag_cell: Cell | None
    area_mm2: float


def make_piece(item: PrintObject, spec: PlateSpec, scale: float) -> Piece:
    """Measure an object and find a place for its tag.

    Parameters
    ----------
    item : PrintObject
        The object.
    spec : PlateSpec
        The plate.
    scale : float
        Factor on all lengths.

    Returns
    -------
    Piece

    Raises
    ------
    InputError
        It is larger than the plate, alone or with its tag.
    ItemError
        It is no solid.
    """
    verdict = require_solid(standing(item.load(), scale))
    outline = outline_of(verdict.manifold)
    if not _fits(outline.size_mm, spec):
        raise InputError(_too_large(item, outline.size_mm, spec, "it"))
    box = verdict.manifold.bounding_box()
    figures = (float(box[5] - box[2]), verdict.volume_mm3)
    grid = spec.grid
    cells = grid.cells_of(outline)
    area_mm2 = float(outline.grown(spec.gap_mm / 2).area())
    if not spec.label:
        return Piece(item, outline, *figures, cells, (0, 0), None, area_mm2)
    tag = _tag_outline(item)
    object_cell, tag_cell = _beside(outline, tag, cells, item, spec)
    joined = _joined(cells, object_cell, grid.cells_of(tag), tag_cell)
    # The rims of an object and its own tag overlap: the tag alone is what it surely needs in addition.
    tag_mm2 = tag.size_mm[0] * tag.size_mm[1]
    return Piece(item, outline, *figures, joined, object_cell, tag_cell, area_mm2 + tag_mm2)


def _fits(size_mm: tuple[float, float], spec: PlateSpec) -> bool:
    return size_mm[0] <= spec.width_mm + 1e-6 and size_mm[1] <= spec.depth_mm + 1e-6


def _too_large(item: PrintObject, size_mm: tuple[float, float], spec: PlateSpec, what: str) -> str:
    return (
        f"{item.name} does not fit on the plate: {what} needs {size_mm[0]:.1f} x {size_mm[1]:.1f} mm, the "
        f"plate is {spec.width_mm:g} x {spec.depth_mm:g} mm; nothing was written; next: a larger "
        "--plate, a smaller --scale, or other --ids"
    )


def _tag_outline(item: PrintObject) -> Outline:
    width_mm, depth_mm = size_mm = tag_size_mm(str(item.id))
    ring = np.array([(0.0, 0.0), (width_mm, 0.0), (width_mm, depth_mm), (0.0, depth_mm)])
    return Outline((ring,), size_mm, (0.0, 0.0))


def _beside(
    outline: Outline, tag: Outline, cells: NDArray[np.bool_], item: PrintObject, spec: PlateSpec
) -> tuple[Cell, Cell]:
    """Choose the place that makes the piece least larger, a bay of the object where there is one."""
    grid = spec.grid
    small = grid.cells_of(tag)
    clear = ~_touching(cells, small)
    # Cells alone cannot tell what lies between touching and a whole gap apart.
    likely = ~clear & ~_touching(grid.cells_of(outline, 0.0), grid.cells_of(tag, 0.0))
    places = _ranked(likely, cells.shape, small.shape, grid)
    best = _first_within(places, outline, tag, spec)
    if best is None:
        best = next(iter(_ranked(clear, cells.shape, small.shape, grid)), None)
    if best is None:
        size_mm = (outline.size_mm[0], outline.size_mm[1] + spec.tag_gap_mm + tag.size_mm[1])
        raise InputError(_too_large(item, size_mm, spec, "with its tag it"))
    first = min(0, best[0]), min(0, best[1])
    return (-first[0], -first[1]), (best[0] - first[0], best[1] - first[1])


def _ranked(free: NDArray[np.bool_], shape: Cell, small: Cell, grid: Grid) -> list[Cell]:
    """List places of a tag by how little larger they make the piece, then from the middle outwards.

    Parameters
    ----------
    free : ndarray of bool
        See :func:`_touching`.
    shape, small : tuple of int
        Rows and columns of object and tag.
    grid : Grid
        Of the plate, on which the piece has to fit.
    """
    row, column = (places - side for places, side in zip(np.nonzero(free), small, strict=True))
    height = np.maximum(shape[0], row + small[0]) - np.minimum(0, row)
    width = np.maximum(shape[1], column + small[1]) - np.minimum(0, column)
    away = (row + (small[0] - shape[0]) / 2) ** 2 + (column + (small[1] - shape[1]) / 2) ** 2
    order = np.lexsort((away, height * width))
    order = order[((height <= grid.rows) & (width <= grid.columns))[order]]
    return list(zip(row[order].tolist(), column[order].tolist(), strict=True))


def _first_within(places: list[Cell], outline: Outline, tag: Outline, spec: PlateSpec) -> Cell | None:
    """Find the first place that is nearer than the gap: beyond it another object may be nearer to the tag."""
    if spec.tag_gap_mm >= spec.gap_mm - _NEARER_MM:
        return None
    cell_width_mm, cell_depth_mm = spec.grid.cell_mm
    body, near, far = outline.grown(0.0), tag.grown(spec.tag_gap_mm), tag.grown(spec.gap_mm - _NEARER_MM)
    for row, column in places[:_PLACES_TRIED]:
        shift = (column * cell_width_mm, row * cell_depth_mm)
        meets = not (far.translate(shift) ^ body).is_empty()
        if meets and (near.translate(shift) ^ body).is_empty():
            return row, column
    return None


def _touching(cells: NDArray[np.bool_], small: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell where a small shape shares cells with another one.

    Returns
    -------
    ndarray of bool
        One entry per place of the small shape, from the one that ends before the other's first cell on.
    """
    around = np.pad(cells, [(side, side) for side in small.shape])
    return np.asarray(np.rint(correlate(around.astype(float), small.astype(float), "valid", "fft")) > 0)


def _joined(
    cells: NDArray[np.bool_], object_cell: Cell, tag: NDArray[np.bool_], tag_cell: Cell
) -> NDArray[np.bool_]:
    parts = ((cells, object_cell), (tag, tag_cell))
    shape = tuple(max(part.shape[axis] + first[axis] for part, first in parts) for axis in (0, 1))
    joined = np.zeros(shape, bool)
    for part, (row, column) in parts:
        joined[row : row + part.shape[0], column : column + part.shape[1]] |= part
    return joined
