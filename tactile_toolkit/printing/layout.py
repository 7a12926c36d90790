"""What lies where on build plates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.printing.checked import Failure
from tactile_toolkit.printing.objects import require_scale
from tactile_toolkit.printing.packing import Spot, pack
from tactile_toolkit.printing.pieces import Piece, make_piece
from tactile_toolkit.printing.tags import tag_size_mm

if TYPE_CHECKING:
    from tactile_toolkit.printing.objects import PrintObject
    from tactile_toolkit.printing.outlines import Outline
    from tactile_toolkit.printing.plate_spec import PlateSpec

__all__ = ["Layout", "Measured", "Placed", "Tag", "arrange", "measure"]

Progress = Callable[[int, int], None]


def _silent(_done: int, _total: int) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Tag:
    """A tag on a plate.

    Attributes
    ----------
    text : str
        What it shows.
    x_mm, y_mm : float
        Its lower left corner, from the front left corner of the plate.
    width_mm, depth_mm : float
        Its sides.
    """

    text: str
    x_mm: float
    y_mm: float
    width_mm: float
    depth_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """An object on a plate.

    Attributes
    ----------
    item : PrintObject
        The object.
    outline : Outline
        What it covers.
    x_mm, y_mm : float
        Lower left corner of its bounding box, from the front left corner of the plate.
    height_mm, volume_mm3 : float
        Of the object.
    tag : Tag or None
        Its tag.
    """

    item: PrintObject
    outline: Outline
    x_mm: float
    y_mm: float
    height_mm: float
    volume_mm3: float
    tag: Tag | None

    @property
    def offset_mm(self) -> tuple[float, float, float]:
        """How the object moves from the place that it is stored at; z = 0 is its lowest point already."""
        return self.x_mm - self.outline.low_mm[0], self.y_mm - self.outline.low_mm[1], 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """A packing.

    Attributes
    ----------
    spec : PlateSpec
        Of the plates.
    scale : float
        Factor on all lengths.
    plates : tuple of tuple of Placed
        What lies on each, from front to back.
    least_plates : int
        No packing needs fewer: the area that all need, over that of a plate.
    shares : tuple of float
        Share of each plate that is needed, so counted.
    failures : tuple of Failure
        Objects that are no solids and were left out.
    """

    spec: PlateSpec
    scale: float
    plates: tuple[tuple[Placed, ...], ...]
    least_plates: int
    shares: tuple[float, ...]
    failures: tuple[Failure, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Objects made ready for packing.

    Attributes
    ----------
    spec : PlateSpec
        Of the plates.
    scale : float
        Factor on all lengths.
    pieces : tuple of Piece
        In the order of the objects.
    failures : tuple of Failure
        Objects that are no solids and were left out.
    """

    spec: PlateSpec
    scale: float
    pieces: tuple[Piece, ...]
    failures: tuple[Failure, ...]


def measure(
    objects: Sequence[PrintObject], spec: PlateSpec, scale: float = 1.0, on_progress: Progress = _silent
) -> Measured:
    """Take the outline of every object, with its tag where the plates have tags.

    Parameters
    ----------
    objects : sequence of PrintObject
        What to print.
    spec : PlateSpec
        Plates.
    scale : float
        Factor on all lengths.
    on_progress : callable
        Told objects done and in all.

    Raises
    ------
    InputError
        An object, alone or with its tag, is larger than a plate; two would have the same tag; or the scale is
        not positive.
    """
    require_scale(scale)
    if spec.label:
        _require_own_tags(objects)
    pieces, failures = [], []
    for done, item in enumerate(objects, 1):
        try:
            pieces.append(make_piece(item, spec, scale))
        except ItemError as error:
            failures.append(Failure(item.name, error.reason, f"{error}; it was left out"))
        on_progress(done, len(objects))
    return Measured(spec, scale, tuple(pieces), tuple(failures))


def _require_own_tags(objects: Iterable[PrintObject]) -> None:
    first: dict[int, PrintObject] = {}
    for item in objects:
        other = first.setdefault(item.id, item)
        if other is not item:
            message = (
                f"--label: {other.name} and {item.name} have the same id {item.id}, and a tag shows the id "
                "alone; next: one --split at a time, or no --label"
            )
            raise InputError(message)


def arrange(measured: Measured, on_progress: Progress = _silent) -> Layout:
    """Find a place for every object on few plates; objects are moved, never turned.

    Parameters
    ----------
    measured : Measured
        What to place.
    on_progress : callable
        Told objects placed and in all, over all attempts.

    Returns
    -------
    Layout
        The same for the same input.
    """
    spec, pieces = measured.spec, measured.pieces
    grid = spec.grid
    least = math.ceil(sum(piece.area_mm2 for piece in pieces) / grid.area_mm2 - 1e-9)
    spots = pack([piece.cells for piece in pieces], (grid.rows, grid.columns), least, on_progress)
    plates = tuple(
        _front_to_back(_placed(pieces[spot.shape], spot, spec) for spot in plate) for plate in spots
    )
    shares = tuple(sum(pieces[spot.shape].area_mm2 for spot in plate) / grid.area_mm2 for plate in spots)
    return Layout(spec, measured.scale, plates, least, shares, measured.failures)


def _placed(piece: Piece, spot: Spot, spec: PlateSpec) -> Placed:
    cell_width_mm, cell_depth_mm = spec.grid.cell_mm

    def moved(corner_mm: tuple[float, float]) -> tuple[float, float]:
        return spot.column * cell_width_mm + corner_mm[0], spot.row * cell_depth_mm + corner_mm[1]

    tag = None
    if piece.tag_mm is not None:
        text = str(piece.item.id)
        tag = Tag(text, *moved(piece.tag_mm), *tag_size_mm(text))
    corner = moved(piece.object_mm)
    return Placed(piece.item, piece.outline, *corner, piece.height_mm, piece.volume_mm3, tag)


def _front_to_back(plate: Iterable[Placed]) -> tuple[Placed, ...]:
    return tuple(sorted(plate, key=lambda placed: (placed.y_mm, placed.x_mm)))
