"""Pieces to place: an object, together with its tag where it has one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.printing.checked import require_solid
from tactile_toolkit.printing.objects import standing
from tactile_toolkit.printing.outlines import Outline, outline_of
from tactile_toolkit.printing.tag_places import place_tag
from tactile_toolkit.printing.tags import tag_size_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.printing.objects import PrintObject
    from tactile_toolkit.printing.plate_spec import PlateSpec

__all__ = ["Piece", "make_piece"]

Corner = tuple[float, float]


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
        Cells that object and tag need; an object of several parts needs what lies among them too.
    object_mm, tag_mm : tuple of float, or None
        Lower left corner of each, from that of both together.
    area_mm2 : float
        What both need of the plate, grown by half the gap.
    """

    item: PrintObject
    outline: Outline
    height_mm: float
    volume_mm3: float
    cells: NDArray[np.bool_]
    object_mm: Corner
    tag_mm: Corner | None
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
    whole, object_mm, tag_mm = outline.claimed(), (0.0, 0.0), None
    if spec.label:
        whole, object_mm, tag_mm = _with_tag(item, outline, spec)
    area_mm2 = float(whole.grown(spec.gap_mm / 2).area())
    return Piece(item, outline, *figures, spec.grid.cells_of(whole), object_mm, tag_mm, area_mm2)


def _with_tag(item: PrintObject, outline: Outline, spec: PlateSpec) -> tuple[Outline, Corner, Corner]:
    """Join an object and its tag; return both as one outline, and where each is in it."""
    tag = _tag_outline(item)
    place = place_tag(outline, tag, spec)
    if place is None:
        size_mm = (outline.size_mm[0], outline.size_mm[1] + spec.tag_gap_mm + tag.size_mm[1])
        raise InputError(_too_large(item, size_mm, spec, "with its tag it"))
    low = np.minimum(0.0, place)
    high = np.maximum(outline.size_mm, np.add(place, tag.size_mm))
    rings = (*(ring - low for ring in outline.claimed().rings), tag.rings[0] + place - low)
    whole = Outline(rings, _corner(high - low), (0.0, 0.0))
    return whole, _corner(-low), _corner(place - low)


def _corner(sides: NDArray[np.float64]) -> Corner:
    return float(sides[0]), float(sides[1])


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
